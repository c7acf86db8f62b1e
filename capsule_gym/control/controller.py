"""The class of control laws that run inside the environment's step."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsule_gym.checks import check_number, first_cause, require
from capsule_gym.core import _core, native
from capsule_gym.tasks.registry import find_task
from capsule_gym.tasks.task import Task

Law = Callable[..., tuple[float, tuple[float, ...]]]

# Period of a control law inside the step, s, unless its `Controller` sets another one: a step of
# the integrator.
LAW_DT = _core.LAW_PHYSICS_DT
# Limits of the numbers in a reference table (80 MB), and of its columns and the cells of a memory,
# each of which the compiler sees.
LARGEST_TABLE = 10_000_000
MOST_COLUMNS = _core.MOST_CELLS


@dataclass(frozen=True)
class CoreLaw:
    """A control law that comes with the package, compiled, with its constants. It is called like a
    law in Python.

    Attributes:
        name: a key of `LAWS` of the core.
        constants: the numbers in the order of the law's list of names.
    """

    name: str
    constants: tuple[float, ...]

    def __init__(self, name: str, /, **constants: float | Sequence[float]) -> None:
        """Puts the constants in order: each is a number or a sequence of numbers, by its name.

        Raises:
            TypeError: if a constant is missing, or the law has none of that name.
            ValueError: if there is no such law, or a constant has a wrong number of values or is
                NaN.
        """
        require(name in _core.LAWS, "name", f"one of {', '.join(_core.LAWS)}", name)
        items = [item.partition(":") for item in _core.LAWS[name][0].split()]
        counts, numbers = {key: int(count or 1) for key, _, count in items}, []
        if counts.keys() != constants.keys():
            raise TypeError(
                f"the law {name!r} takes the constants {', '.join(counts)}, got {', '.join(constants)}"
            )
        for key, count in counts.items():
            numbers += (given := np.ravel(np.asarray(constants[key], np.float64))).tolist()
            require(
                given.size == count and not np.isnan(given).any(),
                key,
                f"{count} numbers",
                constants[key],
            )
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "constants", tuple(numbers))

    @property
    def number(self) -> int:
        """The number of the law in the core."""
        return list(_core.LAWS).index(self.name)

    @property
    def cells(self) -> int:
        """Number of cells of its memory."""
        return int(_core.LAWS[self.name][1])

    def evaluate(
        self, states: np.ndarray, memories: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluates n calls.

        Args:
            states: theta (rad), theta_dot (rad/s), x (m) and x_dot (m/s), shape (n, 4).
            memories: shape (n, cells).
            rows: rows of the reference, each with the memory of the law's task behind it, shape (n,
                columns).

        Returns:
            The torques before their clip to the torque limit, N m, shape (n,), and the memories of
            the next calls.
        """
        n, columns = len(states), _core.LAWS[self.name][2]
        given, rows = (np.ascontiguousarray(array, np.float64) for array in (states, rows))
        renewed, torques, constants = (
            np.array(memories, np.float64),
            np.empty(n),
            np.array([*self.constants, 0.0]),
        )
        expected = (n, 4), (n, self.cells), (n, columns)
        if (given.shape, renewed.shape, rows.shape) != expected:
            raise ValueError(
                f"states, memories and rows of {self.name!r} must have the shapes {expected}"
            )
        native.call("law_torques", self.number, constants, given, renewed, rows, torques, n)
        return torques, renewed

    def __call__(self, *state_memory_reference: Any) -> tuple[float, tuple[float, ...]]:
        """Evaluates one call `law(theta, theta_dot, x, x_dot, memory, reference)`; see
        `Controller`.
        """
        *state, memory, reference = state_memory_reference
        torques, renewed = self.evaluate(
            np.array([state]), np.array([memory]), np.array([reference])
        )
        return float(torques[0]), tuple(renewed[0].tolist())


