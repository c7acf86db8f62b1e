"""PPO's update in compiled code: forward and backward passes of both networks, each in its own thread, and Adam.

A sample is a lane. LANES samples of a minibatch are processed together: row by row, their numbers are contiguous and
fit into the processor's nearest caches. Three matrix products take almost all of the time: the forward pass of a layer,
the backward pass to its inputs, and the gradients of its weights.

Arithmetic is float32, and the compiler may fuse and reorder it. As with torch, equal starts give equal updates on one
machine, but not on different kinds of processors.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import Any

import numpy as np

from agents.fast_ppo.arithmetic import (
    F32,
    HALF,
    LARGEST,
    ONE,
    TILE,
    WIDEST_SPAN,
    ZERO,
    exponential,
    multiply,
    span,
    tanh,
)
from agents.training.algorithms import HALF_LOG_2_PI
from capsule_gym.compilation import jitable, use_widest_vectors
from capsule_gym.compiler import compile_allocating
from capsule_gym.network import Layer

# Samples that pass through the networks together.
LANES = 160
# Size of a cache line in float32.
LINE = 16
NORMAL = F32(HALF_LOG_2_PI)
# Adam's constants, SB3's defaults.
BETA_1, BETA_2, EPS = 0.9, 0.999, F32(1e-5)
DECAY_1, DECAY_2 = F32(1.0 - BETA_1), F32(1.0 - BETA_2)
# Further rows of numbers per sample, in addition to those of the networks.
Rows = namedtuple("Rows", "aim old_log_prob advantage log_std_slope gain squared_error divergence clipped")
ROW = Rows(*range(len(Rows._fields)))
# Names of the logged means.
LOSSES = ("policy_gradient_loss", "value_loss", "entropy_loss", "approx_kl", "clip_fraction")


@jitable
def filled(width: Any) -> Any:
    """Rounds a width, or each of several widths, up to a multiple of TILE."""
    return -(-width // TILE) * TILE


def matrices(packed: np.ndarray, layers: list[Layer]) -> Iterator[np.ndarray]:
    """Views of each layer's part of a packed array: the weights and, as the last column, the biases.

    A packed array contains the matrices of actor and critic row by row, padded with zeros to multiples of TILE, and
    then the logarithm of the standard deviation.
    """
    at = 0
    for weights, _ in layers:
        outputs, inputs = weights.shape
        rows, columns = filled(outputs), filled(inputs + 1)
        yield packed[at : at + rows * columns].reshape(rows, columns)[:outputs, : inputs + 1]
        at += rows * columns


def pack(layers: list[Layer], log_std: np.ndarray) -> np.ndarray:
    """Packs the layers of actor and critic, and the logarithm of the standard deviation, into one array."""
    size = sum(filled(len(bias)) * filled(weights.shape[1] + 1) for weights, bias in layers)
    packed = np.append(np.zeros(size, np.float32), log_std)
    for matrix, (weights, bias) in zip(matrices(packed, layers), layers, strict=True):
        matrix[:, :-1], matrix[:, -1] = weights, bias
    return packed


def unpack(packed: np.ndarray, layers: list[Layer], log_std: np.ndarray) -> None:
    """Writes a packed array back to the arguments of `pack`."""
    for matrix, (weights, bias) in zip(matrices(packed, layers), layers, strict=True):
        weights[:], bias[:] = matrix[:, :-1], matrix[:, -1]
    log_std[:] = packed[-1:]


def _inner(*flags: str) -> Any:
    """Compiles a function that the update calls, with these fast-math flags."""
    return lambda function: jitable(function, fastmath=dict.fromkeys(flags, True))


@_inner("contract")
def activate(rows: np.ndarray) -> None:
    """Applies the activation."""
    use_widest_vectors()
    for j in range(len(rows)):
        rows[j] = tanh(rows[j])


@_inner("contract")
def activate_backward(errors: np.ndarray, activations: np.ndarray) -> None:
    """Multiplies the errors by the derivatives of the activation at the activations, in place."""
    use_widest_vectors()
    for j in range(len(errors)):
        errors[j] *= ONE - activations[j] * activations[j]


@_inner("reassoc")
def sum_of(row: np.ndarray) -> float:
    """The sum of the entries."""
    use_widest_vectors()
    found = 0.0
    for j in range(len(row)):
        found += row[j]
    return found


@_inner("reassoc")
def sum_of_squares(row: np.ndarray) -> float:
    """The sum of the squares of the entries."""
    use_widest_vectors()
    found = 0.0
    for j in range(len(row)):
        found += np.float64(row[j]) * np.float64(row[j])
    return found


@_inner("contract")
def policy_loss(
    samples: np.ndarray,  # the rows of `Rows`; those of the policy are written
    outputs: np.ndarray,  # of the policy, shape (LANES,)
    errors: np.ndarray,  # written: slopes of the loss
    n: int,  # lanes in use; the others are written with 0
    share: float,  # weight of a sample in the loss
    log_std: float,  # logarithm of the standard deviation
    clip_range: float,  # of the ratio of probabilities, around 1
    tanh_mean: bool,  # whether tanh brings the mean to [-1, 1]
) -> None:
    """Computes the policy loss, and its slopes with respect to the policy's outputs, for n lanes."""
    use_widest_vectors()
    precision = exponential(-log_std)
    low, high = ONE - clip_range, ONE + clip_range
    actions, old, advantages = samples[ROW.aim], samples[ROW.old_log_prob], samples[ROW.advantage]
    log_std_slope, gains = samples[ROW.log_std_slope], samples[ROW.gain]
    divergences, clipped = samples[ROW.divergence], samples[ROW.clipped]
    for j in range(LANES):
        mean = tanh(outputs[j]) if tanh_mean else outputs[j]
        deviation = (actions[j] - mean) * precision
        log_ratio = -HALF * deviation * deviation - log_std - NORMAL - old[j]
        bounded = LARGEST if log_ratio > LARGEST else log_ratio
        bounded = -LARGEST if bounded < -LARGEST else bounded
        ratio = exponential(bounded)
        advantage = advantages[j]
        within = low if ratio < low else ratio
        within = high if within > high else within
        unclipped, limited = advantage * ratio, advantage * within
        gain = limited if limited < unclipped else unclipped
        # Slope of the loss with respect to the logarithm of the probability.
        slope = ZERO if limited < unclipped else -share * unclipped
        error = slope * deviation * precision
        used = j < n
        errors[j] = (error * (ONE - mean * mean) if tanh_mean else error) if used else ZERO
        log_std_slope[j] = slope * (deviation * deviation - ONE) if used else ZERO
        gains[j] = gain if used else ZERO
        divergences[j] = ratio - ONE - log_ratio if used else ZERO
        clipped[j] = ONE if used and (ratio < low or ratio > high) else ZERO


