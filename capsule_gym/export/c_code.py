"""Functions of the core in C.

They come from the lists of operations that `core/bindings/recorded_functions.hpp` records.
"""

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from capsule_gym.core import _core, native

# The operations in C: parentheses make every form an operand. NAME stands for the prefix of a
# header's functions.
C_FORMS = {
    "add": "({} + {})",
    "subtract": "({} - {})",
    "multiply": "({} * {})",
    "divide": "({} / {})",
    "negate": "(-{})",
    "less": "({} < {})",
    "less_equal": "({} <= {})",
    "equal": "({} == {})",
    "both": "({} && {})",
    "either": "({} || {})",
    "inverse": "(!{})",
    "select": "({} ? {} : {})",
    "fma": "NAME_fma({}, {}, {})",
    "absolute": "NAME_abs({})",
    "square_root": "NAME_sqrt({})",
    "copysign": "NAME_copysign({}, {})",
    "power_of_two": "NAME_power_of_two({})",
    "sincos": "NAME_sincos({})",
    "sine": "{}.sine",
    "cosine": "{}.cosine",
    "exp": "NAME_exp({})",
    "tanh": "NAME_tanh({})",
}
# Types of the results of operations; the others give a number.
C_TYPES = {"sincos": "NAME_pair"} | dict.fromkeys(
    ("less", "less_equal", "equal", "both", "either", "inverse"), "int"
)
LONGEST_FORM = 100  # characters


def c_number(value: float, single: bool) -> str:
    """A number as a constant of C."""
    if math.isinf(value):
        constant = "HUGE_VALF" if single else "HUGE_VAL"
        return constant if value > 0 else f"-{constant}"
    if not single:
        return repr(float(value))
    if value == _core.ROUNDING:
        # Adding and subtracting it rounds to a whole number.
        value = 1.5 * 2**23
    return f"{np.float32(value)}f"


def c_table(values: Sequence[Any] | np.ndarray, single: bool) -> str:
    """An array as the initialiser of one of C, one row per line."""
    if np.ndim(values) == 1:
        return "{" + ", ".join(c_number(float(value), single) for value in values) + "}"
    return "{" + ",\n".join(c_table(row, single) for row in values) + "}"


def to_c(
    function: str,
    inputs: Iterable[str],
    outputs: Sequence[str | None],
    constants: Iterable[float] = (),
    number: int = 0,
    *,
    single: bool,
) -> str:
    """Statements of C99 that compute a function of the core.

    In double precision, every operation is rounded as in the core.

    Args:
        function: its name in `core/bindings/recorded_functions.hpp`.
        inputs: an expression for each input, in order.
        outputs: what each output is assigned to, in order; None for an output that is not needed.
            All are assigned at the end.
        constants: of a law, or the settings.
        number: of the law or task.
        single: compute in float.
    """
    array = np.array([*constants, 0.0])
    # An operation, and the places of its operands in the list; for a "constant" its value.
    rows = _core.trace(function, number, native.address(array))
    ends = [place for place, row in enumerate(rows) if row[0] == "output"]
    targets = {end: target for end, target in zip(ends, outputs, strict=True) if target is not None}
    uses = _count_uses(rows, list(targets))
    unread = iter(inputs)
    forms: dict[int, str] = {}
    variables: list[str] = []
    assignments: list[str] = []
    for place, (operation, *operands) in enumerate(rows):
        if operation == "input":
            forms[place] = next(unread)
        elif operation == "constant":
            text = c_number(operands[0], single)
            forms[place] = f"({text})" if text.startswith("-") else text
        elif place in targets:
            assignments.append(f"  {targets[place]} = {forms[operands[0]]};")
        elif uses[place]:
            form = C_FORMS[operation].format(*(forms[operand] for operand in operands))
            if uses[place] > 1 or operation == "sincos" or len(form) > LONGEST_FORM:
                variable = f"t{len(variables)}"
                kind = C_TYPES.get(operation, "REAL")
                variables.append(f"  const {kind} {variable} = {form};")
                form = variable
            forms[place] = form
    return "\n".join(variables + assignments)


def _count_uses(rows: Sequence[Any], ends: list[int]) -> Counter[int]:
    """How often each row is an operand in what the outputs at `ends` need; these count as used."""
    uses = Counter(ends)
    for place in reversed(range(len(rows))):
        operation, *operands = rows[place]
        if uses[place] and operation != "constant":
            uses.update(operands)
    return uses
