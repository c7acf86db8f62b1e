"""Compiled float32 arithmetic: products of matrices, exponential and hyperbolic tangent.

Matrix products are computed in tiles whose sums stay in registers.
"""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
from llvmlite import binding as llvm
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from capsule_gym.compilation import inlined

# Number of float32 in the widest register. With narrower registers, the compiler uses several.
WIDTH = 16
# Rows that a tile computes together; layer widths are padded to a multiple.
TILE = 6
# Largest number of entries per row that a tile computes together.
WIDEST_SPAN = 2 * WIDTH

F32 = np.float32
ZERO, HALF, ONE, TWO = F32(0.0), F32(0.5), F32(1.0), F32(2.0)
LOG2_E = F32(1.0 / math.log(2.0))
# log(2) in two parts; the first one is short enough that its multiples are exact.
LN_2 = F32(355.0 / 512.0)
LN_2_REST = F32(math.log(2.0) - float(LN_2))
# Adding this number rounds to an integer, which the lowest bits of the sum contain.
ROUNDING = F32(1.5 * 2.0**23)
# Taylor coefficients of exp.
E_2, E_3, E_4, E_5, E_6, E_7 = (F32(1.0 / math.factorial(n)) for n in range(2, 8))
# Largest absolute argument of exp: beyond it, 2^n is not a normal number.
LARGEST = F32(87.0)
# From this argument on, tanh is 1 in float32.
FLAT = F32(10.0)

FLOAT, INTEGER = ir.FloatType(), ir.IntType(32)
VECTOR = ir.VectorType(FLOAT, WIDTH)


def _vector_at(builder: Any, pointer: Any) -> Any:
    """Casts a pointer to a pointer to a vector."""
    return builder.bitcast(pointer, VECTOR.as_pointer())


def _spread(builder: Any, value: Any) -> Any:
    """A vector with the same number in all entries."""
    first = builder.insert_element(ir.Constant(VECTOR, [0.0] * WIDTH), value, INTEGER(0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(INTEGER, WIDTH), [0] * WIDTH))


def vectors(target_machine: Any) -> int:
    """Number of vectors per row that a tile computes together: as many as fit into the registers for TILE rows.

    A processor with registers of 512 bits has 32 of them, and each holds one vector. Other processors have 16
    registers, and a vector takes two.
    """
    vector, wide = f"<{WIDTH} x float>", '"prefer-vector-width"="512"'
    module = f"define {vector} @f({vector} %a) {wide} {{ %b = fadd {vector} %a, %a\n ret {vector} %b }}"
    return 2 if "zmm" in target_machine.emit_assembly(llvm.parse_assembly(module)) else 1


@intrinsic
def span(typing_context: Any) -> Any:
    """The number of entries per row that `multiply` writes."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.get_constant(types.intp, vectors(context.codegen()._tm) * WIDTH)

    return types.intp(), generate


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
    pitch: Any,
    sums: Any,
    target: Any,
    distance: Any,
) -> Any:
    """Writes the product of TILE rows of a matrix and `span` columns of `given`, without bounds checks.

    The matrix begins at `weights[at]`; `row` and `column` are the strides of its rows and columns, and `count` is the
    number of its columns. `given` has a row for each column of the matrix, starts at `first`, and has the row stride
    `pitch`. The product is written to `sums`, starting at `target`, with the row stride `distance`.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        _, at, row, column, count, _, first, pitch, _, target, distance = arguments
        matrix = _data(context, builder, kinds[0], arguments[0], at)
        source = _data(context, builder, kinds[5], arguments[5], first)
        out = _data(context, builder, kinds[8], arguments[8], target)
        whole = row.type
        starts = [builder.gep(matrix, [builder.mul(row, whole(p))]) for p in range(TILE)]
        places = range(0, vectors(context.codegen()._tm) * WIDTH, WIDTH)
        # The compiler keeps these sums in registers.
        totals = {place: cgutils.alloca_once(builder, VECTOR) for place in product(range(TILE), places)}
        for pointer in totals.values():
            builder.store(ir.Constant(VECTOR, [0.0] * WIDTH), pointer)
        # llvmlite's `fma` takes only scalars.
        kind = ir.FunctionType(VECTOR, [VECTOR] * 3)
        fma = cgutils.get_or_insert_function(builder.module, kind, f"llvm.fma.v{WIDTH}f32")
        with cgutils.for_range(builder, count) as loop:
            line = builder.gep(source, [builder.mul(loop.index, pitch)])
            x = {v: builder.load(_vector_at(builder, builder.gep(line, [whole(v)])), align=4) for v in places}
            offset = builder.mul(loop.index, column)
            w = [_spread(builder, builder.load(builder.gep(start, [offset]))) for start in starts]
            for (p, v), pointer in totals.items():
                builder.store(builder.call(fma, [w[p], x[v], builder.load(pointer)]), pointer)
        for (p, v), pointer in totals.items():
            place = builder.gep(out, [builder.add(builder.mul(distance, whole(p)), whole(v))])
            builder.store(builder.load(pointer), _vector_at(builder, place), align=4)
        return context.get_dummy_value()

    where = types.intp
    return types.void(weights, *[where] * 4, given, where, where, sums, where, where), generate


@intrinsic
def power_of_two(typing_context: Any, shifted: Any) -> Any:
    """2^n from n + ROUNDING: the lowest bits of this sum become the exponent; |n| must not exceed 126."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        exponent = builder.shl(builder.bitcast(arguments[0], INTEGER), INTEGER(23))
        return builder.bitcast(builder.add(exponent, INTEGER(127 << 23)), FLOAT)

    return types.float32(types.float32), generate


@inlined
def exponential(x: float) -> float:
    """e^x up to float32 rounding; |x| must not exceed LARGEST."""
    shifted = x * LOG2_E + ROUNDING
    n = shifted - ROUNDING
    r = x - n * LN_2 - n * LN_2_REST
    p = (((((E_7 * r + E_6) * r + E_5) * r + E_4) * r + E_3) * r + E_2) * (r * r) + r + ONE
    return p * power_of_two(shifted)


@inlined
def tanh(x: float) -> float:
    """The hyperbolic tangent, with an absolute error of about float32's rounding of 1."""
    # Two comparisons instead of a minimum and a maximum, since they propagate NaN.
    x = FLAT if x > FLAT else x
    x = -FLAT if x < -FLAT else x
    return ONE - TWO / (exponential(TWO * x) + ONE)
