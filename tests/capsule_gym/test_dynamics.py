"""The plant's physics: conservation, exact stick, located events and order of convergence."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numba import njit

from benchmarks import reference
from benchmarks.reference import step, torque_for_load
from capsule_gym import contact, dynamics
from capsule_gym.parameters import Capsule, Plant

START = (-math.pi / 3, 0.0, 0.0, 0.0)
HOLD = 0.02


def random_torque(amplitude: float, seed: int, seconds: float = 10.0, hold: float = HOLD) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-amplitude, amplitude, round(seconds / hold))


def periodic_torque(seconds: float = 10.0, hold: float = HOLD) -> np.ndarray:
    t = hold * np.arange(round(seconds / hold))
    return 0.6 * np.sin(2 * math.pi * t / 0.7) + 0.3 * np.sin(4 * math.pi * t / 0.7 + 0.8)


def energy(state: np.ndarray | tuple[float, ...], p: Plant) -> float:
    """Kinetic energy of the platform and of the ball at (x - l sin, l cos), plus gravity's and the spring's."""
    theta, theta_dot, _, x_dot = state
    ball = (x_dot - p.l * math.cos(theta) * theta_dot, -p.l * math.sin(theta) * theta_dot)
    kinetic = 0.5 * p.M * x_dot**2 + 0.5 * p.m * (ball[0] ** 2 + ball[1] ** 2)
    return kinetic + p.m * p.g * p.l * math.cos(theta) + 0.5 * p.k * theta**2


def momentum(state: np.ndarray | tuple[float, ...], p: Plant) -> float:
    theta, theta_dot, _, x_dot = state
    return p.M * x_dot + p.m * (x_dot - p.l * math.cos(theta) * theta_dot)


def random_plant(rng: np.random.Generator, **overrides: float | str) -> Capsule:
    fields: dict = {
        "M": rng.uniform(0.3, 1.0),
        "m": rng.uniform(0.05, 0.3),
        "l": rng.uniform(0.1, 0.5),
        "k": rng.uniform(0.0, 1.0),
        "c": rng.uniform(0.0, 0.2),
        "mu": rng.uniform(0.0, 0.5),
        "static_ratio": rng.uniform(1.0, 1.5),
        "backward_ratio": rng.uniform(0.5, 2.0),
        "normal_force": rng.choice(["newton", "paper"]).item(),
    }
    return Capsule(**{**fields, **overrides})


compiled_rates = njit(reference.rates)


@njit
def losses(state: tuple, slip: float, u: float, p: Plant) -> tuple[float, float, float]:
    """Power of the damper, power of friction and friction force, from the independently typed equations."""
    theta, theta_dot, _, x_dot = state
    alpha, _, normal = compiled_rates(theta, theta_dot, x_dot, slip, u, p)
    if slip == 0.0:
        # At rest, friction balances the load on the platform: row two of Eq. (1) with x'' = 0.
        force = p.m * p.l * (math.cos(theta) * alpha - math.sin(theta) * theta_dot**2)
    else:
        force = slip * (p.mu if slip > 0.0 else p.mu * p.backward_ratio) * normal
    return p.c * theta_dot**2, force * x_dot, force


@njit
def audit(torques: np.ndarray, state: tuple, p: Plant, hold: float, steps: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Runs the plant in steps of hold / steps and integrates its gains and losses along the way.

    Only the full steps advance the run. For the quadrature, each step is repeated in fine pieces, cut at the events by
    bisection, so that Simpson's rule integrates smooth functions.

    Returns:
        Final state; sums of work of the torque, damper loss, friction loss, friction impulse, absolute work and
        absolute friction impulse; number of events.
    """
    sums = np.zeros(6)
    theta, theta_dot, x, x_dot = state
    h = hold / steps
    events = 0
    for u in torques:
        for _ in range(steps):
            motion = step(theta, theta_dot, x, x_dot, u, p, h)
            events += motion.events
            t, piece = 0.0, 0.25 * h
            a = (theta, theta_dot, x, x_dot)
            while t < h:
                piece = min(piece, h - t)
                fine = step(a[0], a[1], a[2], a[3], u, p, piece)
                if fine.events > 0 and piece > 1e-13:
                    piece *= 0.5
                    continue
                middle = step(a[0], a[1], a[2], a[3], u, p, 0.5 * piece)
                b = (fine.theta, fine.theta_dot, fine.x, fine.x_dot)
                half = (middle.theta, middle.theta_dot, middle.x, middle.x_dot)
                slip = np.sign(half[3])
                starts, middles = losses(a, slip, u, p), losses(half, slip, u, p)
                ends = losses(b, slip, u, p)
                for j in range(3):
                    sums[1 + j] += piece / 6.0 * (starts[j] + 4.0 * middles[j] + ends[j])
                sums[5] += piece * abs(middles[2])
                t += piece
                piece = min(2.0 * piece, 0.25 * h)
                a = b
            sums[0] += u * (motion.theta - theta)
            sums[4] += abs(u * (motion.theta - theta))
            theta, theta_dot, x, x_dot = motion.theta, motion.theta_dot, motion.x, motion.x_dot
    return np.array((theta, theta_dot, x, x_dot)), sums, events