@dataclass(frozen=True, eq=False)
class Controller:
    """A control law with its reference table and its initial memory.

    The law is a function of numbers without side effects:

        law(theta, theta_dot, x, x_dot, memory, reference) -> (torque, memory)

    The state is in SI units. `memory` is a tuple of floats of constant length, `reference` the
    current row of the reference table as a tuple. The torque is in N m and is clipped to the torque
    limit. The law is called once per `dt` with the current state; the torque is constant until the
    next call.

    Gains are variables of the enclosing function. With numba installed the law is compiled, once
    per process and controller, with the present values of these variables; otherwise, or where
    numba cannot compile it, Python calls it. Compiled code does not check indices: an index beyond
    the end of an array reads other memory.

    Attributes:
        name: name in messages and tables.
        law: the function above, plain or compiled with `numba.njit`; or a `CoreLaw`.
        reference: shape (steps, columns), float64, one row per call over one cycle, which repeats.
            Column 0 is the reference angle in rad, column 1 its rate in rad/s; a law can have
            further columns. At most 256 columns and ten million numbers. Zeros for a law without a
            reference.
        memory: memory at the start of an episode, 1 to 256 numbers.
        dt: seconds between calls; a divisor of the agent step.
        task: task of the law, or its name. The law then receives the task's memory after the row in
            `reference`. None for a law that does not depend on the task.

    Raises:
        TypeError: if a field is of the wrong type, or the law does not return (torque, memory).
        ValueError: if a field is out of range, or a trial call of the law returns a value that is
            not finite.
    """

    name: str
    law: Law
    reference: np.ndarray
    memory: tuple[float, ...] = (0.0,)
    dt: float = LAW_DT
    task: str | Task | None = None

    def __post_init__(self) -> None:
        require(isinstance(self.name, str), "Controller.name", "a string", self.name, TypeError)
        require(callable(self.law), "Controller.law", "a function", self.law, TypeError)
        object.__setattr__(self, "reference", _check_reference(self.reference))
        object.__setattr__(self, "memory", _check_memory(self.memory))
        check_number("Controller.dt", self.dt, "a finite number > 0 (s)", 0.0, open_low=True)
        # A trial call, so that a wrong signature raises an error here and not inside compiled code,
        # which also does not check indices.
        row = (*(float(value) for value in self.reference[0]), *([0.0] * self.task_size))
        law = getattr(self.law, "py_func", self.law)
        must = (
            f"the control law of {self.name!r} must be law(theta, theta_dot, x, x_dot, memory, reference) -> (torque, "
            f"memory) with finite numbers and as many memory cells as it is given ({len(self.memory)})"
        )
        try:
            torque, memory = law(row[0], row[1], 0.0, 0.0, self.memory, row)
            values = (float(torque + 0.0), *(float(cell + 0.0) for cell in memory))
        except Exception as error:
            # An arithmetic error comes from the values of the reference, not from the types.
            kind = ValueError if isinstance(error, ArithmeticError) else TypeError
            raise kind(
                f"{must}, but a trial call on its reference failed: {first_cause(error)}"
            ) from error
        if len(values) - 1 != len(self.memory) or not all(map(math.isfinite, values)):
            raise ValueError(f"{must}, got {values} on its reference")

    @property
    def task_size(self) -> int:
        """Numbers that the law receives after its row of the reference: the task's memory."""
        return 0 if self.task is None else find_task(self.task).rows

    @property
    def row_size(self) -> int:
        """Numbers that the law receives in `reference`: its row, and the task's memory if it reads
        it.
        """
        return self.reference.shape[1] + self.task_size


def _check_reference(reference: Any) -> np.ndarray:
    """A reference table as a read-only array of float64."""
    accepted = (
        f"a table of finite numbers of shape (steps >= 1, 2 <= columns <= {MOST_COLUMNS}) with theta_d and theta_d_dot "
        f"in front, at most {LARGEST_TABLE} in all"
    )
    try:
        shape = np.shape(reference)
        # Checked before the copy, since the shape of an array can exceed any memory.
        fits = (
            len(shape) == 2
            and shape[0] >= 1
            and 2 <= shape[1] <= MOST_COLUMNS
            and math.prod(shape) <= LARGEST_TABLE
        )
        table = np.array(reference, np.float64, order="C") if fits else None
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"Controller.reference must be {accepted}: {error}") from None
    if table is None or not np.isfinite(table).all():
        raise ValueError(
            f"Controller.reference must be {accepted}, got shape {shape}{', not all finite' if fits else ''}"
        )
    table.setflags(write=False)
    return table


def _check_memory(memory: Any) -> tuple[float, ...]:
    """A law's memory as a tuple of floats."""
    accepted = f"a tuple of 1 to {MOST_COLUMNS} finite numbers; a law without memory carries (0.0,)"
    require(isinstance(memory, (tuple, list)), "Controller.memory", accepted, memory, TypeError)
    require(1 <= len(memory) <= MOST_COLUMNS, "Controller.memory", accepted, len(memory))
    return tuple(check_number("Controller.memory", cell, accepted) for cell in memory)