@_inner("contract")
def value_loss(samples: np.ndarray, values: np.ndarray, errors: np.ndarray, n: int, share: float) -> None:
    """Writes slopes of the critic's loss with respect to n lanes' values, and squared errors; zeros for other lanes."""
    use_widest_vectors()
    targets, squares = samples[ROW.aim], samples[ROW.squared_error]
    for j in range(LANES):
        error = values[j] - targets[j] if j < n else ZERO
        errors[j] = share * error
        squares[j] = error * error


@_inner("contract")
def adam(
    parameters: np.ndarray,  # changed
    gradients: np.ndarray,
    first: np.ndarray,  # first moments; changed
    second: np.ndarray,  # second moments; changed
    scale: float,  # factor of the gradients
    rate: float,  # learning rate, corrected for the bias of the first moments
    root: float,  # square root of the correction of the second moments
) -> None:
    """Makes one step of Adam, as in torch."""
    use_widest_vectors()
    for n in range(len(parameters)):
        gradient = gradients[n] * scale
        first[n] += DECAY_1 * (gradient - first[n])
        second[n] += DECAY_2 * (gradient * gradient - second[n])
        parameters[n] -= rate * first[n] / (np.sqrt(second[n]) * root + EPS)


@_inner()
def forward(parameters: np.ndarray, widths: np.ndarray, rows: np.ndarray) -> int:
    """Passes LANES samples through a network and returns the start of the outputs in `rows`.

    `rows` is a flat array of shape (.., LANES): the padded inputs, followed by the outputs of every layer. `widths` are
    the widths of the inputs and the layers; `parameters` is the network's part of a packed array.
    """
    use_widest_vectors()
    at = given = 0
    layers = len(widths) - 1
    for layer in range(layers):
        inputs, units = widths[layer] + 1, widths[layer + 1]
        columns = filled(inputs)
        sums = given + columns * LANES
        for j in range(0, LANES, span()):
            for k in range(0, units, TILE):
                start, target = at + k * columns, sums + k * LANES + j
                multiply(parameters, start, columns, 1, inputs, rows, given + j, LANES, rows, target, LANES)
        if layer < layers - 1:
            end = sums + units * LANES
            activate(rows[sums:end])
            # The input that the next layer's bias multiplies.
            rows[end : end + LANES] = ONE
        at += filled(units) * columns
        given = sums
    return given


