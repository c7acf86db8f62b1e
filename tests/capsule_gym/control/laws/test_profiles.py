import math

import numpy as np
import pytest
from scipy.integrate import quad

from capsule_gym import dynamics
from capsule_gym.control.laws.feedback_linearisation import feedback_linearising
from capsule_gym.control.laws.profiles import (
    COLUMNS,
    EPC,
    PROPOSED,
    platform_motion,
    reference_table,
)
from capsule_gym.parameters import NOMINAL, Capsule


@pytest.mark.parametrize("profile", [PROPOSED, EPC])
def test_a_profile_is_closed_and_continuous_with_consistent_derivatives(profile):
    angle, velocity, _ = profile.evaluate(
        np.array([0.0, profile.period - 1e-12, 3 * profile.period])
    )
    np.testing.assert_allclose(angle, -math.pi / 3, atol=1e-9)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-9)
    before, after = profile.evaluate(profile.times - 1e-9), profile.evaluate(profile.times + 1e-9)
    np.testing.assert_allclose(before[0], after[0], atol=1e-7)
    np.testing.assert_allclose(before[1], after[1], atol=1e-6)
    t, h = np.linspace(0.0, profile.period, 997), 1e-5
    t = t[np.abs(t[:, None] - np.array([0.0, *profile.times])).min(axis=1) > 1e-3]
    angle, velocity, acceleration = profile.evaluate(t)
    ahead, behind = profile.evaluate(t + h), profile.evaluate(t - h)
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * h), velocity, atol=2e-6)
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * h), acceleration, atol=2e-5)
    assert angle[0] + quad(lambda s: profile.evaluate(np.array([s]))[1][0], t[0], t[20])[
        0
    ] == pytest.approx(angle[20])


def test_profiles_have_the_published_swing_and_peak():
    # The profiles are calibrated to three or four digits, so the last published digit may be off by
    # one.
    for profile, swing in ((PROPOSED, 68.75), (EPC, 85.85)):
        largest = profile.evaluate(np.linspace(0.0, profile.period, 20_001))[0].max()
        assert math.degrees(largest) == pytest.approx(swing, abs=0.01)
    assert PROPOSED.evaluate(np.array([0.15]))[1][0] == 7.8
    assert EPC.evaluate(np.array([0.1]))[1][0] == pytest.approx(11.0)
    # P3.
    slowest = [min(segment.offset for segment in profile.segments) for profile in (PROPOSED, EPC)]
    assert slowest == pytest.approx([-0.459, -0.504], abs=5e-4)


def test_reference_platform_obeys_the_second_row():
    p, rows = NOMINAL.plant(), reference_table(PROPOSED, NOMINAL.plant())
    table = dict(zip(COLUMNS, rows.T, strict=True))
    moving = np.flatnonzero(table["x_d_dot"] != 0.0)
    assert 0 < len(moving) < 0.5 * len(rows)
    for n in moving[2:-2:7]:
        state = (table["theta_d"][n], table["theta_d_dot"][n], table["theta_d_ddot"][n])
        friction = math.copysign(p.mu * dynamics.normal_force(*state, p), table["x_d_dot"][n])
        residual = (p.M + p.m) * table["x_d_ddot"][n] - dynamics.driving_force(*state, p) + friction
        # The columns are sampled half a fine step apart.
        assert abs(residual) < 0.02
    # Within a phase the integrated columns are consistent, to the second order of the fine step.
    np.testing.assert_allclose(
        np.gradient(table["x_d"], 1e-3)[300:850], table["x_d_dot"][300:850], atol=1e-4
    )
    assert table["cycle_start"].tolist() == [1.0] + [0.0] * (len(rows) - 1)
    # Laws share the table.
    assert not rows.flags.writeable


@pytest.mark.parametrize("normal_force", ["newton", "paper"])
def test_the_reference_platform_has_the_bits_of_the_forces(normal_force):
    options = {"mu": 0.05, "backward_ratio": 1.5, "slope": 0.01, "normal_force": normal_force}
    p = Capsule(**options).plant()
    h = 1e-3
    pendulum = EPC.evaluate(h * np.arange(2000))
    _, x_dot, x_ddot = platform_motion(*pendulum, h, p)
    slides = x_dot != 0.0
    assert np.count_nonzero(x_dot > 0.0) > 50
    assert np.count_nonzero(x_dot < 0.0) > 50
    normal = np.maximum(dynamics.normal_force(*pendulum, p), 0.0)
    friction = dynamics.friction_force(np.sign(x_dot), x_dot, normal, p)
    expected = (dynamics.driving_force(*pendulum, p) - friction) / (p.M + p.m)
    assert np.array_equal(x_ddot[slides], expected[slides])
    # Friction that depends on the speed is left out.
    dependent = Capsule(**options, viscous=0.3, static_ratio=1.2, stribeck_speed=0.1).plant()
    constant = Capsule(**options, static_ratio=1.2).plant()
    assert np.array_equal(
        platform_motion(*pendulum, h, dependent), platform_motion(*pendulum, h, constant)
    )


@pytest.mark.parametrize(
    ("theta", "theta_dot", "x_dot"), [(0.3, 1, 0.2), (-0.9, 3, -0.1), (0.5, 0.01, 0), (0.5, 6, 0)]
)
def test_feedback_linearisation_gives_the_commanded_acceleration(theta, theta_dot, x_dot):
    K_p, K_v, p = 90.0, 17.0, NOMINAL.plant()
    controller = feedback_linearising(K_p=K_p, K_v=K_v)
    row = tuple(controller.reference[200].tolist())
    torque, _ = controller.law(theta, theta_dot, 0.0, x_dot, controller.memory, row)
    commanded = row[2] - K_v * (theta_dot - row[1]) - K_p * (theta - row[0])
    slip = dynamics.contact_phase(theta, theta_dot, x_dot, torque, p)
    assert dynamics.accelerations(theta, theta_dot, 0.0, slip, torque, p)[0] == pytest.approx(
        commanded, rel=1e-12
    )
