"""The plant's physics: conservation, exact stick, located events and order of convergence."""

import math
from collections import namedtuple

import numpy as np
import pytest

from benchmarks.accuracy import START, solve
from capsule_gym import dynamics
from capsule_gym.core import _core, native
from capsule_gym.core.layout import Row
from capsule_gym.dynamics import step
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.simulation import Simulation
from capsule_gym.parameters import Capsule

HOLD = 0.02


def random_torque(amplitude, seed, seconds=10.0, hold=HOLD):
    return np.random.default_rng(seed).uniform(-amplitude, amplitude, round(seconds / hold))


def periodic_torque(seconds=10.0, hold=HOLD):
    t = hold * np.arange(round(seconds / hold))
    return 0.6 * np.sin(2 * math.pi * t / 0.7) + 0.3 * np.sin(4 * math.pi * t / 0.7 + 0.8)


def energy(state, p):
    """Kinetic energy of the platform and of the ball at (x - l sin, l cos), plus gravity's and the
    spring's."""
    theta, theta_dot, _, x_dot = state
    ball = (x_dot - p.l * np.cos(theta) * theta_dot, -p.l * np.sin(theta) * theta_dot)
    kinetic = 0.5 * p.M * x_dot**2 + 0.5 * p.m * (ball[0] ** 2 + ball[1] ** 2)
    return kinetic + p.m * p.g * p.l * np.cos(theta) + 0.5 * p.k * theta**2


def momentum(state, p):
    theta, theta_dot, _, x_dot = state
    return p.M * x_dot + p.m * (x_dot - p.l * np.cos(theta) * theta_dot)


# Of `run`, at the multiples of `hold`: theta, theta_dot, x, x_dot; forward, backward, stuck, swept;
# the most in a step.
Run = namedtuple("Run", "states sums events most_events")


def run(torques, p, hold, steps, state=START):
    """Steps cases that differ in torque, M or mu, each torque held for `hold` seconds in equal
    steps."""
    shape = np.broadcast_shapes(torques.shape[1:], np.shape(p.mu))
    motion = [np.broadcast_to(value, shape) for value in state]
    states, sums, events, most = (
        [np.stack(motion, axis=-1)],
        [np.zeros((*shape, 4))],
        [np.zeros(shape)],
        0,
    )
    for u in torques:
        total, count = sums[-1], events[-1]
        for _ in range(steps):
            motion = step(*motion[:4], u, p, hold / steps)
            total, count = total + np.stack(motion[4:8], axis=-1), count + motion.events
            most = max(most, int(motion.events.max()))
        states.append(np.stack(motion[:4], axis=-1))
        sums.append(total)
        events.append(count)
    return Run(np.array(states), np.array(sums), np.array(events), most)


def torque_for_load(ratio, theta, theta_dot, p):
    """The torque at which the load on a platform at rest is `ratio` times mu N (negative:
    backwards), by Eq. (1)."""
    # With x'' = 0, the second row gives theta'' and the first row then the torque.
    s, c, rough = np.sin(theta), np.cos(theta), ratio * p.mu
    wanted = rough * ((p.M + p.m) * p.g / (p.m * p.l) - theta_dot**2 * c) + theta_dot**2 * s
    return (
        p.m * p.l**2 * wanted / (c + rough * s)
        - p.m * p.g * p.l * s
        + p.k * theta
        + p.c * theta_dot
    )


def losses(state, slip, u, p):
    """Power of the damper, power of friction, and friction by the second row of Eq. (1), also in
    stick."""
    theta, theta_dot, _, x_dot = state
    alpha, x_ddot, normal = dynamics.accelerations(theta, theta_dot, x_dot, slip, u, p)
    assert normal.min() > 0.0
    force = (
        p.m * p.l * (np.cos(theta) * alpha - np.sin(theta) * theta_dot**2) - (p.M + p.m) * x_ddot
    )
    return np.array((p.c * theta_dot**2, force * x_dot, force))


BALANCED = {
    "0.01": (Capsule(mu=0.01), random_torque(1.0, 1)),
    "0.3": (Capsule(mu=0.3), random_torque(1.0, 3)),
    "anisotropic": (Capsule(mu=0.05, static_ratio=1.5, backward_ratio=2.0), periodic_torque()),
    "paper": (Capsule(mu=0.1, normal_force="paper"), periodic_torque()),
}


