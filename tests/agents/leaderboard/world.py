"""What the tests of the leaderboard share: sets of a few short episodes, and how to read and change what is written."""

import json

from agents.evaluation.candidates import all_candidates
from agents.evaluation.sets import parse_set
from agents.leaderboard.board import write
from agents.leaderboard.check import check

HORIZON = 0.6


def make_set(name, *plants):
    return parse_set({"name": name, "plants": [{"M": M, "mu": mu, "seed": i} for i, (M, mu) in enumerate(plants)]})


SETS = [make_set("nominal", (0.5, 0.01)), make_set("paper", (0.5, 0.01), (0.55, 0.011), (0.45, 0.009))]


def checked(root, sets=SETS):
    return check(root, all_candidates(), sets, horizon=HORIZON)


def read(root):
    return json.loads((root / "leaderboard.json").read_text())


def edit(root, change, *, pages=True):
    """Changes leaderboard.json, and renders the pages from it unless they should stay behind."""
    board = read(root)
    change(board)
    if pages:
        write(root, board)
    else:
        (root / "leaderboard.json").write_text(json.dumps(board))


def row_of(board, name):
    return next(row for row in board["rows"] if row["policy"] == name)


def table(page, title=""):
    """The cells of the first Markdown table behind a title, header and rule included."""
    lines = page[page.index(title) :].splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("|"))
    last = next((i for i in range(first, len(lines)) if not lines[i].startswith("|")), len(lines))
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[first:last]]
