"""The adaptive law (37) to (39): every term compared with the paper's equations and the plant's,
and tracking."""

import math

import numpy as np
import pytest

from capsule_gym import Capsule, dynamics
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.laws.adaptive import (
    MEMORY,
    adaptive,
    constants_of,
    eta_of,
    nominal_estimates,
    sliding_variables,
)
from capsule_gym.control.laws.gains import PUBLISHED, REGULARISED, UNREGULARISED, Gains
from capsule_gym.control.laws.profiles import COLUMNS, PROPOSED, reference_table
from capsule_gym.parameters import NOMINAL

# All values differ, so that no gain can be confused with another.
GAINS = Gains(Lambda_theta=11.0, Lambda_x=7.0, K1=1.7, K2=3.0, K3=13.0, Gamma_1=0.19, Gamma_2=0.23)
FORMS = {"regularised": REGULARISED, "unregularised": UNREGULARISED}


def some_constants(choices=REGULARISED, *, contact="newton", dt=1e-3, **changes):
    """A nominal plant, and the law's constants with some of the choices changed."""
    plant = Capsule(M=0.47, mu=0.013, normal_force=contact).plant()
    return plant, constants_of(
        GAINS, choices._replace(**changes), plant, reference_table(PROPOSED, plant), dt
    )


def draw(rng, *, n=1):
    """A random call: state, memory and reference, without terms small enough to hide an error."""
    theta, theta_dot, x = (rng.uniform(-1.0, 1.0, 3) * [1.2, 5.0, 0.2]).tolist()
    x_dot = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.4)
    root = rng.uniform(0.2, 3.0) ** (1.0 / (2 * n + 1))
    reference = (*(rng.uniform(-1.0, 1.0, 6) * [1.0, 4.0, 4.0, 0.3, 0.3, 3.0]).tolist(), 0.0)
    return (
        (theta, theta_dot, x, x_dot),
        (*rng.uniform(0.1, 1.0, 9).tolist(), root, rng.uniform(-0.1, 0.1)),
        reference,
    )


def printed(state, memory, reference, p, choices):
    """The torque and the rates of the estimates and the root of eta: (37) to (39) in matrices,
    corrected."""
    gains, width, n = GAINS, choices.saturation_width, choices.n
    q, q_dot = np.array([state[0], state[2]]), np.array([state[1], state[3]])
    q_d, q_d_dot, q_d_ddot = (np.array([reference[i], reference[i + 3]]) for i in range(3))
    q_d = np.array([q_d[0], memory[10] + q_d[1]])
    Lambda = np.diag([gains.Lambda_theta, gains.Lambda_x])
    rho = q_d_dot - Lambda @ (q - q_d)
    rho_dot = q_d_ddot - Lambda @ (q_dot - q_d_dot)
    delta = q_dot - rho
    s, c = math.sin(q[0]), math.cos(q[0])
    spring = p.pivot_torque_on_contact * (p.k * q[0] + p.c * q_dot[0]) * s
    N = max(0.0, (p.M + p.m) * p.g - p.m * p.l * (q_d_ddot[0] * s + q_dot[0] ** 2 * c) - spring)
    Y_theta = np.array([rho_dot[0], -c * rho_dot[1], q[0], q_dot[0], -s])
    Y_x = np.array([-c * rho_dot[0], rho_dot[1], N * np.sign(q_dot[1]), s * q_dot[0] * rho[0]])
    alpha_theta, alpha_x, eta = (
        np.array(memory[:5]),
        np.array(memory[5:9]),
        memory[9] ** (2 * n + 1),
    )
    d, dx = delta
    w = dx * (Y_x @ alpha_x)
    denominator = d**2 + choices.beta
    sgn = np.sign(d) if width == 0.0 else np.clip(d / width, -1.0, 1.0)
    T_c = Y_theta @ alpha_theta - gains.K1 * d
    T_n = -sgn * abs(dx) * abs(eta) - gains.K2 * sgn * abs(dx)
    T_n += (
        -(eta + 1.0) * d * dx * gains.K3 * dx / denominator - (eta - 1.0) * d * abs(w) / denominator
    )
    eta_dot = eta ** ((2 * n + 2) / (2 * n + 1)) * d**2 / denominator * (gains.K3 * dx**2 + abs(w))
    # r = eta^(1 / (2n + 1)), hence r' = eta' / ((2n + 1) r^(2n)).
    root_rate = eta_dot / ((2 * n + 1) * memory[9] ** (2 * n))
    return (
        T_c + T_n,
        np.concatenate([-gains.Gamma_1 * Y_theta * d, -gains.Gamma_2 * Y_x * dx]),
        root_rate,
    )


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("contact", ["newton", "paper"])
def test_every_term_and_the_euler_step_are_the_papers(form, n, contact):
    # The estimates are free and the bound is far away, so nothing is clamped.
    choices = FORMS[form]._replace(n=n, beta=0.7, estimate_range=math.inf, eta_bound=1e6)
    plant, constants = some_constants(choices, contact=contact, dt=2e-4)
    law = CoreLaw("adaptive", **constants)
    rng = np.random.default_rng(n)
    for trial in range(30):
        state, memory, reference = draw(rng, n=n)
        theta, theta_dot, x, _ = state
        if trial % 5 == 0:
            # (39c) takes the absolute value of eta.
            memory = (*memory[:9], -memory[9], memory[10])
        elif trial % 5 == 1:
            # delta_theta = -0.1 rad/s, on the ramp of the saturation.
            theta_dot = reference[1] - GAINS.Lambda_theta * (theta - reference[0]) - 0.1
            state = (theta, theta_dot, *state[2:])
        elif trial % 5 == 2:
            # Stick: no friction.
            state = (theta, theta_dot, x, 0.0)
        elif trial % 5 == 3:
            # The floor never pulls a platform that loses contact.
            state = (0.1 * theta, 20.0, *state[2:])
        elif trial == 4:
            # The state is on the reference: sgn(0) = 0.
            state = (reference[0], reference[1], *state[2:])
        expected, alpha_dot, root_rate = printed(state, memory, reference, plant, choices)
        torque, after = law(*state, memory, reference)
        assert torque == pytest.approx(expected, rel=1e-10)
        np.testing.assert_allclose(
            np.subtract(after[:9], memory[:9]) / 2e-4, alpha_dot, rtol=1e-7, atol=1e-9
        )
        if trial % 5 > 0:
            assert (after[9] - memory[9]) / 2e-4 == pytest.approx(root_rate, rel=1e-7)
        assert after[10] == memory[10]


