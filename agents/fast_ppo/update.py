"""PPO's whole update in one compiled call: every epoch and minibatch, both networks forward and backward, and Adam.

A sample is a lane. Minibatches are taken LANES samples at a time, whose numbers lie side by side, row by row, in the
processor's nearest caches. The three products that take nearly all time (a layer forward, back to its inputs,
and the gradients of its weights) are made of tiles that keep their sums in registers.

Arithmetic is float32, and the compiler may fuse and reorder it: like torch's, an update is the same for the same start
on one machine, not from one kind of processor to another.
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from llvmlite import binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from agents.training.algorithms import HALF_LOG_2_PI
from capsule_gym.compilation import inlined, jitable, use_widest_vectors
from capsule_gym.compiler import compile_allocating
from capsule_gym.network import Layer

# Samples that are taken through the networks together.
LANES = 128
# float32 in the widest register. Where they are narrower the compiler takes several.
WIDTH = 16
# Rows, and vectors of each, whose sums are written together; widths of layers are filled up to a multiple.
TILE = 4
SPAN = TILE * WIDTH
# Of a cache line, in float32.
LINE = 16

F32 = np.float32
ZERO, HALF, ONE, TWO = F32(0.0), F32(0.5), F32(1.0), F32(2.0)
NORMAL = F32(HALF_LOG_2_PI)
LOG2_E = F32(1.0 / math.log(2.0))
# The logarithm of 2, of which a first part so short that its multiples are exact.
LN_2 = F32(355.0 / 512.0)
LN_2_REST = F32(math.log(2.0) - float(LN_2))
# Adding it rounds to a whole number, which the lowest digits of the sum hold.
ROUNDING = F32(1.5 * 2.0**23)
# Taylor's coefficients of exp.
E_2, E_3, E_4, E_5, E_6, E_7 = (F32(1.0 / math.factorial(n)) for n in range(2, 8))
# Adam's constants, SB3's defaults.
BETA_1, BETA_2, EPS = 0.9, 0.999, F32(1e-5)
DECAY_1, DECAY_2 = F32(1.0 - BETA_1), F32(1.0 - BETA_2)
# Exponents that are taken as they are: beyond, 2^n is no normal number.
LARGEST = F32(87.0)
# From here on the tangent is 1 to the last digit.
FLAT = F32(10.0)
# Rows of a sample's numbers besides those of the networks.
Rows = namedtuple("Rows", "action old_log_prob advantage target log_std_slope gain squared_error divergence clipped")
ROW = Rows(*range(len(Rows._fields)))
# Logged means.
LOSSES = ("policy_gradient_loss", "value_loss", "entropy_loss", "approx_kl", "clip_fraction")


@jitable
def filled(width: Any) -> Any:
    """The smallest multiple of TILE that is not below a width, or below each of several."""
    return -(-width // TILE) * TILE


def matrices(packed: np.ndarray, layers: list[Layer]) -> Iterator[np.ndarray]:
    """The part of a packed array that each layer has: weights and, as one more column, biases.

    A packed array holds these matrices row by row, filled up with zeros to multiples of TILE, of actor and critic, and
    at last the logarithm of the standard deviation.
    """
    at = 0
    for weights, _ in layers:
        outputs, inputs = weights.shape
        rows, columns = filled(outputs), filled(inputs + 1)
        yield packed[at : at + rows * columns].reshape(rows, columns)[:outputs, : inputs + 1]
        at += rows * columns


def pack(layers: list[Layer], log_std: np.ndarray) -> np.ndarray:
    """The layers of actor and critic, and the logarithm of the standard deviation, as one array."""
    size = sum(filled(len(bias)) * filled(weights.shape[1] + 1) for weights, bias in layers)
    packed = np.append(np.zeros(size, np.float32), log_std)
    for matrix, (weights, bias) in zip(matrices(packed, layers), layers, strict=True):
        matrix[:, :-1], matrix[:, -1] = weights, bias
    return packed


def unpack(packed: np.ndarray, layers: list[Layer], log_std: np.ndarray) -> None:
    """Writes a packed array back to the arrays that `pack` took."""
    for matrix, (weights, bias) in zip(matrices(packed, layers), layers, strict=True):
        weights[:], bias[:] = matrix[:, :-1], matrix[:, -1]
    log_std[:] = packed[-1:]


FLOAT, INTEGER = ir.FloatType(), ir.IntType(32)
VECTOR = ir.VectorType(FLOAT, WIDTH)


def _vector_at(builder: Any, pointer: Any, kind: Any = VECTOR) -> Any:
    """That address as one of a vector."""
    return builder.bitcast(pointer, kind.as_pointer())


def _load(builder: Any, pointer: Any, kind: Any = VECTOR) -> Any:
    return builder.load(_vector_at(builder, pointer, kind), align=4)


def _spread(builder: Any, value: Any) -> Any:
    """A vector of the same number everywhere."""
    first = builder.insert_element(ir.Constant(VECTOR, [0.0] * WIDTH), value, INTEGER(0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(INTEGER, WIDTH), [0] * WIDTH))


def parts(target_machine: Any) -> list[tuple[range, range]]:
    """Rows and columns of the parts of a tile that are worked out in turn: the sums of each are kept in registers.

    Args:
        target_machine: of the processor that the code is compiled for. With registers of 512 bits one holds a vector,
            and there are 32; else there are 16 of which a vector takes two.
    """
    vector, wide = f"<{WIDTH} x float>", '"prefer-vector-width"="512"'
    module = f"define {vector} @f({vector} %a) {wide} {{ %b = fadd {vector} %a, %a\n ret {vector} %b }}"
    side = TILE if "zmm" in target_machine.emit_assembly(llvm.parse_assembly(module)) else TILE // 2
    halves = [range(first, first + side) for first in range(0, TILE, side)]
    return list(product(halves, halves))


def _sums(builder: Any, rows: range, columns: range) -> dict[tuple[int, int], Any]:
    """A vector of zeros for every row and column, which the compiler keeps in registers."""
    sums = {place: cgutils.alloca_once(builder, VECTOR) for place in product(rows, columns)}
    for pointer in sums.values():
        builder.store(ir.Constant(VECTOR, [0.0] * WIDTH), pointer)
    return sums


def _add_products(builder: Any, sums: dict[tuple[int, int], Any], left: dict[int, Any], right: dict[int, Any]) -> None:
    """Adds the product of every vector on the left with every one on the right."""
    kind = ir.FunctionType(VECTOR, [VECTOR] * 3)
    # llvmlite's own takes scalars only.
    fma = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{WIDTH}f32")
    for (p, q), pointer in sums.items():
        builder.store(builder.call(fma, [left[p], right[q], builder.load(pointer)]), pointer)


def _data(context: Any, builder: Any, kind: Any, array: Any, at: Any) -> Any:
    """The address of an entry of a contiguous array."""
    return builder.gep(context.make_array(kind)(context, builder, array).data, [at])


@intrinsic
def multiply(
    typing_context: Any,
    weights: Any,
    at: Any,
    row: Any,
    column: Any,
    count: Any,
    given: Any,
    first: Any,
    sums: Any,
    target: Any,
) -> Any:
    """Writes TILE rows of a matrix times the rows of `given`, for SPAN lanes; unchecked.

    The matrix begins at `weights[at]`; `row` and `column` are the distances of its rows and its columns, `count` is the
    number of its columns. `given` has a row of LANES for each column, from `first` on. The products are written to
    `sums`, from `target` on.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        _, at, row, column, count, _, first, _, target = arguments
        matrix = _data(context, builder, kinds[0], arguments[0], at)
        lanes = _data(context, builder, kinds[5], arguments[5], first)
        out = _data(context, builder, kinds[7], arguments[7], target)
        step = context.get_constant(types.intp, LANES)
        for rows, columns in parts(context.codegen()._tm):
            starts = {p: builder.gep(matrix, [builder.mul(row, row.type(p))]) for p in rows}
            totals = _sums(builder, rows, columns)
            with cgutils.for_range(builder, count) as loop:
                line = builder.gep(lanes, [builder.mul(loop.index, step)])
                x = {v: _load(builder, builder.gep(line, [step.type(v * WIDTH)])) for v in columns}
                offset = builder.mul(loop.index, column)
                w = {p: _spread(builder, builder.load(builder.gep(starts[p], [offset]))) for p in rows}
                _add_products(builder, totals, w, x)
            for (p, v), pointer in totals.items():
                place = builder.gep(out, [step.type(p * LANES + v * WIDTH)])
                builder.store(builder.load(pointer), _vector_at(builder, place), align=4)
        return context.get_dummy_value()

    where = types.intp
    return types.void(weights, where, where, where, where, given, where, sums, where), generate


