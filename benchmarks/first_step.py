"""Seconds from the start of a process to the first step, with an installed wheel: `python -m benchmarks.first_step`.

The wheel is built and installed in a new virtual environment, with the versions in `constraints.txt`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from benchmarks.measurement import OutputArgs, machine, rates
from capsule_gym.command_line import Count, parse

COMMAND = "python -m benchmarks.first_step"
ROOT = Path(__file__).resolve().parents[1]
STEP = "env.reset(seed=0); env.step(env.action_space.sample())"
ONE = f"import gymnasium; env = gymnasium.make('capsule_gym:CapsuleStickSlip-v0'{{}}); {STEP}"
PROGRAMS = {
    "Pendulum-v1": f"import gymnasium; env = gymnasium.make('Pendulum-v1'); {STEP}",
    "direct": ONE.format(""),
    "adaptive law": ONE.format(", controller='baselines:adaptive'"),
    "law of a user": "import capsule_gym; law = lambda *state: (-state[0], state[4]); "
    + ONE.format(", controller=capsule_gym.Controller('own', law, [[0.0, 0.0]])"),
    "batch": ONE.format(", num_envs=8").replace(".make(", ".make_vec("),
    "trained policy": "import capsule_gym; policy = capsule_gym.load_policy('residual-ppo'); "
    + ONE.format(", **policy.env_kwargs").replace("env.action_space.sample()", "policy(env.reset(seed=0)[0])"),
}


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Seconds to the first step of an installed wheel.

    Examples:
      python -m benchmarks.first_step --markdown first_step.md
    """

    turns: Count = 15
    """Processes for each program."""


def seconds(python: Path, program: str) -> float:
    """The processor time of a program (the time, where there is no `os.fork`)."""
    clock = (lambda: sum(os.times()[2:4])) if hasattr(os, "fork") else time.perf_counter
    start = clock()
    # Python's compiled files are kept, as after any first use.
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    subprocess.run([python, "-c", program], cwd=tempfile.gettempdir(), env=kept, check=True)
    return clock() - start


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    with tempfile.TemporaryDirectory() as folder:
        python = Path(folder, "Scripts" if os.name == "nt" else "bin", "python")
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
