"""The ratios of `python -m benchmarks.regression`: what is measured, how, and the floors.

Absolute times say nothing on another machine, ratios do. A ratio below its floor most often means that the compiler no
longer vectorises a loop. What is compared takes turns, the processor's time counts and of the turns the median, so that
other processes disturb both or neither; a ratio that misses its floor is measured again before it counts.

Each floor is two thirds, or a little less, of the lowest ratio that was measured on processors with AVX2 and with
AVX-512: 3.1, 1.27, 0.84, 0.65, 0.65 and 2.4, in the order of the table; those of resets and episodes on one
machine. Where no loop is vectorised the lanes are 1.2 to 1.3 times as fast as one environment at a time; where the
law's alone is not, it falls to 0.7 to 0.8 of the physics.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from benchmarks.contenders import ACTION_SCALE, DRAWS, LAW, SEED, SINGLE_PEER, THREADS, step_batch
from benchmarks.machine import available_cores
from capsule_gym import ENV_ID, CapsuleVectorEnv, Policy, load_policy
from capsule_gym.kernels import Row
from capsule_gym.parameters import LAW_PHYSICS_DT, EnvConfig
from capsule_gym.rollout import rollout
from capsule_gym.simulation import Simulation

NUM_ENVS = 1024
MANY = 16384
# As many episodes as an evaluation set holds.
EVALUATED, EVALUATED_STEPS = 100, 100
EVALUATED_POLICY = "direct-ppo"
TURNS = 15
TURN_SECONDS = 0.04
ATTEMPTS = 5

Clock = Callable[[], float]
# Takes one turn; returns the seconds that it counts and the steps of environments that these took.
Turn = Callable[[], tuple[float, int]]


@dataclass(frozen=True)
class Guard:
    """A ratio of two rates, or of two times.

    Attributes:
        name: what it is.
        floor: what it must reach; None where it is only shown.
        one: the rate above the line.
        other: the rate below.
    """

    name: str
    floor: float | None
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
        return self.floor is not None and ratio < self.floor

    def row(self, ratio: float) -> list[str]:
        """Its line of the table."""
        floor = "" if self.floor is None else f"{self.floor:g}"
        return [self.name, f"{ratio:.2f}", floor, "below its floor" if self.misses(ratio) else ""]


HEADER = ["", "ratio", "floor", ""]


def stepping(
    simulation: Simulation, kernel: Callable[[], Any], held: bool = False, clock: Clock = time.thread_time
) -> Turn:
    """Agent steps of a simulation by a kernel alone, under random torques.

    Args:
        simulation: its environments go on from turn to turn; one that has ended is reset.
        kernel: what steps them.
        held: whether each environment keeps its first torque, so that the platform seldom turns.
        clock: what the seconds are of.
    """
    n = simulation.num_envs
    simulation.reset(np.arange(n))
    draws = ACTION_SCALE * np.random.default_rng(SEED).uniform(-1.0, 1.0, (1 if held else DRAWS, n))
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
            start = clock()
            kernel()
            seconds += clock() - start
            taken += 1
            steps += n
        return seconds, steps

    return turn


def seeded(num_envs: int, **settings: Any) -> Simulation:
    """Environments with a seed each, so that no two have the same plant."""
    simulation = Simulation(num_envs, EnvConfig(**settings))
    for i in range(num_envs):
        simulation.seed(i, i)
    return simulation


def ours(num_envs: int, held: bool = False, clock: Clock = time.thread_time, **settings: Any) -> Turn:
    """This package's kernel."""
    simulation = seeded(num_envs, **settings)
    return stepping(simulation, lambda: simulation._run(begin=False), held, clock)


def one_at_a_time() -> Turn:
    """A single environment, without what the call from Python takes: a block with one lane in use."""
    simulation = Simulation(1)
    # Short enough for every one of the torques to leave the episode running.
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


def beyond(whole: Turn, part: Turn) -> Turn:
    """What the same steps take longer in the one than in the other."""

    def turn() -> tuple[float, int]:
        (seconds, steps), (part_seconds, part_steps) = whole(), part()
        return seconds - part_seconds * steps / part_steps, steps

    return turn


def whole_steps(num_envs: int) -> Turn:
    """The `step` of a native batch, with everything that it returns."""
    stepper = step_batch(ENV_ID, num_envs, ACTION_SCALE, max_episode_steps=sys.maxsize)

    def turn() -> tuple[float, int]:
        start, steps = time.thread_time(), 0
        while time.thread_time() - start < TURN_SECONDS:
            stepper.step(DRAWS)
            steps += DRAWS * num_envs
        return time.thread_time() - start, steps

    return turn


def resets(env_id: str, **kwargs: Any) -> Turn:
    """The `reset` of a single environment through gymnasium's default wrappers."""
    env = gym.make(env_id, **kwargs)
    env.reset(seed=SEED)
    calls = 500

    def turn() -> tuple[float, int]:
        start, done = time.thread_time(), 0
        while time.thread_time() - start < TURN_SECONDS:
            for _ in range(calls):
                env.reset()
            done += calls
        return time.thread_time() - start, done

    return turn


def episodes_in_one_call(policy: Policy) -> Turn:
    """The first steps of episodes of a trained policy, compiled, as evaluations run them."""
    simulation = seeded(EVALUATED, **policy.env_kwargs)

    def turn() -> tuple[float, int]:
        simulation.reset(np.arange(EVALUATED))
        start = time.thread_time()
        rollout(simulation, policy, EVALUATED_STEPS)
        return time.thread_time() - start, EVALUATED * EVALUATED_STEPS

    return turn


def episodes_with_torch(policy: Policy) -> Turn:
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
    env = CapsuleVectorEnv(EVALUATED, autoreset_mode=AutoresetMode.DISABLED, **policy.env_kwargs)
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
    direct, at_1_ms = ours(NUM_ENVS), ours(NUM_ENVS, physics_dt=LAW_PHYSICS_DT)
    law = beyond(ours(NUM_ENVS, **LAW), at_1_ms)
    found = [
        Guard("lanes against one environment at a time", 2.0, ours(NUM_ENVS, held=True), one_at_a_time()),
        Guard("adaptive law alone against the physics, both at 1 ms", 0.85, law, at_1_ms),
        Guard(f"whole step of {NUM_ENVS} environments against their kernel", 0.55, whole_steps(NUM_ENVS), direct),
        Guard(f"reset of one environment against {SINGLE_PEER}'s", 0.4, resets(ENV_ID), resets(SINGLE_PEER)),
        Guard("the same with the adaptive law", 0.4, resets(ENV_ID, **LAW), resets(SINGLE_PEER)),
    ]
    policy = load_policy(EVALUATED_POLICY)
    name = f"episodes of {policy.name} in one call against a batch with torch"
    found.append(Guard(name, 1.5, episodes_in_one_call(policy), episodes_with_torch(policy)))
    if available_cores() >= max(THREADS):
        # Shown only: what else the machine does decides it.
        one, shared = (ours(MANY, clock=time.perf_counter, threads=threads) for threads in (1, max(THREADS)))
        found.append(Guard(f"{max(THREADS)} threads against one", None, shared, one))
    return found
