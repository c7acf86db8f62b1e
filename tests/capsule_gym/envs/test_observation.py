"""Estimates of M and mu from slip: accurate for exact physics, uncertain after jumps."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.laws.gait import gait_constants
from capsule_gym.tasks.task import CONTROL_DT
from tests.capsule_gym.envs.actions import random_actions

# Prior of M (kg) and log(mu) with their standard deviations, and the range of the estimates.
PRIOR = (0.55, -3.25, 0.2, 1.5)
LOW = (0.15, -7.0)
HIGH = (2.0, 0.0)
# Standard deviation of a change of x_dot, m/s.
NOISE = 1e-3
# m/s: below this speed the platform may have stuck between two observations.
SLOWEST = 0.02
# Numbers in the memory of the filter.
CELLS = 9
EMPTY = np.zeros(CELLS)


def states(M, mu, seconds=4.0, changes=()):
    """The states under a torque that swings the pendulum, float64: theta, theta_dot, x_dot."""
    env = CapsuleEnv()
    _, info = env.reset(seed=0, options={"M": M, "mu": mu, "changes": list(changes)})
    rows = [info["state"]]
    for step in range(round(seconds / CONTROL_DT)):
        theta, theta_dot = rows[-1][:2]
        push = np.cos(2.0 * np.pi * CONTROL_DT * step / 0.74)
        action = np.clip(0.8 * push - 0.3 * theta - 0.02 * theta_dot, -1.0, 1.0)
        _, _, terminated, _, info = env.step(np.array([action], np.float32))
        assert not terminated
        rows.append(info["state"])
    return np.array(rows)[:, [0, 1, 3]]


def update(observations, memories, dt=CONTROL_DT):
    """The estimates (n, 4) after theta, theta_dot, x_dot, .., and the memories (n, CELLS)."""
    capsule = Capsule()
    plant = {"m": capsule.m, "l": capsule.l, "g": capsule.g, "lightest": 0.3}
    law = CoreLaw("gait", **gait_constants(), **plant, dt=dt)
    measured = np.insert(observations[:, :3].astype(np.float64), 2, 0.0, axis=1)
    _, memories = law.evaluate(measured, memories, np.zeros((len(observations), 2)))
    deviations = np.sqrt(np.maximum(0.0, memories[:, [3, 5]]))
    return np.hstack([memories[:, 1:3], deviations]).astype(np.float32), memories


def filtered(rows, memory=EMPTY):
    """The estimates after each theta, theta_dot, x_dot, and the memories, (rows, CELLS)."""
    found = []
    memories = []
    for row in np.float32(rows):
        estimates, (memory,) = update(row[None], memory[None])
        found.append(estimates[0].astype(np.float64))
        memories.append(memory)
    return np.array(found), np.array(memories)


@pytest.mark.parametrize(("M", "mu"), [(0.35, 0.3), (0.5, 0.01), (0.75, 0.05)])
def test_both_are_found_in_slip(M, mu):
    estimates, memories = filtered(states(M, mu))
    assert memories[0, 0] == 1.0
    assert_array_equal(estimates[0], np.float32(PRIOR))
    found_M, found_log_mu, deviation_M, deviation_log_mu = estimates[-1]
    log_mu = math.log(mu)
    # The pairs are exact up to the rounding to float32, but the prior fades only with every pair.
    assert found_M == pytest.approx(M, rel=4e-3)
    # A small friction changes the velocity little.
    assert found_log_mu == pytest.approx(log_mu, abs=0.02)
    assert abs(found_M - M) < 3.0 * deviation_M < 0.05
    assert abs(found_log_mu - log_mu) < 3.0 * deviation_log_mu < 2.0


def test_a_jump_brings_doubt_and_is_found():
    jump = 2.0
    estimates, _ = filtered(states(0.4, 0.02, changes=[{"t": jump, "M": 0.7, "mu": 0.2}]))
    M, log_mu, deviations, _ = estimates[round(jump / CONTROL_DT) :].T
    assert M[0] == pytest.approx(0.4, rel=0.01)
    assert deviations[0] < 0.02
    # The filter forgets its estimates at the first pairs that contradict them.
    assert deviations[:25].max() > 3.0 * deviations[0]
    assert M[-1] == pytest.approx(0.7, rel=0.02)
    assert log_mu[-1] == pytest.approx(math.log(0.2), abs=0.05)


def posterior(rows, mean, P):
    """The mean of M and log(mu), and their covariance, after the change of x_dot between two rows.

    A least-squares fit finds both, with the prior as two of its residuals.
    """
    p = Capsule()
    theta, theta_dot, x_dot = np.float32(rows).astype(np.float64).T
    across = np.diff(np.cos(theta) * theta_dot)
    along = np.diff(np.sin(theta) * theta_dot)
    change = np.diff(x_dot)
    whiten = np.linalg.inv(np.linalg.cholesky(P))

    def residuals(estimates):
        M, log_mu = estimates
        total = M + p.m
        mu = math.exp(log_mu)
        # The momentum of both bodies, and the normal force over the time between the rows.
        momentum = p.m * p.l * across - total * change
        impulse = total * p.g * CONTROL_DT - p.m * p.l * along
        error = (momentum - mu * impulse) / total / NOISE
        return np.concatenate([whiten @ (estimates - mean), error])

    fit = least_squares(residuals, mean, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return fit.x, np.linalg.inv(fit.jac.T @ fit.jac)


@pytest.mark.parametrize(
    ("deviations", "expected"),
    [
        pytest.param((0.03, 0.2), (0.03, 0.2), id="agrees"),
        pytest.param((1e-3, 1e-3), PRIOR[2:], id="contradicts"),
    ],
)
def test_a_pair_in_slip_corrects_the_estimates_as_a_bayesian_would(deviations, expected):
    mean = np.array([0.52, math.log(0.06)])
    found = np.diag(np.square(deviations))
    first = [0.3, 4.0, 0.10]
    second = [0.375, 3.5, 0.06]
    upper = np.triu_indices(2)
    begun = np.array([1.0, *mean, *found[upper], 0.0, 0.0, 0.0])
    _, memory = update(np.float32([first]), begun[None])
    _, (memory,) = update(np.float32([second]), memory)
    expected_mean, P = posterior([first, second], mean, np.diag(np.square(expected)))
    assert_allclose(memory[1:3], expected_mean, rtol=1e-3)
    # A twentieth of the information fades.
    assert_allclose(memory[3:6], P[upper] / 0.95, rtol=1e-2)


@pytest.mark.parametrize(
    ("x_dot", "next_x_dot"),
    [
        pytest.param(0.0, 0.0, id="stick"),
        pytest.param(0.1, 0.0, id="stops"),
        pytest.param(0.0, 0.1, id="starts"),
        pytest.param(0.1, -0.1, id="turns"),
        pytest.param(0.5 * SLOWEST, 0.3, id="slow before"),
        pytest.param(-0.3, -0.5 * SLOWEST, id="slow after"),
    ],
)
def test_nothing_is_learnt_in_stick_and_where_it_turns(x_dot, next_x_dot):
    _, memories = filtered(states(0.5, 0.05, 1.0))
    # The first pair may belong to a slip that began earlier.
    pair = [[0.1, 2.0, x_dot], [0.4, -3.0, next_x_dot]]
    _, (one, next_one) = filtered(pair, memories[-1])
    assert_array_equal(next_one[1:6], one[1:6])
    velocity = (-3.0 * math.cos(0.4), -3.0 * math.sin(0.4))
    assert_allclose(next_one[6:], (*velocity, next_x_dot), rtol=1e-6)


@pytest.mark.parametrize("scale", [1.0, 30.0, 1e4])
def test_whatever_is_observed_the_estimates_stay_within_their_range(scale):
    # The observations are far from any physics, as from a user or after clipping.
    rows = np.random.default_rng(0).normal(0.0, 1.0, (1000, 3))
    estimates, memories = filtered(rows * (1.0, scale, scale) + (0.0, 0.0, scale))
    assert np.isfinite(estimates).all()
    assert (memories[:, 1:3] >= LOW).all()
    assert (memories[:, 1:3] <= HIGH).all()
    P = memories[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
    variances = P[:, [0, 1], [0, 1]]
    assert (variances <= np.square(PRIOR[2:]) * (1.0 + 1e-12)).all()
    assert np.linalg.eigvalsh(P).min() >= -1e-12


@pytest.mark.parametrize(
    "options",
    [
        {"initial_range": (1.0, 8.0)},
        {"controller": "baselines:gait", "control_dt": 0.01},
        {"task": "goal", "disturbances": "real"},
        {"randomization": "real-wide", "stack_size": 2, "observe_parameters": True},
    ],
)
@pytest.mark.parametrize("count", [1, 70])
def test_an_environment_shows_the_estimates_of_a_filter_of_its_observations(count, options):
    options = {"max_episode_steps": 40, "observe_estimates": True, **options}
    env = CapsuleVectorEnv(count, autoreset_mode="SAME_STEP", **options)
    first = list(env.simulation.entries).index("M_estimate")
    memory = np.zeros((count, CELLS))
    ends = 0
    observations, _ = env.reset(seed=2)
    for actions in random_actions(count, 150, count):
        estimates, memory = update(observations, memory, env.simulation.options.control_dt)
        assert_array_equal(observations[:, first : first + 4], estimates)
        assert env.observation_space.contains(observations)
        observations, _, terminated, truncated, _ = env.step(actions)
        ended = terminated | truncated
        memory[ended] = 0.0
        ends += ended.sum()
    assert ends >= 3 * count
    assert count == 1 or np.ptp(estimates[:, 0]) > 0.0


@pytest.mark.parametrize(
    "options", [{"controller": "baselines:gait"}, {"task": "goal", "observe_parameters": True}]
)
def test_a_stack_holds_the_observations_of_the_steps_before(options):
    count = 3
    size = 4
    plain = CapsuleVectorEnv(count, max_episode_steps=30, **options)
    stacked = CapsuleVectorEnv(count, max_episode_steps=30, **options, stack_size=size)
    one = plain.single_observation_space
    space = stacked.single_observation_space
    assert_array_equal(space.low, np.tile(one.low, size))
    assert_array_equal(space.high, np.tile(one.high, size))
    seen = [plain.reset(seed=1)[0]]
    found, _ = stacked.reset(seed=1)
    first = np.zeros(count, int)
    for step, action in enumerate(random_actions(0, 99, 1), start=1):
        for i in range(count):
            steps = np.maximum(first[i], step - 1 - np.arange(size))
            assert_array_equal(found[i], np.concatenate([seen[n][i] for n in steps]))
        actions = np.tile(action, (count, 1))
        first[plain._ended] = step
        observations, *_ = plain.step(actions)
        seen.append(observations)
        found, *_ = stacked.step(actions)
    assert first.any()
