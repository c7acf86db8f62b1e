"""The paper's profiles and laws: closure, continuity, error dynamics, adaptation, and what the policies reach."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

import baselines
from baselines.laws.adaptive import adaptive, compliant, eta_of, nominal_estimates
from baselines.laws.adaptive_terms import MEMORY
from baselines.laws.feedback_linearisation import feedback_linearising
from baselines.laws.gains import COMPLIANT, K_P, K_V, PUBLISHED, REGULARISED, UNREGULARISED
from baselines.laws.profiles import EPC, PROPOSED, seven_phases, six_phases
from baselines.laws.reference import COLUMNS, reference_table
from baselines.policies import SCRIPTED
from capsule_gym import CapsuleEnv, CapsuleVectorEnv, dynamics
from capsule_gym.controller import find_controller
from capsule_gym.layout import ROWS
from capsule_gym.parameters import NOMINAL

NO_ACTION = np.zeros(1, np.float32)


@pytest.mark.parametrize("profile", [PROPOSED, EPC])
def test_profile_closes_and_starts_at_rest(profile):
    angle, velocity, _ = profile.evaluate(np.array([0.0, profile.period - 1e-12, 3 * profile.period]))
    np.testing.assert_allclose(angle, -math.pi / 3, atol=1e-9)
    np.testing.assert_allclose(velocity, 0.0, atol=1e-9)


@pytest.mark.parametrize("profile", [PROPOSED, EPC])
def test_profile_is_continuous_in_angle_and_velocity(profile):
    edges = profile.times
    before, after = profile.evaluate(edges - 1e-9), profile.evaluate(edges + 1e-9)
    np.testing.assert_allclose(before[0], after[0], atol=1e-7)
    np.testing.assert_allclose(before[1], after[1], atol=1e-6)


@pytest.mark.parametrize("profile", [PROPOSED, EPC])
def test_profile_derivatives_are_those_of_the_angle(profile):
    t = np.linspace(0.0, profile.period, 997)
    t = t[np.abs(t[:, None] - np.array([0.0, *profile.times])).min(axis=1) > 1e-3]
    h = 1e-5
    angle, velocity, acceleration = profile.evaluate(t)
    ahead, behind = profile.evaluate(t + h), profile.evaluate(t - h)
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * h), velocity, atol=2e-6)
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * h), acceleration, atol=2e-5)
    assert angle[0] + quad(lambda s: profile.evaluate(np.array([s]))[1][0], t[0], t[20])[0] == pytest.approx(angle[20])


def test_profiles_have_the_published_swing_and_peak():
    # Calibrated with three to four digits, so the last one given may be off by one.
    assert math.degrees(PROPOSED.peak_to_peak) - 60.0 == pytest.approx(68.75, abs=0.01)
    assert math.degrees(EPC.peak_to_peak) - 60.0 == pytest.approx(85.85, abs=0.01)
    assert PROPOSED.evaluate(np.array([0.15]))[1][0] == 7.8
    assert EPC.evaluate(np.array([0.1]))[1][0] == pytest.approx(11.0)
    assert PROPOSED.restoring_speed == pytest.approx(0.459, abs=5e-4)
    assert EPC.restoring_speed == pytest.approx(0.504, abs=5e-4)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: seven_phases((0.1, 0.2), 7.8, 2.1), "t1 to t7"),
        (lambda: seven_phases((0.2, 0.1, 0.3, 0.9, 1.7, 5.8, 6.6), 7.8, 2.1), "must grow"),
        (lambda: seven_phases((0.1, 0.2, 0.3, 0.9, 1.7, 5.8, 6.6), 2.0, 2.1), "P2 must lie"),
        (lambda: six_phases((0.1, 0.33, 0.9, 1.4, 5.8, math.nan), 11.0, 1.4), "times must be"),
        (lambda: adaptive(K1=-1.0), "K1 must be"),
        (lambda: adaptive(beta=0.0), "beta must be"),
        (lambda: adaptive(beta=math.nan), "beta must be"),
        (lambda: adaptive(n=0), "n must be"),
        (lambda: adaptive(eta_0=0.0), "eta_0 must be"),
        (lambda: adaptive(eta_0=10.1), "eta_0 must be a number > 0 and <= 10, got 10.1"),
        (lambda: adaptive(dt=0.0), "dt must be"),
        (lambda: adaptive(dt=7e-4), "multiple"),
        (lambda: feedback_linearising(K_p=math.nan), "K_p must be"),
        (lambda: adaptive(seven_phases((0.1, 0.2, 0.3, 0.9, 1.7, 5.8, 6.60005), 7.8, 2.1)), "multiple"),
    ],
)
def test_bad_profiles_and_gains_are_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_reference_platform_obeys_the_second_row():
    table = dict(zip(COLUMNS, reference_table(PROPOSED, NOMINAL.plant()).T, strict=True))
    p = NOMINAL.plant()
    moving = np.flatnonzero(table["x_d_dot"] != 0.0)
    assert 0 < len(moving) < 0.5 * len(table["x_d"])
    for n in moving[2:-2:7]:
        state = (table["theta_d"][n], table["theta_d_dot"][n], table["theta_d_ddot"][n])
        friction = math.copysign(p.mu * dynamics.normal_force(*state, p), table["x_d_dot"][n])
        residual = (p.M + p.m) * table["x_d_ddot"][n] - dynamics.driving_force(*state, p) + friction
        # The columns are taken half a fine step apart.
        assert abs(residual) < 0.02
    # Between its edges the integrated columns belong together, to the second order of the fine step.
    np.testing.assert_allclose(np.gradient(table["x_d"], 1e-3)[300:850], table["x_d_dot"][300:850], atol=1e-4)
    assert table["cycle_start"].tolist() == [1.0] + [0.0] * (len(table["x_d"]) - 1)


@pytest.mark.parametrize(("theta", "theta_dot", "x_dot"), [(0.3, 1.0, 0.2), (-0.9, 3.0, -0.1), (0.5, 0.01, 0.0)])
def test_feedback_linearisation_gives_the_commanded_acceleration(theta, theta_dot, x_dot):
    K_p, K_v = 90.0, 17.0
    controller = feedback_linearising(K_p=K_p, K_v=K_v)
    p = NOMINAL.plant()
    row = tuple(controller.reference[200].tolist())
    torque, _ = controller.law(theta, theta_dot, 0.0, x_dot, controller.memory, row)
    commanded = row[2] - K_v * (theta_dot - row[1]) - K_p * (theta - row[0])
    slip = dynamics.contact_phase(theta, theta_dot, x_dot, torque, p)
    acceleration = dynamics.accelerations(theta, theta_dot, slip, torque, p)[0]
    assert acceleration == pytest.approx(commanded, rel=1e-12)


def test_error_dynamics_follow_their_closed_form():
    # Eq. (36): a double pole at -20 rad/s, e(t) = (e0 + 20 e0 t) exp(-20 t) from rest. The torque is held for 1 ms, so
    # the acceleration lags by half of that: an offset of jerk / 2 ms / K_p, with the jerk of phase I.
    offset = 7.8 * (math.pi / (2 * 0.133)) ** 2 * 0.5e-3 / 400.0
    env = CapsuleEnv(controller=feedback_linearising(), randomization="none", control_dt=0.001, physics_dt=0.001)
    e0 = 0.05
    env.reset(seed=0, options={"state": [-math.pi / 3 + e0, 0.0, 0.0, 0.0]})
    reference = env.simulation.reference
    for n in range(1, 250):
        _, _, _, _, info = env.step(NO_ACTION)
        t = n * 1e-3
        error = info["state"][0] - reference[n, 0]
        assert error == pytest.approx(e0 * (1 + 20 * t) * math.exp(-20 * t), abs=1.2 * offset)


def test_adaptation_freezes_at_zero_error():
    controller = adaptive()
    row = list(controller.reference[500].tolist())
    x = 0.7
    memory = list(controller.memory)
    memory[MEMORY.index("x_anchor")] = x - row[3]
    _, after = controller.law(row[0], row[1], x, row[4], tuple(memory), tuple(row))
    np.testing.assert_allclose(after, memory, rtol=1e-15, atol=1e-15)


def test_at_zero_error_the_adaptive_law_is_the_inverse_dynamics():
    controller = adaptive()
    p = NOMINAL.plant()
    row = controller.reference[250].tolist()
    assert row[4] > 0.0
    torque, _ = controller.law(row[0], row[1], row[3], row[4], controller.memory, tuple(row))
    theta_ddot, x_ddot, _ = dynamics.accelerations(row[0], row[1], 1.0, torque, p)
    assert theta_ddot == pytest.approx(row[2], rel=2e-3)
    assert x_ddot == pytest.approx(row[5], rel=2e-2)


def test_adaptation_law_is_the_gradient():
    # Eq. (39e): the estimates move along -Gamma Y delta, and (39b) is affine in them with slope Y.
    controller = adaptive(K2=0.0, K3=0.0, Gamma_2=0.0)
    row = tuple(controller.reference[150].tolist())
    state = (row[0] + 0.01, row[1] - 0.2, row[3], row[4])
    delta = -0.2 + 12.0 * 0.01
    memory = list(controller.memory)
    memory[MEMORY.index("eta_root")] = 0.0
    torque, after = controller.law(*state, tuple(memory), row)
    for j in range(5):
        moved = list(memory)
        moved[j] += 1e-6
        # eta = 0 and K3 = 0 leave the load term of (39c); its weight does not depend on alpha_theta.
        slope = (controller.law(*state, tuple(moved), row)[0] - torque) / 1e-6
        assert (after[j] - memory[j]) / 1e-3 == pytest.approx(-0.1 * slope * delta, rel=1e-5)


def test_estimates_stay_within_their_range():
    env = CapsuleEnv(controller="baselines:adaptive", residual_limit=3.0)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    nominal = dict(zip(MEMORY, nominal_estimates(NOMINAL.plant()), strict=False))
    for _ in range(600):
        _, _, terminated, _, _ = env.step(rng.uniform(-1, 1, 1).astype(np.float32))
        cells = env.simulation.world[0, ROWS : ROWS + len(MEMORY), 0]
        memory = dict(zip(MEMORY, cells.tolist(), strict=True))
        for name, value in nominal.items():
            assert 0.499 * value <= memory[name] <= 1.501 * value
        assert 0.0 <= eta_of(cells) <= 10.0 * (1.0 + 1e-15)
        if terminated:
            env.reset()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: adaptive(n=1.5), "n must be an integer"),
        (lambda: adaptive(beta="1"), "beta must be"),
        (lambda: adaptive(eta_0=True), "eta_0 must be"),
        (lambda: adaptive(dt=None), "dt must be"),
        (lambda: adaptive(regularised=1), "regularised must be True or False, got 1"),
    ],
)
def test_arguments_of_a_wrong_type_are_named(make, message):
    with pytest.raises(TypeError, match=message):
        make()


@pytest.mark.parametrize("regularised", [True, False])
def test_eta_starts_where_it_is_told_to(regularised):
    for n, eta_0 in ((1, 0.1), (2, 0.3), (3, 5.0)):
        controller = adaptive(regularised=regularised, n=n, eta_0=eta_0)
        assert eta_of(np.array(controller.memory), n) == pytest.approx(eta_0)
    assert eta_of(np.array(adaptive(regularised=regularised).memory)) == 1.0


def test_choices_enter_where_the_paper_has_them():
    # Off the reference by the same amount: a larger beta weakens the last two terms of (39c), a larger eta the first.
    def torque(**choices):
        controller = adaptive(regularised=False, **choices)
        row = tuple(controller.reference[250].tolist())
        return controller.law(row[0] + 0.05, row[1], row[3] + 0.02, row[4], controller.memory, row)[0]

    feedback = {beta: torque(beta=beta) for beta in (0.01, 1.0, 100.0)}
    assert feedback[0.01] < feedback[1.0] < feedback[100.0]
    assert torque(eta_0=3.0) < torque(eta_0=1.0)
    # With eta = 1 its power does not matter at the first call.
    assert torque(n=3) == torque(n=1)


def test_law_integrates_with_its_own_period():
    slow, fast = adaptive(), adaptive(dt=2e-4)
    assert (slow.dt, fast.dt) == (1e-3, 2e-4)
    assert len(fast.reference) == 5 * len(slow.reference)
    row = tuple(slow.reference[150].tolist())
    state = (row[0] + 0.01, row[1] - 0.2, row[3] + 0.01, row[4])
    moved = [np.subtract(law.law(*state, law.memory, row)[1], law.memory)[:10] for law in (slow, fast)]
    np.testing.assert_allclose(moved[0], 5.0 * moved[1], rtol=1e-6, atol=1e-15)
    assert (moved[1][:9] != 0.0).all()


def test_reference_is_the_same_motion_at_every_rate():
    plant = NOMINAL.plant()
    coarse, fine = reference_table(PROPOSED, plant), reference_table(PROPOSED, plant, 2e-4)[::5]
    # theta_d'' jumps at the edges of the phases, where a rounding of the time decides.
    columns = [i for i, name in enumerate(COLUMNS) if not name.endswith("ddot")]
    np.testing.assert_allclose(coarse[:, columns], fine[:, columns], atol=1e-9)


def test_compliant_law_gives_way():
    stiff, soft = adaptive(), compliant()
    row = tuple(stiff.reference[150].tolist())

    def stiffness(controller):
        on, off = (controller.law(row[0] + e, row[1], row[3], row[4], controller.memory, row)[0] for e in (0.0, 1e-6))
        return (on - off) / 1e-6

    # The feed-forward moves with theta in both alike; what is left is K1 Lambda_theta.
    assert stiffness(stiff) - stiffness(soft) == pytest.approx(15.6 - 0.2, rel=1e-6)


@pytest.mark.parametrize("name", ["feedback-linearising", "adaptive", "compliant", "epc", "adaptive-as-published"])
def test_controllers_are_found_by_import_string(name):
    string = SCRIPTED[name].env_kwargs["controller"]
    assert find_controller(string).name in (name, "feedback-linearising")
    assert hasattr(baselines, string.partition(":")[2])


def run(policy, M, mu, **kwargs):
    """Metrics and largest tracking error of a scripted policy on some plants over 33 s."""
    env = CapsuleVectorEnv(len(M), **policy.env_kwargs, **kwargs)
    observations, _ = env.reset(seed=0, options={"M": np.array(M), "mu": np.array(mu)})
    act = policy.start(range(len(M)))
    error = 0.0
    for _ in range(1650):
        observations = env.step(act(observations))[0]
        if env.simulation.controller:
            error = max(error, float(np.abs(observations[:, 0] - observations[:, 5]).max()))
    return env.episode_metrics(), error


def test_adaptive_law_tracks_over_the_whole_range_of_the_paper():
    M, mu = zip(*[(M, mu) for M in (0.45, 0.5, 0.55) for mu in (0.009, 0.01, 0.011)], strict=True)
    metrics, error = run(SCRIPTED["adaptive"], M, mu)
    assert error < 1e-3
    assert metrics["failed"].sum() == 0.0
    assert metrics["peak_torque"].max() < 1.31


def test_tracking_does_not_depend_on_the_physics_step():
    # The prediction of the nominal speed is physics: refining the integrator tenfold moves it by less than 1e-6.
    coarse, fine = (run(SCRIPTED["adaptive"], [0.5], [0.01], physics_dt=dt)[0] for dt in (1e-3, 1e-4))
    assert coarse["mean_speed"][0] == pytest.approx(fine["mean_speed"][0], rel=1e-6)
    # Exact tracking, by an integration of the platform alone.
    exact = 100.0 * reference_table(PROPOSED, NOMINAL.plant())[-1, 3] / 6.6
    assert coarse["mean_speed"][0] == pytest.approx(exact, rel=2e-3)


def test_zero_and_random_policies():
    zero, _ = run(SCRIPTED["zero"], [0.5], [0.01])
    assert zero["distance"][0] == 0.0 and zero["energy"][0] == 0.0
    act = SCRIPTED["random"].start([3, 4])
    again = SCRIPTED["random"].start([4])
    assert act(np.zeros((2, 5)))[1] == again(np.zeros((1, 5)))[0]


def test_page_prints_the_constants_of_the_laws():
    page = (Path(__file__).resolve().parents[3] / "docs" / "controllers.md").read_text(encoding="utf-8")
    cells = [[cell.strip() for cell in line.split("|")[1:4]] for line in page.splitlines() if line.startswith("| `")]

    def shown(value):
        return str(value) if isinstance(value, bool) else f"{value:g}"

    for pair in ((PUBLISHED, COMPLIANT), (REGULARISED, UNREGULARISED)):
        for name, *values in zip(pair[0]._fields, *pair, strict=True):
            assert [f"`{name}`", *map(shown, values)] in cells
    assert f"`K_p` = {K_P:g} 1/s²" in page and f"`K_v` = {K_V:g} 1/s" in page
