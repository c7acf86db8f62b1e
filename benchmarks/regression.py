"""Whether the kernels are as fast as they should be, in ratios of one run: `python -m benchmarks.regression`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

from baselines.tables import markdown_table, text_table
from benchmarks.machine import describe, machine
from benchmarks.output import Output
from capsule_gym.command_line import parse

COMMAND = "python -m benchmarks.regression"


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """Measures the ratios that the kernels must keep, and fails where one is below its floor.

    Examples:
      python -m benchmarks.regression
      python -m benchmarks.regression --markdown docs/speed_ratios.md
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns 1 where a ratio misses its floor."""
    options = parse(Options, COMMAND, arguments)
    # After the command line is known to be right: the help needs none of it.
    from benchmarks.ratios import HEADER, guards

    found, rows, ratios = machine(), [HEADER], {}
    missed = False
    for guard in guards():
        ratio = ratios[guard.name] = guard.best()
        missed |= guard.misses(ratio)
        rows.append(guard.row(ratio))
    print(text_table(rows))
    numbers = {"machine": found, "ratios": ratios}
    options.write(COMMAND, numbers, [markdown_table(rows), "", f"{describe(found)}."])
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
