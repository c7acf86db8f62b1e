"""The speed map against the environment's own simulation and against what is known without one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from baselines.laws.profiles import EPC, PROPOSED
from baselines.laws.reference import platform_motion
from baselines.paper.sensitivity import main
from baselines.paper.variations import (
    MAP_STEP,
    MU_RANGE,
    contact_effect,
    friction_for,
    grid,
    least_mass_in_contact,
    speed_map,
    step_study,
    turning_points,
)
from capsule_gym import Capsule, Controller
from capsule_gym.compilation import compile_cached
from capsule_gym.parameters import EnvConfig
from capsule_gym.simulation import Simulation

CYCLES = 5
FINE = 2e-5


@pytest.fixture(scope="module")
def maps():
    M, mu = grid(15, 41)
    return [speed_map(profile, M, mu) for profile in (PROPOSED, EPC)]


def feed_forward(theta, theta_dot, x, x_dot, memory, reference):
    """The torque of exact tracking, from the table, with a stiff feedback for what is left."""
    theta_d, theta_d_dot, torque = reference
    return torque - 5.0 * (theta - theta_d) - 0.5 * (theta_dot - theta_d_dot), memory


def simulated_speed(profile, M, mu, dt):
    """Mean speed in cm/s of the environment's simulation under the torque that the first row of Eq. (1) asks for.

    The law knows neither M nor mu: they enter by the table, so one compiled law serves every plant.
    """
    p = Capsule().plant(M, mu)
    # Sampled in the middle of the law's steps: the torque is held over them.
    steps, fine = round(profile.period / dt), round(dt / FINE)
    motion = profile.evaluate((np.arange(CYCLES * steps * fine) + 0.5) * FINE)
    x_ddot = compile_cached(platform_motion)(*motion, FINE, p)[2]
    theta, theta_dot, theta_ddot = motion
    ml = p.m * p.l
    torque = (
        ml * p.l * theta_ddot - ml * np.cos(theta) * x_ddot - ml * p.g * np.sin(theta) + p.k * theta + p.c * theta_dot
    )
    torque = torque.reshape(-1, fine).mean(axis=1)
    reference = np.stack([*profile.evaluate(np.arange(CYCLES * steps) * dt)[:2], torque], axis=1)
    options = EnvConfig(
        controller=Controller("feed-forward", feed_forward, reference, dt=dt),
        randomization="none",
        torque_limit=50.0,
        residual_limit=0.0,
        physics_dt=dt,
    )
    simulation = Simulation(1, options)
    simulation.reset(np.zeros(1, np.int64), M=[M], mu=[mu])
    for _ in range(round(CYCLES * profile.period / options.control_dt)):
        simulation.step(np.zeros((1, 1), np.float32), np.ones(1, np.bool_))
    metrics = simulation.metrics(np.zeros(1, np.int64))
    assert metrics["failed"][0] == 0.0
    return metrics["mean_speed"][0]


@pytest.mark.parametrize(
    ("profile", "M", "mu"),
    [
        (PROPOSED, 0.5, 0.01),
        (PROPOSED, 0.3, 0.1),
        (PROPOSED, 1.0, 0.03),
        (PROPOSED, 0.45, 0.4),
        (EPC, 0.5, 0.1),
        (EPC, 0.8, 0.01),
    ],
)
def test_map_agrees_with_the_environments_simulation(profile, M, mu):
    coarse, fine = (speed_map(profile, [M], [mu], h=h).speed[0, 0] for h in (MAP_STEP, FINE))
    speeds = [simulated_speed(profile, M, mu, dt) for dt in (2e-3, 1e-3, 5e-4)]
    # The held torque is of the first order: what the steps tried make of it bounds what finer ones would add.
    tolerance = abs(coarse - fine) + np.ptp(speeds)
    assert tolerance < 1e-4
    assert coarse == pytest.approx(speeds[-1], abs=tolerance)


def test_refined_map_stays_within_its_stated_error():
    M, mu = grid(4, 7)
    for profile in (PROPOSED, EPC):
        coarse, fine = (speed_map(profile, M, mu, h=h).speed for h in (MAP_STEP, FINE))
        assert np.abs(coarse - fine).max() < 1e-5


def test_nominal_speeds_are_those_of_the_reproduction(maps):
    for profile, speed in ((PROPOSED, 1.384), (EPC, 1.627)):
        assert speed_map(profile, [0.5], [0.01]).speed[0, 0] == pytest.approx(speed, abs=2e-3)


def test_epc_is_faster_on_the_whole_map(maps):
    proposed, epc = maps
    assert turning_points(proposed, epc) == []
    moving = epc.speed > 0.01
    assert (proposed.speed[moving] / epc.speed[moving]).max() == pytest.approx(0.88, abs=0.02)


def test_speed_falls_with_friction_and_with_mass(maps):
    proposed, epc = maps
    # Below, the platform glides on through the slow return, and the profiles gain from a little friction.
    rough = epc.mu > 0.02
    assert (np.diff(epc.speed[:, rough], axis=1)[epc.speed[:, rough][:, 1:] > 0.01] < 0.0).all()
    assert (np.diff(proposed.speed[:, rough], axis=1)[proposed.speed[:, rough][:, 1:] > 0.0] < 0.0).all()
    for speeds in maps:
        both = np.minimum(speeds.speed[:-1], speeds.speed[1:]) > 0.01
        assert (np.diff(speeds.speed, axis=0)[both] < 0.0).all()


def test_mirrored_profile_goes_backwards_at_the_same_speed():
    segments = tuple(replace(s, amplitude=-s.amplitude, offset=-s.offset, slope=-s.slope) for s in PROPOSED.segments)
    mirrored = replace(PROPOSED, segments=segments, start=-PROPOSED.start)
    plants = ([0.35, 0.7], [0.0, 0.005, 0.05, 0.4])
    np.testing.assert_allclose(
        speed_map(mirrored, *plants).speed, -speed_map(PROPOSED, *plants).speed, rtol=1e-9, atol=1e-9
    )


def test_speed_depends_on_mass_by_the_share_of_the_pendulum_alone():
    # Without friction the centre of mass stays, and the platform is back after every closed cycle.
    assert speed_map(PROPOSED, [0.3, 1.0], [0.0]).speed == pytest.approx(0.0, abs=1e-4)
    # So much friction that nothing moves.
    assert (speed_map(PROPOSED, [1.0], [2.0]).speed == 0.0).all()


def test_contact_is_lost_where_the_map_says(maps):
    proposed, epc = maps
    assert proposed.smallest_normal_ratio.min() > 0.0
    limit = least_mass_in_contact(epc)
    around = speed_map(EPC, [limit - 0.005, limit + 0.005], [0.01]).smallest_normal_ratio
    assert around[0] < 0.0 < around[1]
    # At the peak: b = m l V1^2 cos(theta) against the weight, with theta'' sin(theta) just behind the peak.
    theta = EPC.evaluate(np.array([0.1]))[0][0]
    a = (11.0 - 1.451) / 0.23
    lift = 0.138 * 0.3 * (121.0 * math.cos(theta) - a * math.sin(theta))
    assert limit == pytest.approx(lift / 9.81 - 0.138, abs=2e-3)


def test_friction_for_inverts_the_map(maps):
    for speeds, profile, published in zip(maps, (PROPOSED, EPC), (0.642, 0.629), strict=True):
        mu = friction_for(speeds, 0.5, published)
        assert speed_map(profile, [0.5], [mu]).speed[0, 0] == pytest.approx(published, rel=0.01)
    assert math.isnan(friction_for(maps[0], 0.5, 5.0))


def test_turning_points_are_found_where_they_are(maps):
    epc = maps[1]
    mixed = replace(epc, speed=np.where(epc.mu < 0.1, 0.0, 1.0)[None, :] + 0.0 * epc.speed)
    flat = replace(epc, speed=np.full_like(epc.speed, 0.5))
    points = turning_points(mixed, flat)
    assert [M for M, _ in points] == list(epc.M)
    assert all(0.08 < mu < 0.12 for _, mu in points)


def test_paper_normal_force_matters_little_at_the_nominal_friction():
    for profile in (PROPOSED, EPC):
        effect = contact_effect(profile, (0.01, 0.2))
        change = np.abs(effect.paper / effect.newton - 1.0)
        assert change[0] < 0.01 < change[1]


def test_integrators_error_is_of_fourth_order_and_the_held_torques_of_first():
    held = step_study(PROPOSED, (5e-4, 1e-3, 2e-3, 5e-3, 1e-2), law_step=1e-2)
    speed, torque = held.errors()
    # From 5 to 10 ms, against a step whose own error is negligible.
    assert 8.0 < speed[3] / speed[2] < 32.0
    assert 8.0 < torque[3] / torque[2] < 32.0
    speed, torque = step_study(PROPOSED, (1e-4, 1e-3, 2e-3)).errors()
    # Of the first order, so against 0.1 ms the errors are as 1.9 to 0.9.
    assert speed[1] / speed[0] == pytest.approx(1.9 / 0.9, rel=0.1)
    assert torque[1] / torque[0] == pytest.approx(1.9 / 0.9, rel=0.1)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: speed_map(PROPOSED, [0.5], [-0.1]), ValueError, "mu must be"),
        (lambda: speed_map(PROPOSED, [0.0], [0.1]), ValueError, "M must be"),
        (lambda: speed_map(PROPOSED, ["heavy"], [0.1]), TypeError, "M must be"),
        (lambda: speed_map(PROPOSED, [], [0.1]), ValueError, "at least one value"),
        (lambda: speed_map(PROPOSED, [0.5], [0.1], h=0.0), ValueError, "h must be"),
        (lambda: speed_map(PROPOSED, [0.5], [0.1], h=7e-3), ValueError, "divide the profile's period"),
        (lambda: speed_map(PROPOSED, [0.5], [0.1], cycles=0), ValueError, "cycles must be"),
        (lambda: speed_map(PROPOSED, [0.5], [0.1], normal_force="galilei"), ValueError, "normal_force"),
        (lambda: speed_map(PROPOSED, [0.05], [10.0]), ValueError, "Painlev"),
        (lambda: step_study(PROPOSED, (1e-3, 1e-3)), ValueError, "steps must hold"),
        (lambda: step_study(PROPOSED, (1e-3, 3e-3)), ValueError, "divide"),
        (
            lambda: turning_points(speed_map(EPC, [0.5], [0.1]), speed_map(EPC, [0.6], [0.1])),
            ValueError,
            "same M and mu",
        ),
    ],
)
def test_bad_arguments_are_named(call, error, message):
    with pytest.raises(error, match=message):
        call()


def test_grid_spans_the_stated_ranges():
    M, mu = grid()
    assert (M[0], M[-1]) == (0.3, 1.0)
    np.testing.assert_allclose((mu[0], mu[-1]), MU_RANGE)


def test_command_says_where_the_order_turns(capsys):
    assert main([]) == 0
    text = capsys.readouterr().out
    assert "the faster profile changes at no points" in text
    assert "EPC loses contact below M = 0.40" in text
