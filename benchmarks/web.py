"""How fast the module for browsers is beside the native code: `python -m benchmarks.web`.

Whole episodes of one capsule in closed loop, in this process and in node on the same machine. They take turns, and the
processor's time counts, so that a busy machine changes little.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import capsule_gym
from agents.drivers import trained
from baselines.tables import markdown_table, text_table
from benchmarks.machine import describe, machine
from benchmarks.output import Output, check_at_least_one
from benchmarks.timing import Progress, Rate
from capsule_gym.command_line import Count, parse, refuse
from capsule_gym.task import EPISODE_STEPS
from web import build
from web.episodes import env_kwargs

COMMAND = "python -m benchmarks.web"
TURNS = 15
# Nothing in the step, a law, a network, and both with a filter.
DRIVERS = ("zero", "adaptive", "direct-ppo", "robust")
# For every line of its input an episode; answers with its seconds.
SCRIPT = """
import { createInterface } from "node:readline";
const [path, driver] = process.argv.slice(1);
const { drive } = await import(path);
const episode = await drive(driver);
for await (const _ of createInterface({ input: process.stdin })) {
  const start = process.cpuUsage();
  episode.reset();
  for (let step = 0; step < episode.horizon; step++) episode.tick();
  const { user, system } = process.cpuUsage(start);
  console.log((user + system) / 1e6);
}
"""


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """How fast the module for browsers steps one capsule, in node, beside the native environment.

    Examples:
        python -m benchmarks.web --markdown docs/live_speed.md
    """

    turns: Count = TURNS
    """Episodes of every driver, native and in node."""

    def check(self) -> None:
        """Refuses what cannot be measured or written."""
        super().check()
        check_at_least_one("--turns", self.turns)


def native_episode(driver: str) -> float:
    """A nominal episode of Python's environment, as a user steps it; returns its seconds. No driver fails in it."""
    env = capsule_gym.CapsuleEnv(**env_kwargs(driver))
    policy = capsule_gym.load_policy(driver) if trained(driver) else None
    nothing, nominal = np.zeros(1, np.float32), {"M": env.simulation.capsule.M, "mu": env.simulation.capsule.mu}
    start = time.process_time()
    observation, _ = env.reset(options=nominal)
    act = policy.start([0]) if policy else None
    for _ in range(EPISODE_STEPS):
        observation, *_ = env.step(act(observation) if act else nothing)
    seconds = time.process_time() - start
    env.close()
    return seconds


@contextmanager
def running(driver: str, module: Path) -> Iterator[Callable[[], float]]:
    """A process of node; gives the function that runs a nominal episode of the module's and returns its seconds."""
    command = ["node", "--input-type=module", "--eval", SCRIPT, module.as_uri(), driver]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None
        given, answers = process.stdin, process.stdout

        def episode() -> float:
            given.write("\n")
            given.flush()
            return float(answers.readline())

        yield episode


def measure(module: Path, turns: int) -> dict[tuple[str, str], Rate]:
    """Agent steps per second by driver and place, native or in node; the first turn only warms up."""
    with ExitStack() as stack:
        episodes: dict[tuple[str, str], Callable[[], float]] = {}
        for driver in DRIVERS:
            episodes[driver, "native"] = partial(native_episode, driver)
            episodes[driver, "node"] = stack.enter_context(running(driver, module))
        found: dict[tuple[str, str], list[float]] = {key: [] for key in episodes}
        progress = Progress("web, turns", turns + 1)
        for _ in range(turns + 1):
            for key, episode in episodes.items():
                found[key].append(EPISODE_STEPS / episode())
            progress.step()
    return {key: Rate.of(rates[1:]) for key, rates in found.items()}


def rows(rates: dict[tuple[str, str], Rate]) -> list[list[str]]:
    """The table."""
    table = [["driver", "native, steps/s", "IQR", "node, steps/s", "IQR", "node over native"]]
    for driver in DRIVERS:
        native, node = rates[driver, "native"], rates[driver, "node"]
        pairs = [(f"{rate.median:,.0f}", f"{rate.spread:.0%}") for rate in (native, node)]
        table.append([driver, *pairs[0], *pairs[1], f"{node.median / native.median:.3f}"])
    return table


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    options = parse(Options, COMMAND, arguments)
    try:
        version = subprocess.run(["node", "--version"], capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError) as error:
        refuse(COMMAND, f"node must be installed: {error}")
    with tempfile.TemporaryDirectory() as folder:
        build.main(["--output", folder])
        found = machine()
        rates = measure(Path(folder) / "capsule.mjs", options.turns)
    note = (
        f"Agent steps, of 20 ms each, of one capsule in closed loop per second of the processor; medians of "
        f"{options.turns} episodes. "
        f"{describe(found)}, node {version.removeprefix('v')}."
    )
    print(text_table(rows(rates)), note, sep="\n\n")
    entries = [{"driver": driver, "where": kind, **asdict(rate)} for (driver, kind), rate in rates.items()]
    numbers: dict[str, Any] = {"machine": found, "node": version, "turns": options.turns, "rates": entries}
    options.write(COMMAND, numbers, [markdown_table(rows(rates)), "", note])
    return 0


if __name__ == "__main__":
    sys.exit(main())
