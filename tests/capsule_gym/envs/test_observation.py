"""Estimates of M and mu from slip: accurate for exact physics, uncertain after jumps, constant in
stick."""

import math

import numpy as np
import pytest

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv
from capsule_gym.control.controller import CoreLaw
from capsule_gym.control.laws.gait import gait_constants
from capsule_gym.tasks.task import CONTROL_DT

CAPSULE = Capsule()
# Prior of M (kg) and log(mu) with their standard deviations, and the range of the estimates.
PRIOR = (0.55, -3.25, 0.2, 1.5)
LOW, HIGH = (0.15, -7.0), (2.0, 0.0)
# m/s: below this speed the platform may have stuck between two observations.
SLOWEST = 0.02
PLANTS = [(0.35, 0.3), (0.5, 0.01), (0.75, 0.05)]
PAIRS = {"stick": (0.0, 0.0), "stops": (0.1, 0.0), "starts": (0.0, 0.1), "turns": (0.1, -0.1)}
PAIRS |= {"slow before": (0.5 * SLOWEST, 0.3), "slow after": (-0.3, -0.5 * SLOWEST)}
SHOWN = [{"initial_range": (1.0, 8.0)}, {"controller": "baselines:gait", "control_dt": 0.01}]
SHOWN += [{"task": "goal", "disturbances": "real"}]
SHOWN += [{"randomization": "real-wide", "stack_size": 2, "observe_parameters": True}]


def states(M, mu, seconds=4.0, changes=(), capsule=CAPSULE):
    """The states of a capsule under a torque that swings its pendulum, in float64: theta, theta',
    x'."""
    env = CapsuleEnv(capsule=capsule)
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
    """The estimates after theta, theta', x', .., shape (n, 4), and the filters of the law `gait`,
    (n, 9)."""
    law = CoreLaw(
        "gait", **gait_constants(), m=CAPSULE.m, l=CAPSULE.l, g=CAPSULE.g, lightest=0.3, dt=dt
    )
    states, n = np.insert(observations[:, :3].astype(np.float64), 2, 0.0, axis=1), len(observations)
    _, memories = law.evaluate(states, memories, np.zeros((n, 2)))
    estimates = np.hstack([memories[:, 1:3], np.sqrt(np.maximum(0.0, memories[:, [3, 5]]))])
    return estimates.astype(np.float32), memories


def filtered(rows, memory=None):
    """The estimates after each observation of theta, theta', x', shape (rows, 4), and the memories,
    (rows, 9)."""
    found, memories = [], [np.zeros(9) if memory is None else memory]
    for row in np.float32(rows):
        estimates, (renewed,) = update(row[None], memories[-1][None])
        found.append(estimates[0].astype(np.float64))
        memories.append(renewed)
    return np.array(found), np.array(memories[1:])


@pytest.mark.parametrize(("M", "mu"), PLANTS)
def test_both_are_found_in_slip(M, mu):
    estimates, memories = filtered(states(M, mu))
    assert memories[0, 0] == 1.0
    np.testing.assert_array_equal(estimates[0], np.float32(PRIOR))
    found_M, found_log_mu, deviation_M, deviation_log_mu = estimates[-1]
    # The pairs are exact up to the rounding to float32, but the prior fades only with every pair.
    assert found_M == pytest.approx(M, rel=4e-3)
    # A small friction changes the velocity little.
    assert found_log_mu == pytest.approx(math.log(mu), abs=0.02)
    assert abs(found_M - M) < 3.0 * deviation_M < 0.05
    assert abs(found_log_mu - math.log(mu)) < 3.0 * deviation_log_mu < 2.0


def test_a_jump_brings_doubt_and_is_found():
    jump = 2.0
    estimates, _ = filtered(states(0.4, 0.02, 4.0, changes=[{"t": jump, "M": 0.7, "mu": 0.2}]))
    after = estimates[round(jump / CONTROL_DT) :]
    assert after[0, 0] == pytest.approx(0.4, rel=0.01)
    deviations = after[:, 2]
    assert deviations[0] < 0.02
    # The filter forgets its estimates at the first pairs that contradict them.
    assert deviations[:25].max() > 3.0 * deviations[0]
    assert after[-1, 0] == pytest.approx(0.7, rel=0.02)
    assert after[-1, 1] == pytest.approx(math.log(0.2), abs=0.05)


