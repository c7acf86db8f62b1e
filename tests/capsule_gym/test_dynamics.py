"""The plant's equations: Eq. (1), friction, the normal force and the limit of stick."""

from types import SimpleNamespace

import numpy as np
import pytest

from capsule_gym.dynamics import (
    accelerations,
    contact_phase,
    driving_force,
    friction_force,
    normal_force,
    stick_margin,
)
from capsule_gym.parameters import Capsule


def random_states(seed, count=2000):
    """Theta, theta_dot, x_dot, slip and the torque, SI units."""
    rng = np.random.default_rng(seed)
    slip = rng.choice([-1.0, 1.0], count)
    x_dot = slip * rng.uniform(0.0, 0.5, count)
    theta = rng.uniform(-3.0, 3.0, count)
    theta_dot = rng.uniform(-12.0, 12.0, count)
    return theta, theta_dot, x_dot, slip, rng.uniform(-2.0, 2.0, count)


@pytest.fixture(scope="module")
def drawn():
    """Random plants, each with 100 states in all phases of contact, and their accelerations."""
    rng = np.random.default_rng(1)
    ranges = {
        "M": (0.3, 1.0),
        "m": (0.05, 0.3),
        "l": (0.1, 0.5),
        "k": (0.0, 1.0),
        "c": (0.0, 0.2),
        "mu": (0.0, 0.5),
        "static_ratio": (1.0, 1.5),
        "backward_ratio": (0.5, 2.0),
    }
    cases = []
    for _ in range(60):
        kind = rng.choice(["newton", "paper"]).item()
        case = {name: rng.uniform(*ends) for name, ends in ranges.items()}
        p = Capsule(**case, normal_force=kind).plant()
        state = {
            "theta": rng.uniform(-3, 3, 100),
            "theta_dot": rng.uniform(-12, 12, 100),
            "u": rng.uniform(-2, 2, 100),
            "slip": rng.integers(-1, 2, 100).astype(float),
        }
        motion = accelerations(**state, x_dot=0.0, plant=p)
        case |= state | motion._asdict() | {"g": p.g, "paper": kind == "paper"}
        case["friction"] = friction_force(state["slip"], 0.0, motion.normal_force, p)
        case["pivot"] = p.k * state["theta"] + p.c * state["theta_dot"]
        cases.append({name: np.broadcast_to(value, 100) for name, value in case.items()})
    return SimpleNamespace(**{name: np.array([case[name] for case in cases]) for name in cases[0]})


def terms(drawn):
    """The size of the terms of Eq. (1), which bounds rounding errors."""
    inertia = drawn.l * np.abs(drawn.theta_ddot) + np.abs(drawn.x_ddot) + drawn.theta_dot**2
    weight = (drawn.M + drawn.m) * drawn.g
    return np.abs(drawn.u) + np.abs(drawn.pivot) + drawn.m * drawn.l * (drawn.g + inertia) + weight


def test_accelerations_satisfy_the_first_row_of_equation_1(drawn):
    platform = drawn.m * drawn.l * np.cos(drawn.theta) * drawn.x_ddot
    gravity = drawn.m * drawn.g * drawn.l * np.sin(drawn.theta)
    residual = drawn.m * drawn.l**2 * drawn.theta_ddot - platform - gravity + drawn.pivot - drawn.u
    assert (np.abs(residual) < 1e-13 * terms(drawn)).all()


def test_accelerations_in_slip_satisfy_the_second_row_of_equation_1(drawn):
    swing = np.cos(drawn.theta) * drawn.theta_ddot - np.sin(drawn.theta) * drawn.theta_dot**2
    residual = (drawn.M + drawn.m) * drawn.x_ddot - drawn.m * drawn.l * swing + drawn.friction
    slips = drawn.slip != 0.0
    assert (np.abs(residual) < 1e-13 * terms(drawn))[slips].all()


def test_a_platform_in_stick_does_not_accelerate(drawn):
    assert not drawn.x_ddot[drawn.slip == 0.0].any()


def test_the_friction_force_is_coulombs(drawn):
    ratio = np.where(drawn.slip > 0.0, 1.0, drawn.backward_ratio)
    coulomb = drawn.slip * drawn.mu * ratio * drawn.normal_force
    assert (np.abs(drawn.friction - coulomb) <= 1e-15 * np.abs(coulomb)).all()


def test_the_normal_force_is_that_of_newton_or_of_the_paper(drawn):
    lift = drawn.theta_ddot * np.sin(drawn.theta) + drawn.theta_dot**2 * np.cos(drawn.theta)
    newton = (drawn.M + drawn.m) * drawn.g - drawn.m * drawn.l * lift
    expected = newton - np.where(drawn.paper, drawn.pivot * np.sin(drawn.theta), 0.0)  # Eq. (7)
    lifted = drawn.normal_force == 0.0
    error = np.abs(drawn.normal_force - expected)
    assert (error < 1e-13 * terms(drawn))[~lifted].all()
    assert (expected < 1e-12 * terms(drawn))[lifted].all()


