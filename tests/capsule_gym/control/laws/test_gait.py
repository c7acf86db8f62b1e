import math

import numpy as np
import pytest

from capsule_gym.control.laws import gait as module
from capsule_gym.control.laws.gains import known_parameters
from capsule_gym.control.laws.gait import LIGHTEST, PARAMETERS, gait
from capsule_gym.core.layout import NUM_ROWS
from capsule_gym.tasks.task import TORQUE_LIMIT
from tests.capsule_gym.control.laws.test_predictive import episode

TUNED = dict(zip(PARAMETERS, known_parameters("gait"), strict=True))
# Without the guard.
FREE = (*known_parameters("gait")[:-2], 0.0, 0.0)
# M (kg) and mu.
LIGHT = [(0.26, 0.003), (0.3, 0.01), (0.3, 0.5), (0.33, 0.05), (0.33, 0.4), (0.29, 0.1)]


def torque(controller, theta, theta_dot, x_dot):
    found, _ = controller.law(theta, theta_dot, 0.0, x_dot, controller.memory, (0.0, 0.0))
    return found


def test_the_law_is_a_polynomial_of_the_state():
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 3)) * (1.2, 8.0, 0.6)
    states[::5, 2] = 0.0
    scaled = (states / (1.0, 5.0, 0.3)).T
    expected = TUNED["sign_x_dot"] * np.sign(states[:, 2])
    for name, coefficient in TUNED.items():
        if name.startswith("phi_"):
            # The name phi_ijk holds the powers of theta, theta_dot and x_dot.
            powers = [int(power) for power in name.removeprefix("phi_")]
            expected += coefficient * np.prod(scaled.T**powers, axis=1)
    found = [torque(gait(FREE), *state) for state in states.tolist()]
    limited = TORQUE_LIMIT * np.clip(expected, -1.0, 1.0)
    np.testing.assert_allclose(found, limited, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("theta", [-0.6, 0.0, 0.3])
@pytest.mark.parametrize("share", [0.99, 1.1, -0.99, -1.2])
def test_the_guard_is_proportional_to_the_excess(theta, share):
    theta_dot = share * math.sqrt(TUNED["guard_from"] / math.cos(theta))
    excess = max(0.0, theta_dot * theta_dot * math.cos(theta) - TUNED["guard_from"])
    brake = torque(gait(FREE), theta, theta_dot, 0.1) - torque(gait(), theta, theta_dot, 0.1)
    expected = math.copysign(TUNED["guard_gain"] * excess, theta_dot)
    assert brake == pytest.approx(expected, abs=1e-9)


def test_the_guard_keeps_the_contact_of_platforms_lighter_than_those_of_the_search():
    masses, _ = np.transpose(LIGHT)
    assert masses.max() < LIGHTEST
    kept = episode(gait(), LIGHT)
    metrics = kept.episode_metrics()
    assert metrics["failed"].sum() == 0.0
    assert metrics["mean_speed"].min() > 10.0
    # The law's estimates match the plants.
    assert kept.simulation.row(NUM_ROWS + 1) == pytest.approx(masses, rel=0.02)


def test_a_guard_for_no_platform_at_all_loses_the_contact_of_light_ones(monkeypatch):
    # It acts at the same rate on all of them.
    monkeypatch.setattr(module, "LIGHTEST", 0.0)
    lost = episode(gait(), LIGHT)
    assert lost.episode_metrics()["failed"].sum() > 0.0