@njit
def hold_load(ratio: float, state: tuple, p: Plant, h: float, n: int) -> tuple[np.ndarray, int, np.ndarray]:
    """Holds the load at `ratio` of the limit for n steps, its sign such that the pendulum stays near -0.6 rad.

    Returns:
        Final state; number of steps at whose end the platform moved or had moved; lowest and highest angle.
    """
    theta, theta_dot, x, x_dot = state
    moved = 0
    angles = np.array((theta, theta))
    for _ in range(n):
        sign = -1.0 if theta + 0.6 + 0.5 * theta_dot > 0.0 else 1.0
        u = torque_for_load(sign * ratio, theta, theta_dot, p)
        motion = step(theta, theta_dot, x, x_dot, u, p, h)
        theta, theta_dot, x, x_dot = motion.theta, motion.theta_dot, motion.x, motion.x_dot
        if x_dot != 0.0 or x != state[2]:
            moved += 1
        angles[0], angles[1] = min(angles[0], theta), max(angles[1], theta)
    return np.array((theta, theta_dot, x, x_dot)), moved, angles


# Equations of motion


def test_accelerations_satisfy_both_rows_of_equation_1():
    rng = np.random.default_rng(1)
    phases = set()
    for _ in range(3000):
        capsule = random_plant(rng)
        M, m, l, g = capsule.M, capsule.m, capsule.l, capsule.g
        theta, theta_dot, u = rng.uniform(-3, 3), rng.uniform(-12, 12), rng.uniform(-2, 2)
        slip = float(rng.integers(-1, 2))
        a, b, N = dynamics.accelerations(theta, theta_dot, 0.0, slip, u, capsule.plant())
        pivot = capsule.k * theta + capsule.c * theta_dot
        newton = (M + m) * g - m * l * (a * np.sin(theta) + theta_dot**2 * np.cos(theta))
        expected = newton - pivot * np.sin(theta) if capsule.normal_force == "paper" else newton
        row_1 = m * l**2 * a - m * l * np.cos(theta) * b - m * g * l * np.sin(theta) + pivot - u
        row_2 = (M + m) * b - m * l * np.cos(theta) * a + m * l * np.sin(theta) * theta_dot**2
        scale = abs(u) + m * l * (g + l * abs(a) + abs(b) + theta_dot**2) + abs(pivot) + (M + m) * g
        assert abs(row_1) < 1e-13 * scale
        lifted = N == 0.0
        if slip == 0.0:
            assert b == 0.0
        else:
            f = slip * capsule.mu * (1.0 if slip > 0 else capsule.backward_ratio) * N
            assert abs(row_2 + f) < 1e-13 * scale
        if lifted:
            assert expected < 1e-12 * scale
        else:
            assert abs(N - expected) < 1e-13 * scale
        phases.add((slip, lifted, capsule.normal_force))
    assert len(phases) == 12


# Energy and momentum


