"""The motion of a rig from whose log its plant follows."""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np

from capsule_gym.checks import check_integer, check_number


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
        generator = np.random.default_rng(self.seed)
        logarithms = generator.uniform(math.log(0.3), math.log(8.0), 16)
        frequencies = np.exp(logarithms)
        phases = generator.uniform(0.0, 2.0 * np.pi, 16)
        steps = count()

        def act(observation: Any) -> np.ndarray:
            if isinstance(observation, dict):
                observation = observation["observation"]
            theta, theta_dot = observation[:2]
            angles = 2.0 * np.pi * self.control_dt * next(steps) * frequencies + phases
            # The mean square of each wave is 1 / 2.
            multisine = self.amplitude * np.sin(angles).sum() / math.sqrt(8.0)
            torque = multisine - 0.6 * theta - 0.04 * theta_dot
            action = np.array([torque / self.torque_limit], np.float32)
            return np.clip(action, -1.0, 1.0)

        return act
