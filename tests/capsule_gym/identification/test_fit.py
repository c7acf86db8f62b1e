"""Identification: the predictor is the environment, the intervals contain the truth, invalid logs
raise errors."""

import math
import subprocess
import sys
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lfilter

from capsule_gym import (
    Capsule,
    CapsuleEnv,
    Disturbances,
    Excitation,
    Randomization,
    identify,
    record,
)
from capsule_gym.identification.fit import OTHERS
from capsule_gym.identification.log import read_log
from capsule_gym.identification.shooting import PLANT, ShootingProblem
from tests.figures import texts

TRUTH = {
    "M": 0.6,
    "mu": 0.08,
    "m": 0.13,
    "l": 0.31,
    "k": 0.35,
    "c": 0.095,
    "viscous": 0.2,
    "static_ratio": 1.2,
}
OPTIONS = {
    "randomization": "none",
    "control_dt": 0.01,
    "capsule": Capsule(**TRUTH, motor_friction=0.06),
}
MOTOR = {"latency": 0.008, "lag": 0.004}
WHITE = Disturbances(
    theta_noise=0.01, theta_dot_noise=0.1, x_dot_noise=0.01, x_dot_bias=0.01, **MOTOR
)


def make_log(disturbances, seconds=20.0, **options):
    env = CapsuleEnv(**{**OPTIONS, "disturbances": disturbances, **options})
    return record(
        env, Excitation(amplitude=0.4), seconds=seconds, seed=1, options={"state": [0.0] * 4}
    )


@pytest.fixture(scope="module")
def log():
    return make_log(WHITE)


@pytest.fixture(scope="module")
def fit(log):
    return identify(log)


def make_problem(log, physics_dt=2e-3):
    """The problem of a log, and the shares of the true quantities."""
    truth = {**TRUTH, "motor_friction": 0.06, **MOTOR, "x_dot_bias": 0.01}
    ranges = {name: (0.5 * value, 1.5 * value) for name, value in truth.items()}
    problem = ShootingProblem(read_log(log), ranges, False, dict.fromkeys(OTHERS, 0.0), physics_dt)
    return problem, np.where([name in PLANT for name in ranges], math.log(2.0) / math.log(3.0), 0.5)


@pytest.mark.parametrize("physics_dt", [2e-3, 1e-3])
def test_predictions_are_the_environments_readings(physics_dt):
    log = make_log(Disturbances(x_dot_bias=0.01, **MOTOR), 3.0, physics_dt=physics_dt)
    problem, shares = make_problem(log, physics_dt)
    problem.segments = [(problem.lead, len(log["t"]))]
    predicted, _ = problem.predict(np.append(shares, [0.0, 0.0, 0.0]), slopes=False)
    for n, name in enumerate(problem.sensors):
        np.testing.assert_allclose(
            predicted[problem.lead :, n, 0], log[name][problem.lead :], rtol=0.0, atol=1e-9
        )


def test_slopes_of_predictions_equal_differences(log):
    problem, shares = make_problem({name: column[:250] for name, column in log.items()})
    unknowns = np.append(shares, problem.cut(0.8))
    predicted, gaps = problem.predict(unknowns)
    # A gap is the end of a segment minus the state that the next one starts with.
    starts = (
        len(problem.names)
        + np.arange(gaps.shape[1])
        + gaps.shape[1] * np.arange(1, 1 + len(gaps))[:, None]
    )
    assert (np.take_along_axis(gaps[..., 1:], starts[..., None], axis=2) == -1.0).all() and len(
        gaps
    ) > 1
    scales = (
        problem.residuals(unknowns)[0][-gaps[..., 0].size :].reshape(gaps.shape[:2]) / gaps[..., 0]
    )
    assert (scales > 10.0).all() and np.ptp(scales / scales[0]) < 1e-9
    smooth = [
        n for n in range(len(unknowns)) if n >= len(problem.names) or problem.names[n] != "latency"
    ]
    for n in smooth:
        step = 1e-6 * (np.arange(len(unknowns)) == n)
        ends = (
            problem.predict(moved, slopes=False) for moved in (unknowns + step, unknowns - step)
        )
        for slope, high, low in zip((predicted, gaps), *ends, strict=True):
            inside = np.isfinite(high[..., 0])
            difference = (high[inside, 0] - low[inside, 0]) / 2e-6
            np.testing.assert_allclose(
                slope[inside, 1 + n], difference, rtol=1e-4, atol=1e-4 * abs(difference).max()
            )