@pytest.mark.parametrize(
    ("capsule", "torques"),
    [
        (Capsule(mu=0.01), random_torque(1.0, 1)),
        (Capsule(mu=0.1), random_torque(0.5, 2)),
        (Capsule(mu=0.3), random_torque(1.0, 3)),
        (Capsule(mu=0.05, static_ratio=1.5, backward_ratio=2.0), periodic_torque()),
        (Capsule(mu=0.1, normal_force="paper"), periodic_torque()),
    ],
    ids=["0.01", "0.1", "0.3", "anisotropic", "paper"],
)
def test_energy_and_momentum_balance_over_ten_seconds(capsule, torques):
    p = capsule.plant()
    final, sums, events = audit(torques, START, p, HOLD, 40)
    work, damper, friction, impulse, all_work, all_impulse = sums
    assert events > 20
    assert damper > 0.0
    assert friction > 1e-3 * all_work
    exchanged = all_work + damper + friction
    assert abs(energy(final, p) - energy(START, p) - (work - damper - friction)) < 1e-9 * exchanged
    assert abs(momentum(final, p) - momentum(START, p) + impulse) < 1e-9 * all_impulse


def test_without_friction_the_centre_of_mass_keeps_its_velocity():
    p = Capsule(mu=0.0).plant()
    velocity = 0.03
    start = (-1.0, 0.5, 0.2, velocity + p.m * p.l * math.cos(1.0) * 0.5 / (p.M + p.m))
    run = reference.run(random_torque(0.5, 5), start, p, HOLD, 320)
    theta, theta_dot, x, x_dot = run.states.T
    share = p.m * p.l / (p.M + p.m)
    t = HOLD * np.arange(len(theta))
    centre = x - share * np.sin(theta)
    assert np.abs(x_dot - share * np.cos(theta) * theta_dot - velocity).max() < 1e-12
    assert np.abs(centre - centre[0] - velocity * t).max() < 2e-12
    assert run.events[-1] > 20  # the platform itself goes back and forth


# Stick


@pytest.mark.parametrize("ratio", [0.3, 0.9, 0.99, 0.999])
@pytest.mark.parametrize("mu", [0.01, 0.2])
def test_a_load_below_the_threshold_never_moves_the_platform(ratio, mu):
    p = Capsule(mu=mu).plant()
    # The load drifts while a torque is held; at 99.9 % the margin is small, so a torque is held for 0.05 ms.
    start = (-0.6, 0.0, 0.123456789, 0.0)
    final, moved, angles = hold_load(ratio, start, p, 5e-5, 200_000)
    assert moved == 0
    assert final[3] == 0.0
    assert final[2] == 0.123456789
    assert -math.pi / 2 < angles[0] < angles[1] < math.pi / 2
    # The same load just above the threshold moves the platform.
    assert hold_load(1.001, start, p, 5e-5, 2)[1] > 0


# Against the reference


ALL = {"static_ratio": 1.3, "stribeck_speed": 0.1, "viscous": 0.2, "slope": -0.02, "motor_friction": 0.1}
AGREEMENT = [
    *((mu, f"random {amplitude}", random_torque(amplitude, 10 + seed), {})
      for mu in (0.01, 0.3) for seed, amplitude in enumerate((0.2, 0.8))),
    *((mu, "periodic", periodic_torque(), {}) for mu in (0.03, 0.1)),
    (0.05, "anisotropic", random_torque(0.7, 20), {"backward_ratio": 2.0}),
    (0.05, "static", random_torque(0.7, 21), {"static_ratio": 1.5}),
    (0.1, "both", periodic_torque(), {"static_ratio": 1.2, "backward_ratio": 0.5}),
    (0.1, "paper", random_torque(0.7, 22), {"normal_force": "paper"}),
    (0.0, "frictionless", random_torque(0.5, 23), {}),
    (0.1, "slope", random_torque(0.7, 24), {"slope": 0.03, "motor_friction": 0.05}),
    (0.1, "Stribeck", random_torque(0.7, 25), {"static_ratio": 1.5, "stribeck_speed": 0.05, "viscous": 0.4}),
    (0.3, "all", periodic_torque(), ALL),
]  # fmt: skip


