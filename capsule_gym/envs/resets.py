"""The start of an episode: given values replace the draws of `core/step/resets.hpp`."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from capsule_gym.checks import check_number, require, short_repr
from capsule_gym.core import _core
from capsule_gym.core.layout import Description
from capsule_gym.parameters import CONSTANTS, DISTURBANCES, Disturbances
from capsule_gym.parameters.disturbances import DELAYS
from capsule_gym.parameters.limits import LARGEST, check_divisor
from capsule_gym.tasks.task import LARGEST_STATE, THETA_LIMIT, Task

RESET_OPTIONS = ("M", "mu", "state", "changes", "capsule", "disturbances")
CONSTANT_LIMITS = dict.fromkeys(CONSTANTS, (-LARGEST, LARGEST))
DISTURBANCE_LIMITS = {name: Disturbances.limits(name) for name in DISTURBANCES}


def check_options(options: dict[str, Any] | None, further: Iterable[str]) -> dict[str, Any]:
    """Raises an error for options of `reset` outside `RESET_OPTIONS` and further ones."""
    if options is None:
        return {}
    accepted = (*RESET_OPTIONS, *further)
    required = f"a dict with keys out of {accepted}"
    require(isinstance(options, dict), "options", required, options, TypeError)
    require(set(options) <= set(accepted), "options", required, list(options))
    return options


def make_key(seed: int) -> tuple[int, int]:
    """The key of the generator, two words of 64 bits, for a seed, any integer >= 0."""
    return seed % 2**64, (seed >> 64) % 2**64


def random_stream(seed: int, episode: int, stream: str) -> np.random.Generator:
    """The random numbers of one purpose in one episode of one environment.

    A counter-based generator needs no state between episodes, and an environment draws the same
    numbers alone and in a batch.

    Args:
        seed: seed of the environment.
        episode: number of the episode since the seeding.
        stream: the purpose, out of `_core.STREAMS`.
    """
    key = np.array(make_key(seed), np.uint64)
    counter = [0, _core.STREAMS.index(stream), episode, 0]
    return np.random.Generator(np.random.Philox(counter=counter, key=key))


def write_options(
    drawn: np.ndarray, options: dict[str, Sequence[Any]], task: Task, description: Description
) -> None:
    """Writes the reset options that replace draws, one value per episode.

    Args:
        drawn: shape (lines of the draw table, episodes): the numbers that the episodes draw;
            changed.
        options: values by the name of their option; other options are ignored.
        task: the task.
        description: that of the environment.

    Raises:
        TypeError: if a value is of the wrong type.
        ValueError: if a value is out of range.
    """
    layout = description.layout
    row = layout.task_draws
    for name, count in task.option_sizes.items():
        for n, value in enumerate(options.get(name, ())):
            drawn[row : row + count, n] = task.parse(name, value)
        row += count
    for n, values in enumerate(options.get("capsule", ())):
        for name, number in _check_values("capsule", values, CONSTANT_LIMITS).items():
            drawn[layout.constant_draws + CONSTANTS.index(name), n] = number
    settings = description.settings
    reach = {name: (0.0, getattr(settings, f"longest_{name}")) for name in DELAYS}
    limits = DISTURBANCE_LIMITS | reach
    for n, values in enumerate(options.get("disturbances", ())):
        for name, number in _check_values("disturbances", values, limits).items():
            drawn[layout.disturbance_draws + DISTURBANCES.index(name), n] = number


def _check_values(
    option: str, values: Any, limits: dict[str, tuple[float, float]]
) -> dict[str, float]:
    """The numbers of a dict in a reset option, by names with these limits."""
    option = f"options[{option!r}]"
    accepted = f"a dict with keys out of {tuple(limits)}"
    require(isinstance(values, dict), option, accepted, values, TypeError)
    require(set(values) <= set(limits), option, accepted, values)
    numbers: dict[str, float] = {}
    for name, value in values.items():
        low, high = limits[name]
        whose = f"{option}[{name!r}]"
        number = check_number(whose, value, f"a number from {low:g} to {high:g}", low, high)
        numbers[name] = check_divisor(name, whose, number)
    return numbers


def check_state(name: str, state: Any, count: int) -> np.ndarray:
    """The states of episodes, float64, shape (count, 4), from one for each or one for all."""
    _, theta_dot, x, x_dot = LARGEST_STATE
    limits = f"|theta_dot| <= {theta_dot:g} rad/s, |x| <= {x:g} m and |x_dot| <= {x_dot:g} m/s"
    accepted = f"[theta, theta_dot, x, x_dot] with |theta| < pi/2, {limits}"
    message = f"{name} must be {accepted}, got {short_repr(state)}"
    try:
        array = np.asarray(state, dtype=np.float64)
    except OverflowError:
        raise ValueError(message) from None
    except (TypeError, ValueError):
        raise TypeError(message) from None
    if array.shape not in ((4,), (count, 4)):
        raise ValueError(f"{message} of shape {array.shape}")
    sizes = np.abs(array)
    if not (sizes <= LARGEST_STATE).all() or not (sizes[..., 0] < THETA_LIMIT).all():
        raise ValueError(message)
    return np.broadcast_to(array, (count, 4))
