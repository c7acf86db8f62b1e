"""Trajectories of the solutions' policies in the environment, how they are repeated, and their limit cycle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from baselines.dynamic_programming.problem import Problem, Transitions
from baselines.dynamic_programming.solver import Solution
from capsule_gym.layout import Row
from capsule_gym.parameters import DIRECT_PHYSICS_DT
from capsule_gym.simulation import Simulation
from capsule_gym.task import HORIZON, START_THETA, TORQUE_LIMIT

# Torques over their limit from which a policy chooses; their indices fit into a byte.
ACTIONS = np.linspace(-1.0, 1.0, 121)
# s: by then every trajectory is close to its limit cycle.
SETTLED = HORIZON / 2.0
# rad, rad/s, m, m/s: differences of these sizes between the ends of a cycle count alike.
SCALES = np.array([0.1, 1.0, np.inf, 0.05])


@dataclass(frozen=True)
class Trajectory:
    """Episodes side by side.

    Attributes:
        metrics: of `capsule_gym.task.Metrics`, each of shape (episodes,).
        states: theta (rad), theta_dot (rad/s), x (m), x_dot (m/s) at the beginning of every step, shape (steps, 4,
            episodes).
        choices: the torques as indices of `ACTIONS`, shape (steps, episodes), uint8.
        normal_forces: the smallest of each step, N, shape (steps, episodes).
        stuck: time for which the platform has stuck by the end of each step, s, shape (steps, episodes).
    """

    metrics: dict[str, np.ndarray]
    states: np.ndarray
    choices: np.ndarray
    normal_forces: np.ndarray
    stuck: np.ndarray

    def cycle_starts(self) -> np.ndarray:
        """The steps of the first episode at which the pendulum has just reversed to move forwards, left of upright."""
        theta, theta_dot = self.states[:, 0, 0], self.states[:, 1, 0]
        return np.flatnonzero((theta_dot[:-1] <= 0.0) & (theta_dot[1:] > 0.0) & (theta[1:] < 0.0)) + 1

    def steady_speed(self, control_dt: float) -> float:
        """The first episode's mean speed over whole cycles after `SETTLED`, cm/s, or without cycles over that time."""
        first = round(SETTLED / control_dt)
        starts = self.cycle_starts()
        starts = starts[starts >= first]
        begin, end = (starts[0], starts[-1]) if starts.size > 1 else (first, len(self.states) - 1)
        x = self.states[:, 2, 0]
        return float(100.0 * (x[end] - x[begin]) / ((end - begin) * control_dt))


def _record(problem: Problem, thetas: np.ndarray, steps: int, choose: Callable[[int, np.ndarray], Any]) -> Trajectory:
    """Runs episodes from rest at some angles; `choose` takes the step and the states and returns the choices."""
    count = thetas.size
    simulation = Simulation(count, problem.options)
    starts = np.zeros((count, 4))
    starts[:, 0] = thetas
    simulation.reset(np.arange(count), [problem.M] * count, [problem.mu] * count, starts)
    states, choices = np.empty((steps, 4, count)), np.empty((steps, count), np.uint8)
    normal_forces, stuck = np.empty((2, steps, count))
    for step in range(steps):
        states[step] = simulation.rows(Row.theta, Row.x_dot + 1)
        choices[step] = choose(step, states[step])
        simulation.step(ACTIONS[choices[step]], simulation.row(Row.termination) == 0.0)
        normal_forces[step] = simulation.row(Row.normal_force)
        stuck[step] = simulation.row(Row.stuck)
    return Trajectory(simulation.metrics(np.arange(count), steps), states, choices, normal_forces, stuck)


