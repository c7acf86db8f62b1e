import math

import numpy as np
import pytest

from capsule_gym.control.controller import LAW_DT
from capsule_gym.control.laws import periodic
from capsule_gym.tasks.task import TORQUE_LIMIT

# Period, mean, cosines and sines.
SERIES = (0.5004, 0.1, 0.3, 0.0, 0.2, 0.0, 0.0, -0.4, 0.0, 0.1)
LARGE = (0.5004, 0.1, 3.0, 0.0, 0.2, 0.0, 0.0, -0.4, 0.0, 0.1)
ORIGIN = (0.0, 0.0, 0.0, 0.0)


def call(controller, state, memory=(0.0,), step=0):
    """The torque and the memory of a call."""
    row = controller.reference[step % len(controller.reference)]
    return controller.law(*state, memory, row)


def test_a_series_has_its_harmonics():
    values, _ = periodic.fourier(SERIES)
    phase = 2.0 * math.pi * np.arange(500) / 500
    expected = 0.1 + 0.3 * np.cos(phase) + 0.2 * np.cos(3 * phase)
    expected += 0.1 * np.sin(4 * phase) - 0.4 * np.sin(2 * phase)
    np.testing.assert_allclose(values, expected, atol=1e-12)


def test_the_derivative_of_a_series_is_that_of_its_values():
    values, derivatives = periodic.fourier(SERIES)
    differences = (np.roll(values, -1) - np.roll(values, 1)) / (2.0 * LAW_DT)
    np.testing.assert_allclose(derivatives, differences, atol=0.02 * np.abs(derivatives).max())


@pytest.mark.parametrize("state", [ORIGIN, (0.5, -3.0, 1.0, 0.2)])
@pytest.mark.parametrize("step", [0, 100, 250, 730])
def test_the_open_loop_depends_on_the_time_alone(step, state):
    values, _ = periodic.fourier(LARGE)
    torque, _ = call(periodic.open_loop(LARGE), state, step=step)
    assert torque == np.clip(values[step % 500], -TORQUE_LIMIT, TORQUE_LIMIT)


@pytest.mark.parametrize(
    ("error", "rate_error", "torque"),
    [(0.0, 0.0, 0.0), (0.1, 0.0, pytest.approx(-0.2)), (0.0, -2.0, pytest.approx(0.6))],
)
def test_pd_is_zero_on_its_reference_and_opposes_the_error(error, rate_error, torque):
    theta_d, theta_d_dot = (column[20] for column in periodic.fourier(SERIES))
    controller = periodic.pd((*SERIES, 2.0, 0.3))
    state = (theta_d + error, theta_d_dot + rate_error, 7.0, -1.0)
    found, _ = call(controller, state, step=20)
    assert found == torque


def circle(**changes):
    """An oscillator of 5 rad/s without input, whose torque is its real part plus 0.2 N m."""
    constants = {
        "omega": 5.0,
        "alpha": 20.0,
        "E_a": (0.0, 0.0, 0.0),
        "E_b": (0.0, 0.0, 0.0),
        "bias": 0.2,
        "real": (1.0, 0.0, 0.0),
        "imaginary": (0.0, 0.0, 0.0),
        "K_theta": 0.0,
        "K_theta_dot": 0.0,
    }
    constants.update(changes)
    return periodic.oscillator(np.hstack([*constants.values()]).tolist())


def test_the_oscillator_approaches_the_unit_circle():
    controller = circle()
    period = 2.0 * math.pi / 5.0
    memory = (0.1, 0.0)
    torques = []
    for _ in range(3000):
        torque, memory = call(controller, ORIGIN, memory)
        torques.append(torque)
    # Euler steps make the circle a little larger.
    assert math.hypot(*memory) == pytest.approx(1.0, abs=2e-3)
    last = np.array(torques[-round(period / LAW_DT) :])
    assert np.mean(last) == pytest.approx(0.2, abs=0.01)
    above = np.array(torques) >= 0.2
    rises = np.flatnonzero(~above[:-1] & above[1:])
    assert np.diff(rises)[-1] * LAW_DT == pytest.approx(period, rel=0.01)


def test_the_oscillator_has_a_spring_and_a_damper():
    controller = circle(K_theta=1.0, K_theta_dot=0.1)
    still, _ = call(controller, ORIGIN, (1.0, 0.0))
    moved, _ = call(controller, (0.3, 2.0, 0.0, 0.0), (1.0, 0.0))
    assert moved - still == pytest.approx(-0.3 - 0.2)


def test_the_state_entrains_the_oscillator_and_its_torque_is_a_polynomial():
    real, imaginary = np.array([0.7, -0.3, 0.2]), np.array([0.5, 0.4, -0.6])
    E_a, E_b = np.array([0.3, -0.2, 0.5]), np.array([-0.4, 0.6, 0.1])
    controller = circle(E_a=E_a, E_b=E_b, real=real, imaginary=imaginary)
    theta, theta_dot, x, x_dot = 0.4, 0.3, 0.7, -0.2
    z = 0.6 - 0.5j
    torque, memory = call(controller, (theta, theta_dot, x, x_dot), (z.real, z.imag))
    growth = 20.0 * (1.0 - abs(z) ** 2) * z
    entrainment = (E_a + 1j * E_b) @ (theta, theta_dot, x_dot)
    entrained = z + LAW_DT * (growth + 5.0j * z + entrainment)
    assert complex(*memory) == pytest.approx(entrained)
    powers = entrained ** np.arange(1, 4)
    assert torque == pytest.approx(0.2 + real @ powers.real + imaginary @ powers.imag)
