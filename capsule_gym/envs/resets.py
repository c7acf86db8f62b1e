"""The start of an episode: random draws, which the core makes (`core/step/resets.hpp`), and given values."""

from collections.abc import Sequence
from enum import IntEnum
from types import SimpleNamespace
from typing import Any

import numpy as np

from capsule_gym.checks import check_number, short_repr
from capsule_gym.core import _core
from capsule_gym.core.elementary import log
from capsule_gym.core.layout import Row
from capsule_gym.core.native import evaluate
from capsule_gym.parameters import CONSTANTS, DISTURBANCES, Capsule, Disturbances, Randomization
from capsule_gym.parameters.limits import LARGEST, check_divisor
from capsule_gym.tasks.task import LARGEST_STATE, THETA_LIMIT, Draw, Task

# The purposes of random numbers. Each has its own stream, so that draws for one do not shift another.
Stream = IntEnum("Stream", "parameters initial_state disturbances task variation", start=0)


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


def start_table(theta: float, noise: float, noise_of_rate: float) -> np.ndarray:
    """The lines of `draw_table` for the initial state: theta +- noise in rad and theta_dot +- noise in rad/s."""
    centred = ((theta, noise), (0.0, noise_of_rate), (0.0, 0.0), (0.0, 0.0))
    lines = [(row, Stream.initial_state, row, *each, _core.CENTRED) for row, each in enumerate(centred)]
    return np.array(lines, np.float64)


def plant_table(randomization: Randomization, capsule: Capsule) -> np.ndarray:
    """The lines of `draw_table` for M in kg and mu: always two numbers, so that ranges do not shift the stream."""
    M, mu = randomization.M or (capsule.M, capsule.M), randomization.mu or (capsule.mu, capsule.mu)
    table = draw_table(Row.M, Stream.parameters, (Draw(*M), Draw(*mu)))
    if randomization.mu and randomization.log_mu:
        table[1, 4:] = log(mu[1] / mu[0]), _core.LOGARITHMIC
    return table


def draw_plant(randomization: Randomization, capsule: Capsule, rng: np.random.Generator) -> tuple[float, float]:
    """Draws M in kg and mu."""
    M, mu = evaluate("number_at", rng.random(2), *plant_table(randomization, capsule)[:, 3:].T)[0].tolist()
    return M, mu


def draw_table(first: int, stream: Stream, draws: Sequence[Draw]) -> np.ndarray:
    """The table that the core reads, shape (n, 6): a line for each number that an episode draws from a stream.

    A line is a `Draw` of the core (`layout.hpp`): the row of the world, from `first` on, the stream, the number's place
    in it, its lowest value, the range above that, and the distribution: 1.0 where the sign is drawn.
    """
    lines = [(first + n, stream, n, draw.low, draw.high - draw.low, draw.signed) for n, draw in enumerate(draws)]
    return np.array(lines, np.float64).reshape(-1, 6)


def write_options(drawn: np.ndarray, options: dict[str, Sequence[Any]], task: Task, settings: SimpleNamespace) -> None:
    """Writes the reset options that replace draws, one value per episode.

    Args:
        drawn: shape (lines of the tables, episodes): the numbers that the task's options draw, then the constants of
            the plant and the disturbances where they vary; changed.
        options: values by the name of their option; other options are ignored.
        task: the task.
        settings: the settings of the step.

    Raises:
        TypeError: if a value is of the wrong type.
        ValueError: if a value is out of range.
    """
    first = 0
    for name, option in task.options.items():
        last = first + len(option.draws)
        for n, value in enumerate(options.get(name, ())):
            drawn[first:last, n] = option.parse(f"options[{name!r}]", value)
        first = last
    for name, names in (("capsule", CONSTANTS), ("disturbances", DISTURBANCES)):
        for n, values in enumerate(options.get(name, ())):
            accepted = f"a dict with keys out of {names}"
            if not isinstance(values, dict) or set(values) - set(names):
                error = ValueError if isinstance(values, dict) else TypeError
                raise error(f"options[{name!r}] must be {accepted}, got {short_repr(values)}")
            for key, value in values.items():
                low, high = Disturbances.limits(key) if name == "disturbances" else (-LARGEST, LARGEST)
                if key == "latency":
                    # The length of the history; its product may be a rounding error below the latency that it is for.
                    high = (settings.history - 1) * settings.physics_steps * settings.physics_dt * (1.0 + 1e-9)
                in_words = f"a number from {low:g} to {high:g}"
                whose = f"options[{name!r}][{key!r}]"
                number = check_number(whose, value, in_words, low, high)
                drawn[first + names.index(key), n] = check_divisor(key, whose, number)
        first += len(names)


def check_state(name: str, state: Any, count: int) -> np.ndarray:
    """The states of `count` episodes as float64, shape (count, 4), from one for each or one for all."""
    _, *rest = LARGEST_STATE
    accepted = "|theta| < pi/2, |theta_dot| <= {:g} rad/s, |x| <= {:g} m and |x_dot| <= {:g} m/s".format(*rest)
    message = f"{name} must be [theta, theta_dot, x, x_dot] with {accepted}, got {short_repr(state)}"
    try:
        array = np.asarray(state, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise (ValueError if isinstance(error, OverflowError) else TypeError)(message) from None
    if array.shape not in ((4,), (count, 4)):
        raise ValueError(f"{message} of shape {array.shape}")
    if not ((np.abs(array) <= LARGEST_STATE).all() and (np.abs(array[..., 0]) < THETA_LIMIT).all()):
        raise ValueError(message)
    return np.broadcast_to(array, (count, 4))