# A log may begin at any time.
T = 7.0 + 0.01 * np.arange(400)


def make_small_problem(count=400, **more):
    t, torque = 7.0 + 0.01 * np.arange(count), np.random.default_rng(0).normal(size=count)
    columns = {"t": t, "torque": torque, "theta": 0.3 * np.sin(2.0 * t), **more}
    ranges = {"M": (0.4, 0.8), "mu": (0.01, 0.16), "latency": (0.004, 0.012)}
    return ShootingProblem(columns, ranges, True, {"lag": 0.0}, 3e-3)


def test_quantities_segments_and_first_states_by_hand():
    problem = make_small_problem(x_dot=np.where(np.arange(400) % 5 == 0, np.nan, T))
    # 3 ms divide no 10 ms; the segments of 12 ms latency begin 2 readings before their first.
    assert (problem.period, problem.h) == pytest.approx((0.01, 0.0025)) and (
        problem.steps,
        problem.lead,
    ) == (4, 2)
    values, slopes = problem.values(np.array([0.25, 0.5, 1.0]))
    M = 0.4 * 2.0**0.25
    assert values == pytest.approx({"lag": 0.0, "M": M, "mu": 0.04, "latency": 0.012})
    assert slopes == pytest.approx([M * math.log(2.0), 0.04 * math.log(16.0), 0.008])
    assert problem.densities == pytest.approx(
        [math.log(2.0), 0.0, 0.0]
    )  # uniform in M and in the logarithm of mu
    expected = np.transpose([0.3 * np.sin(2.0 * T), 0.6 * np.cos(2.0 * T), T])[2::80]
    for seconds, ends in ((0.8, [82, 162, 242, 322, 400]), (0.2, [22, 102, 182, 262, 342])):
        np.testing.assert_allclose(problem.cut(seconds), expected.ravel(), atol=1e-3)
        assert problem.segments == list(zip((2, 82, 162, 242, 322), ends, strict=True))


def test_errors_are_whitened_by_their_covariance_and_give_the_sizes_of_noise_and_drift():
    problem, rng = make_small_problem(x_dot=T), np.random.default_rng(0)
    problem.noise, problem.segments = (
        {"theta": (0.02, 0.05, 0.3), "x_dot": (0.4, 0.1, 0.2)},
        [(0, 400)],
    )
    errors, expected, determinants = rng.normal(size=(400, 2, 3)), [], []
    for n, (name, (noise, drift, time)) in enumerate(problem.noise.items()):
        rows = rng.uniform(size=400) > 0.1
        problem.log[name] = np.where(rows, problem.log[name], np.nan)
        covariance = drift**2 * np.exp(-np.abs(np.subtract.outer(T, T)) / time) + noise**2 * np.eye(
            400
        )
        covariance = covariance[rows][:, rows]
        expected.append(np.linalg.solve(np.linalg.cholesky(covariance), errors[rows, n]))
        determinants.append(np.linalg.slogdet(covariance)[1])
    found, determinant = problem.whiten(errors)
    np.testing.assert_allclose(found, np.concatenate(expected), rtol=1e-8, atol=1e-9)
    assert determinant == pytest.approx(sum(determinants))
    count, rng, kept = 40_000, np.random.default_rng(1), math.exp(-0.01 / 0.2)
    drift = lfilter([math.sqrt(1.0 - kept**2)], [1.0, -kept], 0.05 * rng.normal(size=count))
    problem = make_small_problem(count, theta=drift + 0.02 * rng.normal(size=count))
    problem.log["theta"][rng.uniform(size=count) < 0.01] = np.nan
    problem.predict = lambda *_, **__: (np.zeros((count, 1, 1)), None)
    problem.segments = [(0, count)]
    problem.estimate_noise(np.zeros(3))
    assert problem.noise["theta"] == pytest.approx((0.02, 0.05, 0.2), rel=0.15)