@pytest.mark.parametrize(("x_dot", "next_x_dot"), PAIRS.values(), ids=PAIRS)
def test_nothing_is_learnt_in_stick_and_where_it_turns(x_dot, next_x_dot):
    known = filtered(states(0.5, 0.05, 1.0))[1][-1]
    # The first pair may belong to a slip that began earlier.
    _, (one, next_one) = filtered(np.array([[0.1, 2.0, x_dot], [0.4, -3.0, next_x_dot]]), known)
    np.testing.assert_array_equal(next_one[1:6], one[1:6])
    np.testing.assert_allclose(
        next_one[6:], (-3.0 * math.cos(0.4), -3.0 * math.sin(0.4), next_x_dot), rtol=1e-6
    )


@pytest.mark.parametrize("scale", [1.0, 30.0, 1e4])
def test_whatever_is_observed_the_estimates_stay_within_their_range(scale):
    # The observations are far from any physics, as from a user or after clipping.
    rng = np.random.default_rng(0)
    rows = rng.normal(0.0, 1.0, (4000, 3)) * (1.0, scale, scale) + (0.0, 0.0, scale)
    estimates, memories = filtered(rows)
    assert np.isfinite(estimates).all()
    assert ((memories[:, 1:3] >= LOW) & (memories[:, 1:3] <= HIGH)).all()
    P = memories[:, [3, 4, 4, 5]].reshape(-1, 2, 2)
    assert (P[:, [0, 1], [0, 1]] <= np.square(PRIOR[2:]) * (1.0 + 1e-12)).all()
    assert np.linalg.eigvalsh(P).min() >= -1e-12


@pytest.mark.parametrize("options", SHOWN)
@pytest.mark.parametrize("count", [1, 70])
def test_an_environment_shows_the_estimates_of_a_filter_of_its_observations(count, options):
    env = CapsuleVectorEnv(
        count, max_episode_steps=40, autoreset_mode="SAME_STEP", observe_estimates=True, **options
    )
    names = list(env.simulation.entries)
    first = names.index("M_estimate")
    dt, rng, memory = (
        env.simulation.options.control_dt,
        np.random.default_rng(count),
        np.zeros((count, 9)),
    )
    (observations, _), ends = env.reset(seed=2), 0
    for _ in range(150):
        estimates, memory = update(observations, memory, dt)
        np.testing.assert_array_equal(observations[:, first : first + 4], estimates)
        assert env.observation_space.contains(observations)
        observations, _, terminated, truncated, _ = env.step(
            rng.uniform(-1.0, 1.0, (count, 1)).astype(np.float32)
        )
        memory[terminated | truncated] = 0.0
        ends += (terminated | truncated).sum()
    assert ends >= 3 * count and (count == 1 or np.ptp(estimates[:, 0]) > 0.0)


@pytest.mark.parametrize(
    "options", [{"controller": "baselines:gait"}, {"task": "goal", "observe_parameters": True}]
)
def test_a_stack_holds_the_observations_of_the_steps_before(options):
    count, size = 3, 4
    plain, stacked = (
        CapsuleVectorEnv(count, max_episode_steps=30, **options, stack_size=n) for n in (1, size)
    )
    low, high = plain.single_observation_space.low, plain.single_observation_space.high
    np.testing.assert_array_equal(stacked.single_observation_space.low, np.tile(low, size))
    np.testing.assert_array_equal(stacked.single_observation_space.high, np.tile(high, size))
    seen = [plain.reset(seed=1)[0]]
    found = stacked.reset(seed=1)[0]
    first, rng = np.zeros(count, int), np.random.default_rng(0)
    for step in range(1, 100):
        for i in range(count):
            expected = [seen[max(first[i], step - 1 - n)][i] for n in range(size)]
            np.testing.assert_array_equal(found[i], np.concatenate(expected))
        actions = np.repeat(rng.uniform(-1.0, 1.0, (1, 1)), count, axis=0).astype(np.float32)
        first[plain._ended] = step
        seen.append(plain.step(actions)[0])
        found = stacked.step(actions)[0]
    assert first.any()