def test_the_states_are_in_all_phases_of_contact(drawn):
    lifted = drawn.normal_force == 0.0
    phases = set(zip(drawn.slip.flat, lifted.flat, drawn.paper.flat, strict=True))
    assert len(phases) == 12


every_floor = pytest.mark.parametrize(
    "floor",
    [
        {},
        {"normal_force": "paper"},
        {"slope": 0.05},
        {"viscous": 0.4},
        {"stribeck_speed": 0.05},
        {
            "stribeck_speed": 0.05,
            "viscous": 0.4,
            "slope": -0.05,
            "motor_friction": 0.1,
            "normal_force": "paper",
        },
    ],
    ids=str,
)


def rough_capsule(floor):
    return Capsule(mu=0.3, static_ratio=1.5, backward_ratio=0.7, **floor)


@every_floor
def test_accelerations_in_slip_follow_from_the_driving_force_and_the_friction_force(floor):
    capsule = rough_capsule(floor)
    p = capsule.plant()
    theta, theta_dot, x_dot, slip, u = random_states(2)

    theta_ddot, x_ddot, normal = accelerations(theta, theta_dot, x_dot, slip, u, p)

    friction = friction_force(slip, x_dot, normal, p)
    driving = driving_force(theta, theta_dot, theta_ddot, p)
    weight = (p.M + p.m) * p.g
    scale = weight + np.abs(driving) + p.m * p.l * (np.abs(theta_ddot) + theta_dot**2)
    residual = (p.M + p.m) * x_ddot - (driving - friction - capsule.viscous * x_dot)
    assert (np.abs(residual) < 1e-13 * scale).all()
    assert np.abs(friction).max() > 0.3 * weight
    # The same normal force with other roundings, and its clamp.
    unclamped = normal_force(theta, theta_dot, theta_ddot, p)
    assert (np.abs(normal - np.maximum(unclamped, 0.0)) < 1e-14 * scale).all()
    assert (normal == 0.0).any()


@every_floor
def test_the_stick_margin_has_the_bits_of_the_forces(floor):
    p = rough_capsule(floor).plant()
    theta, theta_dot, _, _, u = random_states(3)
    theta_ddot, x_ddot, _ = accelerations(theta, theta_dot, 0.0, 0.0, u, p)
    assert not x_ddot.any()
    force = driving_force(theta, theta_dot, theta_ddot, p)
    normal = np.maximum(normal_force(theta, theta_dot, theta_ddot, p), 0.0)
    mu = np.where(force < 0.0, p.mu * p.backward_ratio, p.mu)

    margin, load = stick_margin(theta, theta_dot, u, p)

    limit = p.static_ratio * mu * normal
    assert np.array_equal(margin, limit - np.abs(force))
    assert np.array_equal(load, force)
    sticks = contact_phase(theta, theta_dot, 0.0, u, p) == 0.0
    assert np.array_equal(sticks, margin >= 0.0)
    assert 0 < np.count_nonzero(sticks) < len(sticks)


def test_the_friction_force_follows_the_stribeck_curve():
    p = Capsule(mu=0.3, static_ratio=1.5, stribeck_speed=0.05).plant()
    _, _, x_dot, slip, _ = random_states(4)
    curve = 1.0 + 0.5 / (1.0 + (x_dot / 0.05) ** 2)
    friction = friction_force(slip, x_dot, 2.0, p)
    np.testing.assert_allclose(friction, slip * 0.3 * curve * 2.0, rtol=1e-14)


def test_friction_bounds_what_moves_the_centre_of_mass():
    rng = np.random.default_rng(5)
    n = 2000
    capsule = Capsule(static_ratio=1.3)
    masses = rng.uniform(0.4, 0.6, n)
    p = capsule.plant()._replace(M=masses, mu=rng.uniform(0.0, 0.5, n))
    theta = rng.uniform(-1.5, 1.5, n)
    theta_dot = rng.uniform(-12.0, 12.0, n)
    u = rng.uniform(-1.5, 1.5, n)
    x_dot = rng.choice([-0.1, 0.0, 0.1], n)

    slip = contact_phase(theta, theta_dot, x_dot, u, p)
    theta_ddot, x_ddot, normal = accelerations(theta, theta_dot, 0.1 * slip, slip, u, p)

    sin = np.sin(theta)
    cos = np.cos(theta)
    lever = p.m * p.l / (p.M + p.m)
    along = x_ddot - lever * (cos * theta_ddot - sin * theta_dot**2)
    up = -lever * (sin * theta_ddot + cos * theta_dot**2)
    bound = p.mu * p.static_ratio * (p.g + up)
    assert ((normal == 0.0) | (np.abs(along) <= bound + 1e-9)).all()
