"""Bootstrap intervals of interquartile means, profiles and learning curves.

Scores have the shape (training seeds, episodes): every seed is judged on the same episodes. A scripted policy has
one row.

What is resampled. With several training seeds whole seeds are drawn with replacement, all episodes of a seed
together: the question is what another training run would give, and the episodes of one run are no independent
answers to it. With a single row the episodes are resampled: the interval then says how much the choice of plants
matters and nothing about another training run. With a single row of a single episode nothing can be resampled and
the interval is (NaN, NaN).

Few seeds give coarse intervals. With three seeds the 2.5 % and 97.5 % percentiles of the bootstrap are simply the
worst and the best seed (drawing one seed three times has a probability of 1/27, above 2.5 %), and such a range holds
the true median with a probability of 75 % (two seeds: 50 %, five: 94 %), not 95 %. Read it as a range.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

RESAMPLES = 4000
CONFIDENCE = 0.95
BOOTSTRAP_SEED = 2018
AT_ONCE = 100
_mean: Any = partial(np.mean, axis=-1)

Unit = Literal["seeds", "episodes", "nothing"]


@dataclass(frozen=True)
class Estimate:
    """A summary with its interval.

    Attributes:
        value: the interquartile mean, or the mean.
        low: lower end of the 95 % interval.
        high: upper end.
        resampled: what the bootstrap drew with replacement.
        kind: of the summary, "iqm" or "mean".
    """

    value: float
    low: float
    high: float
    resampled: Unit
    kind: str = "iqm"

    def to_dict(self) -> dict[str, float]:
        """The numbers as they stand in results."""
        return {self.kind: self.value, "low": self.low, "high": self.high}


def interquartile_mean(scores: ArrayLike) -> np.ndarray:
    """The mean of the middle half along the last axis.

    Of n sorted scores floor(n / 4) are dropped at either end and the rest weighs equally: exactly
    `scipy.stats.trim_mean(scores, 0.25)`, which rliable uses; no score is weighted by a fraction. NaN sorts as the
    largest score.

    Args:
        scores: shape (.., n) with n >= 1.

    >>> interquartile_mean([0.0, 1.0, 2.0, 900.0]).item()
    1.5
    """
    ordered = np.sort(np.asarray(scores, dtype=np.float64), axis=-1)
    count = ordered.shape[-1]
    cut = count // 4
    return np.asarray(ordered[..., cut : count - cut].mean(axis=-1))


def _percentiles(values: np.ndarray) -> tuple[float, float]:
    tail = 50.0 * (1.0 - CONFIDENCE)
    # A ratio without forward travel is infinite; between two of those the percentile is undefined, and NaN says so.
    with np.errstate(invalid="ignore"):
        low, high = np.percentile(values, [tail, 100.0 - tail])
    return float(low), float(high)


def _seed_percentiles(statistic: Callable[[np.ndarray], np.ndarray], *draws: np.ndarray) -> tuple[float, float]:
    """The percentiles of a statistic over draws of seeds, of one policy or of two."""
    # The order of seeds does not matter, which leaves few distinct draws (ten for three seeds): each is computed once.
    in_order = np.hstack([np.sort(draw, axis=1) for draw in draws])
    distinct, inverse = np.unique(in_order, axis=0, return_inverse=True)
    # In parts: all draws of ten seeds at once would need hundreds of megabytes.
    parts = [statistic(distinct[first : first + AT_ONCE]) for first in range(0, len(distinct), AT_ONCE)]
    return _percentiles(np.concatenate(parts)[inverse.reshape(-1)])


def _checked(name: str, scores: ArrayLike) -> np.ndarray:
    array = np.asarray(scores, dtype=np.float64)
    if array.ndim != 2 or 0 in array.shape:
        raise ValueError(f"{name} must have the shape (training seeds >= 1, episodes >= 1), got {array.shape}")
    return array


def estimate(scores: ArrayLike, *, mean: bool = False) -> Estimate:
    """The interquartile mean of all scores with its 95 % percentile bootstrap interval.

    Args:
        scores: shape (training seeds, episodes).
        mean: take the mean instead.

    Raises:
        ValueError: if the scores are not of that shape.
    """
    array = _checked("scores", scores)
    return replace(_over_seeds(array, _mean), kind="mean") if mean else _over_seeds(array, interquartile_mean)


def _over_seeds(array: np.ndarray, statistic: Callable[[np.ndarray], np.ndarray]) -> Estimate:
    """A statistic over the last axis of all scores, shape (training seeds, episodes), with its interval."""
    seeds, episodes = array.shape
    value = float(statistic(array.reshape(-1)))
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    if seeds > 1:
        draws = rng.integers(seeds, size=(RESAMPLES, seeds))
        low, high = _seed_percentiles(lambda rows: statistic(array[rows].reshape(len(rows), -1)), draws)
        return Estimate(value, low, high, "seeds")
    if episodes > 1:
        low, high = _percentiles(statistic(array[0][rng.integers(episodes, size=(RESAMPLES, episodes))]))
        return Estimate(value, low, high, "episodes")
    return Estimate(value, float("nan"), float("nan"), "nothing")


def paired_difference(scores: ArrayLike, reference: ArrayLike, *, mean: bool = False) -> Estimate:
    """The interquartile mean of the differences, episode by episode, between two policies on the same episodes.

    Differences are taken between every training seed of the one and every seed of the other. Where either has
    several seeds, its seeds are resampled, those of both independently; else the episodes are. The interquartile
    mean of differences is not the difference of interquartile means.

    Args:
        scores: shape (training seeds, episodes).
        reference: shape (training seeds of the reference, episodes), of the same episodes in the same order.
        mean: take the mean of the differences instead.

    Raises:
        ValueError: if the scores are not of these shapes.
    """
    array, other = _checked("scores", scores), _checked("reference", reference)
    if array.shape[1] != other.shape[1]:
        raise ValueError(f"scores and reference must hold the same episodes, got {array.shape[1]} and {other.shape[1]}")
    # Infinite in both: undefined, and NaN says so.
    with np.errstate(invalid="ignore"):
        pairs = array[:, None, :] - other[None, :, :]
    rows, columns, episodes = pairs.shape
    if rows == 1 or columns == 1:
        return estimate(pairs.reshape(-1, episodes), mean=mean)
    summary, kind = (_mean, "mean") if mean else (interquartile_mean, "iqm")
    rng = np.random.default_rng(BOOTSTRAP_SEED)

    def statistic(drawn: np.ndarray) -> np.ndarray:
        chosen = pairs[drawn[:, :rows, None], drawn[:, None, rows:]]
        return np.asarray(summary(chosen.reshape(len(drawn), -1)))

    low, high = _seed_percentiles(
        statistic, rng.integers(rows, size=(RESAMPLES, rows)), rng.integers(columns, size=(RESAMPLES, columns))
    )
    return Estimate(float(summary(pairs.reshape(-1))), low, high, "seeds", kind)


def _means_of_seeds(values: np.ndarray) -> np.ndarray:
    """The means over the last axis, which is kept, where seeds are resampled: their mean needs nothing else."""
    return values if values[..., 0].size == 1 else values.mean(axis=-1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Curve:
    """Estimates over a variable, with pointwise 95 % intervals.

    Attributes:
        x: the variable, ascending, shape (n,).
        value: shape (n,).
        low: lower ends of the intervals, shape (n,).
        high: upper ends, shape (n,).
    """

    x: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray


def performance_profile(scores: ArrayLike, thresholds: ArrayLike) -> Curve:
    """The share of all episodes of all training seeds that score more than a threshold, over the threshold.

    Rliable's run-score distribution; what is resampled is as for `estimate`. The area under it, from 0 on, is the mean
    of scores that are not negative.

    Args:
        scores: shape (training seeds, episodes).
        thresholds: ascending, shape (n,).

    Raises:
        ValueError: if the scores are not of that shape.
    """
    array, x = _checked("scores", scores), np.asarray(thresholds, dtype=np.float64)
    above = [_means_of_seeds((array > threshold).astype(np.float64)) for threshold in x]
    return _curve(x, [_over_seeds(each, _mean) for each in above])


def learning_curve(runs: Sequence[tuple[ArrayLike, ArrayLike]]) -> Curve:
    """The interquartile mean over training seeds of their evaluations, over the steps of training.

    A run counts with its last evaluation so far, never with a later one; the curve starts where all runs have been
    evaluated once, and ends with the shortest.

    Args:
        runs: of each seed the steps of its evaluations, ascending, and their values; both of shape (evaluations,).

    Raises:
        ValueError: if the runs have no steps in common.
    """
    checked = [(np.asarray(steps, np.float64), np.asarray(values, np.float64)) for steps, values in runs]
    first, last = max(steps[0] for steps, _ in checked), min(steps[-1] for steps, _ in checked)
    if first > last:
        raise ValueError(f"runs must overlap, got one that begins at {first:g} steps and one that ends at {last:g}")
    every = np.unique(np.concatenate([steps for steps, _ in checked]))
    x = every[(every >= first) & (every <= last)]
    held = np.stack([values[np.searchsorted(steps, x, side="right") - 1] for steps, values in checked])
    return _curve(x, [estimate(column[:, None]) for column in held.T])


def _curve(x: np.ndarray, found: Sequence[Estimate]) -> Curve:
    value, low, high = (np.array([getattr(each, name) for each in found]) for name in ("value", "low", "high"))
    return Curve(x, value, low, high)
