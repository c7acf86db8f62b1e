"""The likelihood of a log: its predictor is the environment, its fit that of least squares."""

import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from capsule_gym.identification.log import read_log
from capsule_gym.identification.ranges import OTHERS
from capsule_gym.identification.shooting import PLANT, ShootingProblem
from tests.capsule_gym.identification.rig import EXACT, TRUTH, make_log

ROWS = 400
# A log may begin at any time.
T = 7.0 + 0.01 * np.arange(ROWS)
# One reading in five is missing.
FOURTH_OF_FIVE = np.arange(ROWS) % 5 > 0


def make_problem(log, physics_dt=2e-3):
    """The problem of a log, and the shares of the true quantities."""
    ranges = {name: (0.5 * value, 1.5 * value) for name, value in TRUTH.items()}
    known = dict.fromkeys(OTHERS, 0.0)
    problem = ShootingProblem(read_log(log), ranges, False, known, physics_dt)
    logarithmic = [name in PLANT for name in ranges]
    shares = np.where(logarithmic, math.log(2.0) / math.log(3.0), 0.5)
    low, truth, high = (problem.delay(factor * TRUTH["lag"]) for factor in (0.5, 1.0, 1.5))
    shares[problem.names.index("lag")] = (truth - low) / (high - low)
    return problem, shares


def make_small_problem(count=ROWS, ranges=None, **columns):
    t = 7.0 + 0.01 * np.arange(count)
    torque = np.random.default_rng(0).normal(size=count)
    log = {"t": t, "torque": torque, "theta": 0.3 * np.sin(2.0 * t), **columns}
    ranges = ranges or {"M": (0.4, 0.8), "mu": (0.01, 0.16), "latency": (0.004, 0.012)}
    return ShootingProblem(log, ranges, True, {"lag": 0.0}, 3e-3)


@pytest.mark.parametrize("physics_dt", [2e-3, 1e-3])
def test_predictions_are_the_environments_readings(physics_dt):
    log = make_log(EXACT, 3.0, physics_dt=physics_dt)
    problem, shares = make_problem(log, physics_dt)
    problem.segments = [(problem.lead, len(log["t"]))]
    predicted, _ = problem.predict(np.append(shares, np.zeros(3)), slopes=False)
    expected = np.transpose([log[name] for name in problem.sensors])
    inside = slice(problem.lead, None)
    np.testing.assert_allclose(predicted[inside, :, 0], expected[inside], rtol=0.0, atol=1e-9)


@pytest.fixture(scope="module")
def cut_problem(log):
    """A problem of several segments, and its unknowns."""
    problem, shares = make_problem({name: column[:250] for name, column in log.items()})
    return problem, np.append(shares, problem.cut(0.8))


def test_a_gap_is_the_end_of_a_segment_minus_the_start_of_the_next(cut_problem):
    problem, unknowns = cut_problem
    _, gaps = problem.predict(unknowns)
    count, width, _ = gaps.shape
    assert count > 1
    for n in range(count):
        starts = 1 + len(problem.names) + width * (n + 1)
        assert (np.diag(gaps[n, :, starts:]) == -1.0).all()


def test_gaps_have_the_same_deviations_at_all_segments(cut_problem):
    problem, unknowns = cut_problem
    _, gaps = problem.predict(unknowns)
    residuals, _ = problem.residuals(unknowns)
    sizes = gaps[..., 0]
    scales = residuals[-sizes.size :].reshape(sizes.shape) / sizes
    assert (scales > 10.0).all()
    assert np.ptp(scales / scales[0]) < 1e-9


def test_slopes_of_predictions_equal_differences(cut_problem):
    problem, unknowns = cut_problem
    unknowns = unknowns.copy()
    # Slopes by latency jump where it is a multiple of the integrator's step.
    unknowns[problem.names.index("latency")] += 0.05
    slopes = problem.predict(unknowns)
    for n in range(len(unknowns)):
        step = np.zeros(len(unknowns))
        step[n] = 1e-6
        above = problem.predict(unknowns + step, slopes=False)
        below = problem.predict(unknowns - step, slopes=False)
        for slope, high, low in zip(slopes, above, below, strict=True):
            inside = np.isfinite(high[..., 0])
            difference = (high[inside, 0] - low[inside, 0]) / 2e-6
            atol = 1e-4 * abs(difference).max()
            np.testing.assert_allclose(slope[inside, 1 + n], difference, rtol=1e-4, atol=atol)


def test_steps_of_the_integrator_divide_the_period():
    problem = make_small_problem()
    # 3 ms divide no 10 ms.
    assert (problem.period, problem.h) == pytest.approx((0.01, 0.0025))
    assert problem.steps == 4


def test_quantities_follow_from_their_shares():
    problem = make_small_problem()
    values, slopes = problem.values(np.array([0.25, 0.5, 1.0]))
    M = 0.4 * 2.0**0.25
    assert values == pytest.approx({"lag": 0.0, "M": M, "mu": 0.04, "latency": 0.012})
    assert slopes == pytest.approx([M * math.log(2.0), 0.04 * math.log(16.0), 0.008])
    # Uniform in M and in the logarithm of mu.
    assert problem.densities == pytest.approx([math.log(2.0), 0.0, 0.0])


