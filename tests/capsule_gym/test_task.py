"""Properties that all tasks share: termination at its limits."""

from __future__ import annotations

import math

import numpy as np
import pytest

from capsule_gym import Capsule, CapsuleEnv
from capsule_gym.task import Termination

UPRIGHT = math.nextafter(math.pi / 2, 0.0)


@pytest.mark.parametrize(
    ("theta", "theta_dot", "ends"),
    [
        (UPRIGHT, 0.0, Termination.none),
        (-UPRIGHT, 0.0, Termination.none),
        # Within 1 ns the angle reaches the limit itself.
        (UPRIGHT, 2e-7, Termination.pendulum),
        (-UPRIGHT, -2e-7, Termination.pendulum),
        # The ball's centripetal force carries the weight: less, and more.
        (0.0, 0.9999, Termination.none),
        (0.0, 1.0001, Termination.contact),
    ],
)
def test_termination_is_at_the_limit_itself(theta, theta_dot, ends):
    plant = Capsule()
    if theta == 0.0:
        theta_dot *= math.sqrt((plant.M + plant.m) * plant.g / (plant.m * plant.l))
    env = CapsuleEnv(randomization="none", control_dt=1e-9, physics_dt=1e-9)
    env.reset(seed=0, options={"state": [theta, theta_dot, 0.0, 0.1]})
    _, _, terminated, _, info = env.step(np.zeros(1, np.float32))
    assert info["termination"] == ends and terminated == (ends != Termination.none)
