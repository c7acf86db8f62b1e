"""Control laws that users write in Python, called by the core's step.

With numba installed (the extra `law`) a law is compiled by `numba.cfunc`, once per process and
controller; nothing is kept on disk. Without numba, or where numba cannot compile the law, the
interpreter calls it for each environment, which takes many times as long in a batch
(docs/controllers.md). The torques are the same up to rounding.
"""

import importlib.util
import math
import threading
import warnings
from collections.abc import Callable
from functools import partial
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np

from capsule_gym.checks import first_cause, short_repr
from capsule_gym.control.controller import Controller
from capsule_gym.core import _core
from capsule_gym.core.layout import NUM_ROWS

# Loops over the environments of a block. The source is generated since numba's public interface
# cannot make a tuple of a part of an array. All rows are at constant offsets from one pointer: with
# a pointer for each kind of row LLVM cannot exclude that they overlap, and does not vectorise the
# loop. Nor does it vectorise a loop that catches exceptions: only after an exception each
# environment is called by itself, from the failed one on, and those that fail keep NaN. On Python
# 3.13 numba misses exceptions in a function with two `try`.
SOURCE = """
@njit(**options)
def call_each(b, u, first, last):
    for j in range(first, last):
        torque, renewed = law({arguments}, ({memory},), ({row},){named})
{stores}
        u[j] = torque


@njit(**options)
def fails(b, u, first, last):
    failed = False
    try:
        call_each(b, u, first, last)
    except Exception:
        failed = True
    return failed


def call_law(data, block, torques, n):
    b = carray(block, ({size},))
    u = carray(torques, ({lanes},))
    if fails(b, u, 0, n):
        for j in range(n):
            if u[j] != u[j]:
                fails(b, u, j, j + 1)
"""

_compiled: WeakKeyDictionary[Any, dict[tuple[int, int], Any]] = WeakKeyDictionary()
_lock = threading.Lock()


def bind_user_law(
    controller: Controller, lanes: int, state: int, raised: list[Exception]
) -> dict[str, Any]:
    """Makes the law of a `Controller` callable for the core.

    Args:
        controller: the controller.
        lanes: environments in a block.
        state: the row of theta that the law observes; those of theta_dot, x and x_dot follow.
        raised: receives the exceptions of a law that Python calls.

    Returns:
        The fields `user_law` and `user_data` of the core's `Batch`, and what must be kept alive
        while they are used.
    """
    compiled = _compiled_law(controller, lanes, state)
    if compiled is not None:
        return {"user_law": compiled.address, "compiled": compiled}
    cells = len(controller.memory)
    plain = _plain(controller, raised)
    # The core's `PlainLaw`.
    data = np.array([id(plain), cells, cells + controller.row_size, lanes, state], np.int64)
    return {"user_law": _core.PLAIN_LAW, "user_data": data, "plain": plain}


def _plain(controller: Controller, raised: list[Exception]) -> Callable[..., tuple[float, ...]]:
    """The law as the core calls it.

    It takes all numbers separately and returns one tuple of the torque, or NaN, and the memory.
    """
    law: Any = controller.law
    cells = len(controller.memory)

    def call(
        theta: float, theta_dot: float, x: float, x_dot: float, *numbers: float
    ) -> tuple[float, ...]:
        memory, row = numbers[:cells], numbers[cells:]
        try:
            found = tuple(law(theta, theta_dot, x, x_dot, memory, row))
            renewed = tuple(found[1]) if len(found) == 2 else ()
            if len(renewed) != cells:
                must = f"must return (torque, memory) with {cells} cells of memory"
                place = f"theta = {theta:g}, theta_dot = {theta_dot:g}"
                raise TypeError(
                    f"the control law of {controller.name!r} {must}, "
                    f"got {short_repr(found)} at {place}"
                )
            return found[0], *renewed
        except Exception as error:
            raised.append(error)
            return math.nan, *memory

    return call


def _compiled_law(controller: Controller, lanes: int, state: int) -> Any:
    """The compiled law for blocks of this kind, from an earlier call if there was one, or None."""
    if importlib.util.find_spec("numba") is None:
        return None
    with _lock:
        known = _compiled.setdefault(controller, {})
        if (lanes, state) not in known:
            # Where the compilation has failed once, it has warned.
            failed = None in known.values()
            known[lanes, state] = None if failed else _compile(controller, lanes, state)
        return known[lanes, state]


def _compile(controller: Controller, lanes: int, state: int) -> Any:
    """The law in a compiled loop over a block; a warning and None where numba cannot compile it."""
    law: Any = controller.law
    if not isinstance(law, partial):
        law = partial(law)
    # The arguments that a `functools.partial` binds, by their names in the source.
    given = {f"given_{n}": value for n, value in enumerate(law.args)}
    named = {f"named_{name}": value for name, value in law.keywords.items()}
    source = _source(controller, lanes, state, list(given), list(law.keywords))
    # A division by zero gives infinity, as in the core: an exception would prevent vectorised
    # loops.
    options: dict[str, Any] = {"error_model": "numpy"}
    try:
        import numba

        function = law.func
        if not hasattr(function, "py_func"):
            function = numba.njit(forceinline=True, **options)(function)
        scope = {"law": function, "njit": numba.njit, "options": options, "carray": numba.carray}
        scope |= given | named
        exec(source, scope)
        pointer = numba.types.CPointer(numba.float64)
        signature = numba.void(numba.types.voidptr, pointer, pointer, numba.int64)
        compile_function: Callable[[Any], Any] = numba.cfunc(signature, **options)
        return compile_function(scope["call_law"])
    except Exception as error:
        warnings.warn(
            f"Python calls the control law {controller.name!r}, some tens of times slower than "
            f"compiled code, since numba cannot compile it: {first_cause(error)}",
            stacklevel=2,
        )
        return None


def _source(
    controller: Controller, lanes: int, state: int, given: list[str], keywords: list[str]
) -> str:
    """The source of the loop, in which the law also takes bound arguments and keywords."""
    cells = len(controller.memory)
    size = NUM_ROWS + cells + controller.row_size
    # The number of an environment in each row of the block.
    places = [f"b[j + {row * lanes}]" for row in range(size)]
    memory = places[NUM_ROWS : NUM_ROWS + cells]
    stores = [f"        {place} = renewed[{n}]" for n, place in enumerate(memory)]
    return SOURCE.format(
        size=size * lanes,
        lanes=lanes,
        arguments=", ".join([*given, *places[state : state + 4]]),
        memory=", ".join(memory),
        row=", ".join(places[NUM_ROWS + cells :]),
        named="".join(f", {name}=named_{name}" for name in keywords),
        stores="\n".join(stores),
    )
