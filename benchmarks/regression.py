"""Ratios of speeds that the kernels must reach: `python -m benchmarks.regression`.

Absolute times say nothing on another machine, ratios do. A ratio below its floor most often means that the compiler no
longer vectorises a loop. The two sides of a ratio take turns, the processor's time counts and of the turns the median,
so that other processes disturb both or neither; a ratio that misses its floor is measured again before it counts.

Each floor is two thirds, or a little less, of the lowest ratio that was measured on processors with AVX2 and with
AVX-512: 3.1, 1.27, 0.84, 0.65, 0.65 and 2.4, in the order of the table; those of resets and episodes on one machine.
Where no loop is vectorised the lanes are 1.2 to 1.3 times as fast as one environment at a time; where the law's alone
is not, it falls to 0.7 to 0.8 of the physics.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

import capsule_gym
from baselines.tables import markdown_table, text_table
from benchmarks.measurement import OutputArgs, describe, machine
from benchmarks.throughput import ACTION_SCALE, DRAWS, LAW, SEED, SINGLE_PEER, step_batch
from capsule_gym import ENV_ID
from capsule_gym.command_line import parse
from capsule_gym.parameters import LAW_PHYSICS_DT, EnvConfig

if TYPE_CHECKING:
    from capsule_gym import Policy
    from capsule_gym.simulation import Simulation

COMMAND = "python -m benchmarks.regression"
NUM_ENVS = 1024
# As many episodes as an evaluation set holds.
EVALUATED, EVALUATED_STEPS = 100, 100
EVALUATED_POLICY = "direct-ppo"
TURNS = 15
TURN_SECONDS = 0.04
ATTEMPTS = 5

# Takes one turn; returns the seconds that it counts and the steps of environments that these took.
Turn = Callable[[], tuple[float, int]]


@dataclass(frozen=True)
class Guard:
    """A ratio of two rates, or of two times.

    Attributes:
        name: what it is.
        floor: the smallest allowed ratio.
        one: the rate above the line.
        other: the rate below.
    """

    name: str
    floor: float
    one: Turn
    other: Turn

    def measure(self) -> float:
        """The median over turns of the one and the other, side by side."""
        ratios = []
        for _ in range(TURNS):
            (seconds, steps), (other_seconds, other_steps) = self.one(), self.other()
            ratios.append(steps / seconds / (other_steps / other_seconds) if seconds > 0.0 else math.inf)
        return statistics.median(ratios)

    def best(self) -> float:
        """The ratio, measured again while it misses its floor."""
        ratio = self.measure()
        for _ in range(ATTEMPTS - 1):
            if not self.misses(ratio):
                break
            ratio = max(ratio, self.measure())
        return ratio

    def misses(self, ratio: float) -> bool:
        """Whether a ratio is below the floor."""
        return ratio < self.floor

    def row(self, ratio: float) -> list[str]:
        """Its line of the table."""
        return [self.name, f"{ratio:.2f}", f"{self.floor:g}", "below its floor" if self.misses(ratio) else ""]


def seeded(num_envs: int, **options: Any) -> Simulation:
    """Environments with a seed each, so that no two have the same plant."""
    # numba takes most of a second to import, which --help need not wait for.
    from capsule_gym.simulation import Simulation

    simulation = Simulation(num_envs, EnvConfig(**options))
    for i in range(num_envs):
        simulation.seed(i, i)
    simulation.reset(np.arange(num_envs))
    return simulation


def kernel_steps(num_envs: int, held: bool = False, **options: Any) -> Turn:
    """Agent steps by the kernel alone, under random torques.

    Args:
        num_envs: these go on from turn to turn; one that has ended is reset.
        held: whether each environment keeps its first torque, so that the platform seldom reverses.
        **options: of the environments.
    """
    from capsule_gym.layout import Row

    simulation = seeded(num_envs, **options)
    draws = ACTION_SCALE * np.random.default_rng(SEED).uniform(-1.0, 1.0, (1 if held else DRAWS, num_envs))
    taken = 0

    def turn() -> tuple[float, int]:
        nonlocal taken
        seconds, steps = 0.0, 0
        while seconds < TURN_SECONDS:
            ended = np.flatnonzero(simulation.row(Row.termination) != 0.0)
            if len(ended):
                simulation.reset(ended)
                simulation.world[:, Row.active] = 1.0
            simulation.write(Row.action, draws[taken % len(draws)])
            start = time.thread_time()
            simulation._run(begin=False)
            seconds += time.thread_time() - start
            taken += 1
            steps += num_envs
        return seconds, steps

    return turn


def single_kernel_steps() -> Turn:
    """A single environment, without the cost of the call from Python: a block with one lane in use."""
    from capsule_gym.layout import Row

    simulation = seeded(1)
    # Short enough that the episode runs on under every one of the torques.
    calls, torques = 200, cycle(ACTION_SCALE * np.linspace(-1.0, 1.0, 9))

    def turn() -> tuple[float, int]:
        seconds, steps = 0.0, 0
        while seconds < TURN_SECONDS:
            simulation.reset(np.arange(1))
            simulation.write(Row.action, np.array([next(torques)]))
            marks = [time.thread_time()]
            for last in (1, 0):
                for _ in range(calls):
                    simulation._advance(0, last, False)
                marks.append(time.thread_time())
            seconds += (marks[1] - marks[0]) - (marks[2] - marks[1])
            steps += calls
        return seconds, steps

    return turn


def difference(whole: Turn, part: Turn) -> Turn:
    """The additional time of the same steps in `whole` compared with `part`."""

    def turn() -> tuple[float, int]:
        (seconds, steps), (part_seconds, part_steps) = whole(), part()
        return seconds - part_seconds * steps / part_steps, steps

    return turn


def repeated(work: Callable[[], Any], steps: int) -> Turn:
    """Calls of a function that takes so many steps."""

    def turn() -> tuple[float, int]:
        start, done = time.thread_time(), 0
        while time.thread_time() - start < TURN_SECONDS:
            work()
            done += steps
        return time.thread_time() - start, done

    return turn


def whole_steps(num_envs: int) -> Turn:
    """The `step` of a native batch, with everything that it returns."""
    stepper = step_batch(ENV_ID, num_envs, ACTION_SCALE, max_episode_steps=sys.maxsize)
    return repeated(lambda: stepper.step(DRAWS), DRAWS * num_envs)


def resets(env_id: str, **kwargs: Any) -> Turn:
    """The `reset` of a single environment through gymnasium's default wrappers."""
    env = gym.make(env_id, **kwargs)
    env.reset(seed=SEED)
    return repeated(lambda: [env.reset() for _ in range(100)], 100)


