"""The problem that dynamic programming solves, and its transitions, which are steps of the environment itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from capsule_gym.layout import Row
from capsule_gym.parameters import DIRECT_PHYSICS_DT, NOMINAL, EnvConfig, check_number
from capsule_gym.simulation import Simulation
from capsule_gym.task import CONTROL_DT


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What is optimised: the mean speed, less a weight times the energy.

    Attributes:
        M: mass of the platform, kg.
        mu: friction coefficient.
        energy_weight: cm/J.
        control_dt: control interval, over which the torque is constant, s.
        margin: normal force that must be left, N; a smaller one counts as a failure.

    Raises:
        TypeError: if a value is of the wrong type.
        ValueError: if a value is out of range.
    """

    M: float = NOMINAL.M
    mu: float = NOMINAL.mu
    energy_weight: float = 0.0
    control_dt: float = CONTROL_DT
    margin: float = 0.0

    def __post_init__(self) -> None:
        NOMINAL.check_plant(self.M, self.mu)
        check_number("control_dt", self.control_dt, "a finite number > 0 (s)", 0.0, open_low=True)
        check_number("margin", self.margin, "a finite number >= 0 (N)", 0.0)
        _ = self.options

    @cached_property
    def options(self) -> EnvConfig:
        """Of the environment whose agent step is the control interval."""
        return EnvConfig(
            control_dt=self.control_dt,
            # The environment's own where that divides the control interval.
            physics_dt=self.control_dt / math.ceil(self.control_dt / DIRECT_PHYSICS_DT - 1e-9),
            energy_weight=self.energy_weight,
            termination_penalty=0.0,
            randomization="none",
        )


class Transitions:
    """A batch of the environment that takes one step from any states under any torques.

    Args:
        problem: with the plant of all states; `set_plants` gives others.
        count: states that are moved at once.
    """

    def __init__(self, problem: Problem, count: int) -> None:
        self._simulation = Simulation(count, problem.options)
        self._simulation.reset(np.arange(count))
        self._zeros = np.zeros(count)
        self.margin = problem.margin
        self.set_plants(np.full(count, problem.M), np.full(count, problem.mu))

    def set_plants(self, M: np.ndarray, mu: np.ndarray) -> None:
        """Gives every state a plant of its own: M in kg and mu, shape (count,)."""
        self._simulation.write(Row.M, M)
        self._simulation.write(Row.mu, mu)

    def step(self, states: np.ndarray, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Takes a step.

        Args:
            states: theta (rad), theta_dot (rad/s) and x_dot (m/s), shape (3, count).
            actions: torques over their limit, shape (count,).

        Returns:
            The next states, shape (3, count), the rewards in cm, and whether the steps fail, each of shape (count,).
        """
        simulation = self._simulation
        for row, values in zip((Row.theta, Row.theta_dot, Row.x_dot), states, strict=True):
            simulation.write(row, values)
        simulation.write(Row.x, self._zeros)
        simulation.write(Row.termination, self._zeros)
        simulation.step(actions)
        failed = (simulation.row(Row.termination) != 0.0) | (simulation.row(Row.normal_force) <= self.margin)
        return simulation.rows(Row.theta, Row.x_dot + 1)[[0, 1, 3]], simulation.row(Row.reward), failed