@intrinsic
def correlate(
    typing_context: Any, errors: Any, first: Any, given: Any, start: Any, gradients: Any, at: Any, row: Any
) -> Any:
    """Adds the products of TILE rows with TILE other rows, summed over the lanes, to a matrix; unchecked.

    The rows of the matrix belong to `errors`, from `first` on, its columns to `given`, from `start` on. It begins at
    `gradients[at]`, and `row` is the distance of its rows.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        _, first, _, start, _, at, row = arguments
        left = _data(context, builder, kinds[0], arguments[0], first)
        right = _data(context, builder, kinds[2], arguments[2], start)
        matrix = _data(context, builder, kinds[4], arguments[4], at)
        whole = first.type
        totals: dict[tuple[int, int], Any] = {}
        for ours, theirs in parts(context.codegen()._tm):
            found = _sums(builder, ours, theirs)
            with cgutils.for_range(builder, whole(LANES // WIDTH)) as loop:
                lane = builder.mul(loop.index, whole(WIDTH))
                e, x = (
                    {p: _load(builder, builder.gep(rows, [builder.add(lane, whole(p * LANES))])) for p in chosen}
                    for rows, chosen in ((left, ours), (right, theirs))
                )
                _add_products(builder, found, e, x)
            totals |= {place: builder.load(pointer) for place, pointer in found.items()}
        # Two vectors become one with half as many parts of each sum, until one vector holds all sums.
        vectors = [totals[place] for place in sorted(totals)]
        half = WIDTH // 2
        while len(vectors) > 1:
            halves = [[n for n in range(2 * WIDTH) if bool(n & half) == second] for second in (False, True)]
            masks = [ir.Constant(ir.VectorType(INTEGER, WIDTH), numbers) for numbers in halves]
            pairs = zip(vectors[::2], vectors[1::2], strict=True)
            vectors = [builder.fadd(*(builder.shuffle_vector(a, b, mask) for mask in masks)) for a, b in pairs]
            half //= 2
        short = ir.VectorType(FLOAT, TILE)
        for p in range(TILE):
            mask = ir.Constant(ir.VectorType(INTEGER, TILE), list(range(p * TILE, (p + 1) * TILE)))
            part = builder.shuffle_vector(vectors[0], vectors[0], mask)
            place = builder.gep(matrix, [builder.mul(row, whole(p))])
            total = builder.fadd(_load(builder, place, short), part)
            builder.store(total, _vector_at(builder, place, short), align=4)
        return context.get_dummy_value()

    where = types.intp
    return types.void(errors, where, given, where, gradients, where, where), generate


@intrinsic
def power_of_two(typing_context: Any, shifted: Any) -> Any:
    """2^n from n + ROUNDING: the lowest digits of that sum become the exponent; |n| must not exceed 126."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        exponent = builder.shl(builder.bitcast(arguments[0], INTEGER), INTEGER(23))
        return builder.bitcast(builder.add(exponent, INTEGER(127 << 23)), FLOAT)

    return types.float32(types.float32), generate


