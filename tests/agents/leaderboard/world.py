"""Helpers of the leaderboard's tests: sets of a few short episodes, and functions that write, read
and change rows."""

import dataclasses
import itertools
import json

from agents.leaderboard.__main__ import check_episodes, find_stale
from agents.leaderboard.candidates import all_candidates
from agents.leaderboard.chart import CHART, draw
from agents.leaderboard.page import MAIN_SETS, build, files
from agents.leaderboard.rows import RESULTS, evaluate, load_row, load_rows, save_row
from capsule_gym.evaluation.sets import parse_set

HORIZON = 0.6


def make_set(name, *plants):
    fields = [{"M": M, "mu": mu, "seed": seed} for seed, (M, mu) in enumerate(plants)]
    return parse_set({"name": name, "plants": fields})


PAPER = make_set("paper", (0.5, 0.01), (0.55, 0.011), (0.45, 0.009))
SETS = [make_set(name, (0.5, 0.01)) for name in ("nominal", *MAIN_SETS) if name != "paper"]
SETS.insert(1, PAPER)


def write_all(root):
    """Writes the files of `python -m agents.leaderboard`."""
    for row in evaluate(all_candidates(), SETS, horizon=HORIZON):
        save_row(root / RESULTS, row)
    write_pages(root)


def write_pages(root):
    rows = load_rows(root / RESULTS, [each.name for each in all_candidates()])
    board = build(rows, SETS)
    (root / CHART).write_text(draw(board))
    for name, text in files(root, board).items():
        (root / name).write_text(text)


def checked(root, sets=SETS):
    return list(find_stale(root, all_candidates(), sets))


def evaluated_again(root, *candidates, plants=None):
    sets = [dataclasses.replace(each, plants=each.plants[:plants]) for each in SETS]
    return list(check_episodes(root, evaluate(candidates, sets, horizon=HORIZON)))


def read(root):
    return json.loads((root / "leaderboard.json").read_text())


def edit_row(root, name, change):
    """Changes a row's results, and writes the files that depend on them."""
    row = load_row(root / RESULTS / f"{name}.npz")
    change(row)
    save_row(root / RESULTS, row)
    write_pages(root)


def table(page, title=""):
    """The cells of the first Markdown table below a title, header and rule included."""
    lines = iter(page[page.index(title) :].splitlines())
    below = itertools.dropwhile(lambda line: not line.startswith("|"), lines)
    rows = itertools.takewhile(lambda line: line.startswith("|"), below)
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]
