"""Compares the main table of the leaderboard with plants drawn anew: `python -m
benchmarks.fresh_draws`.
"""

import sys
from itertools import chain
from typing import Annotated

from agents.leaderboard.__main__ import ROOT
from agents.leaderboard.page import GROUPS, MAIN_SETS, SPEED
from agents.leaderboard.rows import RESULTS, load_row
from baselines.tables import text_table
from capsule_gym.command_line import Positional, arg, command
from capsule_gym.evaluation.episodes import evaluate, failures, scores, validation_set
from capsule_gym.evaluation.sets import load_set
from capsule_gym.evaluation.statistics import estimate

# Seeds far from those of frozen sets, 0, 1, ..
FIRST_SEED, PLANTS = 31_000_000, 400


@command("python -m benchmarks.fresh_draws", ValueError)
def main(rows: Annotated[Positional[tuple[str, ...]], arg(metavar="ROW")] = ()) -> int:
    """Evaluates rows of the leaderboard's main table on new plants; fails if a mean speed differs
    from the table.

    They agree if the published interval covers the new mean, or within two standard errors of both
    sets of plants.

    Examples:
      python -m benchmarks.fresh_draws pd lqr

    Args:
        rows: Rows; all of the main table by default.
    """
    differing = 0
    lines = [["row", "set", "published (cm/s)", "new", "standard errors", "failures", ""]]
    for row in [
        load_row(ROOT / RESULTS / f"{name}.npz") for name in rows or chain(*GROUPS.values())
    ]:
        for set_name in MAIN_SETS:
            like = load_set(set_name)
            drawn = validation_set(
                set_name, "new", FIRST_SEED, PLANTS, like.capsule, "speed", like.disturbances
            )
            episodes, before = evaluate(row.name, drawn), row.score(set_name, SPEED.name)
            now, published = scores(episodes, SPEED.name), estimate(before, mean=True)
            error = (
                sum(each.mean(axis=0).var(ddof=1) / each.shape[1] for each in (before, now)) ** 0.5
            )
            errors = (now.mean() - published.value) / error
            differs = not (published.low <= now.mean() <= published.high or abs(errors) <= 2.0)
            differing += differs
            cells = [
                f"{published.value:.2f} [{published.low:.2f}, {published.high:.2f}]",
                f"{now.mean():.2f}",
            ]
            cells += [f"{errors:+.1f}", f"{failures(episodes)}/{len(episodes)}"]
            lines.append([row.name, set_name, *cells, "differs" if differs else ""])
    print(f"{text_table(lines, left=2)}\n{differing} of {len(lines) - 1} means differ")
    return int(differing > 0)


if __name__ == "__main__":
    sys.exit(main())
