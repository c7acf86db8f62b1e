"""The network of a trained policy in strict float64, for any number of environments.

An environment is a lane, as in `capsule_gym.kernels`: every loop runs over LANES of them, of which the compiler takes
several at once. Each unit adds its inputs in their order, bias first, one fused multiply-add after the other, so that
an action depends on nothing but its own observation: neither on the batch nor on the instruction set.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numba import types

from capsule_gym import task
from capsule_gym.compilation import compile_now, fingerprint, inlined, inner, jitable, kernel, use_widest_vectors
from capsule_gym.exponential import tanh
from capsule_gym.kernels import LANES, load, store
from capsule_gym.trigonometry import fma

# Units that are computed together, and inputs that are added to them at once: the registers of AVX2 and AVX-512 hold
# no more. Every width is filled up with zeros to a multiple.
TILE = 4
# Up to this many lanes are computed as they are; more of them with all LANES, whose number the compiler knows.
FEW = 8
# Float64 in a cache line.
LINE = 8
# Where the widths begin in a packed network.
HEADER = 4

Layer = tuple[np.ndarray, np.ndarray]


def filled(width: int) -> int:
    """The smallest multiple of TILE that is not below a width."""
    return -(-width // TILE) * TILE


def pack(
    layers: Sequence[Layer], mean: np.ndarray, scale: np.ndarray, clip: float, *, relu: bool, tanh_squashing: bool
) -> np.ndarray:
    """A network in one array, which is all that compiled code needs to be given.

    Args:
        layers: weights (outputs, inputs) and biases (outputs,) of each layer, in order; the last has one output.
        mean: what is subtracted from an observation, shape (entries,).
        scale: what the difference is multiplied with, likewise.
        clip: largest size of what comes out of that.
        relu: whether max(0, .) follows the hidden layers, else tanh.
        tanh_squashing: whether tanh brings the last output to [-1, 1], else it is clipped.

    Returns:
        Float64: number of layers, the two switches, clip, the filled widths, mean, scale, and each layer's biases and
        weights, row by row.
    """
    entries = len(mean)
    widths = [filled(entries), *(filled(len(bias)) for _, bias in layers)]
    normalisation = np.zeros((2, widths[0]))
    normalisation[0, :entries], normalisation[1, :entries] = mean, scale
    parts = [np.array([len(layers), relu, tanh_squashing, clip, *widths], np.float64), normalisation.ravel()]
    for (weights, bias), inputs, outputs in zip(layers, widths[:-1], widths[1:], strict=True):
        biases, matrix = np.zeros(outputs), np.zeros((outputs, inputs))
        biases[: len(bias)] = bias
        matrix[: len(bias), : weights.shape[1]] = weights
        parts += [biases, matrix.ravel()]
    return np.concatenate(parts)


@jitable
def workspace(network: np.ndarray) -> np.ndarray:
    """What `think` works in, shape (2, units of the widest layer times LANES)."""
    widest = 0
    for layer in range(int(network[0]) + 1):
        widest = max(widest, int(network[HEADER + layer]))
    size = widest * LANES
    room = np.zeros(2 * size + LINE)
    # A wide load that crosses a cache line takes twice as long.
    start = -(room.ctypes.data // 8) % LINE
    return room[start : start + 2 * size].reshape(2, size)


@inlined
def normalise(network: np.ndarray, observations: np.ndarray, first: int, n: int, given: np.ndarray) -> None:
    """Writes the normalised observations first..first + n - 1 into the lanes; what fills up their width stays zero."""
    widths, clip, width = int(network[0]) + 1, network[3], int(network[HEADER])
    for i in range(observations.shape[1]):
        mean, scale = network[HEADER + widths + i], network[HEADER + widths + width + i]
        for j in range(n):
            given[i * LANES + j] = task.clip((observations[first + j, i] - mean) * scale, clip)


@inlined
def add(total: float, weights: tuple[float, ...], inputs: tuple[float, ...]) -> float:
    """The total with TILE products added, in their order."""
    total = fma(weights[0], inputs[0], total)
    total = fma(weights[1], inputs[1], total)
    total = fma(weights[2], inputs[2], total)
    return fma(weights[3], inputs[3], total)


@inlined
def add_tile(
    weights: np.ndarray, at: int, inputs: int, n: int, given: np.ndarray, i: int, sums: np.ndarray, k: int
) -> None:
    """Adds the inputs i, i + 1, .. of n lanes to the sums k, k + 1, .., with the weights that begin at `at`."""
    w0, w1 = load(weights, at, 1, TILE), load(weights, at + inputs, 1, TILE)
    w2, w3 = load(weights, at + 2 * inputs, 1, TILE), load(weights, at + 3 * inputs, 1, TILE)
    for j in range(n):
        x = load(given, i * LANES + j, LANES, TILE)
        s0, s1, s2, s3 = load(sums, k * LANES + j, LANES, TILE)
        store(sums, k * LANES + j, LANES, (add(s0, w0, x), add(s1, w1, x), add(s2, w2, x), add(s3, w3, x)))


def connect(bias: np.ndarray, weights: np.ndarray, n: int, given: np.ndarray, sums: np.ndarray) -> None:
    """What a layer makes of n lanes in `given`, before its activation.

    A function of its own, with arrays of its own: where the compiler can tell that they do not overlap it tries to keep
    all sums of a tile in registers, of which there are too few, and the loop takes half as long again.
    """
    use_widest_vectors()
    inputs = weights.size // bias.size
    for k in range(0, bias.size, TILE):
        start = load(bias, k, 1, TILE)
        for j in range(n):
            store(sums, k * LANES + j, LANES, start)
        for i in range(0, inputs, TILE):
            if n > FEW:
                add_tile(weights, k * inputs + i, inputs, LANES, given, i, sums, k)
            else:
                add_tile(weights, k * inputs + i, inputs, n, given, i, sums, k)


@inlined
def activate(sums: np.ndarray, units: int, n: int, relu: bool) -> None:
    """Applies the activation to the sums of some units."""
    use_widest_vectors()
    for k in range(units):
        for j in range(k * LANES, k * LANES + n):
            total = load(sums, j, 1, 1)[0]
            # What is no number stays none.
            store(sums, j, 1, ((0.0 if total < 0.0 else total) if relu else tanh(total),))


connect_apart = inner(connect)


def think(network: np.ndarray, observations: np.ndarray, first: int, n: int, lanes: np.ndarray) -> np.ndarray:
    """The actions of up to LANES environments.

    Args:
        network: from `pack`.
        observations: shape (environments, entries), float32.
        first: first environment.
        n: how many.
        lanes: from `workspace`; changed.

    Returns:
        The n actions, a part of `lanes`: float64, in [-1, 1].
    """
    layers, relu, tanh_squashing = int(network[0]), network[1] != 0.0, network[2] != 0.0
    given, sums = lanes[0], lanes[1]
    normalise(network, observations, first, n, given)
    at = HEADER + layers + 1 + 2 * int(network[HEADER])
    for layer in range(layers):
        inputs, outputs = int(network[HEADER + layer]), int(network[HEADER + layer + 1])
        end = at + outputs + outputs * inputs
        connect_apart(network[at : at + outputs], network[at + outputs : end], n, given, sums)
        if layer < layers - 1:
            activate(sums, outputs, n, relu)
        given, sums = sums, given
        at = end
    if tanh_squashing:
        activate(given, 1, n, False)
    for j in range(n):
        given[j] = task.clip(given[j], 1.0)
    return given[:n]


think_apart = inner(think)


def decide(network: np.ndarray, observations: np.ndarray, actions: np.ndarray) -> None:
    """The actions of any number of environments.

    Args:
        network: from `pack`.
        observations: shape (n, entries), float32.
        actions: shape (n, 1), float32; written.
    """
    lanes = workspace(network)
    for first in range(0, len(observations), LANES):
        n = min(LANES, len(observations) - first)
        found = think_apart(network, observations, first, n, lanes)
        for j in range(n):
            actions[first + j, 0] = found[j]


@lru_cache(maxsize=1)
def decision() -> Any:
    """`decide` as compiled code: it checks neither dtype nor shape nor contiguity of what it is given."""
    compiled = kernel(decide, fingerprint(decide)[:16], {})
    signature = (types.float64[::1], types.float32[:, ::1], types.float32[:, ::1])
    compile_now(compiled, signature, "the network of trained policies")
    # Read-only arrays are another type to numba, and would be compiled for anew.
    return next(iter(compiled.overloads.values())).entry_point
