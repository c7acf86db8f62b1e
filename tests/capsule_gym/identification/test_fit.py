"""Identification: the intervals contain the truth, and warnings name what is open."""

import json
from dataclasses import replace

import numpy as np
import pytest

from capsule_gym import Capsule, CapsuleEnv, Randomization, identify
from capsule_gym.identification import Fit
from capsule_gym.identification.__main__ import main
from capsule_gym.identification.doubts import doubts
from capsule_gym.identification.ranges import RANGES
from capsule_gym.identification.result import FITTED
from capsule_gym.parameters.disturbances import SAMPLING
from tests.capsule_gym.identification.rig import BIAS, CONSTANTS, MOTOR, TRUTH, WHITE, make_log
from tests.figures import texts


@pytest.fixture(scope="module")
def fit(log):
    return identify(log)


@pytest.mark.parametrize("name", [name for name in RANGES if name.endswith("_bias")])
def test_a_bias_of_either_sign_is_as_likely(name):
    low, high = RANGES[name]
    assert low == -high


def test_intervals_contain_the_truth(fit):
    for name, (low, high) in fit.intervals(0.999).items():
        assert low <= TRUTH.get(name, 0.0) <= high, name


def test_the_model_explains_the_log(fit, log):
    readings = 3 * FITTED * len(log["t"])
    assert 0.8 < fit.chi2 < 1.2
    assert fit.minima[0] == pytest.approx(readings, rel=0.05)


@pytest.mark.parametrize("name", ["m", "l", "k", "c", "M", "mu"])
def test_constants_of_the_plant_are_found(name, fit):
    assert fit.estimates[name] == pytest.approx(TRUTH[name], rel=0.06)


def test_the_sum_of_latency_and_lag_is_found(fit):
    assert fit.estimates["latency"] + fit.estimates["lag"] == pytest.approx(0.012, abs=1e-3)


def test_sizes_of_noise_and_drift_are_found(fit):
    found = fit.disturbances
    assert found.theta_noise == pytest.approx(0.01, rel=0.1)
    assert found.theta_dot_noise == pytest.approx(0.1, rel=0.1)
    assert found.x_dot_noise == pytest.approx(0.01, rel=0.1)
    assert found.theta_drift < 0.003


def test_rows_that_are_not_fitted_are_predicted_within_their_noise(fit):
    assert fit.held_out["theta"] == pytest.approx(0.01, rel=0.25)
    assert fit.held_out["theta_dot"] == pytest.approx(0.1, rel=0.25)
    assert fit.held_out["x_dot"] == pytest.approx(0.01, rel=0.25)
    error = f"{fit.held_out['theta_dot']:.3g} rad/s"
    assert f"not fitted: theta_dot is predicted with an error of {error}" in fit.table()


def test_the_environment_of_a_fit_draws_from_its_intervals(fit):
    options = fit.env_kwargs()
    intervals = fit.intervals(0.95)
    assert options["randomization"] == fit.randomization() == fit.randomization(0.95)
    assert options["disturbances"].latency == intervals["latency"]
    assert intervals["latency"][0] > 0.005
    _, info = CapsuleEnv(**options).reset(seed=0)
    low, high = intervals["m"]
    assert low <= info["capsule"]["m"] <= high
    assert info["disturbances"]["theta_noise"] == fit.disturbances.theta_noise


def test_intervals_grow_with_their_level(fit):
    half = np.array([*fit.intervals(0.5).values()])
    most = np.array([*fit.intervals(0.9).values()])
    assert (np.ptp(half, axis=1) < np.ptp(most, axis=1)).all()


def draws(fit, samples, low, high):
    """The fit with samples of m and l, whose ranges are both from low to high."""
    ranges = {"m": (low, high), "l": (low, high)}
    return replace(fit, estimates={"m": 0.0, "l": 0.0}, samples=samples, ranges=ranges)