def test_the_fit_and_its_posterior_are_those_of_least_squares():
    problem = make_small_problem()
    problem.names, problem.densities = ["a", "b"], np.zeros(2)

    def residuals(u, *_, **__):
        r = np.array(
            [
                30.0 * (u[0] - 1.4) + u[2] ** 2,
                40.0 * (u[1] ** 2 - 0.25),
                u[2] - 3.0 * u[1],
                u[1] * u[2] - 0.4,
            ]
        )
        return r, np.array(
            [[30.0, 0.0, 2.0 * u[2]], [0.0, 80.0 * u[1], 0.0], [0.0, -3.0, 1.0], [0.0, u[2], u[1]]]
        )

    problem.residuals = residuals
    found, cost = problem.fit(np.array([0.2, 0.9, 0.0]), 1e-9)
    bounds = ([0.0, 0.0, -np.inf], [1.0, 1.0, np.inf])
    expected = least_squares(
        lambda u: residuals(u)[0], [0.2, 0.9, 0.0], bounds=bounds, xtol=1e-12, ftol=1e-12
    )
    np.testing.assert_allclose(found, expected.x, atol=1e-4)
    assert cost == pytest.approx(2.0 * expected.cost) and found[0] == 1.0
    # A linear problem: without the third unknown, and within the ranges.
    A = np.array([[40.0, 5.0, 8.0], [3.0, 30.0, -6.0], [1.0, 2.0, 9.0], [7.0, -9.0, 4.0]])
    for scale, b in ((1.0, A @ [0.6, 0.4, 2.0]), (1e-4, np.zeros(4))):
        problem.residuals = lambda u, *_, scale=scale, b=b, **__: (scale * (A @ u - b), scale * A)
        samples, _ = problem.posterior(np.array([0.58, 0.41, 1.9]))
        mean, covariance = np.array([0.6, 0.4]), np.linalg.inv(A.T @ A)[:2, :2]
        if scale < 1.0:
            mean, covariance = np.full(2, 0.5), np.eye(2) / 12.0
        np.testing.assert_allclose(
            samples.mean(axis=0), mean, atol=5.0 * np.sqrt(covariance.max() / len(samples))
        )
        np.testing.assert_allclose(np.cov(samples.T), covariance, atol=0.06 * covariance.max())


def test_the_posterior_follows_a_curve_of_lag_and_latency(monkeypatch):
    def residuals(self, u, *_, **__):
        lag = u[0] if "lag" in self.names else (self.known["lag"] - 0.001) / 0.009
        jacobian = np.array([[150.0 * lag**2, 100.0, 0.0], [2.0, 0.0, 0.0], [0.0, 0.0, 5.0]])
        r = np.array([50.0 * lag**3 + 100.0 * u[-2] - 60.0, 2.0 * lag - 1.0, 5.0 * u[-1]])
        return r, jacobian[:, len(jacobian) - len(u) :]

    monkeypatch.setattr(ShootingProblem, "residuals", residuals)
    problem = ShootingProblem(
        make_small_problem().log, {"lag": (1e-3, 0.01), "latency": (0, 0.02)}, False, {}, 3e-3
    )
    samples, found = problem.posterior(np.array([0.9, 0.2, 0.0]))
    np.testing.assert_allclose(found, [0.5, 0.6 - 0.5 * 0.125, 0.0], atol=2e-3)
    lags = np.linspace(0.0, 1.0, 1001)
    share = np.exp(-0.5 * (2.0 * lags - 1.0) ** 2) / np.exp(-0.5 * (2.0 * lags - 1.0) ** 2).sum()
    assert samples.mean(axis=0) == pytest.approx([0.5, share @ (0.6 - 0.5 * lags**3)], abs=0.012)
    assert samples[:, 0].std() == pytest.approx(math.sqrt(share @ (lags - 0.5) ** 2), rel=0.05)
    # Beside the curve latency is as exact as its reading.
    assert np.std(samples[:, 1] - (0.6 - 0.5 * samples[:, 0] ** 3)) == pytest.approx(0.01, rel=0.1)