def run_policy(solution: Solution, thetas: np.ndarray | None = None, *, horizon: float = HORIZON) -> Trajectory:
    """Runs the policy that takes, at every step, the torque with the largest reward plus value of the next state.

    Args:
        solution: with the values.
        thetas: where the episodes start, at rest, rad; None is the task's own start.
        horizon: length, s.
    """
    problem = solution.problem
    thetas = np.array([START_THETA]) if thetas is None else thetas
    model = Transitions(problem, thetas.size * ACTIONS.size)
    actions = np.tile(ACTIONS, thetas.size)

    def choose(step: int, states: np.ndarray) -> np.ndarray:
        ends, rewards, failed = model.step(np.repeat(states[[0, 1, 3]], ACTIONS.size, axis=1), actions)
        scores = np.where(failed, -np.inf, rewards + solution.at(ends))
        return scores.reshape(-1, ACTIONS.size).argmax(axis=1)

    return _record(problem, thetas, round(horizon / problem.control_dt), choose)


def repeat(problem: Problem, choices: np.ndarray) -> Trajectory:
    """Repeats the torques of one episode from the task's start; `choices` are indices of `ACTIONS`, shape (steps,)."""
    return _record(problem, np.array([START_THETA]), choices.size, lambda step, states: choices[step])


class Cycle(NamedTuple):
    """One period of a limit cycle, sampled at every step of the integrator; arrays are float64 of shape (samples,).

    It begins where the pendulum reverses to move forwards on the left.

    Attributes:
        time: s, from 0.
        theta: rad.
        theta_dot: rad/s.
        x: m, from 0.
        x_dot: m/s.
        normal_force: N, the smallest of the step that begins there.
        torque: N m, during that step.
        stick: 1.0 where the platform sticks throughout that step, else 0.0.
        period: s.
        speed: mean of the cycle, cm/s.
    """

    time: np.ndarray
    theta: np.ndarray
    theta_dot: np.ndarray
    x: np.ndarray
    x_dot: np.ndarray
    normal_force: np.ndarray
    torque: np.ndarray
    stick: np.ndarray
    period: float
    speed: float


@lru_cache(maxsize=8)
def cycle(problem: Problem | None = None) -> Cycle:
    """The settled period whose ends differ the least, of the trajectory on file.

    Args:
        problem: one of those that `python -m baselines.dynamic_programming` solves; None is the nominal plant's.

    Raises:
        ValueError: if there is no trajectory of it on file.
    """
    from baselines.dynamic_programming.archive import key_of, known_results

    problem, archive = problem or Problem(), known_results()
    if key_of(problem) not in archive.results:
        raise ValueError(f"problem must be one of those on file, got {problem}")
    choices = archive.choices(problem)
    trajectory = repeat(problem, choices)
    starts = trajectory.cycle_starts()
    starts = starts[starts * problem.control_dt >= SETTLED]
    n = int(np.abs(np.diff(trajectory.states[starts, :, 0], axis=0) / SCALES).max(axis=1).argmin())
    begin, end = int(starts[n]), int(starts[n + 1])
    # The same trajectory in steps of the integrator, and one control interval more, for where the cycle ends.
    substeps = round(problem.control_dt / DIRECT_PHYSICS_DT)
    dt = problem.control_dt / substeps
    fine = repeat(replace(problem, control_dt=dt), np.repeat(choices[: end + 1], substeps))
    part = slice(begin * substeps, end * substeps)
    theta, theta_dot, x, x_dot = fine.states[part, :, 0].T
    period = (end - begin) * problem.control_dt
    return Cycle(
        time=dt * np.arange(theta.size),
        theta=theta,
        theta_dot=theta_dot,
        x=x - x[0],
        x_dot=x_dot,
        normal_force=fine.normal_forces[part, 0],
        torque=TORQUE_LIMIT * ACTIONS[fine.choices[part, 0]],
        stick=(np.diff(fine.stuck[:, 0], prepend=0.0)[part] > 0.5 * dt).astype(np.float64),
        period=period,
        speed=float(100.0 * (fine.states[part.stop, 2, 0] - x[0]) / period),
    )