def test_accelerations_satisfy_both_rows_of_equation_1():
    rng, n, phases = np.random.default_rng(1), 100, set()
    ranges = {
        "M": (0.3, 1.0),
        "m": (0.05, 0.3),
        "l": (0.1, 0.5),
        "k": (0.0, 1.0),
        "c": (0.0, 0.2),
        "mu": (0.0, 0.5),
    }
    ranges |= {"static_ratio": (1.0, 1.5), "backward_ratio": (0.5, 2.0)}
    for _ in range(60):
        normal_force = rng.choice(["newton", "paper"]).item()
        capsule = Capsule(
            **{name: rng.uniform(*ends) for name, ends in ranges.items()}, normal_force=normal_force
        )
        M, m, l, g = capsule.M, capsule.m, capsule.l, capsule.g
        theta, theta_dot, u = rng.uniform(-3, 3, n), rng.uniform(-12, 12, n), rng.uniform(-2, 2, n)
        slip = rng.integers(-1, 2, n).astype(float)
        a, b, N = dynamics.accelerations(theta, theta_dot, 0.0, slip, u, capsule.plant())
        pivot = capsule.k * theta + capsule.c * theta_dot
        newton = (M + m) * g - m * l * (a * np.sin(theta) + theta_dot**2 * np.cos(theta))
        expected = newton - pivot * np.sin(theta) if capsule.normal_force == "paper" else newton
        row_1 = m * l**2 * a - m * l * np.cos(theta) * b - m * g * l * np.sin(theta) + pivot - u
        row_2 = (M + m) * b - m * l * np.cos(theta) * a + m * l * np.sin(theta) * theta_dot**2
        scale = (
            np.abs(u)
            + m * l * (g + l * np.abs(a) + np.abs(b) + theta_dot**2)
            + np.abs(pivot)
            + (M + m) * g
        )
        assert (np.abs(row_1) < 1e-13 * scale).all()
        f = dynamics.friction_force(slip, 0.0, N, capsule.plant())
        coulomb = slip * capsule.mu * np.where(slip > 0.0, 1.0, capsule.backward_ratio) * N
        assert (np.abs(f - coulomb) <= 1e-15 * np.abs(coulomb)).all()
        sticks, lifted = slip == 0.0, N == 0.0
        assert not b[sticks].any() and (np.abs(row_2 + f) < 1e-13 * scale)[~sticks].all()
        assert np.where(
            lifted, expected < 1e-12 * scale, np.abs(N - expected) < 1e-13 * scale
        ).all()
        phases |= {
            (*phase, capsule.normal_force)
            for phase in zip(slip.tolist(), lifted.tolist(), strict=True)
        }
    assert len(phases) == 12


FLOORS = {
    "Coulomb": {},
    "paper": {"normal_force": "paper"},
    "slope": {"slope": 0.05},
    "viscous": {"viscous": 0.4},
    "Stribeck": {"stribeck_speed": 0.05},
    "all": {
        "stribeck_speed": 0.05,
        "viscous": 0.4,
        "slope": -0.05,
        "motor_friction": 0.1,
        "normal_force": "paper",
    },
}


def random_states(seed, count=2000):
    """Angles and rates of the pendulum, velocities of the platform, phases of slip and torques, SI
    units."""
    rng = np.random.default_rng(seed)
    slip = rng.choice([-1.0, 1.0], count)
    x_dot = slip * rng.uniform(0.0, 0.5, count)
    return (
        rng.uniform(-3.0, 3.0, count),
        rng.uniform(-12.0, 12.0, count),
        x_dot,
        slip,
        rng.uniform(-2.0, 2.0, count),
    )


@pytest.mark.parametrize("floor", FLOORS.values(), ids=FLOORS)
def test_accelerations_in_slip_follow_from_the_driving_force_and_the_friction_force(floor):
    capsule = Capsule(mu=0.3, static_ratio=1.5, backward_ratio=0.7, **floor)
    p = capsule.plant()
    theta, theta_dot, x_dot, slip, u = random_states(2)
    theta_ddot, x_ddot, normal = dynamics.accelerations(theta, theta_dot, x_dot, slip, u, p)
    friction = dynamics.friction_force(slip, x_dot, normal, p)
    driving = dynamics.driving_force(theta, theta_dot, theta_ddot, p)
    weight = (p.M + p.m) * p.g
    scale = weight + np.abs(driving) + p.m * p.l * (np.abs(theta_ddot) + theta_dot**2)
    residual = (p.M + p.m) * x_ddot - (driving - friction - capsule.viscous * x_dot)
    assert (np.abs(residual) < 1e-13 * scale).all()
    assert np.abs(friction).max() > 0.3 * weight
    # The same normal force with other roundings, and its clamp.
    unclamped = dynamics.normal_force(theta, theta_dot, theta_ddot, p)
    assert (np.abs(normal - np.maximum(unclamped, 0.0)) < 1e-14 * scale).all()
    assert (normal == 0.0).any()


