import math

import numpy as np
import pytest

from capsule_gym.control.controller import LAW_DT
from capsule_gym.control.laws import periodic
from capsule_gym.tasks.task import TORQUE_LIMIT

SERIES = (0.5004, 0.1, 0.3, 0.0, 0.2, 0.0, 0.0, -0.4, 0.0, 0.1)


def call(controller, state, memory, step):
    return controller.law(*state, memory, controller.reference[step % len(controller.reference)])


def test_a_series_has_its_harmonics_and_the_open_loop_depends_on_the_time_alone():
    values, derivatives = periodic.fourier(SERIES)
    phase = 2.0 * math.pi * np.arange(500) / 500
    expected = (
        0.1
        + 0.3 * np.cos(phase)
        + 0.2 * np.cos(3 * phase)
        - 0.4 * np.sin(2 * phase)
        + 0.1 * np.sin(4 * phase)
    )
    np.testing.assert_allclose(values, expected, atol=1e-12)
    differences = (np.roll(values, -1) - np.roll(values, 1)) / (2.0 * LAW_DT)
    np.testing.assert_allclose(derivatives, differences, atol=0.02 * np.abs(derivatives).max())
    controller = periodic.open_loop((*SERIES[:2], 3.0, *SERIES[3:]))
    values, _ = periodic.fourier((*SERIES[:2], 3.0, *SERIES[3:]))
    for step in (0, 100, 250, 730):
        torques = {
            call(controller, state, (0.0,), step)[0]
            for state in ((0.0,) * 4, (0.5, -3.0, 1.0, 0.2))
        }
        assert torques == {min(TORQUE_LIMIT, max(-TORQUE_LIMIT, values[step % 500]))}


def test_pd_is_zero_on_its_reference_and_opposes_the_error():
    controller = periodic.pd((*SERIES, 2.0, 0.3))
    theta_d, theta_d_dot = (each[20] for each in periodic.fourier(SERIES))
    assert call(controller, (theta_d, theta_d_dot, 7.0, -1.0), (0.0,), 20)[0] == 0.0
    assert call(controller, (theta_d + 0.1, theta_d_dot, 0.0, 0.0), (0.0,), 20)[0] == pytest.approx(
        -0.2
    )
    assert call(controller, (theta_d, theta_d_dot - 2.0, 0.0, 0.0), (0.0,), 20)[0] == pytest.approx(
        0.6
    )


def test_the_oscillator_approaches_the_unit_circle_and_its_torque_is_a_polynomial():
    omega, constants = 5.0, (0.0,) * 6 + (0.2,) + (1.0, 0.0, 0.0) + (0.0,) * 3 + (1.0, 0.1)
    controller = periodic.oscillator((omega, 20.0, *constants))
    memory, torques = (0.1, 0.0), []
    for step in range(3000):
        torque, memory = call(controller, (0.0, 0.0, 0.0, 0.0), memory, step)
        torques.append(torque)
    # The torque is the bias plus the real part; Euler steps make the circle a little larger.
    assert math.hypot(*memory) == pytest.approx(1.0, abs=2e-3)
    assert np.mean(torques[-round(2.0 * math.pi / omega / LAW_DT) :]) == pytest.approx(
        0.2, abs=0.01
    )
    rises = np.flatnonzero((np.array(torques[:-1]) < 0.2) & (np.array(torques[1:]) >= 0.2))
    assert np.diff(rises)[-1] * LAW_DT == pytest.approx(2.0 * math.pi / omega, rel=0.01)
    # Spring and damper.
    (still, _), (moved, _) = (
        call(controller, (*s, 0.0, 0.0), memory, 0) for s in ((0.0, 0.0), (0.3, 2.0))
    )
    assert moved - still == pytest.approx(-0.3 - 0.2)
    real, imaginary, E_a, E_b = np.array(
        [(0.7, -0.3, 0.2), (0.5, 0.4, -0.6), (0.3, -0.2, 0.5), (-0.4, 0.6, 0.1)]
    )
    controller = periodic.oscillator((5.0, 20.0, *E_a, *E_b, 0.2, *real, *imaginary, 0.0, 0.0))
    state, z = np.array([0.4, 0.3, 0.7, -0.2]), 0.6 - 0.5j
    torque, memory = call(controller, state, (z.real, z.imag), 0)
    entrained = z + LAW_DT * (
        20.0 * (1.0 - abs(z) ** 2) * z + 5.0j * z + (E_a + 1j * E_b) @ state[[0, 1, 3]]
    )
    assert complex(*memory) == pytest.approx(entrained)
    powers = entrained ** np.arange(1, 4)
    assert torque == pytest.approx(0.2 + real @ powers.real + imaginary @ powers.imag)