VALUES = np.array([[1.0, 4.0, 6.0, 7.0, 7.5, 8.0, 8.5, 9.0, 12.0, 20.0]] * 2).T


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(5.8, 20.0, (5.8, 9.0)), (0.0, 9.2, (6.0, 9.2)), (5.6, 9.4, (6.0, 9.0))],
)
def test_an_interval_is_the_shortest_one_and_reaches_a_near_end_of_the_range(
    fit, low, high, expected
):
    assert draws(fit, VALUES, low, high).intervals(0.5)["m"] == expected


def test_the_interval_of_level_1_does_not_reach_beyond_the_samples(fit):
    assert draws(fit, VALUES, 0.5, 20.5).intervals(1.0)["l"] == (1.0, 20.0)


def test_an_axis_of_the_estimates_names_what_is_determined_together(fit):
    # The sum of m and l is known ten times better than their difference.
    samples = np.array([[1.0, -1.0], [-1.0, 1.0], [0.1, 0.1], [-0.1, -0.1]])
    (best, total), (worst, difference) = draws(fit, samples, -1.0, 1.0).identified
    assert worst == pytest.approx(10.0 * best)
    assert total["m"] * total["l"] == pytest.approx(0.5)
    assert difference["m"] * difference["l"] == pytest.approx(-0.5)


def test_the_interval_of_level_1_contains_all_samples(fit):
    low, high = np.transpose([*fit.intervals(1.0).values()])
    assert np.array_equal(low, fit.samples.min(axis=0))
    assert np.array_equal(high, fit.samples.max(axis=0))


def relative_variances(fit):
    """The variances of the estimates over those of their ranges."""
    ranges = np.ptp([*fit.ranges.values()], axis=1)
    relative = 12.0 * fit.samples.var(axis=0, ddof=1) / ranges**2
    return dict(zip(fit.estimates, relative, strict=True))


def test_axes_of_the_estimates_begin_with_the_best_determined(fit):
    sizes = [size for size, _ in fit.identified]
    assert sizes == sorted(sizes)
    assert sizes[0] < 0.02
    assert len(sizes) == len(fit.estimates)
    assert np.square(sizes).sum() == pytest.approx(sum(relative_variances(fit).values()))
    assert all(axis for _, axis in fit.identified)


def test_widths_are_those_of_the_samples(fit):
    variance = relative_variances(fit)["latency"]
    assert fit.widths["latency"] ** 2 == pytest.approx(variance, rel=1e-3)


def test_the_text_of_a_fit_is_without_its_samples(fit):
    assert "array" not in repr(fit)


def test_masses_and_length_are_correlated(fit):
    """They follow from the torque's scale and g alone."""
    names = list(fit.estimates)
    correlations = np.corrcoef(fit.samples.T)
    assert correlations[names.index("m"), names.index("l")] < -0.9


def test_the_others_do_not_follow_the_static_ratio(fit):
    """They are drawn at its best value."""
    correlations = np.corrcoef(fit.samples.T)[list(fit.estimates).index("static_ratio")]
    *_, largest_other, _ = np.sort(np.abs(correlations))
    assert largest_other < 0.1


def test_a_platform_that_sticks_determines_the_static_ratio(fit):
    # In this log the platform sticks for a quarter of the time.
    assert fit.widths["static_ratio"] < 0.7
    assert "not determined: the prior's" not in fit.table()
    assert f"\nchi2 {fit.chi2:.2f}; minima of the fits: (" in fit.table()


def test_what_a_log_does_not_determine_is_named():
    # On a smooth floor the platform hardly sticks.
    log = make_log(WHITE, 4.0, capsule=Capsule(**{**CONSTANTS, "mu": 0.02}))
    with pytest.warns(UserWarning, match="the log does not determine m:"):
        fit = identify(log)
    assert fit.widths["static_ratio"] > 0.9
    assert "not determined: the prior's" in fit.table()


@pytest.fixture(scope="module")
def short_log():
    """A log of 5 s with a sensor of x."""
    return make_log(replace(WHITE, x_noise=0.001), 5.0)


KNOWN = {**CONSTANTS, **MOTOR, **BIAS, "theta_bias": 0.0, "theta_dot_bias": 0.0}


