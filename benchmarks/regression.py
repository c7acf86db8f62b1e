"""Ratios of speeds that the kernels must reach: `python -m benchmarks.regression`.

Unlike absolute times, ratios are comparable between machines. A ratio below its floor usually means that the compiler
no longer vectorises a loop. The two sides of a ratio are measured in turns, in processor time, and the median is used,
so that other processes affect both sides. A ratio below its floor is measured again.

Each floor is at most about two thirds of the lowest ratio that was measured on processors with AVX2 and with AVX-512:
3.0, 0.84 and 0.65 for the first, third and fourth ratio. Without any vectorised loop, the lanes are 1.2 to 1.3 times as
fast as one environment at a time. The law's floor is closer to its lowest ratio, 0.56: if only the law's loop is not
vectorised, the ratio is 0.41 to 0.44. The last ratio was measured on one machine, without AVX-512.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import gymnasium as gym
import numpy as np

from baselines.tables import markdown_table, text_table
from benchmarks.measurement import OutputArgs, machine
from benchmarks.throughput import ACTION_SCALE, DRAWS, LAW, SEED, SINGLE_PEER, step_batch
from capsule_gym import ENV_ID, Policy, load_policy
from capsule_gym.command_line import parse
from capsule_gym.config import LAW_PHYSICS_DT, EnvConfig
from capsule_gym.layout import Row
from capsule_gym.network import rollout
from capsule_gym.simulation import Simulation

COMMAND = "python -m benchmarks.regression"
NUM_ENVS = 1024
# Number and length of the episodes in the measurement of evaluations.
EVALUATED, EVALUATED_STEPS = 100, 100
EVALUATED_POLICY = "direct-ppo"
TURNS = 9
TURN_SECONDS = 0.04
ATTEMPTS = 5

# Runs one turn and returns the environment steps per second of processor time.
Turn = Callable[[], float]


@dataclass(frozen=True)
class Guard:
    """A ratio of two rates.

    Attributes:
        name: description of the ratio.
        floor: the smallest allowed ratio.
        one: the rate in the numerator.
        other: the rate in the denominator.
    """

    name: str
    floor: float
    one: Turn
    other: Turn

    def measure(self) -> float:
        """The median ratio over turns; measured again while it is below the floor, up to `ATTEMPTS` times."""
        best = 0.0
        for _ in range(ATTEMPTS):
            best = max(best, statistics.median(self.one() / self.other() for _ in range(TURNS)))
            if best >= self.floor:
                break
        return best


def seeded(num_envs: int, **options: Any) -> Simulation:
    """Creates environments with different seeds, so that their plants differ."""
    simulation = Simulation(num_envs, EnvConfig(**options))
    for i in range(num_envs):
        simulation.seed(i, i)
    simulation.reset(np.arange(num_envs))
    return simulation


def kernel_steps(held: bool = False, **options: Any) -> Turn:
    """Agent steps of `NUM_ENVS` environments in the kernel alone, under random torques.

    With `held`, each environment keeps its first torque, so that the platform rarely reverses.
    """
    # Episodes continue from turn to turn; an environment whose episode has ended is reset.
    simulation = seeded(NUM_ENVS, **options)
    draws = cycle(ACTION_SCALE * np.random.default_rng(SEED).uniform(-1.0, 1.0, (1 if held else DRAWS, NUM_ENVS)))

    def turn() -> float:
        seconds, steps = 0.0, 0
        while seconds < TURN_SECONDS:
            ended = np.flatnonzero(simulation.row(Row.termination) != 0.0)
            if len(ended):
                simulation.reset(ended)
                simulation.world[:, Row.active] = 1.0
            simulation.write(Row.action, next(draws))
            start = time.process_time()
            simulation._run(begin=False)
            seconds += time.process_time() - start
            steps += NUM_ENVS
        return steps / seconds

    return turn


def single_kernel_steps() -> Turn:
    """Steps of a single environment (a block with one lane in use), without the overhead of the call from Python."""
    simulation = seeded(1)
    # Few enough calls that no torque ends the episode.
    calls, torques = 200, cycle(ACTION_SCALE * np.linspace(-1.0, 1.0, 9))

    def turn() -> float:
        seconds, steps = 0.0, 0
        while seconds < TURN_SECONDS:
            simulation.reset(np.arange(1))
            simulation.write(Row.action, np.array([next(torques)]))
            marks = [time.process_time()]
            for last in (1, 0):
                for _ in range(calls):
                    simulation._advance(0, last, False)
                marks.append(time.process_time())
            seconds += (marks[1] - marks[0]) - (marks[2] - marks[1])
            steps += calls
        return steps / seconds

    return turn


def repeated(work: Callable[[], Any], steps: int) -> Turn:
    """Repeated calls of a function that makes `steps` steps."""

    def turn() -> float:
        start, done = time.process_time(), 0
        while time.process_time() - start < TURN_SECONDS:
            work()
            done += steps
        return done / (time.process_time() - start)

    return turn


def resets(env_id: str) -> Turn:
    """Calls of `reset` of a single environment with gymnasium's default wrappers."""
    env = gym.make(env_id)
    env.reset(seed=SEED)
    return repeated(lambda: [env.reset() for _ in range(100)], 100)


def episodes(policy: Policy) -> Turn:
    """The first steps of episodes of a trained policy in one compiled call, as evaluations run them."""
    simulation = seeded(EVALUATED, **policy.env_kwargs)

    def work() -> None:
        simulation.reset(np.arange(EVALUATED))
        rollout(simulation, policy, EVALUATED_STEPS)

    return repeated(work, EVALUATED * EVALUATED_STEPS)


def guards() -> list[Guard]:
    """All ratios of this benchmark."""
    direct, at_1_ms = kernel_steps(), kernel_steps(physics_dt=LAW_PHYSICS_DT)
    # A native batch, including observations, rewards and infos.
    step, _ = step_batch(ENV_ID, NUM_ENVS, ACTION_SCALE, max_episode_steps=sys.maxsize)
    whole = repeated(lambda: step(DRAWS), DRAWS * NUM_ENVS)
    evaluated = episodes(load_policy(EVALUATED_POLICY))
    return [
        Guard("lanes against one environment at a time", 2.0, kernel_steps(held=True), single_kernel_steps()),
        Guard("adaptive law with the physics against the physics, both at 1 ms", 0.46, kernel_steps(**LAW), at_1_ms),
        Guard(f"whole step of {NUM_ENVS} environments against their kernel", 0.55, whole, direct),
        Guard(f"reset of one environment against {SINGLE_PEER}'s", 0.4, resets(ENV_ID), resets(SINGLE_PEER)),
        Guard(f"episodes of {EVALUATED_POLICY} against the kernel alone", 0.3, evaluated, direct),
    ]


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Measures the ratios that the kernels must reach, and fails where one is below its floor.

    Examples:
      python -m benchmarks.regression
      python -m benchmarks.regression --markdown docs/speed_ratios.md
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns 1 if a ratio is below its floor."""
    args = parse(Args, COMMAND, arguments)
    rows, missed = [["", "ratio", "floor", ""]], False
    for guard in guards():
        ratio = guard.measure()
        low = ratio < guard.floor
        rows.append([guard.name, f"{ratio:.2f}", f"{guard.floor:g}", "below its floor" if low else ""])
        missed |= low
    print(text_table(rows))
    args.write(COMMAND, markdown_table(rows), f"{machine()}.")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