@pytest.mark.parametrize(("mu", "name", "torques", "options"), AGREEMENT, ids=[f"{a[0]}-{a[1]}" for a in AGREEMENT])
def test_agreement_with_the_reference_after_ten_seconds(mu, name, torques, options):
    capsule = Capsule(mu=mu, **options)
    expected = reference.simulate(torques, START, capsule.plant())
    run = reference.run(torques, START, capsule.plant(), HOLD, 20)
    assert np.abs(run.states - expected.states).max() < 1e-8
    assert run.events[-1] == len(expected.events)
    # Rounding must not make the phases chatter.
    assert run.most_events <= 3
    forward, backward, stuck, swept = run.sums.T
    # Up to rounding, forward motion minus backward motion is the displacement.
    assert np.abs(forward - backward - run.states[:, 2]).max() < 1e-12
    assert np.abs(forward - expected.forward).max() < 1e-8
    assert np.abs(backward - expected.backward).max() < 1e-8
    # A vanishing event (the platform just sticks, or just does not) changes the stuck time more than the states.
    assert np.abs(stuck - expected.stuck).max() < 1e-7
    # |theta_dot| has a kink where the pendulum reverses; there the step assumes a constant theta''.
    assert np.abs(swept - expected.swept).max() < 2e-6


def test_coming_to_rest_once_has_the_bits_of_any_step():
    rng = np.random.default_rng(0)
    phases, passed = [], 0
    for options in ({}, {"normal_force": "paper"}, ALL):
        for mu in rng.uniform(0.01, 0.4, 200):
            p = Capsule(mu=mu, **options).plant()
            u, h = rng.uniform(-1.0, 1.0), rng.choice((0.001, 0.005)).item()
            state = (rng.uniform(-1.0, 1.0, 4) * (1.0, 15.0, 1.0, 10.0 * h)).tolist()
            start = contact.begin(*state, math.copysign(1.0, state[3]), u, p)
            end = contact.piece(start, h)
            motion, phase, holds = contact.pass_rest(start, end.theta, end.theta_dot, end.x_dot, h)
            expected = contact.step(*state, u, p, h)
            passed += expected.events == 1
            if holds:
                assert motion == expected
                assert phase == dynamics.contact_phase(motion.theta, motion.theta_dot, motion.x_dot, u, p)
                phases.append(phase)
    assert set(phases) == {-1.0, 0.0, 1.0}
    assert 50 < 0.5 * passed < len(phases) <= passed


def test_fourth_order_through_dozens_of_events():
    hold = 0.024
    orders = []
    for mu, amplitude, others in ((0.01, 0.3, {}), (0.03, 0.8, {}), (0.1, 0.6, {}), (0.3, 1.0, {}), (0.1, 0.8, ALL)):
        capsule = Capsule(mu=mu, **others)
        for seed in range(1):
            torques = random_torque(amplitude, 30 + seed, hold=hold, seconds=9.6)
            expected = reference.simulate(torques, START, capsule.plant(), hold=hold)
            assert len(expected.events) >= 24
            errors = []
            for steps in (3, 24):  # 8 ms and 1 ms
                run = reference.run(torques, START, capsule.plant(), hold, steps)
                assert run.events[-1] >= 24
                errors.append(np.abs(run.states - expected.states).max())
            orders.append(math.log2(errors[0] / errors[1]) / 3)
    assert min(orders) >= 3.5, orders


# Events inside one step


