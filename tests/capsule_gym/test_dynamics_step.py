"""Steps of the plant: conservation, exact stick, located events and order of convergence."""

import math
from collections import namedtuple
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.accuracy import START, solve
from capsule_gym.core import _core, native
from capsule_gym.core.layout import Row
from capsule_gym.dynamics import accelerations, step
from capsule_gym.envs.config import EnvConfig
from capsule_gym.envs.simulation import Simulation
from capsule_gym.parameters import Capsule

HOLD = 0.02  # s


def random_torque(amplitude, seed, seconds=10.0, hold=HOLD):
    return np.random.default_rng(seed).uniform(-amplitude, amplitude, round(seconds / hold))


def periodic_torque():
    t = HOLD * np.arange(500)
    phase = 2 * math.pi * t / 0.7
    return 0.6 * np.sin(phase) + 0.3 * np.sin(2 * phase + 0.8)


def energy(state, p):
    """Energy of the platform, of the ball at (x - l sin, l cos) and of the spring."""
    theta, theta_dot, _, x_dot = state
    ball_x_dot = x_dot - p.l * np.cos(theta) * theta_dot
    ball_y_dot = -p.l * np.sin(theta) * theta_dot
    kinetic = 0.5 * p.M * x_dot**2 + 0.5 * p.m * (ball_x_dot**2 + ball_y_dot**2)
    return kinetic + p.m * p.g * p.l * np.cos(theta) + 0.5 * p.k * theta**2


def momentum(state, p):
    theta, theta_dot, _, x_dot = state
    return p.M * x_dot + p.m * (x_dot - p.l * np.cos(theta) * theta_dot)


# States and sums at the multiples of `hold`: theta, theta_dot, x, x_dot; forward, backward, stuck,
# swept. Number of events, and the most in a step.
Run = namedtuple("Run", "states sums events most_events")


def run(torques, p, hold, steps):
    """Steps a plant from START, each torque held for `hold` seconds in equal steps."""
    motion = START
    states = [START]
    sums = [np.zeros(4)]
    events = []
    for u in torques:
        total = sums[-1]
        for _ in range(steps):
            motion = step(*motion[:4], u, p, hold / steps)
            total = total + motion[4:8]
            events.append(int(motion.events))
        states.append(motion[:4])
        sums.append(total)
    return Run(np.array(states), np.array(sums), sum(events), max(events))


def torque_for_load(ratio, theta, theta_dot, p):
    """The torque at which the load on a platform at rest is `ratio` times mu N, by Eq. (1).

    A negative ratio is a load backwards.
    """
    # With x'' = 0, the second row gives theta'' and the first row then the torque.
    sin = np.sin(theta)
    cos = np.cos(theta)
    friction = ratio * p.mu
    weight = (p.M + p.m) * p.g / (p.m * p.l)
    load = friction * (weight - theta_dot**2 * cos) + theta_dot**2 * sin
    inertia = p.m * p.l**2 * load / (cos + friction * sin)
    return inertia - p.m * p.g * p.l * sin + p.k * theta + p.c * theta_dot


def losses(state, slip, u, p):
    """Power of the damper, power of friction, and friction by the second row of Eq. (1).

    The latter is defined in stick, too.
    """
    theta, theta_dot, _, x_dot = state
    theta_ddot, x_ddot, normal = accelerations(theta, theta_dot, x_dot, slip, u, p)
    assert normal.min() > 0.0
    swing = np.cos(theta) * theta_ddot - np.sin(theta) * theta_dot**2
    force = p.m * p.l * swing - (p.M + p.m) * x_ddot
    return np.array((p.c * theta_dot**2, force * x_dot, force))


