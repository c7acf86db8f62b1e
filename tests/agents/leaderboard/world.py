"""Helpers of the leaderboard's tests: sets of a few short episodes, and functions that write, read and change rows."""

import dataclasses
import json

from agents.leaderboard.__main__ import check
from agents.leaderboard.page import build, files
from agents.leaderboard.rows import RESULTS, evaluate, load_row, path_of, save_row
from baselines.evaluation.policies import all_candidates
from capsule_gym.evaluation_sets import parse_set

HORIZON = 0.6


def make_set(name, *plants):
    return parse_set({"name": name, "plants": [{"M": M, "mu": mu, "seed": i} for i, (M, mu) in enumerate(plants)]})


SETS = [make_set("nominal", (0.5, 0.01)), make_set("paper", (0.5, 0.01), (0.55, 0.011), (0.45, 0.009))]


def write_all(root):
    """Writes the files of `python -m agents.leaderboard`."""
    rows = list(evaluate(all_candidates(), SETS, horizon=HORIZON))
    for row in rows:
        save_row(root / RESULTS, row)
    write_files(root, rows)


def write_files(root, rows):
    for name, text in files(root, build(rows, SETS)).items():
        (root / name).write_text(text)


def checked(root, sets=SETS, evaluated=None, plants=None):
    candidates = all_candidates()
    chosen = candidates if evaluated is None else evaluated
    return check(root, candidates, sets, evaluated=chosen, plants=plants, horizon=HORIZON)


def read(root):
    return json.loads((root / "leaderboard.json").read_text())


def edit_row(root, name, change):
    """Changes a row's results, and writes the files that depend on them."""
    row = load_row(path_of(root / RESULTS, name))
    row = dataclasses.replace(row, scores={name: values.copy() for name, values in row.scores.items()})
    change(row)
    save_row(root / RESULTS, row)
    write_files(root, [load_row(path_of(root / RESULTS, each.name)) for each in all_candidates()])


def row_of(board, name):
    return next(row for row in board["rows"] if row["policy"] == name)


def table(page, title=""):
    """The cells of the first Markdown table below a title, header and rule included."""
    lines = page[page.index(title) :].splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("|"))
    last = next((i for i in range(first, len(lines)) if not lines[i].startswith("|")), len(lines))
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[first:last]]
