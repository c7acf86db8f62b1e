"""The adaptive law (37) to (39): every term against the paper's equations and the plant's, and what the law reaches."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from baselines.laws.adaptive import adaptive, compliant, constants_of, eta_of, nominal_estimates
from baselines.laws.adaptive_terms import MEMORY, Constants, adaptive_step, adaptive_terms, eta_of_root, saturation
from baselines.laws.gains import COMPLIANT, K_P, K_V, PUBLISHED, REGULARISED, UNREGULARISED, Gains
from baselines.laws.profiles import PROPOSED
from baselines.laws.reference import COLUMNS, reference_table
from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, dynamics
from capsule_gym.layout import ROWS
from capsule_gym.parameters import NOMINAL

# No two are equal, so that none passes for another.
GAINS = Gains(Lambda_theta=11.0, Lambda_x=7.0, K1=1.7, K2=3.0, K3=13.0, Gamma_1=0.19, Gamma_2=0.23)
DT = 1e-3
FORMS = {"regularised": REGULARISED, "unregularised": UNREGULARISED}


def some_constants(choices=REGULARISED, *, contact="newton", dt=DT, **changes) -> Constants:
    """The law's constants on a plant with some of the choices changed."""
    plant = Capsule(M=0.47, mu=0.013, normal_force=contact).plant()
    return constants_of(GAINS, choices._replace(**changes), plant, reference_table(PROPOSED, plant), dt)


def draw(rng, *, x_dot=None, eta=None, n=1):
    """A random call: state, memory and reference, with nothing small that could hide."""
    theta, theta_dot, x = rng.uniform(-1.2, 1.2), rng.uniform(-5.0, 5.0), rng.uniform(-0.2, 0.2)
    x_dot = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.4) if x_dot is None else x_dot
    estimates = rng.uniform(0.1, 1.0, 9)
    root = (rng.uniform(0.2, 3.0) if eta is None else eta) ** (1.0 / (2 * n + 1))
    reference = (
        *rng.uniform(-1.0, 1.0, 1),
        *rng.uniform(-4.0, 4.0, 2),
        *rng.uniform(-0.3, 0.3, 2),
        rng.uniform(-3, 3),
        0.0,
    )
    return (theta, theta_dot, x, x_dot), (*estimates.tolist(), root, rng.uniform(-0.1, 0.1)), reference