@pytest.mark.parametrize("floor", FLOORS.values(), ids=FLOORS)
def test_the_stick_margin_has_the_bits_of_the_forces(floor):
    p = Capsule(mu=0.3, static_ratio=1.5, backward_ratio=0.7, **floor).plant()
    theta, theta_dot, _, _, u = random_states(3)
    theta_ddot, x_ddot, _ = dynamics.accelerations(theta, theta_dot, 0.0, 0.0, u, p)
    assert not x_ddot.any()
    force = dynamics.driving_force(theta, theta_dot, theta_ddot, p)
    normal = np.maximum(dynamics.normal_force(theta, theta_dot, theta_ddot, p), 0.0)
    limit = p.static_ratio * np.where(force < 0.0, p.mu * p.backward_ratio, p.mu) * normal
    margin, load = dynamics.stick_margin(theta, theta_dot, u, p)
    assert np.array_equal(margin, limit - np.abs(force))
    assert np.array_equal(load, force)
    sticks = dynamics.contact_phase(theta, theta_dot, 0.0, u, p) == 0.0
    assert np.array_equal(sticks, margin >= 0.0)
    assert 0 < np.count_nonzero(sticks) < len(sticks)


def test_the_friction_force_follows_the_stribeck_curve():
    p = Capsule(mu=0.3, static_ratio=1.5, stribeck_speed=0.05).plant()
    _, _, x_dot, slip, _ = random_states(4)
    expected = slip * 0.3 * (1.0 + 0.5 / (1.0 + (x_dot / 0.05) ** 2)) * 2.0
    np.testing.assert_allclose(dynamics.friction_force(slip, x_dot, 2.0, p), expected, rtol=1e-14)


@pytest.mark.parametrize(("capsule", "torques"), BALANCED.values(), ids=BALANCED)
def test_energy_and_momentum_balance_over_ten_seconds(capsule, torques):
    p, h, u = capsule.plant(), HOLD / 40, np.repeat(torques, 40)
    whole = run(u, p, h, 1)
    a, t, piece = whole.states[:-1].T.copy(), np.zeros(len(u)), np.full(len(u), 0.25 * h)
    sums, absolute = np.zeros(3), 0.0
    # The steps again in pieces, cut at the events by bisection, so that Simpson's rule integrates
    # what is smooth.
    while (left := np.flatnonzero(t < h)).size:
        piece[left] = np.minimum(piece[left], h - t[left])
        fine = step(*a[:, left], u[left], p, piece[left])
        cut = (fine.events > 0) & (piece[left] > 1e-13)
        piece[left[cut]] *= 0.5
        kept = left[~cut]
        middle = np.array(step(*a[:, kept], u[kept], p, 0.5 * piece[kept])[:4])
        ends, slip = np.array(fine[:4])[:, ~cut], np.sign(middle[3])
        first, half, last = (
            losses(state, slip, u[kept], p) for state in (a[:, kept], middle, ends)
        )
        sums += ((first + 4.0 * half + last) * piece[kept] / 6.0).sum(axis=1)
        absolute += (piece[kept] * np.abs(half[2])).sum()
        a[:, kept] = ends
        t[kept] += piece[kept]
        piece[kept] = np.minimum(2.0 * piece[kept], 0.25 * h)
    works = u * np.diff(whole.states[:, 0])
    (damper, friction, impulse), work, all_work, final = (
        sums,
        works.sum(),
        np.abs(works).sum(),
        whole.states[-1],
    )
    assert whole.events[-1] > 20 and damper > 0.0 and friction > 1e-3 * all_work
    exchanged = all_work + damper + friction
    assert abs(energy(final, p) - energy(START, p) - (work - damper - friction)) < 1e-9 * exchanged
    assert abs(momentum(final, p) - momentum(START, p) + impulse) < 1e-9 * absolute


