"""Samples of the posterior distribution, where it is known."""

import math

import numpy as np
import pytest

from capsule_gym.identification.posterior import sample_posterior
from capsule_gym.identification.shooting import ShootingProblem
from tests.capsule_gym.identification.test_shooting import make_small_problem


def replace_residuals(monkeypatch, name, limits, residuals):
    """A problem of a quantity, latency and one state, with residuals that a test defines.

    They are functions of the share of the quantity within its limits (of a lag that of its delay,
    of all others the logarithmic one), of latency, and of the state; their Jacobian has three
    columns.
    The quantity may be known, and is no unknown then.
    """

    def of_unknowns(self, unknowns, *_, **__):
        low, high = limits
        known = self.known.get(name)
        if name in self.names:
            share = unknowns[0]
        elif name == "lag":
            low, known, high = map(self.delay, (low, known, high))
            share = (known - low) / (high - low)
        else:
            share = np.log(known / low) / np.log(high / low)
        latency, state = unknowns[-2:]
        r, jacobian = residuals(share, latency, state)
        of_known = 3 - len(unknowns)
        return r, jacobian[:, of_known:]

    monkeypatch.setattr(ShootingProblem, "residuals", of_unknowns)
    return make_small_problem(ranges={name: limits, "latency": (0, 0.02)})


# A linear problem: a weak likelihood leaves the prior.
A = np.array([[40.0, 5.0, 8.0], [3.0, 30.0, -6.0], [1.0, 2.0, 9.0], [7.0, -9.0, 4.0]])


@pytest.mark.parametrize(
    ("scale", "b", "growth", "mean", "covariance"),
    [
        (1.0, A @ [0.6, 0.4, 2.0], 0.0, [0.6, 0.4], np.linalg.inv(A.T @ A)[:2, :2]),
        (1e-4, np.zeros(4), 0.0, [0.5, 0.5], np.eye(2) / 12.0),
        # The density of a prior that is exp(2 share) on [0, 1].
        (1e-4, np.zeros(4), 2.0, [0.6565, 0.5], np.diag([0.0690, 1.0 / 12.0])),
    ],
    ids=["strong", "weak", "a prior that grows"],
)
def test_the_posterior_is_normal_within_the_ranges(scale, b, growth, mean, covariance):
    problem = make_small_problem()
    problem.names = ["a", "b"]
    problem.densities = np.array([growth, 0.0])
    problem.residuals = lambda unknowns, *_, **__: (scale * (A @ unknowns - b), scale * A)
    samples, _ = sample_posterior(problem, np.array([0.58, 0.41, 1.9]))
    atol = 3.0 * np.sqrt(covariance.max() / len(samples))
    np.testing.assert_allclose(samples.mean(axis=0), mean, atol=atol)
    np.testing.assert_allclose(np.cov(samples.T), covariance, atol=0.04 * covariance.max())


def test_states_that_no_reading_determines_leave_the_posterior_of_the_shares():
    """Two states act alike, so that the readings determine their sum only, without noise."""
    problem = make_small_problem()
    problem.names = ["a", "b"]
    problem.densities = np.zeros(2)
    jacobian = 1e7 * A[:, [0, 1, 2, 2]] * [1.0, 1.0, 1.0, 0.3]
    truth = np.array([0.6, 0.4, 2.0, 1.0])
    problem.residuals = lambda unknowns, *_, **__: (jacobian @ (unknowns - truth), jacobian)
    samples, _ = sample_posterior(problem, truth)
    np.testing.assert_allclose(samples.mean(axis=0), [0.6, 0.4], atol=1e-8)
    determined = jacobian[:, :3]
    covariance = np.linalg.inv(determined.T @ determined)[:2, :2]
    np.testing.assert_allclose(np.cov(samples.T), covariance, atol=0.06 * covariance.max())


def test_the_posterior_follows_a_curve_of_lag_and_latency(monkeypatch):
    def residuals(lag, latency, state):
        exactness = 100.0 - 60.0 * lag
        beside = latency - (0.6 - 0.5 * lag**3)
        by_curve = [1.5 * exactness * lag**2 - 60.0 * beside, exactness, 0.0]
        r = np.array([exactness * beside, 2.0 * lag - 1.0, 5.0 * state])
        return r, np.array([by_curve, [2.0, 0.0, 0.0], [0.0, 0.0, 5.0]])

    problem = replace_residuals(monkeypatch, "lag", (1e-3, 0.01), residuals)
    samples, found = sample_posterior(problem, np.array([0.9, 0.2, 0.0]))
    lags, latencies = samples.T
    np.testing.assert_allclose(found, [0.5, 0.6 - 0.5 * 0.125, 0.0], atol=2e-3)
    grid = np.linspace(0.0, 1.0, 1001)
    density = np.exp(-0.5 * (2.0 * grid - 1.0) ** 2)
    density /= density.sum()
    variance = density @ (grid - 0.5) ** 2
    assert lags.mean() == pytest.approx(0.5, abs=0.012)
    assert lags.std() == pytest.approx(math.sqrt(variance), rel=0.05)
    mean = density @ (0.6 - 0.5 * grid**3)
    assert latencies.mean() == pytest.approx(mean, abs=0.012)
    # Beside the curve latency is as exact as its reading, at the nearest of seven nodes.
    beside = latencies - (0.6 - 0.5 * lags**3)
    assert beside[lags < 0.08].std() == pytest.approx(1.0 / 100.0, rel=0.15)
    assert beside[lags > 0.92].std() == pytest.approx(1.0 / 40.0, rel=0.15)


def test_the_posterior_of_an_unknown_lag_ends_where_the_range_of_latency_does(monkeypatch):
    def residuals(lag, latency, state):
        r = [2.0 * lag - 1.0, 10.0 * latency, 5.0 * state]
        return np.array(r), np.diag([2.0, 10.0, 5.0])

    problem = replace_residuals(monkeypatch, "lag", (1e-3, 0.01), residuals)
    samples, _ = sample_posterior(problem, np.array([0.5, 0.1, 0.0]))
    latencies = samples[:, 1]
    assert (latencies > 0.0).mean() > 0.99
    # Half of a normal distribution.
    assert latencies.mean() == pytest.approx(0.1 * math.sqrt(2.0 / math.pi), rel=0.1)


def test_the_posterior_of_a_likelihood_that_jumps_begins_where_it_may_jump(monkeypatch):
    def residuals(share, latency, state):
        r = [10.0 * (share < 0.45), 40.0 * (latency - 0.6), 5.0 * state]
        return np.array(r), np.diag([0.0, 40.0, 5.0])

    problem = replace_residuals(monkeypatch, "static_ratio", (1.0, 1.5), residuals)
    samples, found = sample_posterior(problem, np.array([0.9, 0.5, 0.0]))
    shares, latencies = samples.T
    assert found[0] > 0.45
    np.testing.assert_allclose(found[1:], [0.6, 0.0], atol=2e-3)
    # The third of seven nodes is the last one before the jump; the prior is uniform in the ratio
    # itself.
    low = 1.5 ** (1.0 / 3.0)
    ratios = 1.5**shares
    assert ratios.min() == pytest.approx(low, abs=1e-3)
    assert ratios.max() > 1.499
    assert ratios.mean() == pytest.approx((low + 1.5) / 2.0, abs=0.006)
    assert latencies.mean() == pytest.approx(0.6, abs=2e-3)
    assert latencies.std() == pytest.approx(0.025, rel=0.1)
