"""The data of distillation: states that expert and student visit, and the regret of every torque in
these states.

The expert is the optimum of the episode's plant, `baselines.dynamic_programming.policy.Oracle`. It
observes M and mu. From a student, M and mu are hidden: it observes online estimates, and learns the
torque with the least mean regret over the plants that a state may belong to.
"""

from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from agents.distillation.config import Student
from baselines.dynamic_programming.policy import TORQUES, Oracle
from capsule_gym import CapsuleVectorEnv
from capsule_gym.envs.contract import draw_plant
from capsule_gym.parameters import NOMINAL, RANDOMIZATIONS
from capsule_gym.policies.scripted import Act
from capsule_gym.tasks.task import CONTROL_DT

# Probabilities per step that the acting policy is drawn again, and that the action is random.
SWITCH_PROBABILITY, EXPLORATION_PROBABILITY = 0.02, 0.01


class Dataset(NamedTuple):
    """The states of one round.

    Attributes:
        inputs: the student's observations, shape (states, entries), float32.
        regrets: regret of each of `TORQUES`, cm, shape (states, NUM_TORQUES), float32; torques that
            leave less normal force than the margin cost more.
    """

    inputs: np.ndarray
    regrets: np.ndarray


def collect(
    student: Student, rng: np.random.Generator, expert_share: float, act: Act | None
) -> Dataset:
    """Runs a batch of episodes in which the expert acts for `expert_share` of the time, and the
    student's `act` else.

    `rng` draws the plants, the acting policy and the exploration. If `act` is None, only the expert
    acts.
    """
    count, none = student.num_envs, AutoresetMode.DISABLED
    env = CapsuleVectorEnv(
        num_envs=count, autoreset_mode=none, **{**student.env_kwargs, "observe_parameters": True}
    )
    expert = Oracle(count, student.grid)
    # The expert observes M and mu, but no estimates; the student estimates, but neither M nor mu.
    names = list(env.simulation.entries)
    plant, deviation = names.index("M"), names.index("M_deviation")
    seeds = rng.integers(2**31, size=count).tolist()
    observations, _ = env.reset(seed=seeds, options=_plant_changes(student, rng))
    running, expert_acts = np.ones(count, bool), rng.random(count) < expert_share
    inputs, regrets = [], []
    for _ in range(student.steps):
        given = np.delete(observations, [plant, plant + 1], axis=1)
        scores = expert.scores(observations[:, : plant + 2])
        margins = (
            np.full((count, 1), student.margin)
            + student.deviations * NOMINAL.g * observations[:, [deviation]]
        )
        scores -= student.max_regret * np.clip(1.0 - expert.normal_force / margins, 0.0, 1.0)
        regret = np.minimum(scores.max(axis=1, keepdims=True) - scores, student.max_regret).astype(
            np.float32
        )
        inputs.append(given[running])
        regrets.append(regret[running])
        actions = TORQUES[regret.argmin(axis=1)]
        if act is not None:
            switch = rng.random(count) < SWITCH_PROBABILITY
            expert_acts = np.where(switch, rng.random(count) < expert_share, expert_acts)
            actions = np.where(expert_acts, actions, act(given)[:, 0])
        explore = rng.random(count) < EXPLORATION_PROBABILITY
        actions = np.where(explore, rng.uniform(-1.0, 1.0, count), actions)
        observations, _, terminated, truncated, _ = env.step(actions[:, None].astype(np.float32))
        running &= ~(terminated | truncated)
        if not running.any():
            break
    return Dataset(np.concatenate(inputs), np.concatenate(regrets))


def _plant_changes(student: Student, rng: np.random.Generator) -> dict[str, Any]:
    """The options of a reset: the times at which M and mu change within an episode, and their new
    values.
    """
    seconds, changes = student.steps * CONTROL_DT, []
    for _ in range(student.num_envs):
        times = np.sort(
            rng.uniform(0.0, seconds, rng.poisson(student.change_rate * seconds))
        ).tolist()
        plants = [draw_plant(RANDOMIZATIONS["wide"], NOMINAL, rng) for _ in times]
        changes.append(
            [{"t": t, "M": M, "mu": mu} for t, (M, mu) in zip(times, plants, strict=True)]
        )
    return {"changes": changes}
