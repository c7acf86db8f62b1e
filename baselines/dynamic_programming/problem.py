"""The problems that dynamic programming solves, their plants, the transitions, and trajectories."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from baselines.dynamic_programming.grid import q_of
from capsule_gym.core.layout import Row
from capsule_gym.envs.config import EnvConfig
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


# Fields of `Problem` that are constants of the pendulum, and all of its plant but M and mu.
PENDULUM = ("m", "l", "k", "c")
CONSTANTS = (*PENDULUM, "static_ratio", "motor_friction")


@dataclass(frozen=True, kw_only=True)
class Problem:
    """The objective: the mean speed, less a weight times the energy."""

    M: float = NOMINAL.M  # mass of the platform, kg
    mu: float = NOMINAL.mu
    energy_weight: float = 0.0  # cm/J
    control_dt: float = CONTROL_DT  # control interval, over which the torque is constant, s
    margin: float = 0.0  # normal force that must be left, N; a smaller one counts as a failure
    static_ratio: float = NOMINAL.static_ratio
    m: float = NOMINAL.m  # kg
    l: float = NOMINAL.l  # m
    k: float = NOMINAL.k  # N m/rad
    c: float = NOMINAL.c  # N m s/rad
    motor_friction: float = NOMINAL.motor_friction  # N m

    @property
    def capsule(self) -> Capsule:
        """The plant's constants but M and mu."""
        return Capsule(**{name: getattr(self, name) for name in CONSTANTS})

    @property
    def q(self) -> float:
        """m l / (M + m), m."""
        return float(q_of(self.M, self.m, self.l))

    @property
    def key(self) -> str:
        """The name under which the archive holds the problem."""
        numbers = [self.M, self.mu, self.energy_weight, self.control_dt, self.margin]
        # The nominal ratio is omitted, as in the first archives.
        if self.static_ratio != NOMINAL.static_ratio:
            numbers.append(self.static_ratio)
        return " ".join(f"{number:g}" for number in numbers)

    @cached_property
    def options(self) -> EnvConfig:
        """Options of the environment whose agent step is the control interval."""
        return EnvConfig(
            control_dt=self.control_dt,
            energy_weight=self.energy_weight,
            termination_penalty=0.0,
            randomization="none",
            capsule=self.capsule,
        )


def plant_problems(grid: PlantGrid) -> list[Problem]:
    """The speed problem of every plant of a grid."""
    return [Problem(M=M, mu=mu, static_ratio=grid.static_ratio) for M, mu in grid.plants]


def corner_weights(along_M: float, along_mu: float) -> np.ndarray:
    """The weights of the corners of a cell of a `PlantGrid` at a position in it, shape (4,)."""
    return np.outer([1.0 - along_M, along_M], [1.0 - along_mu, along_mu]).ravel()


PROBLEMS = (
    *plant_problems(GRID),
    *plant_problems(STICKY_GRID),
    Problem(margin=NOMINAL_MARGIN),
    *(Problem(energy_weight=weight) for weight in ENERGY_WEIGHTS),
    *(Problem(control_dt=control_dt) for control_dt in CONTROL_INTERVALS),
)


class Transitions:
    """A batch of environments that takes one step from each of `count` states.

    They have the problem's plant, or those of `set_plants`.
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
        theta, theta_dot, x_dot = states
        simulation.write(Row.theta, theta)
        simulation.write(Row.theta_dot, theta_dot)
        simulation.write(Row.x_dot, x_dot)
        simulation.write(Row.x, self._zeros)
        simulation.write(Row.termination, self._zeros)
        simulation.step(actions)
        theta, theta_dot, _, x_dot = simulation.rows(Row.theta, Row.x_dot + 1)
        failed = (simulation.row(Row.termination) != 0.0) | (self.normal_force <= self.margin)
        return np.stack([theta, theta_dot, x_dot]), simulation.row(Row.reward), failed


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
        """The steps after `SETTLED` at which the first pendulum reverses to move forwards.

        It is left of upright there.
        """
        theta, theta_dot, *_ = self.states[..., 0].T
        forwards = theta_dot > 0.0
        reverses = ~forwards[:-1] & forwards[1:]
        starts = np.flatnonzero(reverses & (theta[1:] < 0.0)) + 1
        return starts[starts >= round(SETTLED / control_dt)]

    def steady_speed(self, control_dt: float) -> float:
        """The first episode's mean speed over whole cycles after `SETTLED`, cm/s.

        Without cycles it is that over the whole time.
        """
        begin = round(SETTLED / control_dt)
        end = len(self.states) - 1
        starts = self.cycle_starts(control_dt)
        if starts.size > 1:
            begin, end = starts[[0, -1]]
        x = self.states[:, 2, 0]
        duration = (end - begin) * control_dt
        return float(100.0 * (x[end] - x[begin]) / duration)


def run_episodes(
    problem: Problem,
    thetas: np.ndarray,
    steps: int,
    choose: Callable[[int, np.ndarray], Any],
    plants: np.ndarray | None = None,
) -> Trajectory:
    """Runs episodes from rest at the angles `thetas`, rad.

    The plants are the problem's, or `plants`, M in kg and mu of each. choose(step, states) gives
    the torques as indices of `ACTIONS` for states of shape (4, episodes).
    """
    count = thetas.size
    if plants is None:
        plants = np.tile([problem.M, problem.mu], (count, 1))
    M, mu = plants.T.tolist()
    starts = np.zeros((count, 4))
    starts[:, 0] = thetas
    episodes = np.arange(count)
    simulation = Simulation(count, problem.options)
    simulation.reset(episodes, M, mu, starts)
    states = np.empty((steps, 4, count))
    choices = np.empty((steps, count), np.uint8)
    for step in range(steps):
        states[step] = simulation.rows(Row.theta, Row.x_dot + 1)
        choices[step] = choose(step, states[step])
        running = simulation.row(Row.termination) == 0.0
        simulation.step(ACTIONS[choices[step]], running)
    return Trajectory(simulation.metrics(episodes, steps), states, choices)


def repeat(problem: Problem, choices: np.ndarray) -> Trajectory:
    """Repeats the torques of one episode from the task's start.

    `choices` are indices of `ACTIONS`, shape (steps,).
    """
    start = np.array([START_THETA])
    return run_episodes(problem, start, choices.size, lambda step, states: choices[step])
