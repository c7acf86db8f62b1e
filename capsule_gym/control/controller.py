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
# Most numbers in a reference table, 80 MB.
LARGEST_TABLE = 10_000_000
# Most columns of a table and cells of a memory, each of which the compiler sees.
MOST_COLUMNS = _core.MOST_CELLS


def constant_sizes(law: str) -> dict[str, int]:
    """How many numbers each constant of a law of the core has, in the order of the core."""
    items = (item.partition(":") for item in _core.LAWS[law][0].split())
    return {name: int(size or 1) for name, _, size in items}


@dataclass(frozen=True)
class CoreLaw:
    """A compiled control law of the package with its constants, called like a law in Python.

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
        sizes = constant_sizes(name)
        if sizes.keys() != constants.keys():
            expected, given = ", ".join(sizes), ", ".join(constants)
            raise TypeError(f"the law {name!r} takes the constants {expected}, got {given}")
        numbers: list[float] = []
        for key, size in sizes.items():
            values = np.ravel(np.asarray(constants[key], np.float64))
            fits = values.size == size and not np.isnan(values).any()
            require(fits, key, f"{size} numbers", constants[key])
            numbers += values.tolist()
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
            the next calls. A state that is not finite gives the torque 0 and the same memory.
        """
        states = np.ascontiguousarray(states, np.float64)
        rows = np.ascontiguousarray(rows, np.float64)
        renewed = np.array(memories, np.float64)
        n = len(states)
        expected = (n, 4), (n, self.cells), (n, _core.LAWS[self.name][2])
        if (states.shape, renewed.shape, rows.shape) != expected:
            raise ValueError(
                f"states, memories and rows of {self.name!r} must have the shapes {expected}"
            )
        torques = np.empty(n)
        # One number more: the core reads a number even for a law without constants.
        constants = np.array([*self.constants, 0.0])
        native.call("law_torques", self.number, constants, states, renewed, rows, torques, n)
        return torques, renewed

    def __call__(self, *state_memory_reference: Any) -> tuple[float, tuple[float, ...]]:
        """Evaluates `law(theta, theta_dot, x, x_dot, memory, reference)`; see `Controller`."""
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
        self._try_law()

    @property
    def task_size(self) -> int:
        """Numbers that the law receives after its row of the reference: the task's memory."""
        return 0 if self.task is None else find_task(self.task).rows

    @property
    def row_size(self) -> int:
        """Numbers that the law receives in `reference`: its row and `task_size` more."""
        return self.reference.shape[1] + self.task_size

    def _try_law(self) -> None:
        """Calls the law once, so that a wrong signature raises an error here.

        Compiled code does not check indices: the Python function is called instead.
        """
        law = getattr(self.law, "py_func", self.law)
        row = (*self.reference[0].tolist(), *[0.0] * self.task_size)
        cells = len(self.memory)
        must = (
            f"the control law of {self.name!r} must be law(theta, theta_dot, x, x_dot, memory, "
            "reference) -> (torque, memory) with finite numbers and as many memory cells as it "
            f"is given ({cells})"
        )
        try:
            torque, memory = law(*row[:2], 0.0, 0.0, self.memory, row)
            values = (float(torque + 0.0), *(float(cell + 0.0) for cell in memory))
        except Exception as error:
            # An arithmetic error comes from the values of the reference, not from the types.
            kind = ValueError if isinstance(error, ArithmeticError) else TypeError
            failed = f"a trial call on its reference failed: {first_cause(error)}"
            raise kind(f"{must}, but {failed}") from error
        if len(values) != 1 + cells or not all(map(math.isfinite, values)):
            raise ValueError(f"{must}, got {values} on its reference")


def _check_reference(reference: Any) -> np.ndarray:
    """A reference table as a read-only array of float64."""
    must = (
        "Controller.reference must be a table of finite numbers of shape (steps >= 1, 2 <= "
        f"columns <= {MOST_COLUMNS}) with theta_d and theta_d_dot in front, at most "
        f"{LARGEST_TABLE} in all"
    )
    try:
        shape = np.shape(reference)
        # Checked before the copy, since the shape of an array can exceed any memory.
        table = np.array(reference, np.float64, order="C") if _fits_table(shape) else None
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{must}: {error}") from None
    if table is None:
        raise ValueError(f"{must}, got shape {shape}")
    if not np.isfinite(table).all():
        raise ValueError(f"{must}, got shape {shape}, not all finite")
    table.setflags(write=False)
    return table


def _fits_table(shape: tuple[int, ...]) -> bool:
    """Whether a reference table may have this shape."""
    if len(shape) != 2:
        return False
    rows, columns = shape
    return rows >= 1 and 2 <= columns <= MOST_COLUMNS and rows * columns <= LARGEST_TABLE


def _check_memory(memory: Any) -> tuple[float, ...]:
    """A law's memory as a tuple of floats."""
    accepted = f"a tuple of 1 to {MOST_COLUMNS} finite numbers; a law without memory carries (0.0,)"
    require(isinstance(memory, (tuple, list)), "Controller.memory", accepted, memory, TypeError)
    require(1 <= len(memory) <= MOST_COLUMNS, "Controller.memory", accepted, len(memory))
    return tuple(check_number("Controller.memory", cell, accepted) for cell in memory)