def test_the_posterior_of_a_likelihood_that_jumps_begins_where_it_may_jump(monkeypatch):
    def residuals(self, u, *_, **__):
        share = (
            u[0]
            if "static_ratio" in self.names
            else np.log(self.known["static_ratio"]) / np.log(1.5)
        )
        jacobian = np.array([[0.0, 0.0, 0.0], [0.0, 40.0, 0.0], [0.0, 0.0, 5.0]])
        r = np.array([10.0 * (share < 0.45), 40.0 * (u[-2] - 0.6), 5.0 * u[-1]])
        return r, jacobian[:, 3 - len(u) :]

    monkeypatch.setattr(ShootingProblem, "residuals", residuals)
    problem = ShootingProblem(
        make_small_problem().log,
        {"static_ratio": (1.0, 1.5), "latency": (0, 0.02)},
        False,
        {},
        3e-3,
    )
    samples, found = problem.posterior(np.array([0.9, 0.5, 0.0]))
    np.testing.assert_allclose(found[1:], [0.6, 0.0], atol=2e-3)
    # The third of seven nodes is the last one before the jump; the prior is uniform in the ratio
    # itself.
    low, ratios = 1.5 ** (1.0 / 3.0), 1.5 ** samples[:, 0]
    assert found[0] > 0.45 and low - 1e-3 < ratios.min() < low + 1e-3 and ratios.max() > 1.499
    assert ratios.mean() == pytest.approx((low + 1.5) / 2.0, abs=0.006)
    assert samples[:, 1].mean() == pytest.approx(0.6, abs=2e-3) and samples[
        :, 1
    ].std() == pytest.approx(0.025, rel=0.1)


def test_chi2_is_what_past_torques_and_the_motion_explain_of_the_residuals():
    problem, rng = (
        make_small_problem(x_dot=np.where(np.arange(400) % 5 == 0, np.nan, T)),
        np.random.default_rng(2),
    )
    problem.segments = [(2, 400)]
    motion, u, n = rng.normal(size=(400, 2)), problem.log["torque"], np.arange(2, 400)
    r, rows = [rng.normal(size=398), 1.2 * rng.normal(size=319)], [n, n[n % 5 > 0]]
    problem.predict = lambda *_, **__: (
        np.where(np.arange(400)[:, None] < 2, np.nan, motion)[..., None],
        None,
    )
    problem.residuals = lambda *_, **__: (np.concatenate(r), None)
    past = [np.concatenate([np.zeros(lag), u[:-lag]]) for lag in range(1, 100)]
    motion[:2] = 0.0
    X = np.column_stack([np.ones(400), *past, np.sign(motion), np.abs(motion)])
    both = [
        e @ X[own] @ np.linalg.lstsq(X[own], e, rcond=None)[0] / 104.0
        for e, own in zip(r, rows, strict=True)
    ]
    assert problem.statistic(np.zeros(3)) == pytest.approx(np.mean(both)) and 0.7 < both[0] < 1.3


def test_intervals_contain_the_truth_and_are_arguments_of_the_environment(fit):
    for name, (low, high) in fit.intervals(0.999).items():
        truth = {**TRUTH, "motor_friction": 0.06, **MOTOR, "x_dot_bias": 0.01}.get(name, 0.0)
        assert low <= truth <= high, name
    assert 0.8 < fit.chi2 < 1.2 and fit.minima[0] == pytest.approx(
        3 * 2000, rel=0.05
    )  # the number of readings
    for name in ("m", "l", "k", "c", "M", "mu"):
        assert fit.estimates[name] == pytest.approx(TRUTH[name], rel=0.06), name
    assert fit.estimates["latency"] + fit.estimates["lag"] == pytest.approx(0.012, abs=1e-3)
    found = fit.disturbances
    assert found.theta_noise == pytest.approx(0.01, rel=0.1) and found.theta_drift < 0.003
    assert found.theta_dot_noise == pytest.approx(
        0.1, rel=0.1
    ) and found.x_dot_noise == pytest.approx(0.01, rel=0.1)
    options, intervals = fit.env_kwargs(), fit.intervals(0.95)
    assert options["randomization"] == fit.randomization() == fit.randomization(0.95)
    assert (
        options["disturbances"].latency == intervals["latency"] and intervals["latency"][0] > 0.005
    )
    _, info = CapsuleEnv(**options).reset(seed=0)
    low, high = fit.intervals()["m"]
    assert (
        low <= info["capsule"]["m"] <= high
        and info["disturbances"]["theta_noise"] == fit.disturbances.theta_noise
    )
    half, most, whole = (np.array(list(fit.intervals(level).values())) for level in (0.5, 0.9, 1.0))
    assert ((half[:, 1] - half[:, 0]) < (most[:, 1] - most[:, 0])).all()
    assert np.array_equal(whole.T, [fit.samples.min(axis=0), fit.samples.max(axis=0)])


