"""Speed of the module for browsers, compared with the native environment: `python -m benchmarks.web`.

Whole episodes of one capsule in closed loop run in this process and in node on the same machine, in turns. All times
are processor times, so that other processes have little effect.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

import capsule_gym
from benchmarks.measurement import OutputArgs, machine, spread, take_turns
from capsule_gym.command_line import Count, parse, refuse
from capsule_gym.task import EPISODE_STEPS
from web import build
from web.episodes import drivers

COMMAND = "python -m benchmarks.web"
# No control law, a law, a network, and a law with a network and a filter.
CONTROLLERS = ("zero", "adaptive", "direct-ppo", "residual-identifying")
# Runs an episode for every line of its input and prints the episode's seconds.
SCRIPT = """
import { createInterface } from "node:readline";
const [path, name] = process.argv.slice(1);
const { drive } = await import(path);
const episode = await drive(name);
for await (const _ of createInterface({ input: process.stdin })) {
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
        python -m benchmarks.web --markdown docs/live_speed.md
    """

    turns: Count = 15
    """Episodes of every controller, native and in node."""


def native_episode(name: str) -> float:
    """Runs a nominal episode in Python's environment, as a user does; returns the steps per second."""
    policy = drivers()[name]
    env = capsule_gym.CapsuleEnv(**policy.env_kwargs)
    nothing, nominal = np.zeros(1, np.float32), {"M": env.simulation.capsule.M, "mu": env.simulation.capsule.mu}
    start = time.process_time()
    observation, _ = env.reset(options=nominal)
    act = policy.start([0]) if isinstance(policy, capsule_gym.Policy) else None
    for _ in range(EPISODE_STEPS):
        observation, *_ = env.step(act(observation) if act else nothing)
    rate = EPISODE_STEPS / (time.process_time() - start)
    env.close()
    return rate


@contextmanager
def node_process(name: str, module: Path) -> Iterator[Callable[[], float]]:
    """Starts node; yields a function that runs a nominal episode in it and returns the steps per second."""
    command = ["node", "--input-type=module", "--eval", SCRIPT, module.as_uri(), name]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        orders, answers = process.stdin, process.stdout

        def episode() -> float:
            print(file=orders, flush=True)
            return EPISODE_STEPS / float(answers.readline())

        yield episode


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    args = parse(Args, COMMAND, arguments)
    if shutil.which("node") is None:
        refuse(COMMAND, "node must be installed")
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        build.main(["--output", folder])
        turns: dict[tuple[str, str], Callable[[], float]] = {}
        for name in CONTROLLERS:
            turns[name, "native"] = partial(native_episode, name)
            turns[name, "node"] = stack.enter_context(node_process(name, Path(folder) / "capsule.mjs"))
        take_turns(turns, 1)  # warms up
        rates = take_turns(turns, args.turns)
    steps = [["controller", "native, steps/s", "IQR", "node, steps/s", "IQR", "node over native"]]
    for name in CONTROLLERS:
        both = [rates[name, place] for place in ("native", "node")]
        native, node = map(statistics.median, both)
        cells = [cell for rate in both for cell in (f"{statistics.median(rate):,.0f}", f"{spread(rate):.0%}")]
        steps.append([name, *cells, f"{node / native:.3f}"])
    note = (
        f"Agent steps, of 20 ms each, of one capsule in closed loop per second of the processor; medians of "
        f"{args.turns} episodes. {machine()}."
    )
    args.report(COMMAND, steps, note)
    return 0


if __name__ == "__main__":
    sys.exit(main())