def compiled_episodes(policy: Policy) -> Turn:
    """The first steps of episodes of a trained policy in one compiled call, as evaluations run them."""
    from capsule_gym.rollout import rollout

    simulation = seeded(EVALUATED, **policy.env_kwargs)

    def turn() -> tuple[float, int]:
        simulation.reset(np.arange(EVALUATED))
        start = time.thread_time()
        rollout(simulation, policy, EVALUATED_STEPS)
        return time.thread_time() - start, EVALUATED * EVALUATED_STEPS

    return turn


def torch_episodes(policy: Policy) -> Turn:
    """The same steps of the batch, one by one, with the network in torch and its normalisation in numpy."""
    import torch
    from torch import nn

    torch.set_num_threads(1)
    activation = {"tanh": nn.Tanh, "relu": nn.ReLU}[policy.activation]
    modules: list[nn.Module] = []
    for weights, bias in policy.layers:
        modules += [nn.Linear(*weights.shape[::-1]), activation()]
        modules[-2].load_state_dict({"weight": torch.from_numpy(weights), "bias": torch.from_numpy(bias)})
    network = nn.Sequential(*modules[:-1])
    env = capsule_gym.CapsuleVectorEnv(EVALUATED, autoreset_mode=AutoresetMode.DISABLED, **policy.env_kwargs)
    scale = np.sqrt(policy.variance + policy.epsilon)

    def turn() -> tuple[float, int]:
        observations, _ = env.reset(seed=SEED)
        start = time.thread_time()
        with torch.no_grad():
            for _ in range(EVALUATED_STEPS):
                scaled = np.clip((observations - policy.mean) / scale, -policy.clip, policy.clip).astype(np.float32)
                actions = network(torch.from_numpy(scaled)).numpy()
                observations = env.step(np.clip(actions, -1.0, 1.0))[0]
        return time.thread_time() - start, EVALUATED * EVALUATED_STEPS

    return turn


def guards() -> list[Guard]:
    """Everything that is measured here."""
    direct, at_1_ms = kernel_steps(NUM_ENVS), kernel_steps(NUM_ENVS, physics_dt=LAW_PHYSICS_DT)
    law = difference(kernel_steps(NUM_ENVS, **LAW), at_1_ms)
    policy = capsule_gym.load_policy(EVALUATED_POLICY)
    name = f"episodes of {policy.name} in one call against a batch with torch"
    return [
        Guard("lanes against one environment at a time", 2.0, kernel_steps(NUM_ENVS, held=True), single_kernel_steps()),
        Guard("adaptive law alone against the physics, both at 1 ms", 0.85, law, at_1_ms),
        Guard(f"whole step of {NUM_ENVS} environments against their kernel", 0.55, whole_steps(NUM_ENVS), direct),
        Guard(f"reset of one environment against {SINGLE_PEER}'s", 0.4, resets(ENV_ID), resets(SINGLE_PEER)),
        Guard("the same with the adaptive law", 0.4, resets(ENV_ID, **LAW), resets(SINGLE_PEER)),
        Guard(name, 1.5, compiled_episodes(policy), torch_episodes(policy)),
    ]


@dataclass(frozen=True, kw_only=True)
class Args(OutputArgs):
    """Measures the ratios that the kernels must reach, and fails where one is below its floor.

    Examples:
      python -m benchmarks.regression
      python -m benchmarks.regression --markdown docs/speed_ratios.md
    """


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns 1 where a ratio misses its floor."""
    args = parse(Args, COMMAND, arguments)
    found, rows, ratios = machine(), [["", "ratio", "floor", ""]], {}
    missed = False
    for guard in guards():
        ratio = ratios[guard.name] = guard.best()
        missed |= guard.misses(ratio)
        rows.append(guard.row(ratio))
    print(text_table(rows))
    numbers = {"machine": found, "ratios": ratios}
    args.write(COMMAND, numbers, [*markdown_table(rows).split("\n"), "", f"{describe(found)}."])
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
