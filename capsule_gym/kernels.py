"""Compiles the physics, the task and a control law into one step of the agent, for any number of environments.

The environments lie in one float64 array `world` of shape (rows, environments), one row per quantity of `Row`, the
law's memory behind them. The kernels walk a range of columns and hold no lock, so threads share a batch by ranges,
and one environment, a batch and every thread run the same machine code: their results agree bit for bit.

A law enters as a global of the kernel. Both are copied, the kernel with that global bound, under names that hold a hash
of everything it compiles, which lets numba's disk cache serve built-in and user laws alike and never serve a stale one.
"""

from __future__ import annotations

import hashlib
import math
import types
from collections.abc import Callable
from enum import IntEnum, auto
from functools import lru_cache
from typing import Any, NamedTuple

import numba
import numpy as np
from numba.core.registry import CPUDispatcher
from numba.extending import register_jitable
from numba.np.unsafe.ndarray import to_fixed_tuple

from capsule_gym import dynamics, task
from capsule_gym.parameters import Plant


class Row(IntEnum):
    """The quantities of one environment in `world`; the ones from `energy` on belong to the running episode."""

    theta = 0
    theta_dot = auto()
    x = auto()
    x_dot = auto()
    M = auto()
    mu = auto()
    # Row of the reference table that the law has seen last.
    clock = auto()
    law_torque = auto()
    torque = auto()
    normal_force = auto()
    step_energy = auto()
    reward_progress = auto()
    reward_energy = auto()
    reward_termination = auto()
    termination = auto()
    steps = auto()
    start_x = auto()
    duration = auto()
    energy = auto()
    # Distance weighted with (M + m) g, J: the denominator of the cost of transport, also where M changes on the way.
    weight_distance = auto()
    torque_squared = auto()
    peak_torque = auto()
    forward = auto()
    backward = auto()
    stuck = auto()
    smallest_normal_ratio = auto()
    largest_theta = auto()
    largest_theta_dot = auto()


# numba compiles plain integers and floats, no enum members, as constants.
(
    THETA, THETA_DOT, X, X_DOT, MASS, MU, CLOCK, LAW_TORQUE, TORQUE, NORMAL_FORCE, STEP_ENERGY,
    REWARD_PROGRESS, REWARD_ENERGY, REWARD_TERMINATION, TERMINATION, STEPS, START_X, DURATION, ENERGY, WEIGHT_DISTANCE,
    TORQUE_SQUARED, PEAK_TORQUE, FORWARD, BACKWARD, STUCK, SMALLEST_NORMAL_RATIO, LARGEST_THETA, LARGEST_THETA_DOT,
) = (int(row) for row in Row)  # fmt: skip
ROWS = len(Row)


class Settings(NamedTuple):
    """What the kernels need to know of the environment besides the plant; SI units."""

    torque_limit: float
    residual_limit: float
    physics_dt: float
    physics_steps: int
    law_steps: int
    energy_weight: float
    termination_penalty: float
    with_reference: bool
    with_parameters: bool


def pack(plant: Plant, settings: Settings) -> np.ndarray:
    """Plant and settings in one array: a tuple of numbers takes ten times as long to enter compiled code."""
    return np.array([*plant, *settings], dtype=np.float64)


@register_jitable
def unpack(constants: np.ndarray) -> tuple[Plant, Settings]:
    """What `pack` has packed."""
    c = constants
    plant = Plant(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9])
    return plant, Settings(c[10], c[11], c[12], int(c[13]), int(c[14]), c[15], c[16], c[17] != 0.0, c[18] != 0.0)


def no_law(
    theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
) -> tuple[float, tuple[float, ...]]:
    """The law of the direct-torque task: none, so that the residual torque is the whole torque."""
    return 0.0, memory


# Bound anew, per law, in the copies that `build` makes; so are the functions below that call each other.
law: Callable[..., Any] = no_law
MEMORY_SIZE = 1
REFERENCE_SIZE = 2