def test_a_single_quantity_is_estimated_alone(short_log, tmp_path):
    assert list(short_log) == ["t", "torque", "theta", "theta_dot", "x", "x_dot"]
    known = {name: value for name, value in KNOWN.items() if name != "lag"}
    fit = identify(short_log, known)
    low, high = fit.intervals(0.999)["lag"]
    assert fit.covariance.shape == (1, 1)
    assert low < 0.004 < high < low + 0.002
    assert fit.disturbances.x_noise == pytest.approx(0.001, rel=0.2)
    fit.report(tmp_path / "fit.png")


def test_the_last_fifth_is_not_fitted(short_log):
    known = {name: value for name, value in KNOWN.items() if name != "c"}
    last = np.arange(len(short_log["t"])) >= 400
    wrong = {**short_log, "theta": short_log["theta"] + 0.1 * last}
    before, after = (identify(log, known) for log in (short_log, wrong))
    assert np.array_equal(before.samples, after.samples)
    assert after.held_out["theta"] > 5.0 * before.held_out["theta"]
    assert after.held_out["x"] == before.held_out["x"]


def test_the_drift_of_a_sensor_is_found():
    drifting = replace(WHITE, theta_drift=0.05, drift_time=0.3)
    known = {name: value for name, value in KNOWN.items() if name != "c"}
    found = identify(make_log(drifting, 10.0), known).disturbances
    assert found.theta_drift == pytest.approx(0.05, rel=0.3)
    assert found.drift_time == pytest.approx(0.3, rel=0.5)


def test_a_sensor_without_readings_in_the_fitted_rows_is_named(short_log):
    last = np.arange(len(short_log["t"])) >= 400
    late = {**short_log, "theta_dot": np.where(last, short_log["theta_dot"], np.nan)}
    with pytest.raises(ValueError, match="'theta_dot' must be of readings in the first four"):
        identify(late, {name: KNOWN[name] for name in KNOWN if name != "c"})


@pytest.mark.parametrize(("limits", "end"), [((0.3, 0.5), 0.5), ((0.7, 0.9), 0.7)])
def test_a_prior_without_the_truth_gives_its_end_and_a_warning(short_log, limits, end):
    log = {name: short_log[name] for name in ("t", "torque", "theta")}
    without = ("M", "theta_dot_bias", "x_dot_bias")
    known = {name: value for name, value in KNOWN.items() if name not in without}
    few = pytest.warns(UserWarning, match="log has neither x nor x_dot")
    with few, pytest.warns(UserWarning, match="M lies at the end of its range") as caught:
        fit = identify(log, known, Randomization(M=limits))
    assert fit.estimates == pytest.approx({"M": end}, abs=1e-3)
    assert fit.disturbances.unmeasured == ("theta_dot", "x_dot")
    assert fit.disturbances.x_dot_bias == 0.0
    assert caught[0].filename == __file__


@pytest.fixture
def panels(fit, tmp_path, saved_figures):
    """The panels of a report: two for each sensor, the correlations, and their colours' bar."""
    fit.report(tmp_path / "fit.png")
    return saved_figures[0].axes


def test_a_report_shows_readings_and_residuals(panels, log):
    *sensors, _, _ = panels
    assert texts(sensors[0].get_legend().texts) == ["measured", "predicted"]
    for left, right, name in zip(sensors[::2], sensors[1::2], list(log)[2:], strict=True):
        lines = [line.get_xydata().T for line in (*left.lines, *right.lines)]
        (t, measured), (_, predicted), (_, error), (split, _) = lines
        assert split[0] == t[1600]
        assert np.array_equal(t, log["t"])
        assert np.array_equal(measured, log[name])
        assert np.array_equal(error, measured - predicted, equal_nan=True)
        assert np.nanstd(error) < 0.5 * measured.std()
        assert left.get_ylabel().startswith(f"{name} (")
        # The rows that are not fitted.
        assert left.get_xlim() == (t[1600], t[-1])
        assert left.get_subplotspec().is_first_col()
        assert right.get_subplotspec().is_last_col()
        assert right.get_ylabel()


