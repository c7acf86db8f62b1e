"""The data of distillation: states that expert and student visit, and the regret of every torque there.

The expert is the optimum of the episode's plant, `baselines.dynamic_programming.policy.Oracle`. It observes M and mu.
A student from which they are hidden learns what costs least over the plants that a state may belong to. A student that
identifies them on line is also given the estimates of `capsule_gym.observation`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from agents.distillation.config import Student
from baselines.dynamic_programming.policy import TORQUES, Oracle
from capsule_gym import CapsuleVectorEnv
from capsule_gym.compilation import compile_cached
from capsule_gym.network import make_header, write_inputs
from capsule_gym.observation import CELLS
from capsule_gym.parameters import NOMINAL, EnvConfig, Randomization
from capsule_gym.resets import draw_plant
from capsule_gym.task import CONTROL_DT

Act = Callable[[np.ndarray], np.ndarray]

# In every step: that the acting policy is drawn again, and that the action is random.
SWITCH_PROBABILITY, EXPLORATION_PROBABILITY = 0.02, 0.01


class Dataset(NamedTuple):
    """The states of one round.

    Attributes:
        inputs: of the student's network, shape (states, inputs), float32.
        regrets: of each of `TORQUES`, cm, shape (states, NUM_TORQUES), float32.
    """

    inputs: np.ndarray
    regrets: np.ndarray


def regrets_of(scores: np.ndarray, max_regret: float) -> np.ndarray:
    """The loss of each torque compared with the best.

    Args:
        scores: reward plus value of the next state, cm, shape (states, NUM_TORQUES).
        max_regret: larger regrets are clipped to it, cm.

    Returns:
        cm, of the same shape, float32; 0 everywhere where every torque ends the episode.
    """
    return np.minimum(scores.max(axis=1, keepdims=True) - scores, max_regret).astype(np.float32)


class StudentInputs:
    """Computes the inputs of a student's network in a batch of episodes, from their start on.

    Args:
        student: its configuration.
        count: number of episodes.
    """

    def __init__(self, student: Student, count: int) -> None:
        header = make_header(
            EnvConfig(**student.env_kwargs),
            layers=1,
            relu=False,
            tanh_squashing=True,
            clip=1.0,
            identifies=student.identifies,
            observes_energy_weight=False,
            outputs_torque=False,
        )
        self.observed = header.observed
        self._header = np.array([*header], np.float64)
        self._memory = np.zeros(count * CELLS)
        self._inputs = np.zeros((count, header.inputs), np.float32)

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """The inputs of the next step, shape (episodes, inputs), for the student's observations."""
        rows = np.ascontiguousarray(observations)
        _compiled_inputs()(self._header, rows, 0, len(rows), self._memory, self._inputs)
        return self._inputs.copy()


@lru_cache(maxsize=1)
def _compiled_inputs() -> Any:
    return compile_cached(write_inputs.py_func)


class Collector:
    """Collects data in episodes in which expert and student act in turn.

    Args:
        student: its configuration.
        num_envs: number of episodes in a batch.
        rng: draws plants, the acting policy and exploration.
    """

    def __init__(self, student: Student, num_envs: int, rng: np.random.Generator) -> None:
        self._env = CapsuleVectorEnv(
            num_envs=num_envs,
            randomization=student.randomization,
            observe_parameters=True,
            autoreset_mode=AutoresetMode.DISABLED,
        )
        self._student = student
        self._expert = Oracle(num_envs, student.margin)
        self._rng = rng

    def collect(self, steps: int, expert_share: float, act: Act | None, stopped: Callable[[], bool]) -> Dataset:
        """Runs a batch of episodes.

        Args:
            steps: of each, at most.
            expert_share: share of the time in which the expert acts.
            act: the student, from observations to actions; None lets the expert act alone.
            stopped: whether to end early.
        """
        rng, count = self._rng, self._env.num_envs
        seeds = rng.integers(2**31, size=count).tolist()
        observations, _ = self._env.reset(seed=seeds, options=self._plant_changes(steps * CONTROL_DT))
        inputs_of = StudentInputs(self._student, count)
        running, expert_acts = np.ones(count, bool), rng.random(count) < expert_share
        inputs, regrets = [], []
        for _ in range(steps):
            regret = regrets_of(self._expert.scores(observations), self._student.max_regret)
            observed = observations[:, : inputs_of.observed]
            inputs.append(inputs_of(observed)[running])
            regrets.append(regret[running])
            actions = TORQUES[regret.argmin(axis=1)]
            if act is not None:
                switch = rng.random(count) < SWITCH_PROBABILITY
                expert_acts = np.where(switch, rng.random(count) < expert_share, expert_acts)
                actions = np.where(expert_acts, actions, act(observed)[:, 0])
            explore = rng.random(count) < EXPLORATION_PROBABILITY
            actions = np.where(explore, rng.uniform(-1.0, 1.0, count), actions)
            observations, _, terminated, truncated, _ = self._env.step(actions[:, None].astype(np.float32))
            running &= ~(terminated | truncated)
            if stopped() or not running.any():
                break
        return Dataset(np.concatenate(inputs), np.concatenate(regrets))

    def _plant_changes(self, seconds: float) -> dict[str, Any]:
        """The options of a reset: the times at which M and mu change within so many seconds, and their new values."""
        if not self._student.change_rate:
            return {}
        distribution, rng, changes = Randomization.named(self._student.randomization), self._rng, []
        for _ in range(self._env.num_envs):
            times = np.sort(rng.uniform(0.0, seconds, rng.poisson(self._student.change_rate * seconds))).tolist()
            plants = [draw_plant(distribution, NOMINAL, rng) for _ in times]
            changes.append([{"t": t, "M": M, "mu": mu} for t, (M, mu) in zip(times, plants, strict=True)])
        return {"changes": changes}