@inlined
def exponential(x: float) -> float:
    """e^x, to float32's rounding; |x| must not exceed LARGEST."""
    shifted = x * LOG2_E + ROUNDING
    n = shifted - ROUNDING
    r = x - n * LN_2 - n * LN_2_REST
    p = (((((E_7 * r + E_6) * r + E_5) * r + E_4) * r + E_3) * r + E_2) * (r * r) + r + ONE
    return p * power_of_two(shifted)


@inlined
def tanh(x: float) -> float:
    """The hyperbolic tangent, to float32's rounding of 1."""
    # NaN stays NaN.
    x = FLAT if x > FLAT else x
    x = -FLAT if x < -FLAT else x
    return ONE - TWO / (exponential(TWO * x) + ONE)


def _inner(*flags: str) -> Any:
    """Compiles a function that the update calls, with whose arithmetic the compiler may do so."""
    return lambda function: jitable(function, fastmath=dict.fromkeys(flags, True))


@_inner("contract")
def activate(rows: np.ndarray) -> None:
    """Applies the activation."""
    use_widest_vectors()
    for j in range(len(rows)):
        rows[j] = tanh(rows[j])


@_inner("contract")
def activate_backward(errors: np.ndarray, activations: np.ndarray) -> None:
    """Multiplies with the slopes of the activation where it has these values."""
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
    """Computes the policy's loss, and its slopes over the policy's outputs, for n lanes."""
    use_widest_vectors()
    precision = exponential(-log_std)
    low, high = ONE - clip_range, ONE + clip_range
    actions, old, advantages = samples[ROW.action], samples[ROW.old_log_prob], samples[ROW.advantage]
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
        # Of the logarithm of the probability.
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
    """Writes the slopes of the critic's loss over n lanes' values, and their squared errors; the others' are zero."""
    use_widest_vectors()
    targets, squares = samples[ROW.target], samples[ROW.squared_error]
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
    """A step of Adam, as torch makes it."""
    use_widest_vectors()
    for n in range(len(parameters)):
        gradient = gradients[n] * scale
        first[n] += DECAY_1 * (gradient - first[n])
        second[n] += DECAY_2 * (gradient * gradient - second[n])
        parameters[n] -= rate * first[n] / (np.sqrt(second[n]) * root + EPS)