def consult(
    world: np.ndarray, i: int, reference: np.ndarray, settings: Settings, action: float, observation: np.ndarray
) -> None:
    """Asks the law for its torque at the present state and writes the observation of environment i."""
    clock = int(world[CLOCK, i])
    row = to_fixed_tuple(reference[clock], REFERENCE_SIZE)
    memory = to_fixed_tuple(world[ROWS:, i], MEMORY_SIZE)
    theta, theta_dot, x, x_dot = world[THETA, i], world[THETA_DOT, i], world[X, i], world[X_DOT, i]
    law_torque, memory = law(theta, theta_dot, x, x_dot, memory, row)
    law_torque = task.clip(law_torque, settings.torque_limit)
    for j, cell in enumerate(memory):
        world[ROWS + j, i] = cell
    world[LAW_TORQUE, i] = law_torque
    task.write_observation(
        observation,
        (theta, theta_dot, x_dot),
        action,
        (row[0], row[1], clock / reference.shape[0]),
        law_torque,
        (world[MASS, i], world[MU, i]),
        settings.with_reference,
        settings.with_parameters,
    )


def start(
    world: np.ndarray, rows: np.ndarray, constants: np.ndarray, reference: np.ndarray, observations: np.ndarray
) -> None:
    """Begins an episode in the given environments, whose state, M, mu and memory have been set.

    Args:
        world: shape (rows, environments), float64.
        rows: indices of the environments, int64.
        constants: plant and settings, from `pack`.
        reference: the controller's table.
        observations: shape (environments, entries), float32; written.
    """
    _, settings = unpack(constants)
    for i in rows:
        consult(world, i, reference, settings, 0.0, observations[i])


def advance_one(
    world: np.ndarray,
    i: int,
    action: float,
    plant: Plant,
    settings: Settings,
    reference: np.ndarray,
    observation: np.ndarray,
) -> float:
    """One agent step of environment i; returns the reward. M and mu come from `world`."""
    p = Plant(
        world[MASS, i],
        plant.m,
        plant.l,
        plant.g,
        plant.k,
        plant.c,
        world[MU, i],
        plant.static_ratio,
        plant.backward_ratio,
        plant.pivot_torque_on_contact,
    )
    theta, theta_dot, x, x_dot = world[THETA, i], world[THETA_DOT, i], world[X, i], world[X_DOT, i]
    law_torque = world[LAW_TORQUE, i]
    memory = to_fixed_tuple(world[ROWS:, i], MEMORY_SIZE)
    clock = int(world[CLOCK, i])
    cycle = reference.shape[0]
    h = settings.physics_dt
    action = task.clip(action, 1.0)
    residual = settings.residual_limit * action
    weight = (p.M + p.m) * p.g

    before = x
    torque = 0.0
    energy = duration = torque_squared = forward = backward = stuck = 0.0
    peak = world[PEAK_TORQUE, i]
    smallest_normal = math.inf
    largest_theta = world[LARGEST_THETA, i]
    largest_theta_dot = world[LARGEST_THETA_DOT, i]
    ended = 0
    for tick in range(settings.law_steps):
        torque = task.clip(law_torque + residual, settings.torque_limit)
        peak = max(peak, abs(torque))
        for _ in range(settings.physics_steps):
            motion = dynamics.step(theta, theta_dot, x, x_dot, torque, p, h)
            theta, theta_dot, x, x_dot = motion.theta, motion.theta_dot, motion.x, motion.x_dot
            energy += abs(torque) * motion.swept
            torque_squared += torque * torque * h
            duration += h
            forward += motion.forward
            backward += motion.backward
            stuck += motion.stuck
            smallest_normal = min(smallest_normal, motion.normal_force)
            largest_theta = max(largest_theta, abs(theta))
            largest_theta_dot = max(largest_theta_dot, abs(theta_dot))
            ended = task.termination(theta, motion.normal_force)
            if ended:
                break
        clock = clock + 1 if clock + 1 < cycle else 0
        # The last call of the step is `consult`'s, which also shows its torque to the agent.
        if ended or tick == settings.law_steps - 1:
            break
        law_torque, memory = law(theta, theta_dot, x, x_dot, memory, to_fixed_tuple(reference[clock], REFERENCE_SIZE))
        law_torque = task.clip(law_torque, settings.torque_limit)

    world[THETA, i], world[THETA_DOT, i], world[X, i], world[X_DOT, i] = theta, theta_dot, x, x_dot
    world[CLOCK, i] = clock
    for j, cell in enumerate(memory):
        world[ROWS + j, i] = cell
    world[TORQUE, i] = torque
    world[NORMAL_FORCE, i] = smallest_normal
    world[STEP_ENERGY, i] = energy
    world[TERMINATION, i] = ended
    world[STEPS, i] += 1.0
    world[DURATION, i] += duration
    world[ENERGY, i] += energy
    world[WEIGHT_DISTANCE, i] += weight * (x - before)
    world[TORQUE_SQUARED, i] += torque_squared
    world[PEAK_TORQUE, i] = peak
    world[FORWARD, i] += forward
    world[BACKWARD, i] += backward
    world[STUCK, i] += stuck
    world[SMALLEST_NORMAL_RATIO, i] = min(world[SMALLEST_NORMAL_RATIO, i], smallest_normal / weight)
    world[LARGEST_THETA, i] = largest_theta
    world[LARGEST_THETA_DOT, i] = largest_theta_dot
    progress, energy_cost, penalty = task.reward_terms(
        x - before, energy, ended != 0, settings.energy_weight, settings.termination_penalty
    )
    world[REWARD_PROGRESS, i], world[REWARD_ENERGY, i], world[REWARD_TERMINATION, i] = progress, energy_cost, penalty
    consult(world, i, reference, settings, action, observation)
    return progress + energy_cost + penalty


