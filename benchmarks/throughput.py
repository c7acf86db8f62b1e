"""Steps per second of the environment beside gymnasium's own, in one run: `python -m benchmarks.throughput`.

Absolute numbers do not carry from machine to machine; the ratios do. Contenders take turns, so that whatever else the
machine does meets them all, and the median of the turns counts. Every contender plays whole episodes with actions drawn
beforehand, resets included.
"""

from __future__ import annotations

import argparse
import os
import platform
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import capsule_gym
from agents.evaluation import versions
from agents.reporting import text_table
from baselines.files import to_json, write_atomically

# The paper's torques are below this fraction of the limit most of the time; full random torque would mostly reset.
ACTION_SCALE = 0.2
TURN_SECONDS = 0.2


@dataclass(frozen=True)
class Contender:
    """Something that steps.

    Attributes:
        name: for the table.
        step: takes a number of steps of all its environments.
        environments: how many it steps at once.
        peer: name of the contender that its ratio is to; None for the peers themselves.
    """

    name: str
    step: Callable[[int], None]
    environments: int
    peer: str | None = None


def _single(env_id: str, scale: float = 1.0, **kwargs: Any) -> Callable[[int], None]:
    """One environment through gym.make with its default wrappers."""
    env = gym.make(env_id, **kwargs)
    env.action_space.seed(0)
    samples = [env.action_space.sample() for _ in range(256)]
    actions = [sample if isinstance(sample, (int, np.integer)) else np.float32(scale) * sample for sample in samples]
    env.reset(seed=0)

    def step(count: int) -> None:
        for n in range(count):
            _, _, terminated, truncated, _ = env.step(actions[n % len(actions)])
            if terminated or truncated:
                env.reset()

    return step


def _batch(env_id: str, num_envs: int, scale: float = 1.0, **kwargs: Any) -> Callable[[int], None]:
    """A native batch through gym.make_vec."""
    env = gym.make_vec(env_id, num_envs=num_envs, vectorization_mode="vector_entry_point", **kwargs)
    env.action_space.seed(0)
    samples = [env.action_space.sample() for _ in range(16)]
    actions = [s if s.dtype.kind == "i" else np.float32(scale) * s for s in samples]
    env.reset(seed=0)

    def step(count: int) -> None:
        for n in range(count):
            env.step(actions[n % len(actions)])

    return step


def contenders() -> list[Contender]:
    """Everything that is measured."""
    ours = "CapsuleStickSlip-v0"
    law: dict[str, Any] = {"controller": "baselines:adaptive", "residual_limit": 0.2}
    return [
        Contender("CartPole-v1", _single("CartPole-v1"), 1),
        Contender("Pendulum-v1", _single("Pendulum-v1"), 1),
        Contender(f"{ours}", _single(ours, ACTION_SCALE), 1, "CartPole-v1"),
        Contender(f"{ours}, adaptive law", _single(ours, **law), 1, "CartPole-v1"),
        Contender("CartPole-v1, batch of 1024", _batch("CartPole-v1", 1024), 1024),
        Contender(f"{ours}, batch of 64", _batch(ours, 64, ACTION_SCALE), 64, ours),
        Contender(f"{ours}, batch of 1024", _batch(ours, 1024, ACTION_SCALE), 1024, ours),
        Contender(f"{ours}, batch of 1024, 2 threads", _batch(ours, 1024, ACTION_SCALE, threads=2), 1024, ours),
        Contender(f"{ours}, adaptive law, batch of 1024", _batch(ours, 1024, **law), 1024, ours),
    ]


def measure(rivals: Sequence[Contender], turns: int) -> dict[str, float]:
    """Environment steps per second of each, the median over turns that they take one after the other."""
    chunks = {}
    for rival in rivals:
        rival.step(1)
        start = time.perf_counter()
        rival.step(3)
        chunks[rival.name] = max(1, round(3 * TURN_SECONDS / (time.perf_counter() - start)))
    rates: dict[str, list[float]] = {rival.name: [] for rival in rivals}
    for _ in range(turns):
        for rival in rivals:
            start = time.perf_counter()
            rival.step(chunks[rival.name])
            seconds = time.perf_counter() - start
            rates[rival.name].append(chunks[rival.name] * rival.environments / seconds)
    return {name: statistics.median(values) for name, values in rates.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.throughput", description=__doc__)
    parser.add_argument("--turns", type=int, default=9, help="turns that every contender takes (default: 9)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to this new file")
    options = parser.parse_args(arguments)
    if options.turns < 1:
        parser.error(f"--turns must be at least 1, got {options.turns}")
    if options.json is not None and options.json.exists():
        parser.error(f"--json must name a new file, got {str(options.json)!r}")
    rivals = contenders()
    rates = measure(rivals, options.turns)
    rows = [["", "env steps/s", "us per step", "ratio", "to"]]
    for rival in rivals:
        rate = rates[rival.name]
        ratio = f"{rate / rates[rival.peer]:.2f}" if rival.peer else ""
        rows.append([rival.name, f"{rate:,.0f}", f"{1e6 / rate:.2f}", ratio, rival.peer or ""])
    machine = f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"
    print(text_table(rows))
    print(
        f"\n{machine}; median of {options.turns} turns. One step is 20 ms: 10 steps of the integrator, 20 with a law."
    )
    if options.json is not None:
        content = {"machine": machine, "versions": versions(), "env_steps_per_second": rates, "turns": options.turns}
        write_atomically(options.json, to_json(content))
    return 0


if __name__ == "__main__":
    assert capsule_gym.ENV_ID in gym.registry
    sys.exit(main())
