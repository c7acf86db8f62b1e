"""Access to the compiled core, `_core`, which takes arrays by their addresses.

The core contains the same code for several levels of instructions, which give the same bits. The
best level that the processor runs is chosen at import (`core/bindings/instruction_levels.hpp`); the
environment variable CAPSULE_GYM_LEVEL chooses another one.
"""

import math
import os
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from capsule_gym.checks import short_repr
from capsule_gym.core import _core

LEVEL = os.environ.get("CAPSULE_GYM_LEVEL", _core.LEVELS[0])
if LEVEL not in _core.LEVELS:
    raise ImportError(
        f"CAPSULE_GYM_LEVEL must be one of {_core.LEVELS} on this processor, "
        f"got {short_repr(LEVEL)}"
    )
_core.select_level(_core.LEVELS.index(LEVEL))

# Float64 in a cache line.
LINE = 8


def aligned_zeros(shape: tuple[int, ...]) -> np.ndarray:
    """Zeros, float64, whose first entry begins a cache line.

    A wide load that crosses one takes twice as long.
    """
    size = math.prod(shape)
    room = np.zeros(size + LINE)
    start = -(room.ctypes.data // 8) % LINE
    return room[start : start + size].reshape(shape)


def address(array: np.ndarray) -> int:
    """The address of an array, which the caller keeps alive.

    Raises:
        ValueError: if the array is not contiguous.
    """
    if not array.flags.c_contiguous:
        raise ValueError("array must be C-contiguous")
    return array.ctypes.data


def addressed(values: Iterable[Any]) -> list[float]:
    """Numbers as they are, and arrays by their addresses."""
    return [address(value) if isinstance(value, np.ndarray) else value for value in values]


def call(name: str, *values: np.ndarray | float) -> int:
    """Calls a function of `core/bindings/level.cpp` with numbers and arrays.

    Returns:
        What the function returns, -1 where it returns nothing.

    Raises:
        TypeError: if the number of arguments or the type of one is not that of the C++ function. An
            int is converted where a real number is due.
        ValueError: if there is no such function, or an array is not contiguous.
    """
    return _core.call(name, *addressed(values))


def ordered(names: Iterable[str], values: Mapping[str, float]) -> np.ndarray:
    """Numbers by name in the order in which the core reads them, float64."""
    return np.array([values[name] for name in names], np.float64)


def evaluate(
    name: str, *arguments: np.ndarray | float, plant: np.ndarray | None = None
) -> tuple[np.ndarray, ...]:
    """Evaluates a function of the core at every entry of its arguments, which are broadcast.

    Args:
        name: a function of `core/bindings/functions.hpp`; those of the plant need `plant`.
        *arguments: for a function of the plant M and mu come first.
        plant: the plant's constants, in the order of `_core.PLANT`; the arguments replace M and mu.

    Returns:
        The results, float64 arrays of the common shape.

    Raises:
        TypeError: if the function takes another number of arguments, or needs a plant, or none.
        ValueError: if there is no such function.
    """
    # `np.broadcast_arrays` takes several times as long as a function of a few numbers.
    shape = np.broadcast_shapes(*map(np.shape, arguments))
    inputs = np.empty((*shape, len(arguments)))
    outputs = np.empty((_core.MOST_RESULTS, *shape))
    for column, argument in enumerate(arguments):
        inputs[..., column] = argument
    constants = 0 if plant is None else address(plant)
    count = call(name, inputs, len(arguments), outputs, math.prod(shape), constants)
    return tuple(outputs[:count])
