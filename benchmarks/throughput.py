"""Speed of the environment beside its peers, and what accuracy costs: `python -m benchmarks.throughput`.

Three tables from one run: environment steps per second, the error of a simulated trajectory over the computing that it
takes, and the creep of a platform that friction should hold. Peers that need a package more come with the extra
`bench`. Nothing else should run on the machine meanwhile.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from benchmarks import contenders
from benchmarks.machine import available_cores, describe, machine
from benchmarks.output import Output, check_at_least_one
from benchmarks.timing import measure, present
from capsule_gym.command_line import Count, check_output, parse
from capsule_gym.parameters import DIRECT_PHYSICS_DT

COMMAND = "python -m benchmarks.throughput"
TURNS, QUICK_TURNS = 9, 3
TURN_SECONDS = 0.2
# MuJoCo's finest steps take seconds each, and the costs span three decades: fewer turns tell them apart.
COST_TURNS_SHARE = 0.5
TRAJECTORIES, QUICK_TRAJECTORIES = 16, 4


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """Environment steps per second beside peers, accuracy against cost, and creep below the friction limit.

    Peers that need a package more come with the extra `bench`. Takes many minutes; nothing else should run meanwhile.

    Examples:
      python -m benchmarks.throughput --quick
      python -m benchmarks.throughput --markdown docs/speed_tables.md --figure docs/figures/speed.png
    """

    turns: Annotated[Count | None, arg(help=f"turns of every contender: {TURNS}, with --quick {QUICK_TURNS}")] = None
    quick: Annotated[bool, arg(help=f"fewer turns and trajectories, no batch of {contenders.LARGE:,}")] = False
    figure: Path | None = None
    """Draw the chart into this .png file."""

    def check(self) -> None:
        """Refuses what cannot be measured or written."""
        super().check()
        check_output("--figure", self.figure, overwrite=True)
        if self.figure is not None and self.figure.suffix != ".png":
            raise ValueError(f"--figure must name a .png file, got {str(self.figure)!r}")
        if self.turns is not None:
            check_at_least_one("--turns", self.turns)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    # After the command line is known to be right: importing scipy's solvers and matplotlib takes a second.
    from benchmarks import cost, creep, speed_figure, speed_tables

    start, found = time.perf_counter(), machine("mujoco", "envpool")
    turns = options.turns or (QUICK_TURNS if options.quick else TURNS)
    cost_turns = math.ceil(COST_TURNS_SHARE * turns)
    trajectories = QUICK_TRAJECTORIES if options.quick else TRAJECTORIES
    everything = [*contenders.ours(large=not options.quick), *contenders.peers()]
    present_ones, left_out = present(everything, available_cores())
    for line in left_out:
        print(line, file=sys.stderr, flush=True)
    with_mujoco = any("mujoco" in contender.packages for contender in present_ones)
    measured = speed_tables.Measurements(
        present_ones,
        measure(present_ones, turns, TURN_SECONDS, "rates"),
        cost.measure_points(with_mujoco, cost_turns, TURN_SECONDS, trajectories, options.quick),
        creep.table(DIRECT_PHYSICS_DT, with_mujoco),
        trajectories,
    )
    sections = speed_tables.sections(measured)
    spread = f"medians of {turns} turns ({cost_turns} for the costs), IQR: interquartile range over it"
    notes = [f"{describe(found)}; {spread}.", *left_out]
    print(speed_tables.as_text(sections, notes))
    numbers = {
        "machine": found,
        "turns": turns,
        "cost_turns": cost_turns,
        "turn_seconds": TURN_SECONDS,
        "seconds": time.perf_counter() - start,
        "left_out": left_out,
        **measured.to_dict(),
    }
    options.write(COMMAND, numbers, speed_tables.as_markdown(sections, notes))
    if options.figure is not None:
        speed_figure.save(options.figure, measured.contenders, measured.rates, measured.points, notes[0])
    return 0


if __name__ == "__main__":
    sys.exit(main())