@jitable
def distance_of_turned(inputs: int) -> int:
    """Row stride of transposed inputs: an odd number of cache lines, so that few rows share a cache set."""
    return (-(-inputs // LINE) | 1) * LINE


@_inner()
def backward(
    parameters: np.ndarray,  # this and `widths` as in `forward`
    gradients: np.ndarray,  # of the parameters; changed
    widths: np.ndarray,
    rows: np.ndarray,  # as `forward` leaves them
    errors: np.ndarray,  # slopes of the loss with respect to the outputs; changed
    spare: np.ndarray,  # of the size of `errors`; changed
    turned: np.ndarray,  # of the size of `errors`; changed
) -> None:
    """Adds the gradients of LANES samples to a network's gradients."""
    use_widest_vectors()
    tile = np.empty(TILE * WIDEST_SPAN, np.float32)
    at = given = 0
    for layer in range(len(widths) - 1):
        at += filled(widths[layer + 1]) * filled(widths[layer] + 1)
        given += filled(widths[layer] + 1) * LANES
    for layer in range(len(widths) - 2, -1, -1):
        inputs, units = widths[layer], widths[layer + 1]
        columns = filled(inputs + 1)
        at -= filled(units) * columns
        given -= columns * LANES
        # Transposed, so that `multiply` also computes the sums over samples.
        pitch = distance_of_turned(inputs)
        for j in range(LANES):
            for i in range(inputs):
                turned[j * pitch + i] = rows[given + i * LANES + j]
        for k in range(0, units, TILE):
            for i in range(0, inputs, span()):
                multiply(errors, k * LANES, LANES, 1, LANES, turned, i, pitch, tile, 0, WIDEST_SPAN)
                width = min(span(), inputs - i)
                for p in range(min(TILE, units - k)):
                    place = at + (k + p) * columns + i
                    for q in range(width):
                        gradients[place + q] += tile[p * WIDEST_SPAN + q]
        for k in range(units):
            gradients[at + k * columns + inputs] += sum_of(errors[k * LANES : (k + 1) * LANES])
        if layer > 0:
            for j in range(0, LANES, span()):
                for i in range(0, inputs, TILE):
                    target = i * LANES + j
                    multiply(parameters, at + i, 1, columns, units, errors, j, LANES, spare, target, LANES)
            size = inputs * LANES
            activate_backward(spare[:size], rows[given : given + size])
            errors, spare = spare, errors


@jitable
def zeros_aligned(count: int) -> np.ndarray:
    """Zeros aligned to a cache line, since a wide load should not cross cache lines."""
    memory = np.zeros(count + LINE, np.float32)
    start = -(memory.ctypes.data // 4) % LINE
    return memory[start : start + count]


def gradients_of(
    is_policy: bool,  # the actor's network or the critic's
    chosen: np.ndarray,  # the samples of the minibatch
    widths: np.ndarray,  # of the network's inputs and its layers, the last of which is 1
    inputs: np.ndarray,  # normalised, shape (samples, inputs of the critic); the actor's come first
    aims: np.ndarray,  # actions of the policy, or returns that the critic estimates, shape (samples,)
    old_log_probs: np.ndarray,  # logarithmic probabilities of the actions when they were drawn, shape (samples,)
    advantages: np.ndarray,  # of the minibatch, normalised, shape (chosen,)
    vf_coef: float,  # this, `clip_range`, `tanh_mean` and `log_std` as in `update` and `policy_loss`
    clip_range: float,
    tanh_mean: bool,
    log_std: float,
    parameters: np.ndarray,  # the network's part of a packed array
    gradients: np.ndarray,  # of these parameters; changed
    means: np.ndarray,  # of the rows of a sample's numbers that `Rows` names; written
) -> None:
    """Adds the gradients of a minibatch's loss to the gradients of one of the two networks."""
    rows = zeros_aligned(filled(widths + 1).sum() * LANES)
    errors, spare = zeros_aligned(filled(widths.max()) * LANES), zeros_aligned(filled(widths.max()) * LANES)
    turned = zeros_aligned(distance_of_turned(widths.max()) * LANES + WIDEST_SPAN)
    samples = zeros_aligned(len(ROW) * LANES).reshape(len(ROW), LANES)
    rows[widths[0] * LANES : (widths[0] + 1) * LANES] = ONE
    size = len(chosen)
    means[:] = 0.0
    for start in range(0, size, LANES):
        n = min(LANES, size - start)
        for j in range(n):
            i = chosen[start + j]
            samples[ROW.aim, j], samples[ROW.old_log_prob, j] = aims[i], old_log_probs[i]
            samples[ROW.advantage, j] = advantages[start + j]
            for k in range(widths[0]):
                rows[k * LANES + j] = inputs[i, k]
        out = forward(parameters, widths, rows)
        outputs = rows[out : out + LANES]
        if is_policy:
            policy_loss(samples, outputs, errors, n, F32(1.0 / size), F32(log_std), F32(clip_range), tanh_mean)
        else:
            value_loss(samples, outputs, errors, n, F32(2.0 * vf_coef / size))
        backward(parameters, gradients, widths, rows, errors, spare, turned)
        for row in range(len(ROW)):
            means[row] += sum_of(samples[row]) / size


def step(
    parameters: np.ndarray,  # this and the next three as in `adam`, each whole
    gradients: np.ndarray,
    first: np.ndarray,
    second: np.ndarray,
    max_grad_norm: float,
    learning_rate: float,
    count: int,  # of this step, from 1
) -> None:
    """Clips the norm of the gradients and makes a step of Adam."""
    norm = math.sqrt(sum_of_squares(gradients))
    clipping = F32(min(1.0, max_grad_norm / (norm + 1e-6)))
    rate, root = F32(learning_rate / (1.0 - BETA_1**count)), F32(1.0 / math.sqrt(1.0 - BETA_2**count))
    adam(parameters, gradients, first, second, clipping, rate, root)


@lru_cache(maxsize=1)
def compiled() -> tuple[Any, Any]:
    """Compiles `gradients_of` and `step`, which do not check dtype, shape and contiguity of their arrays."""
    number, row, widths = "float64", "float32[::1]", "int64[::1]"
    given = ("boolean", widths, widths, "float32[:, ::1]", row, row, row, number, number, "boolean", number)
    of_network = f"void({', '.join((*given, row, row, 'float64[::1]'))})"
    of_step = f"void({', '.join((row, row, row, row, number, number, 'int64'))})"
    what = "the updates of training"
    return compile_allocating(gradients_of, of_network, what), compile_allocating(step, of_step, what)


def update(
    batch_size: int,  # this and the next five as in SB3's PPO
    clip_range: float,
    ent_coef: float,
    vf_coef: float,
    max_grad_norm: float,
    learning_rate: float,
    count: int,  # steps that Adam has made before
    tanh_mean: bool,  # whether tanh brings the action's mean to [-1, 1]
    least_log_std: float,  # floor of the logarithm of the standard deviation
    actor: np.ndarray,  # widths of its inputs and its layers, the last of which is 1
    critic: np.ndarray,  # the same of the critic, which may have more inputs
    orders: np.ndarray,  # the samples in the order of each epoch, shape (epochs, samples)
    inputs: np.ndarray,  # normalised, shape (samples, inputs of the critic); the actor's come first
    actions: np.ndarray,  # shape (samples,), as the next three
    old_log_probs: np.ndarray,  # their logarithmic probabilities when they were drawn
    advantages: np.ndarray,
    targets: np.ndarray,  # returns, which the critic estimates
    parameters: np.ndarray,  # actor, critic and logarithm of the standard deviation, from `pack`; changed
    first: np.ndarray,  # Adam's first moments; changed
    second: np.ndarray,  # Adam's second moments; changed
) -> np.ndarray:
    """Makes one step of Adam per minibatch; returns the means of LOSSES over the minibatches."""
    of_network, of_step = compiled()
    split = int((filled(actor[1:]) * filled(actor[:-1] + 1)).sum())
    of_actor, of_critic = slice(0, split), slice(split, -1)
    gradients, means, losses = np.empty_like(parameters), np.empty((2, len(ROW))), []
    with ThreadPoolExecutor(1) as beside:
        for order in orders:
            for begin in range(0, len(order), batch_size):
                chosen = order[begin : begin + batch_size]
                some = advantages[chosen].astype(np.float64)
                if len(some) > 1:
                    some = (some - some.mean()) / (some.std(ddof=1) + 1e-8)
                log_std = max(parameters[-1], F32(least_log_std))
                settings = old_log_probs, some.astype(np.float32), vf_coef, clip_range, tanh_mean, log_std
                gradients[:] = 0.0
                mine = True, chosen, actor, inputs, actions, *settings, parameters[of_actor], gradients[of_actor]
                others = False, chosen, critic, inputs, targets, *settings, parameters[of_critic], gradients[of_critic]
                other = beside.submit(partial(of_network, *others, means[1]))
                of_network(*mine, means[0])
                other.result()
                bounded = parameters[-1] < F32(least_log_std)
                gradients[-1] = 0.0 if bounded else means[0, ROW.log_std_slope] * len(chosen) - ent_coef
                count += 1
                of_step(parameters, gradients, first, second, max_grad_norm, learning_rate, count)
                policy, value = (Rows(*row) for row in means.tolist())
                entropy = -(log_std + NORMAL + HALF)
                losses.append((-policy.gain, value.squared_error, entropy, policy.divergence, policy.clipped))
    return np.mean(losses, axis=0)