@_inner()
def forward(parameters: np.ndarray, widths: np.ndarray, rows: np.ndarray) -> int:
    """Takes LANES samples through a network.

    Args:
        parameters: its part of a packed array.
        widths: of its inputs and its layers.
        rows: the padded inputs; the outputs of every layer are written behind them, shape (.., LANES) but flat.

    Returns:
        Where the outputs begin.
    """
    use_widest_vectors()
    at = given = 0
    layers = len(widths) - 1
    for layer in range(layers):
        columns, units = filled(widths[layer] + 1), widths[layer + 1]
        sums = given + columns * LANES
        for j in range(0, LANES, SPAN):
            for k in range(0, filled(units), TILE):
                start, target = at + k * columns, sums + k * LANES + j
                multiply(parameters, start, columns, 1, columns, rows, given + j, rows, target)
        if layer < layers - 1:
            end = sums + units * LANES
            activate(rows[sums:end])
            # The input that the next layer's bias multiplies.
            rows[end : end + LANES] = ONE
        at += filled(units) * columns
        given = sums
    return given


@_inner()
def backward(
    parameters: np.ndarray,  # this and `widths` as in `forward`
    gradients: np.ndarray,  # of the parameters; changed
    widths: np.ndarray,
    rows: np.ndarray,  # as `forward` leaves them
    errors: np.ndarray,  # slopes of the loss over the padded outputs; changed
    spare: np.ndarray,  # of the size of `errors`; changed
) -> None:
    """Adds the gradients of LANES samples to those of a network."""
    use_widest_vectors()
    at = given = 0
    for layer in range(len(widths) - 1):
        at += filled(widths[layer + 1]) * filled(widths[layer] + 1)
        given += filled(widths[layer] + 1) * LANES
    for layer in range(len(widths) - 2, -1, -1):
        inputs, outputs = widths[layer], filled(widths[layer + 1])
        columns = filled(inputs + 1)
        at -= outputs * columns
        given -= columns * LANES
        for k in range(0, outputs, TILE):
            for i in range(0, columns, TILE):
                correlate(errors, k * LANES, rows, given + i * LANES, gradients, at + k * columns + i, columns)
        if layer > 0:
            for j in range(0, LANES, SPAN):
                for i in range(0, filled(inputs), TILE):
                    multiply(parameters, at + i, 1, columns, outputs, errors, j, spare, i * LANES + j)
            size = inputs * LANES
            activate_backward(spare[:size], rows[given : given + size])
            # Padding must stay zero.
            spare[size : filled(inputs) * LANES] = ZERO
            errors, spare = spare, errors


