"""Holds: what the environment's own step makes of any state in which a torque is held."""

from __future__ import annotations

import math

import numpy as np

from capsule_gym.layout import Row
from capsule_gym.parameters import DIRECT_PHYSICS_DT, Capsule, EnvConfig
from capsule_gym.simulation import Simulation


def hold_options(hold: float, torque_limit: float, energy_weight: float, capsule: Capsule | None) -> EnvConfig:
    """The environment of a hold.

    Args:
        hold: how long a torque is held, s.
        torque_limit: N m.
        energy_weight: cost of a joule, cm.
        capsule: the plant's constants.

    Raises:
        TypeError: if an argument is of the wrong type.
        ValueError: if one is out of range.
    """
    return EnvConfig(
        control_dt=hold,
        # As the environment's own where that divides the hold.
        physics_dt=hold / math.ceil(hold / DIRECT_PHYSICS_DT - 1e-9),
        torque_limit=torque_limit,
        energy_weight=energy_weight,
        termination_penalty=0.0,
        randomization="none",
        capsule=capsule,
    )


class Holds:
    """A batch of the environment in which any state takes one hold of any torque.

    Args:
        count: states that are held at once.
        options: of the environment; `hold_options` makes them.
    """

    def __init__(self, count: int, options: EnvConfig) -> None:
        self._simulation = Simulation(count, options)
        self._simulation.reset(np.arange(count))
        self._zeros = np.zeros(count)

    def set_plants(self, M: np.ndarray, mu: np.ndarray) -> None:
        """Gives every state a plant of its own: M in kg and mu, shape (count,)."""
        self._simulation.write(Row.M, M)
        self._simulation.write(Row.mu, mu)

    def put(self, states: np.ndarray) -> None:
        """Sets theta (rad), theta_dot (rad/s) and x_dot (m/s), shape (3, count); nothing has terminated any more."""
        for row, values in zip((Row.theta, Row.theta_dot, Row.x_dot), states, strict=True):
            self._simulation.write(row, values)
        self._simulation.write(Row.x, self._zeros)
        self._simulation.write(Row.termination, self._zeros)

    def take(self, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Holds a torque, given over its limit, shape (count,).

        Returns:
            The states afterwards, shape (3, count), the rewards in cm and whether they terminated, of shape (count,).
        """
        self._simulation.step(actions)
        states = self._simulation.rows(Row.theta, Row.x_dot + 1)[[0, 1, 3]]
        return states, self._simulation.row(Row.reward), self._simulation.row(Row.termination) != 0.0

    def normal_force(self) -> np.ndarray:
        """The smallest normal force of the last hold, N, shape (count,)."""
        return self._simulation.row(Row.normal_force)