@pytest.mark.parametrize("contact", ["newton", "paper"])
def test_error_dynamics_are_those_of_the_plant(contact):
    # Eq. (38), M delta' + C delta = [T, 0] - [Y_theta alpha_theta, Y_x alpha_x], with the plant's
    # own accelerations and normal force, determines every sign and factor of the regressors, which
    # a step of 1 s shows.
    p, constants = some_constants(contact=contact, dt=1.0, estimate_range=math.inf)
    law, alpha, rng, checked = (
        CoreLaw("adaptive", **constants),
        nominal_estimates(p),
        np.random.default_rng(11),
        0,
    )
    for _ in range(200):
        state, memory, reference = draw(rng)
        theta, theta_dot, _, x_dot = state
        u = rng.uniform(-1.0, 1.0)
        theta_ddot, x_ddot, normal = dynamics.accelerations(
            theta, theta_dot, x_dot, math.copysign(1.0, x_dot), u, p
        )
        if normal <= 0.0:
            continue
        checked += 1
        # The law uses theta_d'' in place of theta'' in N. If both are equal, its N is the plant's.
        reference = (*reference[:2], theta_ddot, *reference[3:])
        change = np.subtract(memory, law(*state, memory, reference)[1])
        delta_theta, delta_x = sliding_variables(state, memory[-1], reference, GAINS)
        Y_theta, Y_x = (
            change[:5] / (GAINS.Gamma_1 * delta_theta),
            change[5:9] / (GAINS.Gamma_2 * delta_x),
        )
        theta_part = p.m * p.l * GAINS.Lambda_theta * (theta_dot - reference[1])
        x_part = x_ddot - reference[5] + GAINS.Lambda_x * (x_dot - reference[4])
        cosine, sine = math.cos(theta), p.m * p.l * math.sin(theta)
        left = [p.l * theta_part - p.m * p.l * cosine * x_part]
        left += [-cosine * theta_part + (p.M + p.m) * x_part + sine * theta_dot * delta_theta]
        right = [u - np.dot(Y_theta, alpha[:5]), -np.dot(Y_x, alpha[5:])]
        np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-10)
    assert checked > 100


def test_memory_stays_within_its_bounds():
    plant, constants = some_constants(beta=0.7)
    nominal, law = np.array(nominal_estimates(plant)), CoreLaw("adaptive", **constants)
    rng = np.random.default_rng(4)
    for factor, bound in ((1e3, 1.5), (-1e3, 0.5)):
        state, _, reference = draw(rng)
        _, after = law(*state, (*(factor * nominal).tolist(), 50.0, 0.0), reference)
        np.testing.assert_allclose(after[:9], bound * nominal, rtol=1e-14)
        assert eta_of(np.array(after), 1) == pytest.approx(REGULARISED.eta_bound)


@pytest.mark.parametrize(("form", "expected"), [("regularised", "x"), ("unregularised", "anchor")])
def test_x_d_starts_anew_or_goes_on_at_the_start_of_a_cycle(form, expected):
    plant, constants = some_constants(FORMS[form])
    law = CoreLaw("adaptive", **constants)
    state, memory, reference = draw(np.random.default_rng(6))
    begins = (*reference[: COLUMNS.index("cycle_start")], 1.0)
    start = (
        state[2]
        if expected == "x"
        else memory[MEMORY.index("x_anchor")] + constants["cycle_advance"]
    )
    torque, after = law(*state, memory, begins)
    assert after[-1] == start
    # The same call already uses the new start.
    assert (torque, after) == law(*state, (*memory[:-1], start), reference)
    assert (
        constants["cycle_advance"] == pytest.approx(reference_table(PROPOSED, plant)[-1, 3])
        and start != 0.0
    )


def test_plant_without_friction_or_spring_has_bounds_too():
    # Zero times infinity is not a valid bound: a free estimate stays free if its constant is 0 on
    # the nominal plant.
    plant = Capsule(mu=0.0, k=0.0).plant()
    constants = constants_of(GAINS, UNREGULARISED, plant, reference_table(PROPOSED, plant), 1e-3)
    state, memory, reference = draw(np.random.default_rng(8))
    _, after = CoreLaw("adaptive", **constants)(*state, memory, reference)
    assert np.isfinite(after).all() and after[2] != memory[2] and after[7] != memory[7]


@pytest.mark.parametrize("regularised", [True, False])
def test_choices_reach_the_law(regularised):
    default = FORMS["regularised" if regularised else "unregularised"]
    for given in ({}, {"beta": 3.0, "n": 2, "eta_0": 0.3, "dt": 2e-4}):
        controller = adaptive(regularised=regularised, **given)
        choices = default._replace(**{name: value for name, value in given.items() if name != "dt"})
        assert eta_of(np.array(controller.memory), choices.n) == pytest.approx(choices.eta_0)
        constants = constants_of(
            PUBLISHED, choices, NOMINAL.plant(), controller.reference, controller.dt
        )
        assert controller.law == CoreLaw("adaptive", **constants)
