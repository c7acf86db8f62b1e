import numpy as np
import pytest
from scipy import stats

from agents.evaluation import statistics
from agents.evaluation.statistics import (
    estimate,
    interquartile_mean,
    learning_curve,
    paired_difference,
    performance_profile,
)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 100, 101])
def test_interquartile_mean_is_scipys_trimmed_mean(count):
    scores = np.random.default_rng(count).normal(size=(6, count))
    np.testing.assert_allclose(interquartile_mean(scores), stats.trim_mean(scores, 0.25, axis=-1), rtol=1e-12)


def test_interquartile_mean_known_answers():
    assert interquartile_mean([1, 2, 3, 1000]) == 2.5
    assert interquartile_mean([1, 2, 3, 4, 1000]) == 3.0
    # A quarter of failed ratios does not matter, more does.
    assert interquartile_mean([1, 1, 1, np.nan]) == 1.0
    assert np.isnan(interquartile_mean([1, 1, np.nan, np.nan]))
    assert interquartile_mean([1, 1, np.inf, np.inf]) == np.inf


def test_interval_agrees_with_scipys_bootstrap(monkeypatch):
    monkeypatch.setattr(statistics, "RESAMPLES", 20_000)
    scores = np.random.default_rng(2).gamma(2.0, size=(1, 100))
    ours = estimate(scores)
    theirs = stats.bootstrap(
        (scores[0],),
        lambda x, axis: stats.trim_mean(x, 0.25, axis=axis),
        method="percentile",
        n_resamples=20_000,
        rng=0,
    ).confidence_interval
    assert ours.low == pytest.approx(theirs.low, abs=0.01)
    assert ours.high == pytest.approx(theirs.high, abs=0.01)


def test_several_seeds_are_resampled_whole():
    # Seeds differ, episodes of a seed do not: the three-seed interval is exactly the worst and the best seed, which
    # resampling of single episodes would never give.
    scores = np.repeat([[1.0], [2.0], [6.0]], 100, axis=1)
    result = estimate(scores)
    assert (result.value, result.low, result.high, result.resampled) == (2.5, 1.0, 6.0, "seeds")
    # Episodes that vary while the seeds agree leave no doubt about another seed.
    same = estimate(np.repeat(np.arange(100.0)[None], 3, axis=0))
    assert same.low == pytest.approx(same.high)


def test_a_single_episode_has_no_interval():
    result = estimate([[1.5]])
    assert result.value == 1.5
    assert result.resampled == "nothing"
    assert np.isnan([result.low, result.high]).all()
    # Two have.
    result = estimate([[1.0, 2.0]])
    assert (result.low, result.value, result.high, result.resampled) == (1.0, 1.5, 2.0, "episodes")


def test_paired_difference_known_answers():
    reference = np.arange(8.0)[None]
    assert paired_difference(reference + 2.0, reference).to_dict() == {"iqm": 2.0, "low": 2.0, "high": 2.0}
    several = np.concatenate([reference + 1.0, reference + 2.0, reference + 6.0])
    result = paired_difference(several, reference)
    assert (result.low, result.high, result.resampled) == (1.0, 6.0, "seeds")
    # Both have seeds: the extremes pair the worst seed with the best and the other way round.
    both = paired_difference(several, np.concatenate([reference, reference + 1.0]))
    assert both.resampled == "seeds"
    assert 0.0 <= both.low < both.value < both.high <= 6.0
    with np.errstate(all="raise"):
        undefined = paired_difference([[np.inf] * 4], [[np.inf] * 4])
    assert np.isnan(undefined.value)


def test_performance_profile_known_answers():
    scores = np.array([[0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 0.0]])
    profile = performance_profile(scores, [-1.0, 0.0, 1.0, 2.5, 3.0])
    np.testing.assert_array_equal(profile.value, [1.0, 0.375, 0.25, 0.125, 0.0])
    # Both seeds the worse, or both the better.
    np.testing.assert_array_equal(profile.low, [1.0, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(profile.high, [1.0, 0.75, 0.5, 0.25, 0.0])
    # The episodes of one seed are resampled.
    alone = performance_profile(scores[:1], [0.5])
    assert alone.low < alone.value == 0.75 < alone.high


def test_learning_curves_hold_the_last_evaluation_and_never_a_later_one():
    curve = learning_curve([([10, 20, 30], [1.0, 2.0, 3.0]), ([5, 25, 40], [4.0, 6.0, 8.0])])
    np.testing.assert_array_equal(curve.x, [10, 20, 25, 30])
    np.testing.assert_array_equal(curve.value, [2.5, 3.0, 4.0, 4.5])
    np.testing.assert_array_equal(curve.low, [1.0, 2.0, 2.0, 3.0])
    np.testing.assert_array_equal(curve.high, [4.0, 4.0, 6.0, 6.0])
    alone = learning_curve([([1, 2], [1.0, 2.0])])
    assert np.isnan(alone.low).all()


def test_malformed_scores_are_refused():
    with pytest.raises(ValueError, match="begins at 5 steps and one that ends at 2"):
        learning_curve([([1, 2], [0.0, 0.0]), ([5, 6], [0.0, 0.0])])
    for scores in ([1.0, 2.0, 3.0], np.empty((1, 0))):
        with pytest.raises(ValueError, match=r"scores must have the shape .* got \((3,|1, 0)\)"):
            estimate(scores)
    with pytest.raises(ValueError, match="same episodes, got 3 and 2"):
        paired_difference([[1.0, 2.0, 3.0]], [[1.0, 2.0]])