def printed(state, memory, reference, constants, n):
    """(37) to (39) as the paper sets them, in matrices, with the corrections of the physics page."""
    p, gains, width = constants.plant, constants.gains, constants.saturation_width
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
    alpha_theta, alpha_x, eta = np.array(memory[:5]), np.array(memory[5:9]), memory[9] ** (2 * n + 1)
    d, dx = delta
    w = dx * (Y_x @ alpha_x)
    denominator = d**2 + constants.beta
    sgn = np.sign(d) if width == 0.0 else np.clip(d / width, -1.0, 1.0)
    T_c = Y_theta @ alpha_theta - gains.K1 * d
    T_n = -sgn * abs(dx) * abs(eta) - gains.K2 * sgn * abs(dx)
    T_n += -(eta + 1.0) * d * dx * gains.K3 * dx / denominator - (eta - 1.0) * d * abs(w) / denominator
    eta_dot = eta ** ((2 * n + 2) / (2 * n + 1)) * d**2 / denominator * (gains.K3 * dx**2 + abs(w))
    alpha_theta_dot, alpha_x_dot = -gains.Gamma_1 * Y_theta * d, -gains.Gamma_2 * Y_x * dx
    return {
        "e_x": q[1] - q_d[1],
        "delta": delta,
        "Y_theta": Y_theta,
        "Y_x": Y_x,
        "T_c": T_c,
        "T_n": T_n,
        "power": w,
        # r = eta^(1 / (2n + 1)), hence r' = eta' / ((2n + 1) r^(2n)).
        "root_rate": eta_dot / ((2 * n + 1) * memory[9] ** (2 * n)),
        "alpha_dot": np.concatenate([alpha_theta_dot, alpha_x_dot]),
    }


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("n", [1, 2, 3])
@pytest.mark.parametrize("contact", ["newton", "paper"])
def test_every_term_and_the_euler_step_are_the_papers(form, n, contact):
    # Free estimates and a bound far away: nothing is clamped.
    wide = {"estimate_range": math.inf, "eta_bound": 1e6}
    constants = some_constants(FORMS[form], n=n, beta=0.7, contact=contact, dt=2e-4, **wide)
    rng = np.random.default_rng(n)
    for trial in range(30):
        state, memory, reference = draw(rng, n=n)
        if trial % 5 == 0:
            # (39c) takes the absolute value of eta.
            memory = (*memory[:9], -memory[9], memory[10])
        terms = adaptive_terms(*state, memory, reference, constants)
        expected = printed(state, memory, reference, constants, n)
        assert terms.e_x == pytest.approx(expected["e_x"], rel=1e-12, abs=1e-15)
        np.testing.assert_allclose([terms.delta_theta, terms.delta_x], expected["delta"], rtol=1e-11)
        np.testing.assert_allclose(terms.Y_theta, expected["Y_theta"], rtol=1e-11, atol=1e-13)
        np.testing.assert_allclose(terms.Y_x, expected["Y_x"], rtol=1e-11, atol=1e-13)
        for name in ("T_c", "T_n", "power"):
            assert getattr(terms, name) == pytest.approx(expected[name], rel=1e-10)
        if memory[9] < 0.0:
            continue
        assert terms.root_rate == pytest.approx(expected["root_rate"], rel=1e-10)
        torque, after = adaptive_step(*state, memory, reference, constants)
        assert torque == pytest.approx(expected["T_c"] + expected["T_n"], rel=1e-10)
        change = np.subtract(after[:9], memory[:9]) / 2e-4
        np.testing.assert_allclose(change, expected["alpha_dot"], rtol=1e-7, atol=1e-9)
        assert (after[9] - memory[9]) / 2e-4 == pytest.approx(expected["root_rate"], rel=1e-7)
        assert after[10] == memory[10]


def test_saturation_has_its_ramp_and_sgn_has_none():
    constants = some_constants(beta=0.7)
    small = 0.2 * constants.saturation_width
    assert saturation(small, constants.saturation_width) == pytest.approx(0.2)
    assert saturation(-7.0, constants.saturation_width) == -1.0
    assert [saturation(value, 0.0) for value in (-1e-9, 0.0, 1e-9)] == [-1.0, 0.0, 1.0]
    # Within the ramp, too, every term is the paper's with the ramp in place of sgn.
    rng = np.random.default_rng(5)
    for sign in (-1.0, 1.0):
        (theta, _, x, x_dot), memory, reference = draw(rng)
        theta_dot = reference[1] - GAINS.Lambda_theta * (theta - reference[0]) + sign * small
        state = (theta, theta_dot, x, x_dot)
        terms, expected = (
            adaptive_terms(*state, memory, reference, constants),
            printed(state, memory, reference, constants, 1),
        )
        assert terms.delta_theta == pytest.approx(sign * small)
        assert terms.T_n == pytest.approx(expected["T_n"], rel=1e-9)