def test_what_is_not_determined_is_named(fit):
    sizes = [size for size, _ in fit.identified]
    assert (
        sizes == sorted(sizes)
        and sizes[0] < 0.02
        and len(sizes) == len(fit.estimates)
        and "array" not in repr(fit)
    )
    variances = 12.0 * fit.samples.var(axis=0, ddof=1) / (fit._problem.high - fit._problem.low) ** 2
    assert np.square(sizes).sum() == pytest.approx(variances.sum()) and all(
        axis for _, axis in fit.identified
    )
    assert fit.widths["latency"] ** 2 == pytest.approx(
        variances[list(fit.estimates).index("latency")], rel=1e-3
    )
    # The masses and the length follow from the torque's scale and g alone.
    assert (
        np.corrcoef(fit.samples.T)[list(fit.estimates).index("m"), list(fit.estimates).index("l")]
        < -0.9
    )
    # In this log the platform sticks for a quarter of the time; on a smooth floor it hardly does.
    # Drawn at its best value, the others do not follow the static ratio.
    others = np.corrcoef(fit.samples.T)[list(fit.estimates).index("static_ratio")]
    assert np.sort(np.abs(others))[-2] < 0.1
    assert (
        fit.widths["static_ratio"] < 0.7 and fit.table().count("not determined: the prior's") == 0
    )
    with pytest.warns(UserWarning, match="the log does not determine m:"):
        smooth = identify(
            make_log(WHITE, 4.0, capsule=Capsule(**{**TRUTH, "mu": 0.02}, motor_friction=0.06))
        )
    assert smooth.widths["static_ratio"] > 0.9 and "not determined: the prior's" in smooth.table()


def test_a_single_quantity_is_estimated_alone(tmp_path):
    log = make_log(replace(WHITE, x_noise=0.001), 5.0)
    assert list(log) == ["t", "torque", "theta", "theta_dot", "x", "x_dot"]
    known = {
        **TRUTH,
        **MOTOR,
        "motor_friction": 0.06,
        "theta_bias": 0.0,
        "theta_dot_bias": 0.0,
        "x_dot_bias": 0.01,
    }
    del known["lag"]
    fit = identify(log, known)
    low, high = fit.intervals(0.999)["lag"]
    assert fit.covariance.shape == (1, 1) and low < 0.004 < high < low + 0.002
    fit.report(tmp_path / "fit.png")
    assert fit.disturbances.x_noise == pytest.approx(0.001, rel=0.2)
    # Without the sensors of velocities, and with a prior that does not contain M.
    del known["M"], known["theta_dot_bias"], known["x_dot_bias"]
    log, known = {name: log[name] for name in ("t", "torque", "theta")}, {**known, "lag": 0.004}
    for low, high, end in ((0.3, 0.5, 0.5), (0.7, 0.9, 0.7)):
        few = pytest.warns(UserWarning, match="log has neither x nor x_dot")
        with few, pytest.warns(UserWarning, match="M lies at the end of its range") as caught:
            fit = identify(log, known, Randomization(M=(low, high)))
        assert fit.estimates == pytest.approx({"M": end}, abs=1e-3)
        assert caught[0].filename == __file__ and fit.disturbances.unmeasured == (
            "theta_dot",
            "x_dot",
        )


