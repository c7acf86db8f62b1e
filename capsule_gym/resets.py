"""The start of an episode: random draws and initial values of all quantities, compiled."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import IntEnum

import numpy as np

from capsule_gym.compilation import cached_entry, inlined, jitable
from capsule_gym.elementary import exp, log
from capsule_gym.layout import AT, LANES, MEMORY, Row
from capsule_gym.parameters import Capsule, Randomization
from capsule_gym.task import Draw


class Stream(IntEnum):
    """The purposes of random numbers. Each has its own stream, so that draws for one do not shift another."""

    parameters = 0
    initial_state = 1
    disturbances = 2
    task = 3
    variation = 4


WORD = 2**64


def make_key(seed: int) -> tuple[int, int]:
    """The key of the generator, two words, for a seed, any integer >= 0."""
    return seed % WORD, (seed >> 64) % WORD


def random_stream(seed: int, episode: int, stream: Stream) -> np.random.Generator:
    """The random numbers of one purpose in one episode of one environment, counted since its seeding.

    A counter-based generator needs no state between episodes, and an environment draws the same numbers alone and in a
    batch.
    """
    key = np.array(make_key(seed), np.uint64)
    return np.random.Generator(np.random.Philox(counter=[0, stream, episode, 0], key=key))


# Of Philox4x64-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", 2011), which numpy's `Philox` is: the
# factors of a round, and what the key grows by between rounds.
_FACTOR_0, _FACTOR_1 = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_STEP_0, _STEP_1 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)
_ROUNDS = 10
# Unsigned constants: numba makes a float of the sum of a signed and an unsigned integer.
_HALF, _LOW, _ZERO, _ONE = np.uint64(32), np.uint64(2**32 - 1), np.uint64(0), np.uint64(1)
# The upper 53 bits of a word give a float in [0, 1).
_SHIFT, _UNIT = np.uint64(11), 2.0**-53
PARAMETERS, INITIAL_STATE = np.uint64(Stream.parameters), np.uint64(Stream.initial_state)
# Numbers that `draw_four` draws at once.
_WORDS = 4


@inlined
def high_word(a: np.uint64, b: np.uint64) -> np.uint64:
    """The upper 64 bits of a product of two words."""
    a_0, a_1, b_0, b_1 = a & _LOW, a >> _HALF, b & _LOW, b >> _HALF
    middle = a_1 * b_0 + (a_0 * b_0 >> _HALF)
    return a_1 * b_1 + (middle >> _HALF) + (a_0 * b_1 + (middle & _LOW) >> _HALF)


@inlined
def draw_four(
    key_0: np.uint64, key_1: np.uint64, stream: np.uint64, episode: np.uint64, counter: np.uint64
) -> tuple[float, float, float, float]:
    """Four of `random_stream(..).random()`: with the counter 1 the first four, with 2 the next."""
    a, b, c, d = counter, stream, episode, _ZERO
    for _ in range(_ROUNDS):
        low_0, low_1 = _FACTOR_0 * a, _FACTOR_1 * c
        a, c = high_word(_FACTOR_1, c) ^ b ^ key_0, high_word(_FACTOR_0, a) ^ d ^ key_1
        b, d = low_1, low_0
        key_0 += _STEP_0
        key_1 += _STEP_1
    return _UNIT * (a >> _SHIFT), _UNIT * (b >> _SHIFT), _UNIT * (c >> _SHIFT), _UNIT * (d >> _SHIFT)


@inlined
def draw_two(key_0: np.uint64, key_1: np.uint64, stream: np.uint64, episode: np.uint64) -> tuple[float, float]:
    """The first two of `random_stream(..).random()`."""
    first, second, _, _ = draw_four(key_0, key_1, stream, episode, _ONE)
    return first, second


def plant_ranges(randomization: Randomization, capsule: Capsule) -> np.ndarray:
    """Lower end and width of the ranges of M (kg) and mu, and width of the range of log(mu); float64, shape (5,)."""
    M, mu = randomization.M or (capsule.M, capsule.M), randomization.mu or (capsule.mu, capsule.mu)
    growth_of_log = log(mu[1] / mu[0]) if randomization.mu and randomization.log_mu else 0.0
    return np.array([M[0], M[1] - M[0], mu[0], mu[1] - mu[0], growth_of_log])


@inlined
def plant_at(ranges: np.ndarray, share_M: float, share_mu: float) -> tuple[float, float]:
    """M in kg and mu at these shares, in [0, 1), of their ranges, or of the range of log(mu) where that is drawn."""
    low_M, growth_M, low_mu, growth_mu, growth_of_log = ranges[0], ranges[1], ranges[2], ranges[3], ranges[4]
    mu = low_mu * exp(growth_of_log * share_mu) if growth_of_log > 0.0 else low_mu + growth_mu * share_mu
    return low_M + growth_M * share_M, mu


def draw_plant(randomization: Randomization, capsule: Capsule, rng: np.random.Generator) -> tuple[float, float]:
    """Draws M in kg and mu: always two numbers of the stream, so that ranges do not shift it.

    Examples:
        >>> from capsule_gym import Capsule, Randomization
        >>> heavy = Randomization(M=(0.8, 1.0), mu=(0.01, 0.1), log_mu=True)
        >>> M, mu = draw_plant(heavy, Capsule(), np.random.default_rng(0))
        >>> 0.8 <= M < 1.0 and 0.01 <= mu < 0.1
        True
    """
    M, mu = plant_at(plant_ranges(randomization, capsule), *rng.random(2).tolist())
    return float(M), float(mu)


@jitable
def draw(
    ranges: np.ndarray, start: np.ndarray, rows: np.ndarray, keys: np.ndarray, episodes: np.ndarray, starts: np.ndarray
) -> None:
    """Draws the initial states and the plants of the next episodes of some environments.

    Args:
        ranges: from `plant_ranges`.
        start: middle (rad) and half width of the distribution of theta, and half width of that of theta_dot (rad/s).
        rows: indices of the environments, int64, shape (n,).
        keys: key of every environment, uint64, shape (num_envs, 2).
        episodes: number of episodes that every environment has begun since its seeding.
        starts: shape (6, n), the rows as the first of `Row`; written.

    Raises:
        IndexError: if there is no such environment.
    """
    for n in range(rows.size):
        i = rows[n]
        if i < 0 or i >= len(keys):
            raise IndexError
        share_M, share_mu = draw_two(keys[i, 0], keys[i, 1], PARAMETERS, np.uint64(episodes[i]))
        theta, theta_dot = start[0], 0.0
        if start[1] > 0.0 or start[2] > 0.0:
            share, share_dot = draw_two(keys[i, 0], keys[i, 1], INITIAL_STATE, np.uint64(episodes[i]))
            theta += start[1] * (2.0 * share - 1.0)
            theta_dot += start[2] * (2.0 * share_dot - 1.0)
        starts[Row.theta, n], starts[Row.theta_dot, n] = theta, theta_dot
        starts[Row.x, n] = starts[Row.x_dot, n] = 0.0
        starts[Row.M, n], starts[Row.mu, n] = plant_at(ranges, share_M, share_mu)


def draw_table(first: int, stream: Stream, draws: Sequence[Draw]) -> np.ndarray:
    """The table that `draw_rows` reads: a line for each number that an episode draws from a stream, in their order.

    Returns:
        Float64 of shape (n, 6): the row of the world, from `first` on, the stream, the number's place in it, its lowest
        value, the range above that, and 1.0 where its sign is drawn.
    """
    lines = [(first + n, stream, n, draw.low, draw.high - draw.low, draw.signed) for n, draw in enumerate(draws)]
    return np.array(lines, np.float64).reshape(-1, 6)


@jitable
def draw_rows(table: np.ndarray, rows: np.ndarray, keys: np.ndarray, episodes: np.ndarray, values: np.ndarray) -> None:
    """Draws the other values of the next episodes of some environments; the arguments are those of `draw`.

    `table` is from `draw_table`; `values`, of shape (lines of the table, n), are written.
    """
    for n in range(rows.size):
        i = rows[n]
        for k in range(len(table)):
            stream, place = np.uint64(table[k, 1]), int(table[k, 2])
            counter = np.uint64(1 + place // _WORDS)
            share = draw_four(keys[i, 0], keys[i, 1], stream, np.uint64(episodes[i]), counter)[place % _WORDS]
            low, growth, signed = table[k, 3], table[k, 4], table[k, 5] != 0.0
            # Where the sign is drawn, each half of [0, 1) stands for one sign.
            twice = 2.0 * share - 1.0
            values[k, n] = math.copysign(low + growth * abs(twice), twice) if signed else low + growth * share


@jitable
def renew(
    world: np.ndarray,
    memory: np.ndarray,
    m: float,
    g: float,
    rows: np.ndarray,
    starts: np.ndarray,
    episodes: np.ndarray,
) -> None:
    """Writes the initial values of the next episodes of some environments, and deactivates the others for one step.

    Args:
        world: see `kernels.advance`; changed.
        memory: memory of the law at the start of an episode.
        m: mass of the ball, kg.
        g: gravitational acceleration, m/s^2.
        rows: indices of the environments, int64, shape (n,).
        starts: from `draw`.
        episodes: number of episodes that every environment has begun; changed.
    """
    for b in range(len(world)):
        world[b, AT.active : AT.active + LANES] = 0.0
    for n in range(rows.size):
        block, j = world[rows[n] // LANES], rows[n] % LANES
        # Varied plants begin with `disturbances.begin`.
        block[j : AT.m : LANES] = 0.0
        block[MEMORY + j :: LANES] = 0.0
        for row in range(len(starts)):
            block[row * LANES + j] = starts[row, n]
        for cell in range(memory.size):
            block[MEMORY + cell * LANES + j] = memory[cell]
        block[AT.start_x + j] = block[AT.x + j]
        block[AT.smallest_normal_ratio + j] = math.inf
        block[AT.largest_theta + j] = abs(block[AT.theta + j])
        block[AT.largest_theta_dot + j] = abs(block[AT.theta_dot + j])
        block[AT.normal_force + j] = (block[AT.M + j] + m) * g
        block[AT.active + j] = 1.0
        episodes[rows[n]] += 1


def compiled() -> tuple[Callable[..., int], Callable[..., int]]:
    """`draw` and `renew` as compiled code."""
    indices, table = "int64[::1]", "float64[:, ::1]"
    drawing = f"void(float64[::1], float64[::1], {indices}, uint64[:, ::1], {indices}, {table})"
    renewing = f"void({table}, float64[::1], float64, float64, {indices}, {table}, {indices})"
    return cached_entry(draw, drawing).call, cached_entry(renew, renewing).call


def compiled_rows() -> Callable[..., int]:
    """`draw_rows` as compiled code."""
    indices, table = "int64[::1]", "float64[:, ::1]"
    return cached_entry(draw_rows, f"void({table}, {indices}, uint64[:, ::1], {indices}, {table})").call
