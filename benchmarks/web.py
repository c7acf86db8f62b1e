"""Speed of the module for browsers, compared with the native environment: `python -m benchmarks.web`.

Whole episodes of one capsule in closed loop run in this process and in node on the same machine. All times are
processor times, so that other processes have little effect.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shutil import which

import numpy as np

import capsule_gym
from benchmarks.measurement import TurnArgs, machine, rates
from capsule_gym.command_line import parse, refuse
from capsule_gym.task import EPISODE_STEPS
from web import build
from web.episodes import drivers

COMMAND = "python -m benchmarks.web"
# Runs episodes of a driver and prints the seconds of each.
SCRIPT = """
const [path, name, episodes] = process.argv.slice(1);
const { drive } = await import(path);
const episode = await drive(name);
for (let n = 0; n < episodes; n++) {
  const start = process.cpuUsage();
  episode.reset();
  for (let step = 0; step < episode.horizon; step++) episode.tick();
  const { user, system } = process.cpuUsage(start);
  console.log((user + system) / 1e6);
}
"""


@dataclass(frozen=True, kw_only=True)
class Args(TurnArgs):
    """Speed of one capsule in node, compared with the native environment.

    Examples:
        python -m benchmarks.web --markdown web.md
    """


def native_episode(name: str) -> float:
    """Runs a nominal episode in Python's environment, as a user does; returns its seconds."""
    policy = drivers()[name]
    env = capsule_gym.CapsuleEnv(**policy.env_kwargs)
    start = time.process_time()
    observation, _ = env.reset(options={"M": env.simulation.capsule.M, "mu": env.simulation.capsule.mu})
    act = policy.start([0]) if isinstance(policy, capsule_gym.Policy) else lambda _: np.zeros(1, np.float32)
    for _ in range(EPISODE_STEPS):
        observation, *_ = env.step(act(observation))
    return time.process_time() - start


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    if which("node") is None:
        refuse(COMMAND, "node must be installed")
    table = [["controller", "native, steps/s", "node, steps/s", "node over native"]]
    with tempfile.TemporaryDirectory() as folder:
        build.main(["--output", folder])
        for name in ("adaptive", "direct-ppo"):
            module = Path(folder, "capsule.mjs").as_uri()
            command = ["node", "--input-type=module", "--eval", SCRIPT, module, name, str(args.turns)]
            node = map(float, subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.split())
            found = rates({"native": partial(native_episode, name), "node": partial(next, node)}, args.turns)
            native, browser = (EPISODE_STEPS * rate for rate in found.values())
            table.append([name, f"{native:,.0f}", f"{browser:,.0f}", f"{browser / native:.3f}"])
    note = f"Agent steps of one capsule in closed loop per second of processor time, 10th percentile. {machine()}."
    args.report(COMMAND, table, note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
