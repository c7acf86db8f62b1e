"""How fast the module for browsers is beside the native code: `python -m benchmarks.web`.

Agent steps of one capsule in closed loop, each with its reset every episode, in this process and in node on the same
machine. They take turns: the ratios of one run carry further than its absolute numbers.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import capsule_gym
from baselines.tables import markdown_table, text_table
from benchmarks.machine import describe, machine
from benchmarks.output import Output, check_at_least_one
from benchmarks.timing import Contender, Rate, Stepper, measure
from capsule_gym.command_line import Count, parse, refuse
from capsule_gym.task import EPISODE_STEPS
from web import build
from web.episodes import env_kwargs, trained

COMMAND = "python -m benchmarks.web"
TURNS = 15
TURN_SECONDS = 0.2
# Nothing in the step, a law, a network, and both with a filter.
DRIVERS = ("zero", "adaptive", "direct-ppo", "robust")
# Steps as often as a line of its input says, and answers when it has.
SCRIPT = """
import { createInterface } from "node:readline";
const [path, driver] = process.argv.slice(1);
const { drive } = await import(path);
const episode = await drive(driver);
for await (const line of createInterface({ input: process.stdin })) {
  for (let left = Number(line); left > 0; left--) {
    const { terminated, truncated } = episode.tick();
    if (terminated || truncated) episode.reset();
  }
  console.log("done");
}
"""


@dataclass(frozen=True, kw_only=True)
class Options(Output):
    """How fast the module for browsers steps one capsule, in node, beside the native environment.

    Examples:
        python -m benchmarks.web --markdown docs/live_speed.md
    """

    turns: Count = TURNS
    """Turns of every contender."""

    def check(self) -> None:
        """Refuses what cannot be measured or written."""
        super().check()
        check_at_least_one("--turns", self.turns)


def make_native(driver: str) -> Stepper:
    """One environment of Python's, as a user steps it."""
    env = capsule_gym.CapsuleEnv(**env_kwargs(driver))
    policy = capsule_gym.load_policy(driver) if trained(driver) else None
    nothing, nominal = np.zeros(1, np.float32), {"M": env.simulation.capsule.M, "mu": env.simulation.capsule.mu}
    taken, observation, act = EPISODE_STEPS, np.zeros(0), None

    def run(count: int) -> None:
        nonlocal taken, observation, act
        for _ in range(count):
            if taken == EPISODE_STEPS:
                observation, _ = env.reset(options=nominal)
                act, taken = policy.start([0]) if policy else None, 0
            observation, _, terminated, _, _ = env.step(act(observation) if act else nothing)
            taken = EPISODE_STEPS if terminated else taken + 1

    return Stepper(run, env.close)


def make_node(driver: str, module: Path) -> Stepper:
    """One capsule of the module's in a process of node."""
    command = ["node", "--input-type=module", "--eval", SCRIPT, module.as_uri(), driver]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin is not None and process.stdout is not None
    given, answers = process.stdin, process.stdout

    def run(count: int) -> None:
        given.write(f"{count}\n")
        given.flush()
        if not answers.readline():
            raise RuntimeError(f"node ended with status {process.wait()}")

    def close() -> None:
        given.close()
        process.wait()
        answers.close()

    return Stepper(run, close)


def rows(rates: dict[tuple[str, str], Rate]) -> list[list[str]]:
    """The table."""
    table = [["driver", "native, steps/s", "IQR", "node, steps/s", "IQR", "node over native"]]
    for driver in DRIVERS:
        native, node = rates[driver, "native"], rates[driver, "node"]
        cells = [cell for rate in (native, node) for cell in (f"{rate.median:,.0f}", f"{rate.spread:.0%}")]
        table.append([driver, *cells, f"{node.median / native.median:.2f}"])
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
        module = Path(folder) / "capsule.mjs"
        contenders = {
            (driver, kind): Contender(f"{driver}, {kind}", make)
            for driver in DRIVERS
            for kind, make in {
                "native": partial(make_native, driver),
                "node": partial(make_node, driver, module),
            }.items()
        }
        found = machine()
        measured = measure(list(contenders.values()), options.turns, TURN_SECONDS, "web")
    rates = {key: measured[contender.name] for key, contender in contenders.items()}
    note = (
        f"Agent steps per second of one capsule in closed loop, of 20 ms each; medians of {options.turns} turns. "
        f"{describe(found)}, node {version.removeprefix('v')}."
    )
    print(text_table(rows(rates)), note, sep="\n\n")
    entries = [{"driver": driver, "where": kind, **asdict(rate)} for (driver, kind), rate in rates.items()]
    numbers: dict[str, Any] = {"machine": found, "node": version, "turns": options.turns, "rates": entries}
    options.write(COMMAND, numbers, [markdown_table(rows(rates)), "", note])
    return 0


if __name__ == "__main__":
    sys.exit(main())
