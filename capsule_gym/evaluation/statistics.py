"""Interquartile means and means, with 95 % intervals and p-values.

Scores have the shape (training seeds, episodes): every seed is evaluated on the same episodes,
those of a set of plants. A scripted policy has one row.

All intervals are for another training run on other plants of the same distribution. The summary is
linearised in the scores (by its influence function), the variances of the means over seeds and over
plants are added, and Student's t has the degrees of freedom of Satterthwaite's approximation, four
or more for five seeds. An axis with a single seed or plant adds no variance: the interval of a
single run says nothing about another run. Two seeds have no interval: with the plants' variance
added, that of one degree of freedom would cover 87 %.

The percentile bootstrap over seeds, or over seeds and plants, covers less: with five seeds whose
spread is 0.3 of the plants', 80 and 90 % instead of 95 %
(`tests/capsule_gym/evaluation/test_statistics.py` measures the coverage of ours).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from capsule_gym.checks import as_floats, require

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A summary with its interval.

    Attributes:
        value: the interquartile mean, or the mean.
        low: lower end of the 95 % interval; NaN if there is a single score, two seeds differ or the
            value is not finite.
        high: upper end.
        kind: kind of the summary, "iqm" or "mean".
        p_value: two-sided p-value of the value 0, NaN where the ends are.
    """

    value: float
    low: float
    high: float
    kind: str = "iqm"
    p_value: float = np.nan

    def to_dict(self) -> dict[str, float]:
        """The numbers as in results."""
        return {self.kind: self.value, "low": self.low, "high": self.high}


def interquartile_mean(scores: ArrayLike) -> np.ndarray:
    """The mean of the middle half along the last axis.

    Of n sorted scores, floor(n / 4) are dropped at either end and the others have equal weights, as
    in `scipy.stats.trim_mean(scores, 0.25)`, which rliable uses.

    Args:
        scores: shape (.., n) with n >= 1.

    Raises:
        ValueError: if there is no score, or one is NaN or masked.

    >>> interquartile_mean([0.0, 1.0, 2.0, 900.0]).item()
    1.5
    """
    array = as_floats(scores)
    require(array.ndim > 0 and array.size > 0, "scores", "at least one number", scores)
    _check_scores(array)
    return _middle_mean(array)


def _check_scores(scores: np.ndarray) -> None:
    """Raises a ValueError if a score is NaN, as masked ones are."""
    count = int(np.isnan(scores).sum())
    if count:
        raise ValueError(f"scores must not be NaN, got NaN in {count} of {scores.size}")


def _middle_mean(scores: np.ndarray) -> np.ndarray:
    """The interquartile mean along the last axis; NaN sorts as the largest score."""
    ordered = np.sort(scores, axis=-1)
    count = ordered.shape[-1]
    cut = count // 4
    return np.asarray(ordered[..., cut : count - cut].mean(axis=-1))


def estimate(scores: ArrayLike, *, mean: bool = False) -> Estimate:
    """The interquartile mean of all scores with its 95 % interval.

    Args:
        scores: shape (training seeds, episodes).
        mean: take the mean instead, for shares; the interval is then limited to the range of the
            scores.

    Raises:
        ValueError: if the scores have another shape, or one is NaN or masked.
    """
    array = as_floats(scores)
    if array.ndim != 2 or 0 in array.shape:
        accepted = "the shape (training seeds >= 1, episodes >= 1)"
        raise ValueError(f"scores must have {accepted}, got {array.shape}")
    _check_scores(array)
    return _estimate(array, mean)