def test_a_report_shows_readings_residuals_and_correlations(fit, log, tmp_path, saved_figures):
    fit.report(tmp_path / "fit.png")
    *panels, correlations, bar = saved_figures[0].axes
    for left, right, name in zip(panels[::2], panels[1::2], list(log)[2:], strict=True):
        (t, measured), (_, predicted), (_, error) = (
            each.get_xydata().T for each in (*left.lines, *right.lines)
        )
        assert np.array_equal(t, log["t"]) and np.array_equal(measured, log[name])
        assert (
            np.array_equal(error, measured - predicted, equal_nan=True)
            and np.nanstd(error) < 0.5 * measured.std()
        )
        assert (
            left.get_ylabel().startswith(f"{name} (")
            and t[0] == left.get_xlim()[0] < left.get_xlim()[1] <= t[-1]
        )
        assert (
            left.get_subplotspec().is_first_col()
            and right.get_subplotspec().is_last_col()
            and right.get_ylabel()
        )
    np.testing.assert_allclose(correlations.images[0].get_array(), np.corrcoef(fit.samples.T))
    assert (
        correlations.images[0].get_clim() == (-1.0, 1.0)
        and correlations.get_subplotspec().is_last_row()
    )
    assert (
        texts(correlations.get_xticklabels())
        == texts(correlations.get_yticklabels())
        == list(fit.estimates)
    )
    assert (
        texts(panels[0].get_legend().texts) == ["measured", "predicted"]
        and bar.get_ylabel() == "correlation"
    )


def test_command_and_lost_readings(log, tmp_path):
    path, lost = tmp_path / "log.csv", np.random.default_rng(0).uniform(size=(1000, 5)) < 0.1
    cells = np.where(
        lost & [False, False, True, True, True],
        "",
        np.transpose([*log.values()])[:1000].astype(str),
    )
    path.write_text("\n".join(map(",".join, [log, *cells])), encoding="utf-8-sig")
    command = [
        sys.executable,
        "-m",
        "capsule_gym.identification",
        str(path),
        "--known",
        "lag",
        "0.004",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = {line.split()[0]: line.split()[1:] for line in done.stdout.splitlines()[1:]}
    assert "lag" not in found and float(found["c"][0]) == pytest.approx(TRUTH["c"], rel=0.03)
    assert float(found["latency"][0]) == pytest.approx(0.008, abs=1e-3) and "theta_bias" in found
    commas = r"a row of log must be of one number for each of \['t', 'torque', 'theta'\], got"
    bad = [
        ("\nt, torque,theta\n0,0,0\n0,01,0,1,0,2\n", commas),
        ("t,t\n0,0\n", "columns with different names, got"),
    ]
    for text, said in (*bad, ("\xb5", "CSV file in UTF-8")):
        path.write_text(text, encoding="latin-1")
        with pytest.raises(ValueError, match=said):
            read_log(path)


def test_a_wrong_model_warns():
    # A floor that slopes by one degree.
    log = make_log(WHITE, capsule=Capsule(**TRUTH, slope=0.02))
    with pytest.warns(UserWarning) as caught:
        assert identify(log).chi2 > 1.2
    assert any("chi2 is" in str(warning.message) for warning in caught)


def changed(**columns):
    return lambda log: {**log, **{name: change(log[name]) for name, change in columns.items()}}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (changed(t=lambda t: t**1.1), "column 't' must be in equal steps"),
        (
            changed(torque=lambda u: 5.0 + 1e-6 * u),
            r"column 'torque' must be varied \(N m\), got .*5",
        ),
        (
            changed(torque=lambda u: np.where(u > 0.5, np.nan, u)),
            "column 'torque' must be finite numbers",
        ),
        (changed(theta=np.degrees), "column 'theta' must be in rad"),
        (
            changed(theta_dot=lambda w: 0.4 * w),
            "column 'theta_dot' must be the derivative of column 'theta'.* 2.[45]",
        ),
        (
            changed(theta_dot=lambda w: np.where(np.arange(len(w)) % 50, w / 9.0, np.nan)),
            "column 'theta_dot' must be",
        ),
        (
            changed(theta_dot=lambda w: np.where(np.arange(len(w)) % 5, np.nan, w / 9.0)),
            "column 'theta_dot' must be",
        ),
        (changed(x_dot=lambda v: v[:-1]), "column 'x_dot' must be one number for each row"),
        (
            lambda log: {name: np.resize(each, 100_001) for name, each in log.items()},
            "'t' must be .* at most 100 s",
        ),
        (
            lambda log: {name: column[::10] for name, column in log.items()},
            "column 't' must be in equal steps",
        ),
        (
            lambda log: {name: each[150:200] for name, each in log.items()},
            "column 't' must be .*, over at least 2 s",
        ),
        (lambda log: {**log, "speed": log["x_dot"]}, "log must have columns out of"),
        (
            lambda log: {name: log[name] for name in ("t", "theta")},
            "log must be of the columns 't', 'torque'",
        ),
    ],
)
def test_invalid_logs_name_the_column(log, change, text):
    with pytest.raises(ValueError, match=text):
        identify(change(log))


