import math

import numpy as np
import pytest

from capsule_gym.control.laws import gait as module
from capsule_gym.control.laws.gains import known_parameters
from capsule_gym.control.laws.gait import LIGHTEST, PARAMETERS, gait
from capsule_gym.core.layout import NUM_ROWS
from capsule_gym.tasks.task import TORQUE_LIMIT
from tests.capsule_gym.control.laws.test_predictive import episode

LIGHT = [(0.26, 0.003), (0.3, 0.01), (0.3, 0.5), (0.33, 0.05), (0.33, 0.4), (0.29, 0.1)]
FREE = (*known_parameters("gait")[:-2], 0.0, 0.0)


def torque(controller, theta, theta_dot, x_dot):
    return controller.law(theta, theta_dot, 0.0, x_dot, controller.memory, (0.0, 0.0))[0]


def test_the_law_is_a_polynomial_of_the_state_and_its_guard_proportional_to_the_excess():
    states = np.random.default_rng(0).uniform(-1.0, 1.0, (200, 3)) * (1.2, 8.0, 0.6)
    states[::5, 2] = 0.0
    a, b, c = (states / (1.0, 5.0, 0.3)).T
    *coefficients, step = FREE[:-2]
    # The name phi_ijk holds the powers of theta, theta_dot and x_dot.
    powers = [map(int, name.removeprefix("phi_")) for name in PARAMETERS[:-3]]
    cubic = sum(
        phi * a**i * b**j * c**k for phi, (i, j, k) in zip(coefficients, powers, strict=True)
    )
    expected = TORQUE_LIMIT * (cubic + step * np.sign(c))
    found = [torque(gait(FREE), *state) for state in states.tolist()]
    np.testing.assert_allclose(
        found, np.clip(expected, -TORQUE_LIMIT, TORQUE_LIMIT), rtol=1e-9, atol=1e-12
    )
    *_, gain, threshold = known_parameters("gait")
    for theta in (-0.6, 0.0, 0.3):
        limit = math.sqrt(threshold / math.cos(theta))
        for theta_dot in (0.99 * limit, 1.1 * limit, -0.99 * limit, -1.2 * limit):
            brake = torque(gait(FREE), theta, theta_dot, 0.1) - torque(
                gait(), theta, theta_dot, 0.1
            )
            excess = max(0.0, theta_dot * theta_dot * math.cos(theta) - threshold)
            assert brake == pytest.approx(math.copysign(gain * excess, theta_dot), abs=1e-9)


def test_the_guard_keeps_the_contact_of_platforms_lighter_than_those_of_the_search(monkeypatch):
    assert max(LIGHT)[0] < LIGHTEST
    kept = episode(gait(), LIGHT)
    # A guard for no platform at all acts at the same rate on all of them.
    monkeypatch.setattr(module, "LIGHTEST", 0.0)
    lost = episode(gait(), LIGHT)
    metrics = kept.episode_metrics()
    assert metrics["failed"].sum() == 0.0 < lost.episode_metrics()["failed"].sum()
    assert metrics["mean_speed"].min() > 10.0
    # The law's estimates match the plants.
    assert kept.simulation.row(NUM_ROWS + 1) == pytest.approx(np.array(LIGHT)[:, 0], rel=0.02)