def test_a_load_at_the_limit_to_the_last_bit_neither_hangs_nor_chatters():
    rng = np.random.default_rng(43)
    nearly = 1.0 + np.array([0.0, 0.0, 2.3e-16, -1.2e-16, 1e-15, -1e-15, 1e-12, -1e-12, 1e-6])
    for i in range(4000):
        # With little friction, the load soon passes from one limit to the other, which is the difficult case.
        capsule = Capsule(mu=10.0 ** rng.uniform(-5.0, -0.5))
        p = capsule.plant()
        theta, theta_dot = rng.uniform(-1.2, 1.2), rng.choice([0.0, rng.uniform(-6, 6)])
        u = torque_for_load(rng.choice([-1.0, 1.0]) * rng.choice(nearly), theta, theta_dot, p)
        x_dot = rng.choice([0.0, 5e-324, -5e-324, 1e-17, -1e-17, 1e-12])
        h = rng.choice([1e-3, 5e-3])
        motion = step(theta, theta_dot, 0.0, x_dot, u, p, h)
        assert motion.events <= 5
        # The step covers its whole duration: a torque off by 1e-9, away from the limit, gives nearly the same motion.
        if i % 10 == 0:
            beside = [step(theta, theta_dot, 0.0, 0.0, u + off, p, h) for off in (-1e-9, 1e-9)]
            error = min(np.abs(np.array(motion[:4]) - other[:4]).max() for other in beside)
            assert error < 1e-6
            assert abs(motion.theta - theta - h * theta_dot) < 400.0 * h**2
            if abs(theta_dot) > 1.0:
                assert abs(motion.swept) > 0.3 * h


# Contact


def test_a_step_reports_that_the_contact_is_lost():
    p = Capsule(mu=0.1).plant()
    upright = math.sqrt((p.M + p.m) * p.g / (p.m * p.l))  # the ball's centripetal force carries the whole weight
    for x_dot in (0.1, -0.1):
        assert contact.step(0.0, 0.999 * upright, 0.0, x_dot, 0.0, p, 1e-4).normal_force > 0.0
        assert contact.step(0.0, 1.001 * upright, 0.0, x_dot, 0.0, p, 1e-4).normal_force == 0.0
    resting = contact.step(-0.2, 0.0, 0.0, 0.0, 0.0, p, 1e-3).normal_force
    assert resting == pytest.approx(reference.rates(-0.2, 0.0, 0.0, 0.0, 0.0, Capsule().plant())[2], rel=1e-12)


def test_friction_never_pushes_a_platform_that_has_lost_contact():
    capsule = Capsule(mu=0.3, k=0.0, c=0.0)
    p = capsule.plant()
    for theta_dot in (18.0, -18.0):
        for x_dot in (2.0, -2.0):
            state = (-math.copysign(0.4, theta_dot), theta_dot, 0.0, x_dot)
            start, drift = energy(state, p), momentum(state, p)
            lifted = 0
            for _ in range(2500):
                motion = step(*state, 0.0, p, 1e-4)
                assert energy(motion[:4], p) - energy(state, p) < 1e-10
                if motion.normal_force == 0.0:
                    lifted += 1
                    # Contact has been lost until the start of this step; within the step, it may come back.
                    assert momentum(state, p) == pytest.approx(drift, abs=1e-10)
                    assert energy(state, p) == pytest.approx(start, rel=1e-10)
                elif lifted > 0:
                    break
                state = motion[:4]
            assert lifted > 200
            for _ in range(200):
                state = step(*state, 0.0, p, 1e-4)[:4]
            # Once contact is back, friction dissipates energy.
            assert energy(state, p) < start - 1e-3


# Compiled and interpreted


def test_python_and_compiled_steps_are_equal_bit_for_bit():
    rng = np.random.default_rng(50)
    events = 0
    for i in range(1000):
        capsule = random_plant(rng) if i % 2 else Capsule(mu=rng.uniform(0.0, 0.3))
        p = capsule.plant()
        theta, theta_dot = rng.uniform(-2, 2), rng.uniform(-8, 8)
        x_dot = float(rng.choice([0.0, rng.uniform(-0.01, 0.01), rng.uniform(-0.5, 0.5)]))
        u = rng.uniform(-1.5, 1.5)
        if x_dot == 0.0 and rng.random() < 0.5:
            u = torque_for_load(rng.choice([-1, 1]) * rng.uniform(0.95, 1.05), theta, theta_dot, p)
        h = float(rng.choice([5e-4, 1e-3, 5e-3, 2e-2]))
        interpreted = contact.step(theta, theta_dot, 0.3, x_dot, u, p, h)
        compiled = step(theta, theta_dot, 0.3, x_dot, u, p, h)
        assert interpreted == compiled
        events += interpreted.events
    assert events > 150
