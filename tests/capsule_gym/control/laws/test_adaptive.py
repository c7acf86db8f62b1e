"""The adaptive law (37) to (39): every term compared with the paper's equations and the plant's."""

import math
import re

import numpy as np
import pytest

from capsule_gym import Capsule, dynamics
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.laws.adaptive import (
    MEMORY as NAMES,
)
from capsule_gym.control.laws.adaptive import (
    adaptive,
    constants_of,
    eta_of,
    nominal_estimates,
    sliding_variables,
)
from capsule_gym.control.laws.gains import PUBLISHED, REGULARISED, UNREGULARISED, Gains
from capsule_gym.control.laws.profiles import COLUMNS, PROPOSED, reference_table
from capsule_gym.parameters import NOMINAL
from tests import ROOT

# All values differ, so that no gain can be confused with another.
GAINS = Gains(Lambda_theta=11.0, Lambda_x=7.0, K1=1.7, K2=3.0, K3=13.0, Gamma_1=0.19, Gamma_2=0.23)
FORMS = {"regularised": REGULARISED, "unregularised": UNREGULARISED}


# Cells of the memory.
ESTIMATES, ETA_ROOT, ANCHOR = slice(9), 9, 10


def test_the_gains_are_those_that_the_documentation_quotes_from_the_paper():
    page = (ROOT / "docs" / "controllers.md").read_text(encoding="utf-8")
    _, _, table = page.partition("|gain|value|unit|")
    quoted = dict(re.findall(r"^\|`(\w+)`\|([\d.]+)\|", table.partition("\n\n")[0], re.MULTILINE))
    assert {name: float(value) for name, value in quoted.items()} == PUBLISHED._asdict()


def some_constants(choices=REGULARISED, *, contact="newton", dt=1e-3, **changes):
    """A nominal plant, and the law's constants with some of the choices changed."""
    plant = Capsule(M=0.47, mu=0.013, normal_force=contact).plant()
    choices = choices._replace(**changes)
    return plant, constants_of(GAINS, choices, plant, reference_table(PROPOSED, plant), dt)


def draw(rng, *, n=1):
    """A random call: state, memory and reference, without terms small enough to hide an error."""
    theta, theta_dot, x = (rng.uniform(-1.0, 1.0, 3) * [1.2, 5.0, 0.2]).tolist()
    x_dot = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.4)
    root = rng.uniform(0.2, 3.0) ** (1.0 / (2 * n + 1))
    reference = (rng.uniform(-1.0, 1.0, 6) * [1.0, 4.0, 4.0, 0.3, 0.3, 3.0]).tolist()
    estimates = rng.uniform(0.1, 1.0, 9).tolist()
    memory = (*estimates, root, rng.uniform(-0.1, 0.1))
    return (theta, theta_dot, x, x_dot), memory, (*reference, 0.0)


def printed(state, memory, reference, p, choices):
    """The torque and the rates of the estimates and the root of eta: (37) to (39) in matrices,
    corrected."""
    n, width = choices.n, choices.saturation_width
    root = memory[ETA_ROOT]
    eta = root ** (2 * n + 1)
    alpha_theta, alpha_x = np.array(memory[:5]), np.array(memory[5:9])
    theta, theta_dot, x, x_dot = state
    theta_d, theta_d_dot, theta_d_ddot, x_d, x_d_dot, x_d_ddot, _ = reference
    q, q_dot = np.array([theta, x]), np.array([theta_dot, x_dot])
    q_d = np.array([theta_d, memory[ANCHOR] + x_d])
    q_d_dot = np.array([theta_d_dot, x_d_dot])
    q_d_ddot = np.array([theta_d_ddot, x_d_ddot])
    # Eq. (37)
    Lambda = np.diag([GAINS.Lambda_theta, GAINS.Lambda_x])
    rho = q_d_dot - Lambda @ (q - q_d)
    rho_dot = q_d_ddot - Lambda @ (q_dot - q_d_dot)
    d, dx = q_dot - rho
    # Eq. (38)
    s, c = math.sin(theta), math.cos(theta)
    spring = p.pivot_torque_on_contact * (p.k * theta + p.c * theta_dot) * s
    pendulum = p.m * p.l * (theta_d_ddot * s + theta_dot**2 * c)
    N = max(0.0, (p.M + p.m) * p.g - pendulum - spring)
    Y_theta = np.array([rho_dot[0], -c * rho_dot[1], theta, theta_dot, -s])
    Y_x = np.array([-c * rho_dot[0], rho_dot[1], N * np.sign(x_dot), s * theta_dot * rho[0]])
    # Eq. (39)
    w = dx * (Y_x @ alpha_x)
    denominator = d**2 + choices.beta
    sgn = np.sign(d) if width == 0.0 else np.clip(d / width, -1.0, 1.0)
    torque = Y_theta @ alpha_theta - GAINS.K1 * d
    torque -= sgn * abs(dx) * abs(eta) + GAINS.K2 * sgn * abs(dx)
    torque -= (eta + 1.0) * d * dx * GAINS.K3 * dx / denominator
    torque -= (eta - 1.0) * d * abs(w) / denominator
    alpha_dot = np.concatenate([-GAINS.Gamma_1 * Y_theta * d, -GAINS.Gamma_2 * Y_x * dx])
    growth = d**2 / denominator * (GAINS.K3 * dx**2 + abs(w))
    eta_dot = eta ** ((2 * n + 2) / (2 * n + 1)) * growth
    # r = eta^(1 / (2n + 1)), hence r' = eta' / ((2n + 1) r^(2n)).
    root_rate = eta_dot / ((2 * n + 1) * root ** (2 * n))
    return torque, alpha_dot, root_rate


