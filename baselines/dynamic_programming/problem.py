"""The problems that dynamic programming solves, their plants, the transitions, and trajectories."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from capsule_gym.core.layout import Row
from capsule_gym.envs.config import DIRECT_PHYSICS_DT, EnvConfig
from capsule_gym.envs.simulation import Simulation
from capsule_gym.evaluation.optimum import GRID, STICKY_GRID, PlantGrid
from capsule_gym.parameters import NOMINAL, Capsule
from capsule_gym.tasks.task import CONTROL_DT, HORIZON, START_THETA

# Torques, divided by their limit, from which a policy chooses; their indices fit into a byte.
ACTIONS = np.linspace(-1.0, 1.0, 121)
SETTLED = HORIZON / 2.0  # s: time after which every trajectory is close to its limit cycle
CONTROL_INTERVALS = (0.01, 0.005)  # s
# cm/J
ENERGY_WEIGHTS = (
    0.1,
    0.2,
    0.4,
    0.7,
    1.0,
    1.5,
    2.0,
    3.0,
    4.0,
    6.0,
    8.0,
    12.0,
    16.0,
    24.0,
    32.0,
    48.0,
    64.0,
)
# N: normal force that `dp-nominal` leaves; the lightest platform of `wide` weighs 1.47 N less than
# the nominal one.
NOMINAL_MARGIN = 1.6


@dataclass(frozen=True, kw_only=True)
class Problem:
    """The objective: the mean speed, less a weight times the energy."""

    M: float = NOMINAL.M  # mass of the platform, kg
    mu: float = NOMINAL.mu
    energy_weight: float = 0.0  # cm/J
    control_dt: float = CONTROL_DT  # control interval, over which the torque is constant, s
    margin: float = 0.0  # normal force that must be left, N; a smaller one counts as a failure
    static_ratio: float = NOMINAL.static_ratio

    @property
    def key(self) -> str:
        """The name under which the archive holds the problem."""
        numbers = [self.M, self.mu, self.energy_weight, self.control_dt, self.margin]
        # The nominal ratio is omitted, as in the first archives.
        numbers += [self.static_ratio] if self.static_ratio != NOMINAL.static_ratio else []
        return " ".join(f"{number:g}" for number in numbers)

    @cached_property
    def options(self) -> EnvConfig:
        """Options of the environment whose agent step is the control interval."""
        return EnvConfig(
            control_dt=self.control_dt,
            # The environment's own step if it divides the control interval.
            physics_dt=self.control_dt / math.ceil(self.control_dt / DIRECT_PHYSICS_DT - 1e-9),
            energy_weight=self.energy_weight,
            termination_penalty=0.0,
            randomization="none",
            capsule=Capsule(static_ratio=self.static_ratio),
        )


def plant_problems(grid: PlantGrid) -> list[Problem]:
    """The speed problem of every plant of a grid."""
    return [Problem(M=M, mu=mu, static_ratio=grid.static_ratio) for M, mu in grid.plants]


PROBLEMS = (
    *plant_problems(GRID),
    *plant_problems(STICKY_GRID),
    Problem(margin=NOMINAL_MARGIN),
    *(Problem(energy_weight=weight) for weight in ENERGY_WEIGHTS),
    *(Problem(control_dt=control_dt) for control_dt in CONTROL_INTERVALS),
)


class Transitions:
    """A batch of environments that takes one step from each of `count` states, on the problem's
    plant or others.
    """

    def __init__(self, problem: Problem, count: int) -> None:
        self._simulation = Simulation(count, problem.options)
        self._zeros = np.zeros(count)
        self.margin = problem.margin
        self.set_plants(np.full(count, problem.M), np.full(count, problem.mu))

    def set_plants(self, M: np.ndarray, mu: np.ndarray) -> None:
        """Gives every state a plant of its own: M in kg and mu, shape (count,)."""
        self._simulation.write(Row.M, M)
        self._simulation.write(Row.mu, mu)

    @property
    def normal_force(self) -> np.ndarray:
        """The smallest normal force in the last step, N, shape (count,)."""
        return self._simulation.row(Row.normal_force)

    def step(
        self, states: np.ndarray, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The next states, rewards in cm, and whether the steps fail.

        States are theta (rad), theta_dot (rad/s) and x_dot (m/s), shape (3, count).
        """
        simulation = self._simulation
        rows = Row.theta, Row.theta_dot, Row.x_dot, Row.x, Row.termination
        for row, values in zip(rows, (*states, self._zeros, self._zeros), strict=True):
            simulation.write(row, values)
        simulation.step(actions)
        failed = (simulation.row(Row.termination) != 0.0) | (self.normal_force <= self.margin)
        return (
            simulation.rows(Row.theta, Row.x_dot + 1)[[0, 1, 3]],
            simulation.row(Row.reward),
            failed,
        )