@pytest.mark.parametrize("contact", ["newton", "paper"])
def test_error_dynamics_are_those_of_the_plant(contact):
    # Eq. (38), M delta' + C delta = [T, 0] - [Y_theta alpha_theta, Y_x alpha_x], with the plant's own accelerations
    # and normal force: no sign and no factor of a regressor is free.
    constants = some_constants(contact=contact)
    p = constants.plant
    alpha = np.array(nominal_estimates(p))
    rng = np.random.default_rng(11)
    checked = 0
    for _ in range(200):
        (theta, theta_dot, x, x_dot), memory, reference = draw(rng)
        u = rng.uniform(-1.0, 1.0)
        theta_ddot, x_ddot, normal = dynamics.accelerations(theta, theta_dot, math.copysign(1.0, x_dot), u, p)
        if normal <= 0.0:
            continue
        checked += 1
        # The law puts theta_d'' in place of theta'' in N: with the one equal to the other its N is the plant's.
        reference = (*reference[:2], theta_ddot, *reference[3:])
        terms = adaptive_terms(theta, theta_dot, x, x_dot, memory, reference, constants)
        e_dot, e_x_dot = theta_dot - reference[1], x_dot - reference[4]
        delta_dot = np.array(
            [
                theta_ddot - (theta_ddot - GAINS.Lambda_theta * e_dot),
                x_ddot - (reference[5] - GAINS.Lambda_x * e_x_dot),
            ]
        )
        ml, s, c = p.m * p.l, math.sin(theta), math.cos(theta)
        mass = np.array([[ml * p.l, -ml * c], [-ml * c, p.M + p.m]])
        coriolis = np.array([[0.0, 0.0], [ml * s * theta_dot, 0.0]])
        left = mass @ delta_dot + coriolis @ [terms.delta_theta, terms.delta_x]
        right = np.array([u - np.dot(terms.Y_theta, alpha[:5]), -np.dot(terms.Y_x, alpha[5:])])
        np.testing.assert_allclose(left, right, rtol=1e-9, atol=1e-10)
    assert checked > 100


def test_friction_enters_with_the_sign_of_the_motion_and_not_in_stick():
    constants = some_constants()
    rng = np.random.default_rng(3)
    (theta, theta_dot, x, _), memory, reference = draw(rng)

    def friction(x_dot):
        return adaptive_terms(theta, theta_dot, x, x_dot, memory, reference, constants).Y_x[2]

    # However slow.
    for x_dot in (0.1, 1e-9):
        assert friction(-x_dot) == -friction(x_dot) < 0.0 == friction(0.0)
    # Thrown up hard enough the floor gives nothing, never a pull.
    flying = adaptive_terms(0.0, 20.0, x, 0.1, memory, reference, constants)
    assert flying.Y_x[2] == 0.0


def test_memory_stays_within_its_bounds():
    constants = some_constants(beta=0.7)
    nominal = np.array(nominal_estimates(constants.plant))
    rng = np.random.default_rng(4)
    for factor, bound in ((10.0, 1.5), (0.01, 0.5)):
        state, _, reference = draw(rng)
        _, after = adaptive_step(*state, (*(factor * nominal).tolist(), 50.0, 0.0), reference, constants)
        np.testing.assert_allclose(after[:9], bound * nominal, rtol=1e-14)
        assert eta_of_root(after[9], 1) == pytest.approx(REGULARISED.eta_bound)


@pytest.mark.parametrize(("form", "expected"), [("regularised", "x"), ("unregularised", "anchor")])
def test_x_d_starts_anew_or_goes_on_at_the_start_of_a_cycle(form, expected):
    constants = some_constants(FORMS[form])
    state, memory, reference = draw(np.random.default_rng(6))
    begins = (*reference[: COLUMNS.index("cycle_start")], 1.0)
    start = state[2] if expected == "x" else memory[MEMORY.index("x_anchor")] + constants.cycle_advance
    torque, after = adaptive_step(*state, memory, begins, constants)
    assert after[-1] == start
    # The call itself uses it already.
    terms = adaptive_terms(*state, (*memory[:-1], start), reference, constants)
    assert torque == terms.T_c + terms.T_n
    assert constants.cycle_advance == pytest.approx(reference_table(PROPOSED, constants.plant)[-1, 3]) and start != 0.0