def test_an_excitation_is_a_multisine_of_its_size_under_a_weak_pd_law():
    excitation, seen = (
        Excitation(seed=3, amplitude=0.2, torque_limit=2.0),
        np.zeros((3, 4000, 5), np.float32),
    )
    seen[1, :, 0], seen[2, :, 1] = 0.1, 1.0
    (rest, leant, swung) = (
        2.0 * np.array([*map(excitation.start(), each)]).ravel() for each in seen
    )
    power, frequencies = (
        np.abs(np.fft.rfft(rest * np.hanning(4000))) ** 2,
        np.fft.rfftfreq(4000, 0.01),
    )
    assert np.sqrt(np.mean(rest**2)) == pytest.approx(0.2, rel=0.1)
    assert power[(frequencies > 0.25) & (frequencies < 8.05)].sum() > 0.999 * power.sum()
    assert [Excitation().start()(np.float32([theta, 0.0]))[0] for theta in (9.0, -9.0)] == [
        -1.0,
        1.0,
    ]
    assert leant - rest == pytest.approx(-0.06, abs=1e-6) and swung - rest == pytest.approx(
        -0.04, abs=1e-6
    )


def test_record_writes_what_happens(tmp_path):
    env = CapsuleEnv(**OPTIONS, torque_limit=1.0)
    actions = []

    def policy(observation):
        actions.append(np.float32([0.5 - 0.2 * observation[0]]))
        return actions[-1]

    path = tmp_path / "log.csv"
    log = record(env, policy, path, seconds=0.5, seed=0)
    assert list(log) == ["t", "torque", "theta", "theta_dot", "x", "x_dot"] and len(log["t"]) == 50
    assert np.array_equal(log["torque"], np.array(actions)[:, 0].astype(float))
    observed = CapsuleEnv(**OPTIONS, torque_limit=1.0)
    observed.reset(seed=0)
    for n, action in enumerate(actions[:-1]):
        state = observed.step(action)[4]["state"]
        assert np.array_equal([log[name][n + 1] for name in list(log)[2:]], state)
    read = np.genfromtxt(path, delimiter=",", names=True)
    assert all(np.array_equal(read[name], column) for name, column in log.items())
    with pytest.raises(ValueError, match="path must be that of a new file"):
        record(env, policy, path)
    with pytest.raises(ValueError, match="env must be an environment with direct torque"):
        record(CapsuleEnv(controller="baselines:gait"), policy)
    total, wide = ({"residual_limit": 0.5, "total_torque": True}, {"residual_limit": 2.0})
    scaled = gym.wrappers.RescaleAction(CapsuleEnv(**OPTIONS), np.float32(0.0), np.float32(1.0))
    for action, torque, changes in (
        (0.2, 0.3, total),
        (0.9, 0.5, total),
        (0.9, 1.5, wide),
        (0.75, 0.75, None),
    ):
        env = scaled if changes is None else CapsuleEnv(**OPTIONS, **changes)
        assert record(env, lambda _, a=action: np.float32([a]), seconds=0.01)[
            "torque"
        ] == pytest.approx([torque])
    late = CapsuleEnv(
        **{**OPTIONS, "disturbances": Disturbances(latency=0.01, unmeasured=("x_dot",))}
    )
    assert list(record(late, seconds=0.1, seed=0)) == ["t", "torque", "theta", "theta_dot"]
