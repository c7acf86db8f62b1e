import numpy as np
import pytest
from scipy import stats

from capsule_gym.evaluation.statistics import (
    adjust,
    estimate,
    interquartile_mean,
    lowest_decile,
    paired_difference,
    share,
)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 100, 101])
def test_interquartile_mean_is_scipys_trimmed_mean(count):
    scores = np.random.default_rng(count).normal(size=(6, count))
    expected = stats.trim_mean(scores, 0.25, axis=-1)
    np.testing.assert_allclose(interquartile_mean(scores), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ([1, 1, 1, np.inf], 1.0),
        ([1, 1, np.inf, np.inf], np.inf),
    ],
)
def test_a_quarter_of_failed_ratios_has_no_effect_and_a_larger_share_does(scores, expected):
    np.testing.assert_equal(interquartile_mean(scores).item(), expected)


def test_the_interquartile_mean_of_one_score_is_the_score():
    assert interquartile_mean([1.5]) == 1.5


@pytest.mark.parametrize("scores", [[], np.zeros((3, 0)), 1.0])
def test_no_score_has_no_mean(scores):
    with pytest.raises(ValueError, match="scores must be at least one number"):
        interquartile_mean(scores)


def difference(scores):
    return paired_difference(scores, [[1.0, 2.0]])


def difference_to(scores):
    return paired_difference([[1.0, 2.0]], scores)


@pytest.mark.parametrize("summary", [interquartile_mean, estimate, difference, difference_to])
@pytest.mark.parametrize(
    "scores",
    [[[1.0, np.nan], [2.0, np.nan]], np.ma.masked_greater([[1, 9], [2, 9]], 8)],
    ids=["NaN", "masked"],
)
def test_a_score_that_is_missing_is_an_error(summary, scores):
    with pytest.raises(ValueError, match="scores must not be NaN, got NaN in 2 of 4"):
        summary(scores)


def simulated(rng, seeds, plants, spreads, failing):
    """Scores that vary over seeds and over plants, the latter with a tail; some episodes fail."""
    of_seeds, of_plants, rest = spreads
    scores = 18.0 + of_seeds * rng.normal(size=(seeds, 1))
    scores = scores - of_plants * (0.5 * rng.gamma(4.0, size=(1, plants)) - 2.0)
    scores = scores + rest * rng.normal(size=(seeds, plants))
    fails = rng.random((seeds, plants)) < failing
    return np.where(fails, 0.3 * scores, scores)


def test_intervals_cover_another_training_run_on_other_plants():
    rng = np.random.default_rng(4)
    shares = []
    for seeds, plants in ((1, 100), (5, 100), (5, 400), (10, 100)):
        for failing, spread_of_seeds, spread_of_plants, rest in (
            (0.0, 0.3, 1.0, 0.2),
            (0.03, 0.05, 1.0, 0.2),
            (0.06, 0.1, 2.0, 0.5),
        ):
            # A single run says nothing about other runs.
            spreads = (spread_of_seeds if seeds > 1 else 0.0, spread_of_plants, rest)
            # Many runs, each on other plants.
            many = [simulated(rng, 1, 100, spreads, failing) for _ in range(4000)]
            truth = interquartile_mean(np.hstack(many))
            found = [estimate(simulated(rng, seeds, plants, spreads, failing)) for _ in range(250)]
            shares.append(np.mean([each.low <= truth <= each.high for each in found]))
    assert np.mean(shares) >= 0.93
    assert min(shares) >= 0.9


def test_the_interval_of_the_mean_of_many_plants_is_that_of_a_normal_distribution():
    scores = np.random.default_rng(4).normal(size=(1, 10_000))
    half = estimate(scores, mean=True).high - scores.mean()
    assert half == pytest.approx(0.0196, rel=0.03)


@pytest.mark.parametrize("differ", ["plants", "seeds"])
def test_the_interval_is_students_t_where_only_one_axis_differs(differ):
    scores = np.random.default_rng(2).normal(size=(1, 9))
    low, high = stats.t.interval(0.95, 8, scores.mean(), stats.sem(scores[0]))
    if differ == "seeds":
        scores = np.repeat(scores.T, 100, axis=1)
    result = estimate(scores, mean=True)
    assert (result.low, result.high) == (pytest.approx(low), pytest.approx(high))


def test_the_interval_of_one_run_has_the_standard_error_of_scipys_trimmed_mean():
    scores = np.random.default_rng(7).gamma(2.0, size=(1, 24))
    result = estimate(scores)
    error = stats.mstats.trimmed_stde(scores[0], limits=(0.25, 0.25))
    half = stats.t.ppf(0.975, 23) * error
    assert result.high - result.value == pytest.approx(half, rel=1e-9)
    assert result.value - result.low == pytest.approx(half, rel=1e-9)


def test_the_interval_of_equal_seeds_is_that_of_one():
    one = np.random.default_rng(3).normal(size=(1, 100))
    alone = estimate(one)
    same = estimate(np.repeat(one, 3, axis=0))
    assert same.high - same.low == pytest.approx(alone.high - alone.low, rel=0.02)


def test_the_interval_of_equal_scores_is_empty():
    assert estimate(np.ones((2, 3))).to_dict() == {"iqm": 1.0, "low": 1.0, "high": 1.0}