def advance(
    world: np.ndarray,
    first: int,
    last: int,
    actions: np.ndarray,
    active: np.ndarray,
    constants: np.ndarray,
    reference: np.ndarray,
    observations: np.ndarray,
    rewards: np.ndarray,
) -> int:
    """One agent step of the environments first..last-1.

    Args:
        world: shape (rows, environments), float64; changed.
        first: first column.
        last: one past the last column.
        actions: shape (environments, 1), float32.
        active: shape (environments,), bool; the others stand still and get reward 0.
        constants: plant and settings, from `pack`; M and mu come from `world`.
        reference: the controller's table.
        observations: shape (environments, entries), float32; written.
        rewards: shape (environments,), float64; written.

    Returns:
        Index of an environment whose state or torque is no longer finite, or -1.
    """
    plant, settings = unpack(constants)
    broken = -1
    for i in range(first, last):
        rewards[i] = 0.0
        if active[i]:
            rewards[i] = advance_one(world, i, float(actions[i, 0]), plant, settings, reference, observations[i])
            if not (math.isfinite(rewards[i]) and math.isfinite(world[THETA_DOT, i] + world[LAW_TORQUE, i])):
                broken = i
    return broken


class Kernels(NamedTuple):
    """The compiled entry points for one control law."""

    start: Callable[..., None]
    advance: Callable[..., int]


def fingerprint(function: Callable[..., Any]) -> str:
    """A sha256 of a function and of everything it refers to: bytecode, constants, closures, globals, callees."""
    digest = hashlib.sha256()
    seen: set[int] = set()

    def add_code(code: types.CodeType, scope: dict[str, Any]) -> None:
        digest.update(code.co_code)
        digest.update(repr((code.co_names, code.co_varnames, code.co_freevars)).encode())
        for constant in code.co_consts:
            if isinstance(constant, types.CodeType):
                add_code(constant, scope)
            else:
                digest.update(repr(constant).encode())
        for name in code.co_names:
            if name in scope:
                add(name, scope[name], code.co_names)

    def add(name: str, value: Any, names: tuple[str, ...]) -> None:
        digest.update(name.encode())
        value = getattr(value, "py_func", value)
        if isinstance(value, types.FunctionType):
            if id(value) in seen:
                return
            seen.add(id(value))
            add_code(value.__code__, value.__globals__)
            digest.update(repr(value.__defaults__).encode())
            for free, cell in zip(value.__code__.co_freevars, value.__closure__ or (), strict=True):
                add(free, cell.cell_contents, ())
        elif isinstance(value, types.ModuleType):
            if not value.__name__.startswith(("math", "numpy", "numba", "typing", "builtins")):
                for attribute in names:
                    if hasattr(value, attribute):
                        add(attribute, getattr(value, attribute), ())
        elif isinstance(value, np.ndarray):
            digest.update(repr((value.dtype, value.shape)).encode() + np.ascontiguousarray(value).tobytes())
        elif isinstance(value, type):
            digest.update(repr((value.__qualname__, getattr(value, "_fields", ()))).encode())
        else:
            digest.update(repr(value).encode())

    add(function.__name__, function, ())
    return digest.hexdigest()


