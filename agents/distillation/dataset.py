"""The data of distillation: the states that expert and student visit, and regrets of torques.

The expert is the optimum of the episode's plant at its true state,
`baselines.dynamic_programming.policy.PlantOracle`. The student observes neither the plant nor, with
disturbances, the state: it learns the torque with the least mean regret over all that its
observations may belong to.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from agents.distillation.config import Student
from agents.distillation.plants import Group, draw_changes, draw_disturbances
from baselines.dynamic_programming.policy import NUM_TORQUES, TORQUES, PlantOracle
from baselines.dynamic_programming.problem import PENDULUM
from baselines.dynamic_programming.solver import Solution
from capsule_gym import CapsuleVectorEnv
from capsule_gym.core.layout import Row
from capsule_gym.parameters import NOMINAL
from capsule_gym.policies.scripted import Act
from capsule_gym.tasks.task import CONTROL_DT

# Probability per step that the acting policy is drawn again.
SWITCH_PROBABILITY = 0.02
# Probability per step that the action is random.
EXPLORATION_PROBABILITY = 0.01


class Dataset(NamedTuple):
    """The episodes of one round.

    Attributes:
        inputs: the student's observations, shape (episodes, steps, entries), float32.
        regrets: regret of each of `TORQUES`, cm, shape (episodes, steps, NUM_TORQUES), float16;
            torques that leave less normal force than the margin cost more.
        running: whether the episode has not ended, shape (episodes, steps).
    """

    inputs: np.ndarray
    regrets: np.ndarray
    running: np.ndarray


def collect(
    student: Student,
    groups: Sequence[Group],
    solutions: Sequence[Solution],
    rng: np.random.Generator,
    expert_share: float,
    act: Act | None,
) -> Dataset:
    """Runs a batch of episodes in which the expert acts for `expert_share` of the time.

    The student's `act` acts in the remaining time; if it is None, only the expert acts. `rng` draws
    the plants, the acting policy and the exploration.
    """
    count = student.num_envs
    env_kwargs = student.env_kwargs
    env = CapsuleVectorEnv(num_envs=count, autoreset_mode=AutoresetMode.DISABLED, **env_kwargs)
    expert = PlantOracle(env.simulation, solutions)
    lightest = min((problem.M for group in groups for problem in group.targets), default=0.0)
    seeds = rng.integers(2**31, size=count).tolist()
    options = _episode_options(student, groups, rng)
    observations, _ = env.reset(seed=seeds, options=options)
    inputs = np.zeros((student.steps, *observations.shape), np.float32)
    regrets = np.zeros((student.steps, count, NUM_TORQUES), np.float16)
    running = np.zeros((student.steps, count), bool)
    runs = np.ones(count, bool)
    expert_acts = rng.random(count) < expert_share
    for step in range(student.steps):
        spare = np.maximum(env.simulation.row(Row.M) - lightest, 0.0) * NOMINAL.g
        margin = student.margin + student.spare_share * spare[:, None]
        regret = _regret(expert.scores(), expert.normal_force, margin, student.max_regret)
        inputs[step] = observations
        regrets[step] = regret
        running[step] = runs
        actions = TORQUES[regret.argmin(axis=1)]
        if act is not None:
            switch = rng.random(count) < SWITCH_PROBABILITY
            expert_acts = np.where(switch, rng.random(count) < expert_share, expert_acts)
            actions = np.where(expert_acts, actions, act(observations)[:, 0])
        explore = rng.random(count) < EXPLORATION_PROBABILITY
        actions = np.where(explore, rng.uniform(-1.0, 1.0, count), actions)
        observations, _, terminated, truncated, _ = env.step(actions[:, None].astype(np.float32))
        runs &= ~(terminated | truncated)
        if not runs.any():
            break
    return Dataset(inputs.swapaxes(0, 1), regrets.swapaxes(0, 1), running.swapaxes(0, 1))


def _regret(
    scores: np.ndarray, normal_force: np.ndarray, margin: np.ndarray, max_regret: float
) -> np.ndarray:
    """The regret of every torque, cm, shape (episodes, NUM_TORQUES).

    Args:
        scores: the expert's scores of the torques, cm, shape (episodes, NUM_TORQUES).
        normal_force: least normal force after each torque, N, of the same shape.
        margin: normal force below which a torque costs more, N, shape (episodes, 1).
        max_regret: what it costs more at 0 N, and the upper bound of a regret, cm.
    """
    scores = scores - max_regret * np.clip(1.0 - normal_force / margin, 0.0, 1.0)
    regret = scores.max(axis=1, keepdims=True) - scores
    return np.minimum(regret, max_regret)


def _episode_options(
    student: Student, groups: Sequence[Group], rng: np.random.Generator
) -> dict[str, Any]:
    """The options of a reset: the plants of the episodes, their changes and disturbances."""
    seconds = student.steps * CONTROL_DT
    episodes: list[dict[str, Any]] = []
    for _ in range(student.num_envs):
        group = groups[int(rng.integers(len(groups)))]
        problem = group.problems[int(rng.integers(len(group.problems)))]
        options: dict[str, Any] = {"M": problem.M, "mu": problem.mu}
        options["changes"] = draw_changes(group, student.change_rate, seconds, rng)
        if student.disturbances != "none":
            names = (*PENDULUM, "static_ratio")
            options["capsule"] = {name: getattr(problem, name) for name in names}
            # That of the problem is one of the disturbances.
            options["capsule"]["motor_friction"] = 0.0
            options["disturbances"] = draw_disturbances(group, rng)
        episodes.append(options)
    return {name: [options[name] for options in episodes] for name in episodes[0]}