@dataclass(frozen=True)
class Trajectory:
    """The trajectories of a batch of episodes, and their metrics by name, of shape (episodes,).

    `states` are theta (rad), theta_dot (rad/s), x (m) and x_dot (m/s) at the beginning of every
    step, shape (steps, 4, episodes), and `choices` the torques as indices of `ACTIONS`, uint8,
    shape (steps, episodes).
    """

    metrics: dict[str, np.ndarray]
    states: np.ndarray
    choices: np.ndarray

    def cycle_starts(self, control_dt: float) -> np.ndarray:
        """The steps after `SETTLED` at which the first pendulum, left of upright, reverses to move
        forwards.
        """
        theta, theta_dot = self.states[:, 0, 0], self.states[:, 1, 0]
        starts = (
            np.flatnonzero((theta_dot[:-1] <= 0.0) & (theta_dot[1:] > 0.0) & (theta[1:] < 0.0)) + 1
        )
        return starts[starts >= round(SETTLED / control_dt)]

    def steady_speed(self, control_dt: float) -> float:
        """The first episode's mean speed over whole cycles after `SETTLED`, cm/s, or without cycles
        over that time.
        """
        starts = self.cycle_starts(control_dt)
        begin, end = (
            starts[[0, -1]]
            if starts.size > 1
            else (round(SETTLED / control_dt), len(self.states) - 1)
        )
        x = self.states[:, 2, 0]
        return float(100.0 * (x[end] - x[begin]) / ((end - begin) * control_dt))


def run_episodes(
    problem: Problem,
    thetas: np.ndarray,
    steps: int,
    choose: Callable[[int, np.ndarray], Any],
    plants: np.ndarray | None = None,
) -> Trajectory:
    """Runs episodes from rest at the angles `thetas`, rad, on the problem's plant or `plants`, M in
    kg and mu of each.

    choose(step, states) gives the torques as indices of `ACTIONS` for states of shape (4,
    episodes).
    """
    count = thetas.size
    M, mu = (np.tile([problem.M, problem.mu], (count, 1)) if plants is None else plants).T
    simulation = Simulation(count, problem.options)
    starts = np.zeros((count, 4))
    starts[:, 0] = thetas
    simulation.reset(np.arange(count), M.tolist(), mu.tolist(), starts)
    states, choices = np.empty((steps, 4, count)), np.empty((steps, count), np.uint8)
    for step in range(steps):
        states[step] = simulation.rows(Row.theta, Row.x_dot + 1)
        choices[step] = choose(step, states[step])
        simulation.step(ACTIONS[choices[step]], simulation.row(Row.termination) == 0.0)
    return Trajectory(simulation.metrics(np.arange(count), steps), states, choices)


def repeat(problem: Problem, choices: np.ndarray) -> Trajectory:
    """Repeats the torques of one episode from the task's start; `choices` are indices of `ACTIONS`,
    shape (steps,).
    """
    return run_episodes(
        problem, np.array([START_THETA]), choices.size, lambda step, states: choices[step]
    )
