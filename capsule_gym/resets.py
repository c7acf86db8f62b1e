"""The random draws at the start of an episode; the core draws them (`capsule_gym/core/resets.hpp`)."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np

from capsule_gym.elementary import log
from capsule_gym.native import evaluate
from capsule_gym.parameters import Capsule, Randomization
from capsule_gym.task import Draw


class Stream(IntEnum):
    """The purposes of random numbers. Each has its own stream, so that draws for one do not shift another."""

    parameters = 0
    initial_state = 1
    disturbances = 2
    task = 3
    variation = 4


def make_key(seed: int) -> tuple[int, int]:
    """The key of the generator, two words of 64 bits, for a seed, any integer >= 0."""
    return seed % 2**64, (seed >> 64) % 2**64


def random_stream(seed: int, episode: int, stream: Stream) -> np.random.Generator:
    """The random numbers of one purpose in one episode of one environment, counted since its seeding.

    A counter-based generator needs no state between episodes, and an environment draws the same numbers alone and in a
    batch.
    """
    key = np.array(make_key(seed), np.uint64)
    return np.random.Generator(np.random.Philox(counter=[0, stream, episode, 0], key=key))


def plant_ranges(randomization: Randomization, capsule: Capsule) -> np.ndarray:
    """Lower end and width of the ranges of M (kg) and mu, and width of the range of log(mu); float64, shape (5,)."""
    M, mu = randomization.M or (capsule.M, capsule.M), randomization.mu or (capsule.mu, capsule.mu)
    growth_of_log = float(log(mu[1] / mu[0])) if randomization.mu and randomization.log_mu else 0.0
    return np.array([M[0], M[1] - M[0], mu[0], mu[1] - mu[0], growth_of_log])


def plant_at(ranges: np.ndarray, share_M: float, share_mu: float) -> tuple[float, float]:
    """M in kg and mu at these shares, in [0, 1), of their ranges, or of the range of log(mu) where that is drawn."""
    M, mu = evaluate("plant_at", *ranges, share_M, share_mu)
    return float(M), float(mu)


def draw_plant(randomization: Randomization, capsule: Capsule, rng: np.random.Generator) -> tuple[float, float]:
    """Draws M in kg and mu: always two numbers of the stream, so that ranges do not shift it."""
    return plant_at(plant_ranges(randomization, capsule), *rng.random(2).tolist())


def draw_table(first: int, stream: Stream, draws: Sequence[Draw]) -> np.ndarray:
    """The table that the core reads, shape (n, 6): a line for each number that an episode draws from a stream.

    A line is the row of the world, from `first` on, the stream, the number's place in it, its lowest value, the range
    above that, and 1.0 where its sign is drawn.
    """
    lines = [(first + n, stream, n, draw.low, draw.high - draw.low, draw.signed) for n, draw in enumerate(draws)]
    return np.array(lines, np.float64).reshape(-1, 6)
