import numpy as np
import pytest
from scipy import stats

from capsule_gym.evaluation.statistics import estimate, interquartile_mean, paired_difference


def test_interquartile_mean_is_scipys_trimmed_mean():
    for count in (1, 2, 3, 4, 5, 100, 101):
        scores = np.random.default_rng(count).normal(size=(6, count))
        np.testing.assert_allclose(
            interquartile_mean(scores), stats.trim_mean(scores, 0.25, axis=-1), rtol=1e-12
        )
    # A quarter of failed ratios has no effect; a larger share does.
    assert interquartile_mean([1, 1, 1, np.nan]) == 1.0 and np.isnan(
        interquartile_mean([1, 1, np.nan, np.nan])
    )
    assert interquartile_mean([1, 1, np.inf, np.inf]) == np.inf


def simulated(rng, seeds, plants, spreads, failing):
    """Scores of a policy that vary over seeds and over plants, the latter with a tail; a few
    episodes fail."""
    of_seeds, of_plants, rest = spreads
    scores = (
        18.0
        + of_seeds * rng.normal(size=(seeds, 1))
        - of_plants * (0.5 * rng.gamma(4.0, size=(1, plants)) - 2.0)
    )
    scores = scores + rest * rng.normal(size=(seeds, plants))
    return np.where(rng.random((seeds, plants)) < failing, 0.3 * scores, scores)


def test_intervals_cover_another_training_run_on_other_plants():
    rng, shares = np.random.default_rng(4), []
    spreads = (0.3, 1.0, 0.2), (0.05, 1.0, 0.2), (0.1, 2.0, 0.5)
    for seeds, plants in ((1, 100), (5, 100), (5, 400), (10, 100)):
        for n, spread in enumerate(spreads):
            chosen = (0.0, *spread[1:]) if seeds == 1 else spread
            # Many runs, each on other plants.
            truth = interquartile_mean(
                np.hstack([simulated(rng, 1, 100, chosen, 0.03 * n) for _ in range(20_000)])
            )
            found = [estimate(simulated(rng, seeds, plants, chosen, 0.03 * n)) for _ in range(250)]
            shares.append(np.mean([each.low <= truth <= each.high for each in found]))
    assert np.mean(shares) >= 0.93 and min(shares) >= 0.9
    # The intervals are not too wide: for the mean of many plants, the interval is that of a normal
    # distribution.
    scores = rng.normal(size=(1, 10_000))
    assert estimate(scores, mean=True).high - scores.mean() == pytest.approx(0.0196, rel=0.03)


def test_intervals_of_known_scores():
    # The interval is Student's t, whether plants or seeds alone differ.
    scores = np.random.default_rng(2).normal(size=(1, 9))
    low, high = stats.t.interval(0.95, 8, scores.mean(), stats.sem(scores[0]))
    for result in (
        estimate(scores, mean=True),
        estimate(np.repeat(scores.T, 100, axis=1), mean=True),
    ):
        assert (result.low, result.high) == (pytest.approx(low), pytest.approx(high))
    # Plants differ and seeds do not: the interval is that of one seed.
    one = np.random.default_rng(3).normal(size=(1, 100))
    alone, same = estimate(one), estimate(np.repeat(one, 3, axis=0))
    assert same.high - same.low == pytest.approx(alone.high - alone.low, rel=0.02)
    # Neither plants nor seeds differ.
    assert estimate(np.ones((2, 3))).to_dict() == {"iqm": 1.0, "low": 1.0, "high": 1.0}
    # The interval of a share ends at 1.
    most = estimate([[1.0] * 99 + [0.0]], mean=True)
    assert most.kind == "mean" and most.low < most.value < most.high == 1.0
    for scores in ([[1.5]], [[1.0, np.inf, np.inf, np.inf]]):
        assert np.isnan([estimate(scores).low, estimate(scores).high]).all()
    # The interquartile mean discards up to a quarter of infinite ratios.
    assert np.isfinite(estimate([[1.0, 2.0, 3.0, np.inf]]).high)


def test_paired_difference_known_answers():
    reference = np.arange(8.0)[None]
    assert paired_difference(reference + 2.0, reference).to_dict() == {
        "iqm": 2.0,
        "low": 2.0,
        "high": 2.0,
    }
    several = np.concatenate([reference + 1.0, reference + 2.0, reference + 6.0])
    assert paired_difference(several, reference) == estimate(several - reference)
    # Variation over the reference's seeds that the policy does not share widens the interval.
    rng = np.random.default_rng(5)
    base, offsets = rng.normal(size=(5, 200)), rng.normal(size=(5, 1))
    both, alone = (
        paired_difference(several[:1, :1] + base, base + offsets),
        paired_difference(1.0 + base, base),
    )
    assert both.high - both.low > 3.0 * (alone.high - alone.low)
    with np.errstate(all="raise"):
        assert np.isnan(paired_difference([[np.inf] * 4], [[np.inf] * 4]).value)
