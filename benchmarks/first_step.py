"""Seconds from the start of a process to the first step, with an installed wheel.

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
from pathlib import Path

import baselines
from benchmarks.measurement import OutputArgs, machine
from capsule_gym.command_line import parse

COMMAND = "python -m benchmarks.first_step"
ROOT = Path(__file__).resolve().parents[1]
LAW = "lambda theta, theta_dot, x, x_dot, memory, reference: (-theta, memory)"
OWN_LAW = f"capsule_gym.Controller('own', {LAW}, [[0.0, 0.0]])"
ONE = "env = gymnasium.make(ID{}); env.reset(seed=0); env.step([0.3])"
MANY = "env = gymnasium.make_vec(ID, 8{}); env.reset(seed=0); env.step(env.action_space.sample())"
WORKERS = ", vectorization_mode='async', vector_kwargs={'context': 'spawn'}, controller='baselines:adaptive'"
POLICY = "policy = capsule_gym.load_policy('residual-ppo'); {}; policy(env.reset(seed=0)[0])"
ROLLOUT = "; capsule_gym.network.rollout(env.unwrapped.simulation, policy, 1)"
IMPORTS = "import capsule_gym.network, gymnasium\nID = 'capsule_gym:CapsuleStickSlip-v0'\n"
# Programs without their imports.
PROGRAMS = {
    "direct": ONE.format(""),
    **{name: ONE.format(f", controller='baselines:{name}'") for name in baselines.__all__},
    "law of one's own": ONE.format(f", controller={OWN_LAW}"),
    "batch": MANY.format(""),
    "three processes": MANY.replace("8", "3").format(WORKERS),
    "trained policy": POLICY.format(ONE.format(", **policy.env_kwargs")),
    "its rollout": POLICY.format(MANY.format(", **policy.env_kwargs")) + ROLLOUT,
}


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Seconds to the first step of an installed wheel.

    Examples:
      python -m benchmarks.first_step --markdown docs/speed_first_step.md
    """


def seconds(python: Path, program: str, folder: str) -> float:
    """The wall time in seconds of a program, which is written to a folder."""
    script = Path(folder, "program.py")
    script.write_text(f"{IMPORTS}if __name__ == '__main__':\n    {program}\n", encoding="utf-8")
    start = time.perf_counter()
    subprocess.run([python, script], cwd=folder, check=True)
    return time.perf_counter() - start


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    rows = [["first step", "s"]]
    with tempfile.TemporaryDirectory() as wheels, tempfile.TemporaryDirectory() as environment:
        python = Path(environment, "Scripts" if os.name == "nt" else "bin", "python")
        subprocess.run([sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", wheels, ROOT], check=True)
        subprocess.run([sys.executable, "-m", "venv", environment], check=True)
        constraints = ["-c", str(ROOT / "constraints.txt")]
        subprocess.run([python, "-m", "pip", "install", "-q", *Path(wheels).glob("*.whl"), *constraints], check=True)
        # The first process compiles the bytecode.
        seconds(python, PROGRAMS["direct"], wheels)
        rows += [[name, f"{seconds(python, program, wheels):.2f}"] for name, program in PROGRAMS.items()]
    note = f"Wall time from the start of the process to its end, of an installed wheel. {machine()}."
    args.report(COMMAND, rows, note, left=1)
    return 0


if __name__ == "__main__":
    sys.exit(main())
