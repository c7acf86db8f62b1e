"""The data of distillation: the states that expert and student visit, and regrets of torques.

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

# Probability per step that the acting policy is drawn again.
SWITCH_PROBABILITY = 0.02
# Probability per step that the action is random.
EXPLORATION_PROBABILITY = 0.01


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
    """Runs a batch of episodes in which the expert acts for `expert_share` of the time.

    The student's `act` acts in the remaining time; if it is None, only the expert acts. `rng` draws
    the plants, the acting policy and the exploration.
    """
    count = student.num_envs
    env_kwargs = student.env_kwargs | {"observe_parameters": True}
    env = CapsuleVectorEnv(num_envs=count, autoreset_mode=AutoresetMode.DISABLED, **env_kwargs)
    entries = list(env.simulation.entries)
    M, mu = entries.index("M"), entries.index("mu")
    expert = Oracle(count, student.grid)
    seeds = rng.integers(2**31, size=count).tolist()
    observations, _ = env.reset(seed=seeds, options=_plant_changes(student, rng))
    running = np.ones(count, bool)
    expert_acts = rng.random(count) < expert_share
    inputs = []
    regrets = []
    for _ in range(student.steps):
        # The expert observes M and mu, but no estimates; the student estimates, but neither M nor
        # mu.
        observed = np.delete(observations, [M, mu], axis=1)
        scores = expert.scores(observations[:, : mu + 1])
        M_deviation = observations[:, [entries.index("M_deviation")]]
        regret = _regret(student, scores, expert.normal_force, M_deviation)
        inputs.append(observed[running])
        regrets.append(regret[running])
        actions = TORQUES[regret.argmin(axis=1)]
        if act is not None:
            switch = rng.random(count) < SWITCH_PROBABILITY
            expert_acts = np.where(switch, rng.random(count) < expert_share, expert_acts)
            actions = np.where(expert_acts, actions, act(observed)[:, 0])
        explore = rng.random(count) < EXPLORATION_PROBABILITY
        actions = np.where(explore, rng.uniform(-1.0, 1.0, count), actions)
        observations, _, terminated, truncated, _ = env.step(actions[:, None].astype(np.float32))
        running &= ~(terminated | truncated)
        if not running.any():
            break
    return Dataset(np.concatenate(inputs), np.concatenate(regrets))


def _regret(
    student: Student, scores: np.ndarray, normal_force: np.ndarray, M_deviation: np.ndarray
) -> np.ndarray:
    """The regret of every torque, cm, shape (episodes, NUM_TORQUES).

    Args:
        student: the student, whose margin makes torques with little normal force more costly.
        scores: the expert's scores of the torques, cm, shape (episodes, NUM_TORQUES).
        normal_force: least normal force after each torque, N, of the same shape.
        M_deviation: standard deviation of the estimate of M, kg, shape (episodes, 1).
    """
    weight_deviations = student.deviations * NOMINAL.g * M_deviation
    margins = student.margin + weight_deviations.astype(np.float64)
    scores = scores - student.max_regret * np.clip(1.0 - normal_force / margins, 0.0, 1.0)
    regret = scores.max(axis=1, keepdims=True) - scores
    return np.minimum(regret, student.max_regret).astype(np.float32)


def _plant_changes(student: Student, rng: np.random.Generator) -> dict[str, Any]:
    """The options of a reset: when M and mu change within an episode, and their new values."""
    seconds = student.steps * CONTROL_DT
    changes: list[list[dict[str, float]]] = []
    for _ in range(student.num_envs):
        count = rng.poisson(student.change_rate * seconds)
        changes.append([])
        for t in sorted(rng.uniform(0.0, seconds, count).tolist()):
            M, mu = draw_plant(RANDOMIZATIONS["wide"], NOMINAL, rng)
            changes[-1].append({"t": t, "M": M, "mu": mu})
    return {"changes": changes}
