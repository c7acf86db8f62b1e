"""What each trick of the kernel gains: `python -m benchmarks.tricks`.

How they are undone stands in `benchmarks.undoing`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from baselines.tables import markdown_table, text_table
from benchmarks.contenders import ACTION_SCALE
from benchmarks.machine import describe, machine
from benchmarks.output import Output, check_at_least_one
from benchmarks.timing import measure
from capsule_gym.command_line import Count, parse
from capsule_gym.options import DIRECT_PHYSICS_DT
from capsule_gym.task import TORQUE_LIMIT

COMMAND = "python -m benchmarks.tricks"
TURNS = 15
TURN_SECONDS = 0.1


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """What each trick of the kernel gains: its rate as it is, and with one trick undone at a time.

    Examples:
      python -m benchmarks.tricks --markdown docs/speed_tricks.md
    """

    turns: Count = TURNS
    """Turns of every contender."""

    def check(self) -> None:
        """Refuses what cannot be measured or written."""
        super().check()
        check_at_least_one("--turns", self.turns)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    # After the command line is known to be right: the help needs none of it.
    from benchmarks.undoing import contenders, rows

    found, everything = machine(), contenders()
    measured = measure(list(everything.values()), options.turns, TURN_SECONDS, "tricks")
    rates = {key: measured[contender.name] for key, contender in everything.items()}
    note = (
        f"The kernel alone on one core, direct torque uniform within ±{ACTION_SCALE * TORQUE_LIMIT:g} N m, "
        f"{1e3 * DIRECT_PHYSICS_DT:g} ms; medians of {options.turns} turns. {describe(found)}."
    )
    print(text_table(rows(rates)), note, sep="\n\n")
    entries = [{"undone": name, "environments": n, **asdict(rate)} for (name, n), rate in rates.items()]
    numbers: dict[str, Any] = {"machine": found, "turns": options.turns, "rates": entries}
    options.write(COMMAND, numbers, [markdown_table(rows(rates)), "", note])
    return 0


if __name__ == "__main__":
    sys.exit(main())