@pytest.mark.parametrize(
    ("seconds", "ends"), [(0.8, [82, 162, 242, 322, 400]), (0.2, [22, 102, 182, 262, 342])]
)
def test_segments_begin_at_readings(seconds, ends):
    problem = make_small_problem(x_dot=np.where(FOURTH_OF_FIVE, T, np.nan))
    states = problem.cut(seconds)
    # The segments of 12 ms latency begin 2 readings before their first.
    assert problem.lead == 2
    assert problem.segments == list(zip((2, 82, 162, 242, 322), ends, strict=True))
    theta, theta_dot = 0.3 * np.sin(2.0 * T), 0.6 * np.cos(2.0 * T)
    expected = np.transpose([theta, theta_dot, T])
    np.testing.assert_allclose(states, expected[2::80].ravel(), atol=1e-3)


def test_errors_are_whitened_by_their_covariance():
    rng = np.random.default_rng(0)
    problem = make_small_problem(x_dot=T)
    problem.noise = {"theta": (0.02, 0.05, 0.3), "x_dot": (0.4, 0.1, 0.2)}
    problem.segments = [(0, ROWS)]
    errors = rng.normal(size=(ROWS, 2, 3))
    distances = np.abs(np.subtract.outer(T, T))
    expected = []
    logarithm = 0.0
    for n, (name, (noise, drift, time)) in enumerate(problem.noise.items()):
        rows = rng.uniform(size=ROWS) > 0.1
        problem.log[name] = np.where(rows, problem.log[name], np.nan)
        covariance = drift**2 * np.exp(-distances / time) + noise**2 * np.eye(ROWS)
        covariance = covariance[np.ix_(rows, rows)]
        factor = np.linalg.cholesky(covariance)
        expected.append(np.linalg.solve(factor, errors[rows, n]))
        logarithm += np.linalg.slogdet(covariance)[1]
    found, determinant = problem.whiten(errors)
    np.testing.assert_allclose(found, np.concatenate(expected), rtol=1e-8, atol=1e-9)
    assert determinant == pytest.approx(logarithm)


def test_sizes_of_noise_and_drift_are_those_of_the_errors():
    count = 40_000
    rng = np.random.default_rng(1)
    kept = math.exp(-0.01 / 0.2)
    white = 0.05 * rng.normal(size=count)
    drift = lfilter([math.sqrt(1.0 - kept**2)], [1.0, -kept], white)
    problem = make_small_problem(count, theta=drift + 0.02 * rng.normal(size=count))
    problem.log["theta"][rng.uniform(size=count) < 0.01] = np.nan
    problem.predict = lambda *_, **__: (np.zeros((count, 1, 1)), None)
    problem.segments = [(0, count)]
    problem.estimate_noise(np.zeros(3))
    assert problem.noise["theta"] == pytest.approx((0.02, 0.05, 0.2), rel=0.15)


def test_the_fit_is_that_of_least_squares():
    start = np.array([0.2, 0.9, 0.0])

    def residuals(unknowns):
        a, b, state = unknowns
        bounded = 30.0 * (a - 1.4) + state**2
        return np.array([bounded, 40.0 * (b**2 - 0.25), state - 3.0 * b, b * state - 0.4])

    def jacobian(unknowns):
        _, b, state = unknowns
        rows = [[30.0, 0.0, 2.0 * state], [0.0, 80.0 * b, 0.0]]
        return np.array([*rows, [0.0, -3.0, 1.0], [0.0, state, b]])

    problem = make_small_problem()
    problem.names = ["a", "b"]
    problem.residuals = lambda unknowns, *_, **__: (residuals(unknowns), jacobian(unknowns))
    found, cost = problem.fit(start, 1e-9)
    bounds = ([0.0, 0.0, -np.inf], [1.0, 1.0, np.inf])
    expected = least_squares(residuals, start, bounds=bounds, xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(found, expected.x, atol=1e-4)
    assert cost == pytest.approx(2.0 * expected.cost)
    assert found[0] == 1.0


def test_chi2_is_what_past_torques_and_the_motion_explain_of_the_residuals():
    rng = np.random.default_rng(2)
    problem = make_small_problem(x_dot=np.where(FOURTH_OF_FIVE, T, np.nan))
    problem.segments = [(2, ROWS)]
    motion = rng.normal(size=(ROWS, 2))
    first, second = rng.normal(size=398), 1.2 * rng.normal(size=319)
    predicted = motion.copy()
    predicted[:2] = np.nan
    problem.predict = lambda *_, **__: (predicted[..., None], None)
    problem.residuals = lambda *_, **__: (np.append(first, second), None)
    torque = problem.log["torque"]
    past = [np.append(np.zeros(lag), torque[:-lag]) for lag in range(1, 100)]
    motion[:2] = 0.0
    regressors = np.column_stack([np.ones(ROWS), *past, np.sign(motion), np.abs(motion)])

    def explained(r, rows):
        X = regressors[2:][rows]
        solution, _, _, _ = np.linalg.lstsq(X, r, rcond=None)
        return r @ X @ solution / 104.0

    of_noise = explained(first, slice(None))
    expected = (of_noise + explained(second, FOURTH_OF_FIVE[2:])) / 2.0
    assert problem.statistic(np.zeros(3)) == pytest.approx(expected)
    assert 0.7 < of_noise < 1.3


@pytest.mark.parametrize(("share", "outwards"), [(0.0, 1.0), (1.0, -1.0)])
def test_an_unknown_at_the_end_of_its_range_is_free_to_leave_it_only_inwards(share, outwards):
    problem = make_small_problem()
    # The last unknown is a state, which has no range.
    unknowns = np.array([share, 0.5, share, share])
    for slope in (0.3, 3.0):
        gradient = np.full(4, slope * outwards)
        assert problem.free(unknowns, gradient).tolist() == [False, True, False, True]
        assert problem.free(unknowns, -gradient).all()