def test_the_interval_of_a_share_ends_at_1():
    most = estimate([[1.0] * 99 + [0.0]], mean=True)
    assert most.kind == "mean"
    assert most.low < most.value < most.high == 1.0


@pytest.mark.parametrize("scores", [[[1.5]], [[1.0, np.inf, np.inf, np.inf]]])
def test_a_single_score_or_infinite_ones_have_no_interval(scores):
    result = estimate(scores)
    assert np.isnan([result.low, result.high]).all()


@pytest.mark.parametrize("seeds", [2, 3])
def test_two_training_runs_have_no_interval(seeds):
    scores = np.random.default_rng(6).normal(size=(seeds, 100))
    one = scores[:1]
    found = [estimate(scores), estimate(scores, mean=True), paired_difference(one, scores)]
    assert [np.isnan(each.low) for each in found] == [seeds == 2] * 3
    assert [np.isnan(each.high) for each in found] == [seeds == 2] * 3


def test_the_interquartile_mean_discards_up_to_a_quarter_of_infinite_ratios():
    assert np.isfinite(estimate([[1.0, 2.0, 3.0, np.inf]]).high)


REFERENCE = np.arange(8.0)[None]


def test_the_paired_difference_of_shifted_scores_is_the_shift():
    difference = paired_difference(REFERENCE + 2.0, REFERENCE)
    assert difference.to_dict() == {"iqm": 2.0, "low": 2.0, "high": 2.0}


def test_the_paired_difference_is_the_estimate_of_the_differences():
    several = np.concatenate([REFERENCE + 1.0, REFERENCE + 2.0, REFERENCE + 6.0])
    assert paired_difference(several, REFERENCE) == estimate(several - REFERENCE)


def test_variation_over_the_seeds_of_the_reference_widens_the_interval():
    rng = np.random.default_rng(5)
    base = rng.normal(size=(5, 200))
    offsets = rng.normal(size=(5, 1))
    both = paired_difference(1.0 + base, base + offsets)
    alone = paired_difference(1.0 + base, base)
    assert both.high - both.low > 3.0 * (alone.high - alone.low)


def test_the_paired_difference_of_infinite_scores_is_undefined_without_a_warning():
    with np.errstate(all="raise"):
        assert np.isnan(paired_difference([[np.inf] * 4], [[np.inf] * 4]).value)


@pytest.mark.parametrize("seed", range(3))
def test_the_p_value_of_one_run_is_that_of_students_t(seed):
    scores = np.random.default_rng(seed).normal(0.2, size=(1, 30))
    expected = stats.ttest_1samp(scores[0], 0.0).pvalue
    assert estimate(scores, mean=True).p_value == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_p_value_is_below_5_percent_where_the_interval_excludes_zero(seed):
    scores = np.random.default_rng(seed).normal(0.3, size=(5, 12))
    found = estimate(scores)
    assert (found.p_value < 0.05) == (found.low > 0.0 or found.high < 0.0)


def test_equal_scores_differ_from_zero_for_certain_or_not_at_all():
    assert paired_difference(REFERENCE + 2.0, REFERENCE).p_value == 0.0
    assert paired_difference(REFERENCE, REFERENCE).p_value == 1.0


def test_holms_method_rejects_step_by_step():
    # Level / 4, / 3, / 2, / 1: the third smallest exceeds 0.05 / 2, so the fourth is not rejected.
    adjusted = adjust([0.03, 0.012, 0.02, 0.026])
    assert (adjusted < 0.05).tolist() == [False, True, False, False]
    np.testing.assert_allclose(adjusted, [0.06, 0.048, 0.06, 0.06])


def test_a_comparison_without_a_p_value_counts_and_is_not_rejected():
    assert adjust([0.02, np.nan]).tolist() == [0.04, 1.0]
    assert adjust([0.8, 0.9]).tolist() == [1.0, 1.0]


def test_holms_method_holds_the_level_of_the_family():
    rng = np.random.default_rng(8)
    families = rng.uniform(size=(4000, 20))
    wrong = np.mean([(adjust(family) < 0.05).any() for family in families])
    assert wrong == pytest.approx(0.05, abs=0.01)


def test_the_lowest_decile_is_of_plants_and_not_of_episodes():
    # Eleven plants; each seed is bad on one of the others.
    scores = np.tile(np.arange(11.0), (2, 1))
    scores[0, 5] -= 20.0
    scores[1, 5] += 20.0
    assert lowest_decile(scores) == 1.0


@pytest.mark.parametrize(
    ("count", "total", "low", "high"),
    [
        (0, 1000, 0.0, 0.003827),
        (1, 1, 0.206549, 1.0),
        (5, 10, 0.236593, 0.763407),
        (400, 400, 0.990488, 1.0),
    ],
)
def test_a_share_has_wilsons_interval(count, total, low, high):
    # (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n), z = 1.959964
    found = share(count, total)
    assert found.value == count / total
    assert (found.low, found.high) == pytest.approx((low, high), abs=1e-6)


@pytest.mark.parametrize(("count", "total"), [(-1, 5), (6, 5), (0, 0)])
def test_a_share_of_other_counts_is_refused(count, total):
    with pytest.raises(ValueError, match=f"got {count} and {total}"):
        share(count, total)
