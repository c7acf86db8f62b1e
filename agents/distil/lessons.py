"""What the teacher says: states that teacher and student come to, and what each torque would cost there.

The teacher is the optimum of the plant at hand, `baselines.optimum.policy.Oracle`. It is shown M and mu, the student
only where it is told them; what is best for it then is what costs least over the plants that a state may belong to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from baselines.optimum.policy import TORQUES, Oracle
from capsule_gym import CapsuleVectorEnv
from capsule_gym.task import observation_names

Act = Callable[[np.ndarray], np.ndarray]

# Between two steps: that the lead is drawn anew, and that a step's torque is a random one.
TURN, STRAY = 0.02, 0.01
# cm: what a torque costs at most. The end of an episode, which costs more, is as clear as that.
MOST_REGRET = 5.0


@dataclass(frozen=True)
class Student:
    """What a student meets and sees.

    Attributes:
        randomization: where M and mu of its episodes come from.
        told: whether it observes them.
        rivals: policies that it is compared with.
    """

    randomization: str
    told: bool
    rivals: tuple[str, ...]

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """The arguments of the environment that it acts in."""
        return {"randomization": self.randomization, "observe_parameters": self.told}


# By their names, which those that are published have on the leaderboard; the teacher is the first rival.
STUDENTS = {
    "optimum-distilled": Student(
        "paper", False, ("optimum-oracle", "optimum-nominal", "residual-on-gait", "direct-ppo")
    ),
    "optimum-distilled-told": Student("wide", True, ("optimum-oracle", "robust", "direct-ppo-wide")),
}


class Lesson(NamedTuple):
    """Some states.

    Attributes:
        observations: what the student sees, shape (states, entries), float32.
        regrets: what each of `TORQUES` costs against the best, cm, shape (states, TRIED), float32.
    """

    observations: np.ndarray
    regrets: np.ndarray


def regrets_of(scores: np.ndarray) -> np.ndarray:
    """What each torque costs against the best, at most `MOST_REGRET`.

    Args:
        scores: what the torques are worth, cm, shape (states, TRIED).

    Returns:
        cm, of the same shape, float32; 0 everywhere where every torque ends the episode.
    """
    return np.minimum(scores.max(axis=1, keepdims=True) - scores, MOST_REGRET).astype(np.float32)


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
        self._entries = len(observation_names(False, student.told))
        self._teacher = Oracle(num_envs)
        self._rng = rng

    def lesson(self, steps: int, share: float, act: Act | None, stopped: Callable[[], bool]) -> Lesson:
        """Runs episodes from their start.

        Args:
            steps: of each, at most.
            share: of the time in which the teacher leads.
            act: the student, from what it sees to actions; None where the teacher leads alone.
            stopped: whether to end early.
        """
        rng, count = self._rng, self._env.num_envs
        observations, _ = self._env.reset(seed=rng.integers(2**31, size=count).tolist())
        going, leads = np.ones(count, bool), rng.random(count) < share
        seen, regrets = [], []
        for _ in range(steps):
            regret = regrets_of(self._teacher.scores(observations))
            view = observations[:, : self._entries]
            seen.append(view[going])
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