def special(case, state, memory, reference):
    """The random call, changed so that it checks this case."""
    theta, theta_dot, x, x_dot = state
    theta_d, theta_d_dot, *_ = reference
    if case == "negative eta":
        # (39c) takes the absolute value of eta.
        memory = (*memory[:ETA_ROOT], -memory[ETA_ROOT], memory[ANCHOR])
    elif case == "ramp of the saturation":
        # delta_theta = -0.1 rad/s
        theta_dot = theta_d_dot - GAINS.Lambda_theta * (theta - theta_d) - 0.1
    elif case == "stick":
        # No friction.
        x_dot = 0.0
    elif case == "lost contact":
        # The floor never pulls.
        theta, theta_dot = 0.1 * theta, 20.0
    elif case == "on the reference":
        # sgn(0) = 0
        theta, theta_dot = theta_d, theta_d_dot
    return (theta, theta_dot, x, x_dot), memory


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("contact", ["newton", "paper"])
@pytest.mark.parametrize(
    "case",
    ["any", "negative eta", "ramp of the saturation", "stick", "lost contact", "on the reference"],
)
def test_every_term_and_the_euler_step_are_the_papers(case, form, n, contact):
    # The estimates are free and the bound is far away, so nothing is clamped.
    choices = FORMS[form]._replace(n=n, beta=0.7, estimate_range=math.inf, eta_bound=1e6)
    dt = 2e-4
    plant, constants = some_constants(choices, contact=contact, dt=dt)
    law = CoreLaw("adaptive", **constants)
    rng = np.random.default_rng(n)
    for _ in range(6):
        state, memory, reference = draw(rng, n=n)
        state, memory = special(case, state, memory, reference)
        torque, after = law(*state, memory, reference)
        expected, alpha_dot, root_rate = printed(state, memory, reference, plant, choices)
        assert torque == pytest.approx(expected, rel=1e-10)
        rates = np.subtract(after, memory) / dt
        np.testing.assert_allclose(rates[ESTIMATES], alpha_dot, rtol=1e-7, atol=1e-9)
        # A negative eta is clamped.
        if case != "negative eta":
            assert rates[ETA_ROOT] == pytest.approx(root_rate, rel=1e-7)
        assert rates[ANCHOR] == 0.0


@pytest.mark.parametrize("contact", ["newton", "paper"])
def test_error_dynamics_are_those_of_the_plant(contact):
    # Eq. (38), M delta' + C delta = [T, 0] - [Y_theta alpha_theta, Y_x alpha_x], with the plant's
    # own accelerations and normal force, determines every sign and factor of the regressors, which
    # a step of 1 s shows.
    p, constants = some_constants(contact=contact, dt=1.0, estimate_range=math.inf)
    law = CoreLaw("adaptive", **constants)
    nominal = nominal_estimates(p)
    alpha_theta, alpha_x = nominal[:5], nominal[5:]
    rng = np.random.default_rng(11)
    checked = 0
    for _ in range(200):
        state, memory, reference = draw(rng)
        theta, theta_dot, _, x_dot = state
        torque = rng.uniform(-1.0, 1.0)
        slip = math.copysign(1.0, x_dot)
        theta_ddot, x_ddot, normal = dynamics.accelerations(
            theta, theta_dot, x_dot, slip, torque, p
        )
        if normal <= 0.0:
            continue
        checked += 1
        theta_d, theta_d_dot, _, x_d, x_d_dot, x_d_ddot, _ = reference
        # The law uses theta_d'' in place of theta'' in N. If both are equal, its N is the plant's.
        reference = (theta_d, theta_d_dot, theta_ddot, x_d, x_d_dot, x_d_ddot, 0.0)
        _, after = law(*state, memory, reference)
        delta_theta, delta_x = sliding_variables(state, memory[ANCHOR], reference, GAINS)
        change = np.subtract(memory, after)
        Y_theta = change[:5] / (GAINS.Gamma_1 * delta_theta)
        Y_x = change[5:9] / (GAINS.Gamma_2 * delta_x)
        delta_theta_dot = GAINS.Lambda_theta * (theta_dot - theta_d_dot)
        delta_x_dot = x_ddot - x_d_ddot + GAINS.Lambda_x * (x_dot - x_d_dot)
        ml = p.m * p.l
        coupling = ml * math.cos(theta)
        coriolis = ml * math.sin(theta) * theta_dot * delta_theta
        pendulum = ml * p.l * delta_theta_dot - coupling * delta_x_dot
        platform = (p.M + p.m) * delta_x_dot - coupling * delta_theta_dot + coriolis
        expected = torque - np.dot(Y_theta, alpha_theta)
        np.testing.assert_allclose(pendulum, expected, rtol=1e-9, atol=1e-10)
        np.testing.assert_allclose(platform, -np.dot(Y_x, alpha_x), rtol=1e-9, atol=1e-10)
    assert checked > 100


