"""Processor time of a process that makes the first step of an installed wheel: `python -m benchmarks.first_step`.

The wheel is built and installed in a new virtual environment, with the versions in `constraints.txt`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.measurement import TurnArgs, machine, rates
from capsule_gym.command_line import parse

COMMAND = "python -m benchmarks.first_step"
ROOT = Path(__file__).resolve().parents[1]
PROGRAM = "import gymnasium; env = gymnasium.make({}); env.reset(seed=0); env.step(env.action_space.sample())"
PROGRAMS = {
    "Pendulum-v1": PROGRAM.format("'Pendulum-v1'"),
    "direct": PROGRAM.format("'capsule_gym:CapsuleStickSlip-v0'"),
    "adaptive law": PROGRAM.format("'capsule_gym:CapsuleStickSlip-v0', controller='baselines:adaptive'"),
}


@dataclass(frozen=True, kw_only=True)
class Args(TurnArgs):
    """Seconds to the first step of an installed wheel.

    Examples:
      python -m benchmarks.first_step --markdown first_step.md
    """


def seconds(python: Path, program: str) -> float:
    """The processor time of a program."""
    before = os.times()
    # Python's compiled files are kept, as after any first use.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([python, "-c", program], cwd=tempfile.gettempdir(), env=kept, check=True)
    return sum(os.times()[2:4]) - sum(before[2:4])


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    with tempfile.TemporaryDirectory() as folder:
        python = Path(folder, "bin", "python")
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        subprocess.run([python, "-m", "pip", "install", "-q", ROOT, "-c", ROOT / "constraints.txt"], check=True)
        turns = {name: partial(seconds, python, program) for name, program in PROGRAMS.items()}
        # The first processes write Python's compiled files.
        rates(turns, 1)
        found = rates(turns, args.turns)
    rows = [[name, f"{1.0 / rate:.2f}", f"{found['Pendulum-v1'] / rate:.2f}"] for name, rate in found.items()]
    note = f"Processor time of a whole process, 10th percentile of {args.turns}, of an installed wheel. {machine()}."
    args.report(COMMAND, [["first step", "s", "over Pendulum-v1"], *rows], note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