def test_plant_without_friction_or_spring_has_bounds_too():
    # Zero times infinity is no bound: the free estimate of a constant that is 0 on the nominal plant stays free.
    plant = Capsule(mu=0.0, k=0.0).plant()
    constants = constants_of(GAINS, UNREGULARISED, plant, reference_table(PROPOSED, plant), DT)
    state, memory, reference = draw(np.random.default_rng(8))
    _, after = adaptive_step(*state, memory, reference, constants)
    assert np.isfinite(after).all()
    assert after[2] != memory[2] and after[7] != memory[7]


# The controllers


@pytest.mark.parametrize(
    ("error", "make", "message"),
    [
        (ValueError, lambda: adaptive(K1=-1.0), "K1 must be"),
        (ValueError, lambda: adaptive(beta=0.0), "beta must be"),
        (ValueError, lambda: adaptive(beta=math.nan), "beta must be"),
        (ValueError, lambda: adaptive(n=0), "n must be"),
        (ValueError, lambda: adaptive(eta_0=0.0), "eta_0 must be"),
        (ValueError, lambda: adaptive(eta_0=10.1), "eta_0 must be a number > 0 and <= 10, got 10.1"),
        (ValueError, lambda: adaptive(dt=0.0), "dt must be"),
        (ValueError, lambda: adaptive(dt=7e-4), "multiple"),
        (TypeError, lambda: adaptive(n=1.5), "n must be an integer"),
        (TypeError, lambda: adaptive(beta="1"), "beta must be"),
        (TypeError, lambda: adaptive(eta_0=True), "eta_0 must be"),
        (TypeError, lambda: adaptive(dt=None), "dt must be"),
        (TypeError, lambda: adaptive(regularised=1), "regularised must be True or False, got 1"),
    ],
)
def test_invalid_arguments_raise_an_error(error, make, message):
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize("regularised", [True, False])
def test_choices_enter_where_the_paper_has_them(regularised):
    for n, eta_0 in ((1, 0.1), (2, 0.3), (3, 5.0)):
        controller = adaptive(regularised=regularised, n=n, eta_0=eta_0)
        assert eta_of(np.array(controller.memory), n) == pytest.approx(eta_0)
    assert eta_of(np.array(adaptive(regularised=regularised).memory)) == 1.0

    def torque(**choices):
        controller = adaptive(regularised=regularised, **choices)
        row = tuple(controller.reference[250].tolist())
        return controller.law(row[0] + 0.05, row[1], row[3] + 0.02, row[4], controller.memory, row)[0]

    # A larger beta weakens the last two terms of (39c), a larger eta strengthens the first.
    feedback = {beta: torque(beta=beta) for beta in (0.01, 1.0, 100.0)}
    assert feedback[0.01] < feedback[1.0] < feedback[100.0]
    assert torque(eta_0=3.0) < torque(eta_0=1.0)
    # With eta = 1 its power does not matter at the first call.
    assert torque(n=3) == torque(n=1)


def test_at_zero_error_the_law_is_the_inverse_dynamics_and_nothing_adapts():
    controller, p = adaptive(), NOMINAL.plant()
    row = controller.reference[250].tolist()
    assert row[4] > 0.0
    memory = (*controller.memory[:-1], 0.7)
    torque, after = controller.law(row[0], row[1], 0.7 + row[3], row[4], memory, tuple(row))
    np.testing.assert_allclose(after, memory, rtol=1e-15, atol=1e-15)
    theta_ddot, x_ddot, _ = dynamics.accelerations(row[0], row[1], 1.0, torque, p)
    assert theta_ddot == pytest.approx(row[2], rel=2e-3)
    assert x_ddot == pytest.approx(row[5], rel=2e-2)


