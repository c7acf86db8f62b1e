"""Compares the leaderboard's main table with new plants: `python -m benchmarks.fresh_draws`."""

import sys
from itertools import chain
from typing import Annotated

import numpy as np

from agents.leaderboard.__main__ import ROOT
from agents.leaderboard.page import GROUPS, MAIN_SETS, SPEED
from agents.leaderboard.rows import RESULTS, load_row
from baselines.tables import text_table
from capsule_gym.command_line import Positional, arg, command
from capsule_gym.evaluation.episodes import drawn_like, evaluate, failures, scores
from capsule_gym.evaluation.statistics import estimate

# Seeds far from those of frozen sets, 0, 1, ..
FIRST_SEED = 31_000_000
PLANTS = 400
# Standard errors within which means agree.
MOST_ERRORS = 2.0


def variance(speeds: np.ndarray) -> float:
    """The variance of the mean over plants, of shape (training seeds, plants)."""
    return speeds.mean(axis=0).var(ddof=1) / speeds.shape[1]


@command("python -m benchmarks.fresh_draws", ValueError)
def main(rows: Annotated[Positional[tuple[str, ...]], arg(metavar="ROW")] = ()) -> int:
    """Evaluates rows of the leaderboard's main table on new plants.

    Fails if a mean speed differs from the table. They agree if the published interval covers the
    new mean, or within two standard errors of both sets of plants.

    Examples:
      python -m benchmarks.fresh_draws pd lqr

    Args:
        rows: Rows; all of the main table by default.
    """
    lines = [["row", "set", "published (cm/s)", "new", "standard errors", "failures", ""]]
    differing = 0
    for name in rows or chain(*GROUPS.values()):
        row = load_row(ROOT / RESULTS / f"{name}.npz")
        for set_name in MAIN_SETS:
            episodes = evaluate(row.name, drawn_like(set_name, FIRST_SEED, PLANTS))
            new = scores(episodes, SPEED.name)
            before = row.score(set_name, SPEED.name)
            mean = new.mean()
            published = estimate(before, mean=True)
            error = (variance(before) + variance(new)) ** 0.5
            errors = (mean - published.value) / error
            inside = published.low <= mean <= published.high
            differs = not inside and abs(errors) > MOST_ERRORS
            differing += differs
            interval = f"[{published.low:.2f}, {published.high:.2f}]"
            line = [row.name, set_name]
            line.append(f"{published.value:.2f} {interval}")
            line.append(f"{mean:.2f}")
            line.append(f"{errors:+.1f}")
            line.append(f"{failures(episodes)}/{len(episodes)}")
            line.append("differs" if differs else "")
            lines.append(line)
    print(text_table(lines, left=2))
    print(f"{differing} of {len(lines) - 1} means differ")
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
