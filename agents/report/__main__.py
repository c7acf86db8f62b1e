"""Writes an HTML page about runs, policies or the whole leaderboard: `python -m agents.report --help`."""

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
class Args:
    """Writes one self-contained page: learning curve, metrics on every set, speed and cost, profiles, plants.

    Rows of the leaderboard are read from its results; other runs are evaluated on every frozen set.

    Examples:
      python -m agents.report -o report.html
      python -m agents.report direct-ppo residual-on-gait -o report.html
      python -m agents.report runs/my-run -o report.html
    """

    policies: Annotated[Positional[tuple[str, ...]], arg(metavar="NAME_OR_PATH")] = ()
    """Rows of the leaderboard, or paths of runs; the whole leaderboard by default."""
    output: Annotated[Path, arg(metavar="FILE", aliases=["-o"])] = Path("report.html")
    """The page."""
    overwrite: bool = False
    """Replace an existing file."""
    trust_controller: bool = False
    """Accept a policy with a control law that is not of this package: importing it runs its code."""
    trust_pickle: bool = False
    """Accept the folder of a run with an LSTM, whose agent is unpickled: that can run any code."""

    def check(self) -> None:
        """Checks that the file can be written."""
        check_output("--output", self.output, overwrite=self.overwrite)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    # Imported after the command line is checked: the import is slow, and --help does not need it.
    from agents.report.page import write

    try:
        write(args.output, args.policies, trust_controller=args.trust_controller, trust_pickle=args.trust_pickle)
    except ValueError as error:
        refuse(COMMAND, str(error))
    print(f"Written: {args.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