def test_the_law_integrates_with_its_own_period():
    slow, fast = adaptive(), adaptive(dt=2e-4)
    assert (slow.dt, fast.dt) == (1e-3, 2e-4)
    assert len(fast.reference) == 5 * len(slow.reference)
    row = tuple(slow.reference[150].tolist())
    state = (row[0] + 0.01, row[1] - 0.2, row[3] + 0.01, row[4])
    changes = [np.subtract(law.law(*state, law.memory, row)[1], law.memory)[:10] for law in (slow, fast)]
    np.testing.assert_allclose(changes[0], 5.0 * changes[1], rtol=1e-6, atol=1e-15)
    assert (changes[1][:9] != 0.0).all()


def test_the_compliant_law_has_a_small_stiffness():
    stiff, soft = adaptive(), compliant()
    row = tuple(stiff.reference[150].tolist())

    def stiffness(controller):
        on, off = (controller.law(row[0] + e, row[1], row[3], row[4], controller.memory, row)[0] for e in (0.0, 1e-6))
        return (on - off) / 1e-6

    # The feed-forward changes with theta in both alike; what is left is K1 Lambda_theta.
    assert stiffness(stiff) - stiffness(soft) == pytest.approx(15.6 - 0.2, rel=1e-6)


def test_estimates_and_eta_stay_within_their_bounds():
    env = CapsuleEnv(controller="baselines:adaptive", residual_limit=3.0)
    env.reset(seed=0)
    rng, nominal = np.random.default_rng(0), np.array(nominal_estimates(NOMINAL.plant()))
    for _ in range(600):
        terminated = env.step(rng.uniform(-1, 1, 1).astype(np.float32))[2]
        cells = env.simulation.world[0, ROWS : ROWS + len(MEMORY), 0]
        assert ((0.499 * nominal <= cells[:9]) & (cells[:9] <= 1.501 * nominal)).all()
        assert 0.0 <= eta_of(cells) <= 10.0 * (1.0 + 1e-15)
        if terminated:
            env.reset()


def run(M, mu, **kwargs):
    """Metrics and largest tracking error of the adaptive law on some plants over 33 s."""
    env = CapsuleVectorEnv(len(M), controller="baselines:adaptive", **kwargs)
    env.reset(seed=0, options={"M": np.array(M), "mu": np.array(mu)})
    error = 0.0
    for _ in range(1650):
        observations = env.step(np.zeros((len(M), 1), np.float32))[0]
        error = max(error, float(np.abs(observations[:, 0] - observations[:, 5]).max()))
    return env.episode_metrics(), error


def test_the_law_tracks_over_the_whole_range_of_the_paper():
    M, mu = zip(*[(M, mu) for M in (0.45, 0.5, 0.55) for mu in (0.009, 0.01, 0.011)], strict=True)
    metrics, error = run(M, mu)
    assert error < 1e-3
    assert metrics["failed"].sum() == 0.0
    assert metrics["peak_torque"].max() < 1.31
    # Refining the integrator tenfold changes the nominal speed by less than 1e-6; exact tracking has nearly that speed.
    fine = run([0.5], [0.01], physics_dt=1e-4)[0]["mean_speed"][0]
    assert metrics["mean_speed"][4] == pytest.approx(fine, rel=1e-6)
    assert fine == pytest.approx(100.0 * reference_table(PROPOSED, NOMINAL.plant())[-1, 3] / 6.6, rel=2e-3)


def test_the_page_prints_the_constants_of_the_laws():
    page = (Path(__file__).resolve().parents[3] / "docs" / "controllers.md").read_text(encoding="utf-8")
    cells = [[cell.strip() for cell in line.split("|")[1:4]] for line in page.splitlines() if line.startswith("| `")]
    for pair in ((PUBLISHED, COMPLIANT), (REGULARISED, UNREGULARISED)):
        for name, *values in zip(pair[0]._fields, *pair, strict=True):
            shown = [str(value) if isinstance(value, bool) else f"{value:g}" for value in values]
            assert [f"`{name}`", *shown] in cells
    assert f"`K_p` = {K_P:g} 1/s²" in page and f"`K_v` = {K_V:g} 1/s" in page
