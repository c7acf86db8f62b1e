import numpy as np
import pytest
from scipy import stats

from agents.evaluation.statistics import estimate, interquartile_mean, paired_difference


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 7, 8, 99, 100, 101, 300])
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


def test_interval_is_deterministic_and_holds_the_value():
    scores = np.random.default_rng(0).normal(size=(1, 100))
    first = estimate(scores)
    assert first == estimate(scores)
    assert first.low < first.value < first.high
    assert first.resampled == "episodes"


def test_interval_covers_the_truth_as_often_as_it_says():
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(400):
        result = estimate(rng.normal(loc=3.0, size=(1, 100)), resamples=400)
        hits += result.low <= 3.0 <= result.high
    # 95 % nominal; the percentile bootstrap is known to fall a little short, and 400 trials scatter by 1.1 %.
    assert 0.91 <= hits / 400 <= 0.985


def test_interval_agrees_with_scipys_bootstrap():
    scores = np.random.default_rng(2).gamma(2.0, size=(1, 100))
    ours = estimate(scores, resamples=20_000)
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


def test_infinite_scores_give_no_warning():
    result = estimate([[1.0, 1.0, np.inf, np.inf]])
    assert result.value == np.inf
    assert np.isnan(result.high) or result.high == np.inf


def test_paired_difference_is_narrower_than_unpaired():
    rng = np.random.default_rng(3)
    plants = rng.normal(scale=5.0, size=100)
    ours = plants + 1.0 + rng.normal(scale=0.1, size=(1, 100))
    reference = plants + rng.normal(scale=0.1, size=(1, 100))
    paired = paired_difference(ours, reference)
    assert paired.value == pytest.approx(1.0, abs=0.1)
    assert paired.low > 0.9
    unpaired_width = (estimate(ours).high - estimate(ours).low) + (estimate(reference).high - estimate(reference).low)
    assert paired.high - paired.low < 0.1 * unpaired_width
    assert paired.resampled == "episodes"


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


def test_malformed_scores_are_refused():
    with pytest.raises(ValueError, match=r"scores must have the shape .* got \(3,\)"):
        estimate([1.0, 2.0, 3.0])
    with pytest.raises(ValueError, match=r"got \(1, 0\)"):
        estimate(np.empty((1, 0)))
    with pytest.raises(ValueError, match="same episodes, got 3 and 2"):
        paired_difference([[1.0, 2.0, 3.0]], [[1.0, 2.0]])
