"""Estimates of M and mu from slip: accurate for exact physics, uncertain after jumps, constant in stick."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from capsule_gym import Capsule, CapsuleEnv, CapsuleVectorEnv, observation
from capsule_gym.network import compiled_act_batch, make_workspace
from capsule_gym.observation import (
    CELLS,
    DEVIATION_LOG_MU,
    DEVIATION_M,
    HIGH_LOG_MU,
    HIGH_M,
    LOW_LOG_MU,
    LOW_M,
    SLOWEST,
    Memory,
    estimates,
    identify,
)
from capsule_gym.task import CONTROL_DT
from tests.capsule_gym.test_network import make_layers, make_network

CAPSULE = Capsule()
PLANT = {"m": CAPSULE.m, "l": CAPSULE.l, "g": CAPSULE.g, "dt": CONTROL_DT}
EMPTY: Memory = (0.0,) * CELLS  # type: ignore[assignment]
PLANTS = [(0.35, 0.3), (0.5, 0.01), (0.75, 0.05)]


def states(M: float, mu: float, seconds: float = 4.0, changes: Any = (), capsule: Capsule = CAPSULE) -> np.ndarray:
    """The states of a capsule under a torque that swings its pendulum, in float64: theta, theta', x'."""
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


def memories_of(rows: np.ndarray, memory: Memory = EMPTY) -> list[Memory]:
    """The memory after each observation."""
    found = []
    for row in rows.tolist():
        memory = identify(memory, *row, **PLANT)
        found.append(memory)
    return found


@pytest.mark.parametrize(("M", "mu"), PLANTS)
def test_both_are_found_in_slip(M, mu):
    rows = states(M, mu)
    first, *_, last = memories_of(rows)
    assert first[0] == 1.0
    assert estimates(first) == (observation.PRIOR_M, observation.PRIOR_LOG_MU, DEVIATION_M, DEVIATION_LOG_MU)
    # The float32 precision of observations is sufficient.
    assert estimates(memories_of(rows.astype(np.float32).astype(np.float64))[-1])[0] == pytest.approx(M, rel=4e-3)
    found_M, found_log_mu, deviation_M, deviation_log_mu = estimates(last)
    # The pairs are exact, but the filter assumes noise: the weight of the prior fades with every pair.
    assert found_M == pytest.approx(M, rel=1e-3)
    # A small friction changes the velocity little.
    assert found_log_mu == pytest.approx(math.log(mu), abs=0.02)
    assert abs(found_M - M) < 3.0 * deviation_M < 0.05
    assert abs(found_log_mu - math.log(mu)) < 3.0 * deviation_log_mu < 2.0


def test_a_jump_brings_doubt_and_is_found():
    jump = 2.0
    rows = states(0.4, 0.02, 4.0, changes=[{"t": jump, "M": 0.7, "mu": 0.2}])
    memories = memories_of(rows)
    before = memories[round(jump / CONTROL_DT)]
    assert estimates(before)[0] == pytest.approx(0.4, rel=0.01)
    deviations = np.array([estimates(memory)[2] for memory in memories[round(jump / CONTROL_DT) :]])
    assert deviations[0] < 0.02
    # The filter forgets its estimates at the first pairs that contradict them.
    assert deviations[:25].max() > 3.0 * deviations[0]
    M, log_mu, *_ = estimates(memories[-1])
    assert M == pytest.approx(0.7, rel=0.02)
    assert log_mu == pytest.approx(math.log(0.2), abs=0.05)


@pytest.mark.parametrize(
    ("x_dot", "next_x_dot"),
    [(0.0, 0.0), (0.1, 0.0), (0.0, 0.1), (0.1, -0.1), (0.5 * SLOWEST, 0.3), (-0.3, -0.5 * SLOWEST)],
    ids=["stick", "stops", "starts", "turns", "slow before", "slow after"],
)
def test_nothing_is_learnt_in_stick_and_where_it_turns(x_dot, next_x_dot):
    known = memories_of(states(0.5, 0.05, 1.0))[-1]
    one = identify(known, 0.1, 2.0, x_dot, **PLANT)
    # The first pair may belong to a slip that began earlier.
    next_one = identify(one, 0.4, -3.0, next_x_dot, **PLANT)
    assert next_one[1:6] == one[1:6]
    assert next_one[6:] == pytest.approx((-3.0 * math.cos(0.4), -3.0 * math.sin(0.4), next_x_dot))


@pytest.mark.parametrize("scale", [1.0, 30.0, 1e4])
def test_whatever_is_observed_the_estimates_stay_within_their_range(scale):
    # The observations are far from any physics, as from a user or after clipping.
    rng = np.random.default_rng(0)
    rows = rng.normal(0.0, 1.0, (4000, 3)) * (1.0, scale, scale) + (0.0, 0.0, scale)
    prior = np.array([DEVIATION_M**2, DEVIATION_LOG_MU**2])
    for memory in memories_of(rows):
        _, M, log_mu, *_ = memory
        assert LOW_M <= M <= HIGH_M
        assert LOW_LOG_MU <= log_mu <= HIGH_LOG_MU
        P = np.array([[memory[3], memory[4]], [memory[4], memory[5]]])
        assert np.isfinite(P).all()
        assert (np.diag(P) <= prior * (1.0 + 1e-12)).all()
        assert np.linalg.eigvalsh(P).min() >= -1e-12
        assert np.isfinite(estimates(memory)).all()


@pytest.mark.parametrize("n", [1, 70])
def test_compiled_and_in_python_it_is_the_same_bits(n):
    rng = np.random.default_rng(n)
    layers = make_layers((9, 1))
    network = make_network(layers, observed=5, identifies=True)
    memory, given, actions = np.zeros(n * CELLS), np.empty((n, 9), np.float32), np.empty((n, 1), np.float32)
    by_hand, lanes = [EMPTY] * n, make_workspace(network)
    rows = states(0.5, 0.05, 1.5).astype(np.float32)
    for row in rows:
        observations = np.zeros((n, 5), np.float32)
        observations[:, :3] = row * rng.uniform(0.9, 1.1, (n, 1))
        compiled_act_batch()(network, observations, memory, given, lanes, actions)
        by_hand = [identify(own, *seen[:3].tolist(), **PLANT) for own, seen in zip(by_hand, observations, strict=True)]
        assert memory.tobytes() == np.array(by_hand).tobytes()
        assert given[:, :5].tobytes() == observations.tobytes()
        assert given[:, 5:].tobytes() == np.array([estimates(own) for own in by_hand], np.float32).tobytes()
    assert np.ptp(given[:, 5]) > 0.0 or n == 1


@pytest.mark.parametrize("options", [{"controller": "baselines:gait"}, {"task": "goal", "observe_parameters": True}])
def test_a_stack_holds_the_observations_of_the_steps_before(options):
    count, size = 3, 4
    plain, stacked = (CapsuleVectorEnv(count, max_episode_steps=30, **options, stack_size=n) for n in (1, size))
    low, high = plain.single_observation_space.low, plain.single_observation_space.high
    np.testing.assert_array_equal(stacked.single_observation_space.low, np.tile(low, size))
    np.testing.assert_array_equal(stacked.single_observation_space.high, np.tile(high, size))
    seen = [plain.reset(seed=1)[0]]
    found = stacked.reset(seed=1)[0]
    first = np.zeros(count, int)
    rng = np.random.default_rng(0)
    begins = 0
    for step in range(1, 100):
        for i in range(count):
            expected = [seen[max(first[i], step - 1 - n)][i] for n in range(size)]
            np.testing.assert_array_equal(found[i], np.concatenate(expected))
        actions = np.repeat(rng.uniform(-1.0, 1.0, (1, 1)), count, axis=0).astype(np.float32)
        ended = plain._ended.copy()
        seen.append(plain.step(actions)[0])
        found = stacked.step(actions)[0]
        first[ended] = step
        begins += ended.sum()
    assert begins > 0
