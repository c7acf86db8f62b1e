"""Motions of the optimum: what its policy does in the environment, and how a motion is kept and repeated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baselines.optimum.solver import Problem, Solution
from capsule_gym.layout import Row
from capsule_gym.simulation import Simulation
from capsule_gym.task import HORIZON, START_THETA

# Torques among which the policy looks ahead, evenly spaced over the limits: as many as a byte can name.
CANDIDATES = 121
# s: by then every optimum has left its start behind.
SETTLED = HORIZON / 2.0


@dataclass(frozen=True)
class Motion:
    """Episodes side by side.

    Attributes:
        metrics: of `capsule_gym.task.Metrics`, each of shape (episodes,).
        states: theta (rad), theta_dot (rad/s), x (m), x_dot (m/s) at the beginning of every hold, shape (holds, 4,
            episodes).
        choices: the torques as indices of `CANDIDATES`, shape (holds, episodes), uint8.
        normal_forces: the smallest of the hold, N, shape (holds, episodes).
        stuck: how long the platform had stuck by the end of the hold, s, likewise.
    """

    metrics: dict[str, np.ndarray]
    states: np.ndarray
    choices: np.ndarray
    normal_forces: np.ndarray
    stuck: np.ndarray

    @property
    def actions(self) -> np.ndarray:
        """The torques over their limit, shape (holds, episodes)."""
        return ACTIONS[self.choices]


ACTIONS = np.linspace(-1.0, 1.0, CANDIDATES)


class _Recorder:
    """Episodes of a problem's plant, recorded hold by hold."""

    def __init__(self, problem: Problem, thetas: np.ndarray, steps: int) -> None:
        count = thetas.size
        self.steps = steps
        self.simulation = Simulation(count, problem.options)
        starts = np.zeros((count, 4))
        starts[:, 0] = thetas
        self.simulation.reset(np.arange(count), [problem.M] * count, [problem.mu] * count, starts)
        self.states = np.empty((steps, 4, count))
        self.choices = np.empty((steps, count), np.uint8)
        self.normal_forces, self.stuck = np.empty((2, steps, count))

    def look(self, step: int) -> np.ndarray:
        """The states at the beginning of a hold: theta, theta_dot, x_dot."""
        self.states[step] = self.simulation.rows(Row.theta, Row.x_dot + 1)
        return self.states[step][[0, 1, 3]]

    def take(self, step: int, choices: np.ndarray) -> None:
        self.choices[step] = choices
        self.simulation.step(ACTIONS[choices], self.simulation.row(Row.termination) == 0.0)
        self.normal_forces[step] = self.simulation.row(Row.normal_force)
        self.stuck[step] = self.simulation.row(Row.stuck)

    def motion(self) -> Motion:
        metrics = self.simulation.metrics(np.arange(self.simulation.num_envs), self.steps)
        return Motion(metrics, self.states, self.choices, self.normal_forces, self.stuck)


def follow(solution: Solution, thetas: np.ndarray | None = None, *, horizon: float = HORIZON) -> Motion:
    """Runs the policy that takes, hold by hold, the torque of the best reward and value after it.

    Args:
        solution: with the values.
        thetas: where the episodes start, at rest, rad; the task's own start by default.
        horizon: length, s.
    """
    problem = solution.problem
    thetas = np.array([START_THETA]) if thetas is None else np.asarray(thetas, np.float64)
    recorder = _Recorder(problem, thetas, round(horizon / problem.hold))
    holds = problem.holds(thetas.size * CANDIDATES)
    actions = np.tile(ACTIONS, thetas.size)
    for step in range(recorder.steps):
        holds.put(np.repeat(recorder.look(step), CANDIDATES, axis=1))
        ends, rewards, dead = holds.take(actions)
        dead |= holds.normal_force() <= problem.margin
        scores = np.where(dead, -np.inf, rewards + solution.at(ends))
        recorder.take(step, scores.reshape(-1, CANDIDATES).argmax(axis=1))
    return recorder.motion()


def repeat(problem: Problem, choices: np.ndarray) -> Motion:
    """Repeats the torques of one episode from the task's start.

    Args:
        problem: with the plant and the hold.
        choices: indices of `CANDIDATES`, shape (holds,).
    """
    recorder = _Recorder(problem, np.array([START_THETA]), choices.size)
    for step, choice in enumerate(choices):
        recorder.look(step)
        recorder.take(step, np.array([choice]))
    return recorder.motion()


def steady_speed(motion: Motion, hold: float) -> float:
    """The mean speed over whole cycles after `SETTLED`, cm/s; over all that time where there are none.

    A cycle begins where the pendulum turns forwards on the left.

    Args:
        motion: its first episode counts.
        hold: s.
    """
    first = round(SETTLED / hold)
    turns = cycle_starts(motion)
    turns = turns[turns >= first]
    begin, end = (turns[0], turns[-1]) if turns.size > 1 else (first, len(motion.states) - 1)
    x = motion.states[:, 2, 0]
    return float(100.0 * (x[end] - x[begin]) / ((end - begin) * hold))


def cycle_starts(motion: Motion) -> np.ndarray:
    """The holds of the first episode at whose beginning the pendulum has just turned forwards, left of the upright."""
    theta, theta_dot = motion.states[:, 0, 0], motion.states[:, 1, 0]
    turned = (theta_dot[:-1] <= 0.0) & (theta_dot[1:] > 0.0) & (theta[1:] < 0.0)
    return np.flatnonzero(turned) + 1
