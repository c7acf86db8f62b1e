"""The motion of a rig from whose log its plant follows."""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np

from capsule_gym.checks import check_integer, check_number
from capsule_gym.control.controller import Controller
from capsule_gym.control.laws import periodic

# Gains that keep the pendulum away from its stop, N m/rad and N m s/rad.
K_THETA, K_THETA_DOT = 0.6, 0.04


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """A policy for `record`: a multisine under a weak PD law, from which a plant can be identified.

    `start` returns the policy of an episode. It observes theta and theta_dot first, as the
    environment's agents do.

    Attributes:
        seed: seed of the frequencies, from 0.3 to 8 Hz, and of the phases.
        amplitude: root mean square of the multisine, N m.
        torque_limit: torque of an action of 1, N m.
        control_dt: period, s.
    """

    seed: int = 0
    amplitude: float = 0.45
    torque_limit: float = 1.5
    control_dt: float = 0.01

    def __post_init__(self) -> None:
        check_integer("Excitation.seed", self.seed, "an integer >= 0", 0, sys.maxsize)
        for name in ("amplitude", "torque_limit", "control_dt"):
            value = getattr(self, name)
            check_number(f"Excitation.{name}", value, "a finite number > 0", 0.0, open_low=True)

    def start(self, seeds: Any = (0,)) -> Callable[[Any], np.ndarray]:
        """The policy of an episode, from observations to actions: a multisine and a PD control.

        `seeds`, which every policy takes, changes nothing: all episodes have the same multisine.
        """
        multisine = self._multisine()
        steps = count()

        def act(observation: Any) -> np.ndarray:
            if isinstance(observation, dict):
                observation = observation["observation"]
            theta, theta_dot = observation[:2]
            torque = multisine(next(steps)) - K_THETA * theta - K_THETA_DOT * theta_dot
            action = np.array([torque / self.torque_limit], np.float32)
            return np.clip(action, -1.0, 1.0)

        return act

    def controller(self, seconds: float = 20.0) -> Controller:
        """The same motion as a control law, for a rig: `python -m capsule_gym.export excitation`.

        Args:
            seconds: duration, s, after which the multisine begins again.
        """
        accepted = f"a finite number >= {2.0 * self.control_dt:g} (s)"
        seconds = check_number("seconds", seconds, accepted, 2.0 * self.control_dt)
        rows = round(seconds / self.control_dt)
        multisine = self._multisine()
        torques = [multisine(step) for step in range(rows)]
        columns = {
            periodic.FEEDFORWARD: np.clip(torques, -self.torque_limit, self.torque_limit),
            periodic.K_THETA: K_THETA,
            periodic.K_THETA_DOT: K_THETA_DOT,
        }
        law = periodic.tracking("excitation", columns, rows)
        return replace(law, dt=self.control_dt)

    def _multisine(self) -> Callable[[int], float]:
        """The sum of the waves, N m, as a function of the step."""
        generator = np.random.default_rng(self.seed)
        logarithms = generator.uniform(math.log(0.3), math.log(8.0), 16)
        frequencies = np.exp(logarithms)
        phases = generator.uniform(0.0, 2.0 * np.pi, 16)

        def torque(step: int) -> float:
            angles = 2.0 * np.pi * self.control_dt * step * frequencies + phases
            # The mean square of each wave is 1 / 2.
            return float(self.amplitude * np.sin(angles).sum() / math.sqrt(8.0))

        return torque