@jitable
def zeros_aligned(count: int) -> np.ndarray:
    """Zeros that begin at a cache line, which a wide load should not cross."""
    memory = np.zeros(count + LINE, np.float32)
    start = -(memory.ctypes.data // 4) % LINE
    return memory[start : start + count]


def update(
    batch_size: int,  # this and the next five as in SB3's PPO
    clip_range: float,
    ent_coef: float,
    vf_coef: float,
    max_grad_norm: float,
    learning_rate: float,
    step: int,  # steps that Adam has made before
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
    losses: np.ndarray,  # written: means of LOSSES over the minibatches
) -> None:
    """Makes a step of Adam for every minibatch."""
    split, last = (filled(actor[1:]) * filled(actor[:-1] + 1)).sum(), len(parameters) - 1
    rows_a = zeros_aligned(filled(actor + 1).sum() * LANES)
    rows_c = zeros_aligned(filled(critic + 1).sum() * LANES)
    widest = max(actor.max(), critic.max())
    errors, spare = zeros_aligned(filled(widest) * LANES), zeros_aligned(filled(widest) * LANES)
    samples = zeros_aligned(len(ROW) * LANES).reshape(len(ROW), LANES)
    gradients = zeros_aligned(len(parameters))
    rows_a[actor[0] * LANES : (actor[0] + 1) * LANES] = ONE
    rows_c[critic[0] * LANES : (critic[0] + 1) * LANES] = ONE
    losses[:] = 0.0
    power_1, power_2 = BETA_1**step, BETA_2**step
    batches = 0
    for order in orders:
        for begin in range(0, len(order), batch_size):
            chosen = order[begin : begin + batch_size]
            size = len(chosen)
            centre, scale = 0.0, 1.0
            if size > 1:
                values = advantages[chosen].astype(np.float64)
                centre = values.mean()
                scale = 1.0 / (math.sqrt(((values - centre) ** 2).sum() / (size - 1)) + 1e-8)
            gradients[:] = ZERO
            log_std = max(parameters[last], F32(least_log_std))
            for start in range(0, size, LANES):
                n = min(LANES, size - start)
                for j in range(n):
                    i = chosen[start + j]
                    samples[ROW.action, j], samples[ROW.old_log_prob, j] = actions[i], old_log_probs[i]
                    samples[ROW.advantage, j], samples[ROW.target, j] = (advantages[i] - centre) * scale, targets[i]
                    for k in range(actor[0]):
                        rows_a[k * LANES + j] = inputs[i, k]
                    for k in range(critic[0]):
                        rows_c[k * LANES + j] = inputs[i, k]
                out = forward(parameters[:split], actor, rows_a)
                errors[LANES : TILE * LANES] = ZERO
                settings = F32(1.0 / size), log_std, F32(clip_range), tanh_mean
                policy_loss(samples, rows_a[out : out + LANES], errors[:LANES], n, *settings)
                backward(parameters[:split], gradients[:split], actor, rows_a, errors, spare)
                out = forward(parameters[split:last], critic, rows_c)
                errors[LANES : TILE * LANES] = ZERO
                value_loss(samples, rows_c[out : out + LANES], errors[:LANES], n, F32(2.0 * vf_coef / size))
                backward(parameters[split:last], gradients[split:last], critic, rows_c, errors, spare)
                gradients[last] += sum_of(samples[ROW.log_std_slope])
                losses[0] -= sum_of(samples[ROW.gain]) / size
                losses[1] += sum_of(samples[ROW.squared_error]) / size
                losses[3] += sum_of(samples[ROW.divergence]) / size
                losses[4] += sum_of(samples[ROW.clipped]) / size
            losses[2] -= log_std + NORMAL + HALF
            gradients[last] = gradients[last] - ent_coef if parameters[last] >= F32(least_log_std) else 0.0
            norm = math.sqrt(sum_of_squares(gradients))
            power_1 *= BETA_1
            power_2 *= BETA_2
            clipping = F32(min(1.0, max_grad_norm / (norm + 1e-6)))
            rate, root = F32(learning_rate / (1.0 - power_1)), F32(1.0 / math.sqrt(1.0 - power_2))
            adam(parameters, gradients, first, second, clipping, rate, root)
            batches += 1
    losses /= batches


@lru_cache(maxsize=1)
def compiled() -> Any:
    """`update` as compiled code: it checks neither dtype nor shape nor contiguity of its arrays."""
    number, row, widths = "float64", "float32[::1]", "int64[::1]"
    settings = ("int64", *[number] * 5, "int64", "boolean", number)
    samples = ("int64[:, ::1]", "float32[:, ::1]", row, row, row, row)
    given = (*settings, widths, widths, *samples, row, row, row, "float64[::1]")
    return compile_allocating(update, f"void({', '.join(given)})", "the updates of training")