def integrate_losses(states, u, p, h):
    """The integrals of `losses` and of |friction| over steps of h seconds from the states.

    The steps are taken again in pieces, cut at the events by bisection, so that Simpson's rule
    integrates what is smooth.
    """
    state = states.T.copy()
    t = np.zeros(len(u))
    piece = np.full(len(u), 0.25 * h)
    integrals = np.zeros(3)
    absolute = 0.0
    while (left := np.flatnonzero(t < h)).size:
        piece[left] = np.minimum(piece[left], h - t[left])
        fine = step(*state[:, left], u[left], p, piece[left])
        cut = (fine.events > 0) & (piece[left] > 1e-13)
        piece[left[cut]] *= 0.5
        kept = left[~cut]
        duration = piece[kept]
        start = state[:, kept]
        middle = np.array(step(*start, u[kept], p, 0.5 * duration)[:4])
        end = np.array(fine[:4])[:, ~cut]
        slip = np.sign(middle[3])
        first, half, last = (losses(each, slip, u[kept], p) for each in (start, middle, end))
        integrals += ((first + 4.0 * half + last) * duration / 6.0).sum(axis=1)
        absolute += (duration * np.abs(half[2])).sum()
        state[:, kept] = end
        t[kept] += duration
        piece[kept] = np.minimum(2.0 * duration, 0.25 * h)
    return *integrals, absolute


@pytest.fixture(
    scope="module",
    params=[
        (Capsule(mu=0.01), random_torque(1.0, 1)),
        (Capsule(mu=0.3), random_torque(1.0, 3)),
        (Capsule(mu=0.05, static_ratio=1.5, backward_ratio=2.0), periodic_torque()),
        (Capsule(mu=0.1, normal_force="paper"), periodic_torque()),
    ],
    ids=["0.01", "0.3", "anisotropic", "paper"],
)
def balance(request):
    """Ten seconds of a plant, and the integrals of its losses."""
    capsule, torques = request.param
    p = capsule.plant()
    h = HOLD / 40
    u = np.repeat(torques, 40)
    whole = run(u, p, h, 1)
    assert whole.events > 20
    damper, friction, impulse, absolute = integrate_losses(whole.states[:-1], u, p, h)
    return SimpleNamespace(
        p=p,
        final=whole.states[-1],
        works=u * np.diff(whole.states[:, 0]),
        damper=damper,
        friction=friction,
        impulse=impulse,
        absolute=absolute,
    )


def test_the_energy_is_balanced_over_ten_seconds(balance):
    all_work = np.abs(balance.works).sum()
    assert balance.damper > 0.0
    assert balance.friction > 1e-3 * all_work
    exchanged = all_work + balance.damper + balance.friction
    gained = energy(balance.final, balance.p) - energy(START, balance.p)
    supplied = balance.works.sum() - balance.damper - balance.friction
    assert abs(gained - supplied) < 1e-9 * exchanged


def test_the_momentum_is_balanced_over_ten_seconds(balance):
    gained = momentum(balance.final, balance.p) - momentum(START, balance.p)
    assert abs(gained + balance.impulse) < 1e-9 * balance.absolute


def torque_near_start(share, theta, theta_dot, p):
    """The torque for a load at this share of the limit.

    Its sign is such that the pendulum stays near -0.6 rad.
    """
    sign = np.where(theta + 0.6 + 0.5 * theta_dot > 0.0, -1.0, 1.0)
    return torque_for_load(sign * share, theta, theta_dot, p)


@pytest.mark.parametrize("mu", [0.01, 0.2])
def test_a_load_above_the_threshold_moves_the_platform(mu):
    p = Capsule(mu=mu).plant()
    motion = step(-0.6, 0.0, 0.123456789, 0.0, torque_near_start(1.001, -0.6, 0.0, p), p, 5e-5)
    assert motion.x_dot != 0.0


def test_a_load_below_the_threshold_never_moves_the_platform():
    shares, mu = np.meshgrid([0.3, 0.9, 0.99, 0.999], [0.01, 0.2])
    p = Capsule().plant()._replace(mu=mu)
    theta = np.full(mu.shape, -0.6)
    theta_dot = np.zeros(mu.shape)
    x = 0.123456789
    # The load drifts while a torque is held; at 99.9 % the margin is small, so a torque is held for
    # 0.05 ms.
    for _ in range(40_000):
        u = torque_near_start(shares, theta, theta_dot, p)
        motion = step(theta, theta_dot, x, 0.0, u, p, 5e-5)
        theta = motion.theta
        theta_dot = motion.theta_dot
        assert not motion.x_dot.any()
        assert (motion.x == x).all()
    assert (np.abs(theta + 0.6) < 0.5).all()