@pytest.mark.parametrize(("factor", "bound"), [(1e3, 1.5), (-1e3, 0.5)])
def test_memory_stays_within_its_bounds(factor, bound):
    plant, constants = some_constants(beta=0.7)
    nominal = np.array(nominal_estimates(plant))
    law = CoreLaw("adaptive", **constants)
    state, _, reference = draw(np.random.default_rng(4))
    far = (factor * nominal).tolist()
    _, after = law(*state, (*far, 50.0, 0.0), reference)
    np.testing.assert_allclose(after[ESTIMATES], bound * nominal, rtol=1e-14)
    assert eta_of(np.array(after), 1) == pytest.approx(REGULARISED.eta_bound)


@pytest.mark.parametrize("form", FORMS)
def test_x_d_starts_anew_or_goes_on_at_the_start_of_a_cycle(form):
    _, constants = some_constants(FORMS[form])
    law = CoreLaw("adaptive", **constants)
    state, memory, reference = draw(np.random.default_rng(6))
    *columns, _ = reference
    start = memory[ANCHOR] + constants["cycle_advance"] if form == "unregularised" else state[2]
    torque, after = law(*state, memory, (*columns, 1.0))
    assert after[ANCHOR] == start
    # The same call already uses the new start.
    assert (torque, after) == law(*state, (*memory[:ANCHOR], start), reference)


def test_x_d_goes_on_by_its_last_value():
    plant, constants = some_constants()
    table = reference_table(PROPOSED, plant)
    assert constants["cycle_advance"] == table[-1, COLUMNS.index("x_d")]
    assert constants["cycle_advance"] > 0.0


def test_plant_without_friction_or_spring_has_bounds_too():
    # Zero times infinity is not a valid bound: a free estimate stays free if its constant is 0 on
    # the nominal plant.
    plant = Capsule(mu=0.0, k=0.0).plant()
    constants = constants_of(GAINS, UNREGULARISED, plant, reference_table(PROPOSED, plant), 1e-3)
    law = CoreLaw("adaptive", **constants)
    state, memory, reference = draw(np.random.default_rng(8))
    _, after = law(*state, memory, reference)
    assert np.isfinite(after).all()
    for estimate in (NAMES.index("alpha_theta_3"), NAMES.index("alpha_x_3")):
        assert after[estimate] != memory[estimate]


@pytest.mark.parametrize(("form", "beta"), [("regularised", 1.0), ("unregularised", 0.01)])
def test_the_defaults_are_the_documented_ones(form, beta):
    regularised = form == "regularised"
    given = adaptive(regularised=regularised, beta=beta, n=1, eta_0=1.0)
    default = adaptive(regularised=regularised)
    assert given.law == default.law
    assert given.memory == default.memory


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(("dt", "given"), [(1e-3, {}), (2e-4, {"beta": 3.0, "n": 2, "eta_0": 0.3})])
def test_choices_reach_the_law(form, dt, given):
    controller = adaptive(regularised=form == "regularised", dt=dt, **given)
    choices = FORMS[form]._replace(**given)
    constants = constants_of(PUBLISHED, choices, NOMINAL.plant(), controller.reference, dt)
    assert controller.law == CoreLaw("adaptive", **constants)
    assert controller.dt == dt
    assert eta_of(np.array(controller.memory), choices.n) == pytest.approx(choices.eta_0)


@pytest.mark.parametrize("n", [-1e300, 1e300, math.inf])
def test_any_number_is_an_exponent_of_the_core(n):
    _, constants = some_constants()
    state, memory, reference = draw(np.random.default_rng(0))
    law = CoreLaw("adaptive", **(constants | {"n": n}))
    torque, _ = law(*state, memory, reference)
    assert math.isfinite(torque)
