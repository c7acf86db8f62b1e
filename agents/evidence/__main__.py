"""Writes what the leaderboard's results show, and how surely: `python -m agents.evidence`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agents.evaluation import policies as evaluation_policies
from agents.evaluation.policies import all_candidates
from agents.evidence.figures import draw_all
from agents.evidence.material import gather
from agents.evidence.page import COMMAND, render
from agents.leaderboard.rows import RESULTS, load_rows
from capsule_gym.command_line import parse, refuse
from capsule_gym.evaluation_sets import SET_NAMES, load_set
from capsule_gym.files import write_atomically

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Options:
    """Makes the tables and figures of docs/evidence.md from the results of the leaderboard; evaluates nothing.

    Examples:
      python -m agents.evidence            write docs/evidence_tables.md and docs/figures/evidence_*.png
      python -m agents.evidence --check    fail where the tables are stale
    """

    check: bool = False
    """Write nothing; fail where docs/evidence_tables.md is not what the results give."""


def main(arguments: Sequence[str] | None = None, *, root: Path = ROOT) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    path = root / "docs" / "evidence_tables.md"
    try:
        rows = load_rows(root / RESULTS, [candidate.name for candidate in all_candidates()])
        evidence = gather(rows, [load_set(name) for name in SET_NAMES], evaluation_policies.CHECKPOINTS)
    except ValueError as error:
        refuse(COMMAND, str(error))
    text = render(evidence)
    if options.check:
        if path.is_file() and path.read_text(encoding="utf-8") == text:
            print(f"{path.relative_to(root)} is what the results give.")
            return 0
        print(f"{path.relative_to(root)} is stale: run `{COMMAND}` and commit what it writes.")
        return 1
    written = draw_all(evidence, root / "docs" / "figures")
    write_atomically(path, text)
    print("Written:", path.relative_to(root), *(each.relative_to(root) for each in written), sep="\n- ")
    return 0


if __name__ == "__main__":
    sys.exit(main())
