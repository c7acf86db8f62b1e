"""What `baselines.paper.variations` finds, in numbers: `python -m baselines.paper.sensitivity`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

from capsule_gym.command_line import parse


@dataclass(frozen=True)
class Options:
    """Prints how far both profiles carry the platform on other plants, contacts and integration steps; some seconds.

    Examples:
      python -m baselines.paper.sensitivity    the speed map in numbers, the normal force of (7), the steps
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parse(Options, "python -m baselines.paper.sensitivity", arguments)
    # After the command line is known to be right: the help needs none of it.
    from baselines.paper.text.sensitivity import study_text

    print(study_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