def _rebound(function: Any, name: str, bindings: dict[str, Any]) -> Any:
    """A copy of a module-level function under another name, some of its globals bound to other values."""
    copy = types.FunctionType(function.__code__, {**function.__globals__, **bindings}, name, function.__defaults__)
    copy.__qualname__ = name
    copy.__module__ = function.__module__
    return copy


def _distinct(function: Any, digest: str, outer: tuple[Any, ...] = ()) -> Any:
    """A copy of a law, and of the compiled helpers it refers to, under names that hold the hash.

    numba's symbols hold a function's name and a counter of the process. Two laws out of one factory, compiled in two
    processes and loaded from the disk cache into a third, would have the same symbol, and the linker would give both
    the first one's code.
    """

    def renewed(value: Any) -> Any:
        if not isinstance(value, CPUDispatcher) or value in outer:
            return value
        return numba.jit(_distinct(value.py_func, digest, (*outer, value)), **value.targetoptions)

    names = {
        name: renewed(function.__globals__[name]) for name in function.__code__.co_names if name in function.__globals__
    }
    cells = tuple(types.CellType(renewed(cell.cell_contents)) for cell in function.__closure__ or ())
    scope = {**function.__globals__, **names}
    name = f"{function.__name__}_{digest}"
    copy = types.FunctionType(function.__code__, scope, name, function.__defaults__, cells or None)
    copy.__qualname__ = name
    copy.__module__ = function.__module__
    return copy


def build(law_function: Callable[..., Any], memory_size: int, reference_size: int) -> Kernels:
    """Compiles (lazily, at the first call, or loads from numba's disk cache) the kernels for one law.

    Args:
        law_function: the law, plain or jitted.
        memory_size: number of its memory cells.
        reference_size: number of columns of its reference table.
    """
    source = law_function.py_func if isinstance(law_function, CPUDispatcher) else law_function
    key = f"{fingerprint(source)}:{memory_size}:{reference_size}:{_own_fingerprint()}"
    digest = hashlib.sha256(key.encode()).hexdigest()[:16]
    if digest not in _built:
        _built[digest] = _bind(source, memory_size, reference_size, digest)
    return _built[digest]


_built: dict[str, Kernels] = {}


@lru_cache(maxsize=1)
def _own_fingerprint() -> str:
    """The part of the fingerprint that all laws share: the kernels, the task and the physics."""
    return "".join(fingerprint(function) for function in (consult, start, advance_one, advance))


def _bind(law_function: Callable[..., Any], memory_size: int, reference_size: int, digest: str) -> Kernels:
    """The kernels for one law and one set of sources."""
    bindings: dict[str, Any] = {
        "law": numba.njit(_distinct(law_function, digest)),
        "MEMORY_SIZE": memory_size,
        "REFERENCE_SIZE": reference_size,
    }
    for function in (consult, advance_one):
        name = function.__name__
        bindings[name] = numba.njit(_rebound(function, f"{name}_{digest}", bindings))
    return Kernels(*(_compiled(function, digest, bindings) for function in (start, advance)))


def _compiled(function: Callable[..., Any], digest: str, bindings: dict[str, Any]) -> Any:
    """The function with those globals, compiled at its first call or loaded from the disk cache of its sources."""
    return numba.njit(_rebound(function, f"{function.__name__}_{digest}", bindings), cache=True, nogil=True)


def compile_cached(function: Callable[..., Any]) -> Any:
    """Compiles a module-level function with numba; unlike numba's own, the disk cache notices edits of its callees."""
    return _compiled(function, fingerprint(function)[:16], {})