def test_a_load_below_the_threshold_never_moves_the_platform():
    ratios, mu = np.meshgrid([0.3, 0.9, 0.99, 0.999], [0.01, 0.2])
    p = Capsule().plant()._replace(mu=mu)
    theta, theta_dot, at = np.full(mu.shape, -0.6), np.zeros(mu.shape), 0.123456789

    def torque(share):
        """The torque for a load at this share of the limit, its sign such that the pendulum stays
        near -0.6 rad."""
        sign = np.where(theta + 0.6 + 0.5 * theta_dot > 0.0, -1.0, 1.0)
        return torque_for_load(sign * share, theta, theta_dot, p)

    # The same load just above the threshold moves the platform.
    assert (step(theta, theta_dot, at, 0.0, torque(1.001), p, 5e-5).x_dot != 0.0).all()
    # The load drifts while a torque is held; at 99.9 % the margin is small, so a torque is held for
    # 0.05 ms.
    for _ in range(40_000):
        motion = step(theta, theta_dot, at, 0.0, torque(ratios), p, 5e-5)
        theta, theta_dot = motion.theta, motion.theta_dot
        assert not motion.x_dot.any() and (motion.x == at).all()
    assert (np.abs(theta + 0.6) < 0.5).all()


ALL = {
    "static_ratio": 1.3,
    "stribeck_speed": 0.1,
    "viscous": 0.2,
    "slope": -0.02,
    "motor_friction": 0.1,
}
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


@pytest.mark.parametrize(
    ("mu", "name", "torques", "options"), AGREEMENT, ids=[f"{a[0]}-{a[1]}" for a in AGREEMENT]
)
def test_agreement_with_the_reference_after_ten_seconds(mu, name, torques, options):
    capsule = Capsule(mu=mu, **options)
    expected = solve(torques, capsule.plant())
    result = run(torques, capsule.plant(), HOLD, 20)
    assert np.abs(result.states - expected.states).max() < 1e-8
    assert result.events[-1] == expected.events
    # Rounding must not make the phases chatter.
    assert result.most_events <= 3
    forward, backward, *_ = result.sums.T
    # Up to rounding, forward motion minus backward motion is the displacement.
    assert np.abs(forward - backward - result.states[:, 2]).max() < 1e-12
    forward, backward, stuck, swept = np.abs(result.sums - expected.sums).max(axis=0)
    assert max(forward, backward) < 1e-8
    # A vanishing event (the platform just sticks, or just does not) changes the stuck time more
    # than the states.
    assert stuck < 1e-7
    # |theta_dot| has a kink where the pendulum reverses; there the step assumes a constant theta''.
    assert swept < 2e-6


@pytest.mark.parametrize(
    "options", [{}, {"normal_force": "paper"}, ALL], ids=["Coulomb", "paper", "all"]
)
@pytest.mark.parametrize(
    ("h", "level"), [(0.005, None), *((0.001, level) for level in _core.LEVELS)]
)
def test_a_substep_of_a_batch_has_the_bits_of_the_plants_step(options, h, level, select_level):
    """Also where several environments of a block come to rest, which are stepped together."""
    select_level(level or native.LEVEL)
    rng, n = np.random.default_rng(0), 500
    mu, actions = rng.uniform(0.01, 0.4, n), rng.uniform(-1.0, 1.0, n)
    states = rng.uniform(-1.0, 1.0, (n, 4)) * (1.0, 15.0, 1.0, 10.0 * h)
    states[::10, 3] = 0.0
    capsule = Capsule(**options)
    batch = Simulation(
        n,
        EnvConfig(
            capsule=capsule, control_dt=h, physics_dt=h, torque_limit=1.0, residual_limit=1.0
        ),
    )
    batch.reset(np.arange(n), [capsule.M] * n, mu.tolist(), states)
    batch.step(actions)
    motion = step(*states.T, actions, capsule.plant()._replace(mu=mu), h)
    for name in (
        "theta",
        "theta_dot",
        "x",
        "x_dot",
        "forward",
        "backward",
        "stuck",
        "normal_force",
    ):
        assert batch.row(getattr(Row, name)).tobytes() == getattr(motion, name).tobytes(), name
    assert batch.row(Row.energy).tobytes() == (np.abs(actions) * motion.swept).tobytes()
    assert (
        np.count_nonzero(motion.events == 1.0) > 100 and np.count_nonzero(motion.x_dot == 0.0) > 20
    )
    assert np.count_nonzero(motion.normal_force == 0.0) > 20