ALL = {
    "static_ratio": 1.3,
    "stribeck_speed": 0.1,
    "viscous": 0.2,
    "slope": -0.02,
    "motor_friction": 0.1,
}


@pytest.mark.parametrize(
    ("name", "capsule", "torques"),
    [
        ("random 0.2", Capsule(mu=0.01), random_torque(0.2, 10)),
        ("random 0.8", Capsule(mu=0.01), random_torque(0.8, 11)),
        ("random 0.2", Capsule(mu=0.3), random_torque(0.2, 10)),
        ("random 0.8", Capsule(mu=0.3), random_torque(0.8, 11)),
        ("periodic", Capsule(mu=0.03), periodic_torque()),
        ("periodic", Capsule(mu=0.1), periodic_torque()),
        ("anisotropic", Capsule(mu=0.05, backward_ratio=2.0), random_torque(0.7, 20)),
        ("static", Capsule(mu=0.05, static_ratio=1.5), random_torque(0.7, 21)),
        ("both", Capsule(mu=0.1, static_ratio=1.2, backward_ratio=0.5), periodic_torque()),
        ("paper", Capsule(mu=0.1, normal_force="paper"), random_torque(0.7, 22)),
        ("frictionless", Capsule(mu=0.0), random_torque(0.5, 23)),
        ("slope", Capsule(mu=0.1, slope=0.03, motor_friction=0.05), random_torque(0.7, 24)),
        (
            "Stribeck",
            Capsule(mu=0.1, static_ratio=1.5, stribeck_speed=0.05, viscous=0.4),
            random_torque(0.7, 25),
        ),
        ("all", Capsule(mu=0.3, **ALL), periodic_torque()),
    ],
)
def test_agreement_with_the_reference_after_five_seconds(name, capsule, torques):
    torques = torques[:250]
    expected = solve(torques, capsule.plant())

    result = run(torques, capsule.plant(), HOLD, 20)

    assert np.abs(result.states - expected.states).max() < 1e-8
    assert result.events == expected.events
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


SHOWN = ("theta", "theta_dot", "x", "x_dot", "forward", "backward", "stuck", "normal_force")


@pytest.mark.parametrize(
    "options", [{}, {"normal_force": "paper"}, ALL], ids=["Coulomb", "paper", "all"]
)
@pytest.mark.parametrize(
    ("h", "level"), [(0.005, native.LEVEL), *((0.001, level) for level in _core.LEVELS)]
)
def test_a_substep_of_a_batch_has_the_bits_of_the_plants_step(options, h, level, select_level):
    """Also where several environments of a block come to rest, which are stepped together."""
    select_level(level)
    rng = np.random.default_rng(0)
    n = 500
    mu = rng.uniform(0.01, 0.4, n)
    actions = rng.uniform(-1.0, 1.0, n)
    states = rng.uniform(-1.0, 1.0, (n, 4)) * (1.0, 15.0, 1.0, 10.0 * h)
    states[::10, 3] = 0.0
    capsule = Capsule(**options)
    steps = {"control_dt": h, "physics_dt": h}
    config = EnvConfig(capsule=capsule, **steps, torque_limit=1.0, residual_limit=1.0)
    batch = Simulation(n, config)
    batch.reset(np.arange(n), [capsule.M] * n, mu.tolist(), states)

    batch.step(actions)

    motion = step(*states.T, actions, capsule.plant()._replace(mu=mu), h)
    for name in SHOWN:
        assert batch.row(getattr(Row, name)).tobytes() == getattr(motion, name).tobytes(), name
    assert batch.row(Row.energy).tobytes() == (np.abs(actions) * motion.swept).tobytes()
    assert np.count_nonzero(motion.events == 1.0) > 100
    assert np.count_nonzero(motion.x_dot == 0.0) > 20
    assert np.count_nonzero(motion.normal_force == 0.0) > 20