def _estimate(scores: np.ndarray, mean: bool) -> Estimate:
    """Computes `estimate` for scores with any number of axes of training runs before the last."""
    # Imported here, since the import takes a tenth of a second.
    try:
        from scipy.special import stdtr, stdtrit
    except ImportError as error:
        raise ImportError('intervals need scipy: pip install "capsule-gym[paper]"') from error

    kind = "mean" if mean else "iqm"
    value = float(scores.mean() if mean else _middle_mean(scores.reshape(-1)))
    if not np.isfinite(value) or scores.size == 1:
        return Estimate(value, np.nan, np.nan, kind)
    influence = scores if mean else _influence_on_interquartile_mean(scores)
    variance = 0.0
    # The denominator of Satterthwaite's degrees of freedom.
    squares = 0.0
    for axis, count in enumerate(scores.shape):
        if count > 1:
            others = tuple(other for other in range(scores.ndim) if other != axis)
            part = float(influence.mean(axis=others).var(ddof=1)) / count
            variance += part
            squares += part * part / (count - 1)
    half = 0.0
    p_value = float(value == 0.0)
    if variance != 0.0:
        if 2 in scores.shape[:-1]:
            return Estimate(value, np.nan, np.nan, kind)
        degrees = variance**2 / squares
        deviation = variance**0.5
        quantile = float(stdtrit(degrees, 0.5 + 0.5 * CONFIDENCE))
        half = quantile * deviation
        p_value = 2.0 * float(stdtr(degrees, -abs(value) / deviation))
    low, high = value - half, value + half
    if mean:
        low = max(low, float(scores.min()))
        high = min(high, float(scores.max()))
    return Estimate(value, low, high, kind, p_value)


def _influence_on_interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """The scores of which the interquartile mean is the mean, to first order."""
    ordered = np.sort(scores, axis=None)
    cut = scores.size // 4
    # A score beyond a quartile counts as the quartile; NaN sorts as the largest score.
    largest_last = np.where(np.isnan(scores), np.inf, scores)
    clipped = np.clip(largest_last, ordered[cut], ordered[-1 - cut])
    return clipped / (1.0 - 2.0 * cut / scores.size)


def paired_difference(scores: ArrayLike, reference: ArrayLike, *, mean: bool = False) -> Estimate:
    """The interquartile mean of the differences between two policies on the same episodes.

    Differences are taken between every training seed of one policy and every seed of the other. The
    interquartile mean of differences is not the difference of interquartile means.

    Args:
        scores: shape (training seeds, episodes).
        reference: shape (training seeds of the reference, episodes).
        mean: take the mean of the differences instead, for shares.

    Raises:
        ValueError: if the scores have other shapes, or one is NaN or masked.
    """
    array = as_floats(scores)
    other = as_floats(reference)
    two_axes = array.ndim == other.ndim == 2
    if not two_axes or array.shape[1] != other.shape[1] or 0 in array.shape + other.shape:
        got = f"{array.shape} and {other.shape}"
        raise ValueError(f"scores and reference must contain the same episodes, got {got}")
    _check_scores(array)
    _check_scores(other)
    # The difference of two infinite scores is NaN, without a warning.
    with np.errstate(invalid="ignore"):
        return _estimate(array[:, None, :] - other[None, :, :], mean)


def adjust(p_values: ArrayLike) -> np.ndarray:
    """Adjusts the p-values of several comparisons by Holm's method.

    If the comparisons with an adjusted p-value below 0.05 are said to differ, all statements are
    true with a probability of at least 95 %, however many comparisons there are.

    Args:
        p_values: one for each comparison; NaN counts as 1.

    >>> adjust([0.01, 0.04, 0.03]).tolist()
    [0.03, 0.06, 0.06]
    """
    values = np.nan_to_num(as_floats(p_values), nan=1.0)
    order = np.argsort(values)
    multiples = values[order] * np.arange(len(values), 0, -1)
    adjusted = np.empty_like(values)
    adjusted[order] = np.minimum(np.maximum.accumulate(multiples), 1.0)
    return adjusted


def lowest_decile(scores: ArrayLike) -> float:
    """The value below which the means over training seeds of a tenth of the episodes are.

    Args:
        scores: shape (training seeds, episodes).
    """
    return float(np.quantile(as_floats(scores).mean(axis=0), 0.1))


def share(count: int, total: int) -> Estimate:
    """The share of episodes in which something happens, with Wilson's 95 % interval.

    All episodes count as independent.

    Args:
        count: number of these episodes.
        total: number of all episodes.

    Raises:
        ValueError: if `total` is not positive, or `count` is not in [0, total].
    """
    if total < 1 or not 0 <= count <= total:
        raise ValueError(f"count must be in [0, total] and total >= 1, got {count} and {total}")
    from scipy.stats import binomtest

    interval = binomtest(count, total).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(count / total, float(interval.low), float(interval.high), "mean")