def test_a_load_at_the_limit_to_the_last_bit_neither_hangs_nor_chatters():
    rng, n = np.random.default_rng(43), 20_000
    nearly = 1.0 + np.array([0.0, 0.0, 2.3e-16, -1.2e-16, 1e-15, -1e-15, 1e-12, -1e-12, 1e-6])
    # With little friction, the load soon passes from one limit to the other, which is the difficult
    # case.
    p = Capsule().plant()._replace(mu=10.0 ** rng.uniform(-5.0, -0.5, n))
    theta, theta_dot = (
        rng.uniform(-1.2, 1.2, n),
        rng.choice([0.0, 1.0], n) * rng.uniform(-6.0, 6.0, n),
    )
    u = torque_for_load(rng.choice([-1.0, 1.0], n) * rng.choice(nearly, n), theta, theta_dot, p)
    x_dot, h = (
        rng.choice([0.0, 5e-324, -5e-324, 1e-17, -1e-17, 1e-12], n),
        rng.choice([1e-3, 5e-3], n),
    )
    motion = step(theta, theta_dot, 0.0, x_dot, u, p, h)
    assert motion.events.max() <= 5
    # The step covers its whole duration: a torque off by 1e-9, away from the limit, gives nearly
    # the same motion.
    near = [np.array(step(theta, theta_dot, 0.0, 0.0, u + off, p, h)[:4]) for off in (-1e-9, 1e-9)]
    assert (
        np.minimum(*(np.abs(np.array(motion[:4]) - other).max(axis=0) for other in near)).max()
        < 1e-6
    )
    assert (np.abs(motion.theta - theta - h * theta_dot) < 400.0 * h**2).all()
    turning = np.abs(theta_dot) > 1.0
    assert (motion.swept[turning] > 0.3 * h[turning]).all()


def test_friction_never_pushes_a_platform_that_has_lost_contact():
    p = Capsule(mu=0.3, k=0.0, c=0.0).plant()
    theta_dot, x_dot = (each.ravel() for each in np.meshgrid([18.0, -18.0], [2.0, -2.0]))
    state = (-np.copysign(0.4, theta_dot), theta_dot, np.zeros(4), x_dot)
    start, drift = energy(state, p), momentum(state, p)
    lifted, back = np.zeros(4), np.zeros(4, np.bool_)
    for _ in range(2500):
        motion = step(*state, 0.0, p, 1e-4)
        assert (energy(motion[:4], p) - energy(state, p) < 1e-10).all()
        # Contact has been lost until the start of this step; within the step, it may come back.
        flies = (motion.normal_force == 0.0) & ~back
        np.testing.assert_allclose(momentum(state, p)[flies], drift[flies], rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(energy(state, p)[flies], start[flies], rtol=1e-10)
        lifted += flies
        back |= (motion.normal_force > 0.0) & (lifted > 0)
        state = motion[:4]
    assert back.all() and (lifted > 200).all()
    # Once contact is back, friction dissipates energy.
    assert (energy(state, p) < start - 1e-3).all()


def test_fourth_order_through_dozens_of_events():
    hold = 0.024
    orders = []
    for mu, amplitude, others in (
        (0.01, 0.3, {}),
        (0.03, 0.8, {}),
        (0.1, 0.6, {}),
        (0.3, 1.0, {}),
        (0.1, 0.8, ALL),
    ):
        capsule = Capsule(mu=mu, **others)
        torques = random_torque(amplitude, 30, hold=hold, seconds=9.6)
        expected = solve(torques, capsule.plant(), hold)
        assert expected.events >= 24
        errors = []
        for steps in (3, 24):  # 8 ms and 1 ms
            result = run(torques, capsule.plant(), hold, steps)
            assert result.events[-1] >= 24
            errors.append(np.abs(result.states - expected.states).max())
        orders.append(math.log2(errors[0] / errors[1]) / 3)
    assert min(orders) >= 3.5, orders


def test_friction_bounds_what_moves_the_centre_of_mass():
    rng, n = np.random.default_rng(5), 2000
    p = (
        Capsule(static_ratio=1.3)
        .plant()
        ._replace(M=rng.uniform(0.4, 0.6, n), mu=rng.uniform(0.0, 0.5, n))
    )
    theta, theta_dot, u = (
        rng.uniform(-1.5, 1.5, n),
        rng.uniform(-12.0, 12.0, n),
        rng.uniform(-1.5, 1.5, n),
    )
    slip = dynamics.contact_phase(theta, theta_dot, rng.choice([-0.1, 0.0, 0.1], n), u, p)
    theta_ddot, x_ddot, normal = dynamics.accelerations(theta, theta_dot, 0.1 * slip, slip, u, p)
    sin, cos, s = np.sin(theta), np.cos(theta), p.m * p.l / (p.M + p.m)
    along = x_ddot - s * (cos * theta_ddot - sin * theta_dot**2)
    up = -s * (sin * theta_ddot + cos * theta_dot**2)
    assert ((normal == 0.0) | (np.abs(along) <= p.mu * p.static_ratio * (p.g + up) + 1e-9)).all()