def test_a_load_at_the_limit_to_the_last_bit_neither_hangs_nor_chatters():
    rng = np.random.default_rng(43)
    n = 20_000
    nearly = 1.0 + np.array([0.0, 0.0, 2.3e-16, -1.2e-16, 1e-15, -1e-15, 1e-12, -1e-12, 1e-6])
    # With little friction, the load soon passes from one limit to the other, which is the difficult
    # case.
    p = Capsule().plant()._replace(mu=10.0 ** rng.uniform(-5.0, -0.5, n))
    theta = rng.uniform(-1.2, 1.2, n)
    theta_dot = rng.choice([0.0, 1.0], n) * rng.uniform(-6.0, 6.0, n)
    loads = rng.choice([-1.0, 1.0], n) * rng.choice(nearly, n)
    u = torque_for_load(loads, theta, theta_dot, p)
    x_dot = rng.choice([0.0, 5e-324, -5e-324, 1e-17, -1e-17, 1e-12], n)
    h = rng.choice([1e-3, 5e-3], n)

    motion = step(theta, theta_dot, 0.0, x_dot, u, p, h)

    assert motion.events.max() <= 5
    # The step covers its whole duration: a torque off by 1e-9, away from the limit, gives nearly
    # the same motion.
    less, more = (step(theta, theta_dot, 0.0, 0.0, u + off, p, h) for off in (-1e-9, 1e-9))
    below = np.abs(np.subtract(motion[:4], less[:4])).max(axis=0)
    above = np.abs(np.subtract(motion[:4], more[:4])).max(axis=0)
    assert np.minimum(below, above).max() < 1e-6
    assert (np.abs(motion.theta - theta - h * theta_dot) < 400.0 * h**2).all()
    turning = np.abs(theta_dot) > 1.0
    assert (motion.swept[turning] > 0.3 * h[turning]).all()


def test_friction_never_pushes_a_platform_that_has_lost_contact():
    p = Capsule(mu=0.3, k=0.0, c=0.0).plant()
    theta_dot, x_dot = (each.ravel() for each in np.meshgrid([18.0, -18.0], [2.0, -2.0]))
    state = (-np.copysign(0.4, theta_dot), theta_dot, np.zeros(4), x_dot)
    first_energy = energy(state, p)
    first_momentum = momentum(state, p)
    flights = np.zeros(4)
    landed = np.zeros(4, np.bool_)
    for _ in range(2500):
        motion = step(*state, 0.0, p, 1e-4)
        assert (energy(motion[:4], p) - energy(state, p) < 1e-10).all()
        # Contact has been lost until the start of this step; within the step, it may come back.
        flies = (motion.normal_force == 0.0) & ~landed
        drift = (momentum(state, p) - first_momentum)[flies]
        np.testing.assert_allclose(drift, 0.0, atol=1e-10)
        np.testing.assert_allclose(energy(state, p)[flies], first_energy[flies], rtol=1e-10)
        flights += flies
        landed |= (motion.normal_force > 0.0) & (flights > 0)
        state = motion[:4]
    assert landed.all()
    assert (flights > 200).all()
    # Once contact is back, friction dissipates energy.
    assert (energy(state, p) < first_energy - 1e-3).all()


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
        p = Capsule(mu=mu, **others).plant()
        torques = random_torque(amplitude, 30, hold=hold, seconds=9.6)
        expected = solve(torques, p, hold)
        assert expected.events >= 24
        errors = []
        for steps in (3, 24):  # 8 ms and 1 ms
            result = run(torques, p, hold, steps)
            assert result.events >= 24
            errors.append(np.abs(result.states - expected.states).max())
        orders.append(math.log2(errors[0] / errors[1]) / 3)
    assert min(orders) >= 3.5, orders
