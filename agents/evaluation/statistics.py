"""Interquartile means with bootstrap intervals.

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

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

RESAMPLES = 4000
CONFIDENCE = 0.95
BOOTSTRAP_SEED = 2018

Unit = Literal["seeds", "episodes", "nothing"]


@dataclass(frozen=True)
class Estimate:
    """A summary with its interval.

    Attributes:
        value: the interquartile mean.
        low: lower end of the 95 % interval.
        high: upper end.
        resampled: what the bootstrap drew with replacement.
    """

    value: float
    low: float
    high: float
    resampled: Unit

    def to_dict(self) -> dict[str, float]:
        """The numbers as they stand in results."""
        return {"iqm": self.value, "low": self.low, "high": self.high}


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


def _draw(rng: np.random.Generator, count: int, resamples: int) -> np.ndarray:
    """Indices with replacement, shape (resamples, count)."""
    return rng.integers(count, size=(resamples, count))


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
    return _percentiles(statistic(distinct)[inverse.reshape(-1)])


def _checked(name: str, scores: ArrayLike) -> np.ndarray:
    array = np.asarray(scores, dtype=np.float64)
    if array.ndim != 2 or 0 in array.shape:
        raise ValueError(f"{name} must have the shape (training seeds >= 1, episodes >= 1), got {array.shape}")
    return array


def estimate(scores: ArrayLike, *, resamples: int = RESAMPLES, seed: int = BOOTSTRAP_SEED) -> Estimate:
    """The interquartile mean of all scores with its 95 % percentile bootstrap interval.

    Args:
        scores: shape (training seeds, episodes).
        resamples: number of bootstrap resamples.
        seed: of the resampling: the same scores give the same interval.

    Raises:
        ValueError: if the scores are not of that shape.
    """
    array = _checked("scores", scores)
    seeds, episodes = array.shape
    value = float(interquartile_mean(array.reshape(-1)))
    rng = np.random.default_rng(seed)
    if seeds > 1:
        draws = _draw(rng, seeds, resamples)
        low, high = _seed_percentiles(lambda rows: interquartile_mean(array[rows].reshape(len(rows), -1)), draws)
        return Estimate(value, low, high, "seeds")
    if episodes > 1:
        low, high = _percentiles(interquartile_mean(array[0][_draw(rng, episodes, resamples)]))
        return Estimate(value, low, high, "episodes")
    return Estimate(value, float("nan"), float("nan"), "nothing")


def paired_difference(
    scores: ArrayLike, reference: ArrayLike, *, resamples: int = RESAMPLES, seed: int = BOOTSTRAP_SEED
) -> Estimate:
    """The interquartile mean of the differences, episode by episode, between two policies on the same episodes.

    Differences are taken between every training seed of the one and every seed of the other. Where either has
    several seeds, its seeds are resampled, those of both independently; else the episodes are. The interquartile
    mean of differences is not the difference of interquartile means.

    Args:
        scores: shape (training seeds, episodes).
        reference: shape (training seeds of the reference, episodes), of the same episodes in the same order.
        resamples: number of bootstrap resamples.
        seed: of the resampling.

    Raises:
        ValueError: if the scores are not of these shapes.
    """
    array, other = _checked("scores", scores), _checked("reference", reference)
    if array.shape[1] != other.shape[1]:
        raise ValueError(
            f"scores and reference must hold the same episodes, got {array.shape[1]} and {other.shape[1]} of them"
        )
    # Infinite in both: undefined, and NaN says so.
    with np.errstate(invalid="ignore"):
        differences = array[:, None, :] - other[None, :, :]
    rows, columns, episodes = differences.shape
    if rows == 1 or columns == 1:
        return estimate(differences.reshape(-1, episodes), resamples=resamples, seed=seed)
    rng = np.random.default_rng(seed)

    def statistic(drawn: np.ndarray) -> np.ndarray:
        pairs = differences[drawn[:, :rows, None], drawn[:, None, rows:]]
        return interquartile_mean(pairs.reshape(len(drawn), -1))

    low, high = _seed_percentiles(statistic, _draw(rng, rows, resamples), _draw(rng, columns, resamples))
    return Estimate(float(interquartile_mean(differences.reshape(-1))), low, high, "seeds")