def test_a_report_shows_correlations(panels, fit):
    *_, axes, bar = panels
    (image,) = axes.images
    np.testing.assert_allclose(image.get_array(), np.corrcoef(fit.samples.T))
    assert image.get_clim() == (-1.0, 1.0)
    assert axes.get_subplotspec().is_last_row()
    assert texts(axes.get_xticklabels()) == texts(axes.get_yticklabels()) == list(fit.estimates)
    assert bar.get_ylabel() == "correlation"


def test_the_command_identifies_a_log_with_lost_readings(log, tmp_path, capsys):
    cells = np.transpose([*log.values()])[:1000].astype(str)
    lost = np.random.default_rng(0).uniform(size=cells.shape) < 0.1
    lost[:, :2] = False
    cells[lost] = ""
    # Two rows are lost.
    cells = np.delete(cells, [500, 501], axis=0)
    path = tmp_path / "log.csv"
    path.write_text("\n".join(map(",".join, [log, *cells])), encoding="utf-8-sig")
    options = "--known lag 0.004 --period 0.01 --ranges latency 0 0.03"
    main([str(path), *options.split()])
    words = [line.split() for line in capsys.readouterr().out.splitlines()[1:-4]]
    estimates = {name: value for name, value, *_ in words}
    assert "lag" not in estimates
    assert "theta_bias" in estimates
    assert float(estimates["c"]) == pytest.approx(TRUTH["c"], rel=0.03)
    assert float(estimates["latency"]) == pytest.approx(0.008, abs=1e-3)


def test_a_wrong_model_warns():
    # A floor that slopes by one degree.
    plant = {name: value for name, value in CONSTANTS.items() if name != "motor_friction"}
    log = make_log(WHITE, capsule=Capsule(**plant, slope=0.02))
    with pytest.warns(UserWarning) as caught:
        assert identify(log).chi2 > 1.2
    assert any("chi2 is" in str(warning.message) for warning in caught)


def test_a_chi2_above_the_documented_one_is_a_doubt(fit):
    assert next(doubts(replace(fit, chi2=1.21), None, None)).startswith("chi2 is 1.21")


def test_a_saved_result_is_the_same(fit, tmp_path):
    fit.save(tmp_path / "fit.json")
    loaded = Fit.load(tmp_path / "fit.json")
    assert loaded.env_kwargs(0.9) == fit.env_kwargs(0.9)
    assert loaded.identified == fit.identified
    assert loaded.ranges == fit.ranges
    assert loaded.table() == fit.table()


def test_an_older_file_has_no_sampling(fit, tmp_path):
    path = tmp_path / "fit.json"
    fit.save(path)
    content = json.loads(path.read_text(encoding="utf-8"))
    for name in SAMPLING:
        del content["disturbances"][name]
    path.write_text(json.dumps(content), encoding="utf-8")
    assert Fit.load(path).env_kwargs(0.9) == fit.env_kwargs(0.9)


def test_a_report_is_a_picture(fit, tmp_path):
    with pytest.raises(ValueError, match=r"path must be the name of a file \.png or"):
        fit.report(tmp_path / "fit.txt")


def test_a_result_from_a_file_draws_no_report(fit, tmp_path):
    fit.save(tmp_path / "fit.json")
    with pytest.raises(ValueError, match="call report on that of identify"):
        Fit.load(tmp_path / "fit.json").report(tmp_path / "fit.png")


BROKEN = {
    "empty": lambda content: {},
    "a list": lambda content: [],
    "an unknown quantity": lambda content: content | {"colour": 1.0},
    "a plant without a mass": lambda content: content | {"capsule": {"M": 0.0}},
    "samples of other lengths": lambda content: (
        content | {"samples": content["samples"] | {"M": [0.5]}}
    ),
    "samples beyond the limits": lambda content: (
        content | {"samples": content["samples"] | {"M": [-1.0] * len(content["samples"]["M"])}}
    ),
}


@pytest.mark.parametrize("change", BROKEN.values(), ids=BROKEN)
def test_another_file_is_no_result(fit, tmp_path, change):
    path = tmp_path / "fit.json"
    fit.save(path)
    path.write_text(json.dumps(change(json.loads(path.read_text()))))
    with pytest.raises(ValueError, match=r"fit\.json is not a result that Fit.save wrote"):
        Fit.load(path)
