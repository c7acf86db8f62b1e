"""What the teacher says: states that teacher and student come to, and what each torque would cost there.

The teacher is the optimum of the plant at hand, `baselines.dynamic_programming.policy.Oracle`. It is shown M and
mu, the student only where it is told them; what is best for it then is what costs least over the plants that a state
may belong to.
One that identifies them on line is given what `capsule_gym.identification` finds besides.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from agents.distil.students import Student
from baselines.dynamic_programming.policy import TORQUES, Oracle
from capsule_gym import CapsuleVectorEnv
from capsule_gym.compilation import compile_cached
from capsule_gym.identification import CELLS
from capsule_gym.network import make_header, write_inputs
from capsule_gym.parameters import NOMINAL, EnvConfig, Randomization
from capsule_gym.resets import draw_plant
from capsule_gym.task import CONTROL_DT

Act = Callable[[np.ndarray], np.ndarray]

# Between two steps: that the lead is drawn anew, and that a step's torque is a random one.
TURN, STRAY = 0.02, 0.01


class Lesson(NamedTuple):
    """Some states.

    Attributes:
        inputs: what the student's network is given, shape (states, inputs), float32.
        regrets: what each of `TORQUES` costs against the best, cm, shape (states, NUM_TORQUES), float32.
    """

    inputs: np.ndarray
    regrets: np.ndarray


def regrets_of(scores: np.ndarray, most: float) -> np.ndarray:
    """What each torque costs against the best.

    Args:
        scores: what the torques are worth, cm, shape (states, NUM_TORQUES).
        most: what one costs at most, cm.

    Returns:
        cm, of the same shape, float32; 0 everywhere where every torque ends the episode.
    """
    return np.minimum(scores.max(axis=1, keepdims=True) - scores, most).astype(np.float32)


class Sight:
    """What a student's network is given in some episodes, from their beginnings on.

    Args:
        student: whose.
        count: episodes.
    """

    def __init__(self, student: Student, count: int) -> None:
        options = EnvConfig(**student.env_kwargs)
        header = make_header(
            options,
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
        """The inputs of the next step, shape (episodes, inputs), for what the student observes."""
        seen = np.ascontiguousarray(observations)
        _perceive()(self._header, seen, 0, len(seen), self._memory, self._inputs)
        return self._inputs.copy()


@lru_cache(maxsize=1)
def _perceive() -> Any:
    """`network.write_inputs`, compiled by itself."""
    return compile_cached(write_inputs.py_func)


class Classroom:
    """Episodes in which teacher and student take turns.

    Args:
        student: what it meets and sees.
        num_envs: episodes side by side.
        rng: draws plants, turns and random torques.
    """

    def __init__(self, student: Student, num_envs: int, rng: np.random.Generator) -> None:
        self._env = CapsuleVectorEnv(
            num_envs=num_envs,
            randomization=student.randomization,
            observe_parameters=True,
            autoreset_mode=AutoresetMode.DISABLED,
        )
        self._student = student
        self._teacher = Oracle(num_envs, student.margin)
        self._rng = rng

    def lesson(self, steps: int, share: float, act: Act | None, stopped: Callable[[], bool]) -> Lesson:
        """Runs episodes from their start.

        Args:
            steps: of each, at most.
            share: of the time in which the teacher leads.
            act: the student, which begins now, from what it observes to actions; None where the teacher leads alone.
            stopped: whether to end early.
        """
        rng, count = self._rng, self._env.num_envs
        seeds = rng.integers(2**31, size=count).tolist()
        observations, _ = self._env.reset(seed=seeds, options=self._jumps(steps * CONTROL_DT))
        sight = Sight(self._student, count)
        going, leads = np.ones(count, bool), rng.random(count) < share
        seen, regrets = [], []
        for _ in range(steps):
            regret = regrets_of(self._teacher.scores(observations), self._student.most_regret)
            view = observations[:, : sight.observed]
            seen.append(sight(view)[going])
            regrets.append(regret[going])
            actions = TORQUES[regret.argmin(axis=1)]
            if act is not None:
                leads = np.where(rng.random(count) < TURN, rng.random(count) < share, leads)
                actions = np.where(leads, actions, act(view)[:, 0])
            strays = rng.random(count) < STRAY
            actions = np.where(strays, rng.uniform(-1.0, 1.0, count), actions)
            observations, _, terminated, truncated, _ = self._env.step(actions[:, None].astype(np.float32))
            going &= ~(terminated | truncated)
            if stopped() or not going.any():
                break
        return Lesson(np.concatenate(seen), np.concatenate(regrets))

    def _jumps(self, seconds: float) -> dict[str, Any]:
        """The options of a reset: when M and mu jump within so many seconds, and where to."""
        if not self._student.jump_rate:
            return {}
        drawn, rng, changes = Randomization.named(self._student.randomization), self._rng, []
        for _ in range(self._env.num_envs):
            times = np.sort(rng.uniform(0.0, seconds, rng.poisson(self._student.jump_rate * seconds))).tolist()
            plants = [draw_plant(drawn, NOMINAL, rng) for _ in times]
            changes.append([{"t": t, "M": M, "mu": mu} for t, (M, mu) in zip(times, plants, strict=True)])
        return {"changes": changes}
