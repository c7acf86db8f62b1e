"""Speed of the module for browsers, compared with the native environment: `python -m benchmarks.web`.

Whole episodes of one capsule in closed loop run in this process and in node on the same machine. All times are
processor times, so that other processes have little effect.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import capsule_gym
from benchmarks.measurement import OutputArgs, machine, rates
from capsule_gym.command_line import Count, parse, refuse
from capsule_gym.task import EPISODE_STEPS
from web import build
from web.episodes import drivers

COMMAND = "python -m benchmarks.web"
# A law, and a network.
CONTROLLERS = ("adaptive", "direct-ppo")
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
class Args(OutputArgs):
    """Speed of one capsule in node, compared with the native environment.

    Examples:
        python -m benchmarks.web --markdown web.md
    """

    turns: Count = 30
    """Episodes of every controller, native and in node."""


def native_episode(name: str) -> float:
    """Runs a nominal episode in Python's environment, as a user does; returns its seconds."""
    policy = drivers()[name]
    env = capsule_gym.CapsuleEnv(**policy.env_kwargs)
    nothing, nominal = np.zeros(1, np.float32), {"M": env.simulation.capsule.M, "mu": env.simulation.capsule.mu}
    start = time.process_time()
    observation, _ = env.reset(options=nominal)
    act = policy.start([0]) if isinstance(policy, capsule_gym.Policy) else None
    for _ in range(EPISODE_STEPS):
        observation, *_ = env.step(act(observation) if act else nothing)
    return time.process_time() - start


def node_episodes(module: Path, name: str, count: int) -> Iterator[float]:
    """The seconds of nominal episodes in node."""
    command = ["node", "--input-type=module", "--eval", SCRIPT, module.as_uri(), name, str(count)]
    return map(float, subprocess.run(command, check=True, capture_output=True, text=True).stdout.split())


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    if shutil.which("node") is None:
        refuse(COMMAND, "node must be installed")
    table = [["controller", "native, steps/s", "node, steps/s", "node over native"]]
    with tempfile.TemporaryDirectory() as folder:
        build.main(["--output", folder])
        for name in CONTROLLERS:
            node = node_episodes(Path(folder, "capsule.mjs"), name, args.turns)
            found = rates({"native": partial(native_episode, name), "node": node.__next__}, args.turns)
            native, browser = (EPISODE_STEPS * rate for rate in found.values())
            table.append([name, f"{native:,.0f}", f"{browser:,.0f}", f"{browser / native:.3f}"])
    note = (
        "Agent steps, of 20 ms each, of one capsule in closed loop per second of the processor; 10th percentile of the "
        f"times of {args.turns} episodes. {machine()}."
    )
    args.report(COMMAND, table, note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
