"""Writes a page about a run, about some policies, or about the whole leaderboard: `python -m agents.report`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from agents.report import COMMAND
from capsule_gym.command_line import Positional, check_output, parse, refuse


@dataclass(frozen=True)
class Options:
    """Writes one self-contained page: learning curve, measures on every set, speed against cost, profiles, plants.

    Rows of the leaderboard are read from its results, runs of one's own are evaluated on every frozen set.

    Examples:
      python -m agents.report -o report.html
      python -m agents.report direct-ppo residual-on-gait -o report.html
      python -m agents.report runs/my-run -o report.html
    """

    policies: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME_OR_PATH")] = ()
    """Rows of the leaderboard, or paths of runs; the whole leaderboard where there is none."""
    output: Annotated[Path, arg(metavar="FILE", aliases=["-o"])] = Path("report.html")
    """The page."""
    overwrite: bool = False
    """Replace an existing file."""
    trust_controller: bool = False
    """Accept a policy with a control law from elsewhere: importing it runs its code."""

    def check(self) -> None:
        """Refuses a file that cannot be written."""
        check_output("--output", self.output, overwrite=self.overwrite)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    # After the command line is known to be right: the help needs none of it.
    from agents.report.page import write

    try:
        write(options.output, options.policies, trust_controller=options.trust_controller)
    except ValueError as error:
        refuse(COMMAND, str(error))
    print(f"Written: {options.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
