"""Compiles the physics, the task and a control law into one step of the agent, for any number of environments.

The environments lie in one float64 array `world` of shape (blocks, rows, LANES): one row per quantity of `Row`, the
law's memory and its line of the reference behind them. Within a block every loop runs over the environments, and the
compiler takes several at once; an environment to which something happens (a change of phase, the end of the episode)
is left out of that and follows alone. One environment is a block with one lane in use, threads share a batch by blocks:
the arithmetic is the same everywhere, and so are the results, bit for bit.

A law enters as a global of the kernel. Both are copied, the kernel with that global bound, under names that hold a hash
of everything it compiles, which lets numba's disk cache serve built-in and user laws alike and never serve a stale one.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from enum import IntEnum, auto
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic

from capsule_gym import dynamics, task
from capsule_gym.compilation import (
    compile_now,
    distinct,
    fingerprint,
    inlined,
    inner,
    jitable,
    kernel,
    rebound,
    use_widest_vectors,
)
from capsule_gym.parameters import Plant

# Environments that one loop takes through a step together. Their rows lie side by side at offsets that the compiler
# knows, and one block stays in the first-level cache.
LANES = 64


class Row(IntEnum):
    """The quantities of one environment in `world`; the ones from `energy` to `largest_theta_dot` are the episode's."""

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
    reward = auto()
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
    # What the caller wants: the action, and 1.0 where the environment takes part in the step.
    action = auto()
    active = auto()
    # Of the running step: m / (M + m), x at its start, the phase of the contact, whether something happens in the
    # present substep, how far the environment has stopped, and the time that its present torque has acted.
    mass_ratio = auto()
    before_x = auto()
    slip = auto()
    eventful = auto()
    # What `dynamics.runge_kutta` returned for the present substep.
    next_theta = auto()
    next_theta_dot = auto()
    next_x = auto()
    next_x_dot = auto()
    x_ddot = auto()
    first_normal_force = auto()
    least_normal_force = auto()
    halt = auto()
    elapsed = auto()


# Where each row begins in a block. numba compiles plain integers and floats, no enum members, as constants.
(
    THETA, THETA_DOT, X, X_DOT, MASS, MU, CLOCK, LAW_TORQUE, TORQUE, NORMAL_FORCE, STEP_ENERGY,
    REWARD, REWARD_PROGRESS, REWARD_ENERGY, REWARD_TERMINATION, TERMINATION, STEPS, START_X, DURATION, ENERGY,
    WEIGHT_DISTANCE, TORQUE_SQUARED, PEAK_TORQUE, FORWARD, BACKWARD, STUCK, SMALLEST_NORMAL_RATIO, LARGEST_THETA,
    LARGEST_THETA_DOT, ACTION, ACTIVE, MASS_RATIO, BEFORE_X, SLIP, EVENTFUL, NEXT_THETA, NEXT_THETA_DOT,
    NEXT_X, NEXT_X_DOT, X_DDOT, FIRST_NORMAL_FORCE, LEAST_NORMAL_FORCE, HALT, ELAPSED,
) = (int(row) * LANES for row in Row)  # fmt: skip
ROWS = len(Row)
# Where the law's memory begins; its line of the reference follows.
MEMORY = ROWS * LANES
# The values of `Row.halt`: under way; stopped in the present substep, its law to be asked once more; and at rest.
UNDER_WAY, ENDING, HALTED = 0.0, 1.0, 2.0


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


def pack(plant: Plant, settings: Settings, reference: np.ndarray) -> np.ndarray:
    """Plant, settings and the controller's table in one array, shape (CONSTANTS + table.size,).

    Numbers in a tuple, and every array more, would take longer to enter compiled code than a substep takes.
    """
    return np.concatenate([[*plant, *settings], reference.ravel()])


@jitable
def unpack(fixed: np.ndarray, pivot_torque_on_contact: float) -> tuple[Plant, Settings]:
    """Plant and settings out of what `pack` has packed, but for the constant that the compiler is to know."""
    c = fixed
    plant = Plant(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], pivot_torque_on_contact, c[10])
    steps, law_steps = np.int64(c[14]), np.int64(c[15])
    return plant, Settings(c[11], c[12], c[13], steps, law_steps, c[16], c[17], c[18] != 0.0, c[19] != 0.0)


# Where the controller's table begins.
CONSTANTS = len(Plant._fields) + len(Settings._fields)


def no_law(
    theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
) -> tuple[float, tuple[float, ...]]:
    """The law of the direct-torque task: none, so that the residual torque is the whole torque."""
    return 0.0, memory


@intrinsic(prefer_literal=True)
def load(typing_context: Any, array: Any, start: Any, stride: Any, count: Any) -> Any:
    """The tuple of `count` entries of a contiguous float64 array from `start` on, in steps of `stride`; unchecked.

    The last two are constants of the compiler's. Slices would do as well, were their bounds not checked at run time,
    which keeps the loop around them from vectorising.
    """
    size, step = count.literal_value, stride.literal_value

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        offsets = (builder.add(arguments[1], context.get_constant(types.intp, n * step)) for n in range(size))
        entries = [builder.load(builder.gep(data, [offset])) for offset in offsets]
        return context.make_tuple(builder, signature.return_type, entries)

    return types.UniTuple(types.float64, size)(array, types.intp, stride, count), generate


@intrinsic(prefer_literal=True)
def store(typing_context: Any, array: Any, start: Any, stride: Any, values: Any) -> Any:
    """Writes a tuple where `load` would read it."""
    step = stride.literal_value

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        for n, entry in enumerate(cgutils.unpack_tuple(builder, arguments[3])):
            offset = builder.add(arguments[1], context.get_constant(types.intp, n * step))
            builder.store(entry, builder.gep(data, [offset]))
        return context.get_dummy_value()

    return types.void(array, types.intp, stride, types.UniTuple(types.float64, len(values))), generate


# A table for a task without a law.
NO_REFERENCE = np.zeros((1, 2))

# Bound anew, per law, in the copies that `build` makes; so are the functions below that call each other.
law: Callable[..., Any] = no_law
MEMORY_SIZE = 1
REFERENCE_SIZE = 2
PIVOT_TORQUE_ON_CONTACT = 0.0


@inlined
def plant_of(block: np.ndarray, j: int, plant: Plant) -> Plant:
    """The plant of one environment."""
    return Plant(
        block[MASS + j],
        plant.m,
        plant.l,
        plant.g,
        plant.k,
        plant.c,
        block[MU + j],
        plant.static_ratio,
        plant.backward_ratio,
        plant.pivot_torque_on_contact,
        block[MASS_RATIO + j],
    )


@inlined
def prepare(block: np.ndarray, n: int, plant: Plant) -> int:
    """Begins an agent step of a block's environments; returns how many take part."""
    use_widest_vectors()
    count = 0
    for j in range(n):
        active = block[ACTIVE + j] != 0.0
        block[HALT + j] = UNDER_WAY if active else HALTED
        block[ACTION + j] = task.clip(block[ACTION + j], 1.0)
        block[MASS_RATIO + j] = plant.m / (block[MASS + j] + plant.m)
        block[BEFORE_X + j] = block[X + j]
        block[STEP_ENERGY + j] = 0.0 if active else block[STEP_ENERGY + j]
        block[NORMAL_FORCE + j] = math.inf if active else block[NORMAL_FORCE + j]
        count += active
    return count


@inlined
def engage(block: np.ndarray, n: int, plant: Plant, settings: Settings) -> int:
    """Switches the torque and finds the phases of contact under it; returns how many environments stick."""
    use_widest_vectors()
    period = settings.physics_steps * settings.physics_dt
    resting = 0
    for j in range(n):
        going = block[HALT + j] == UNDER_WAY
        residual = settings.residual_limit * block[ACTION + j]
        torque = task.clip(block[LAW_TORQUE + j] + residual, settings.torque_limit)
        torque = torque if going else block[TORQUE + j]
        x_dot = block[X_DOT + j]
        block[TORQUE + j] = torque
        block[PEAK_TORQUE + j] = max(block[PEAK_TORQUE + j], abs(torque))
        block[ELAPSED + j] = period
        block[SLIP + j] = -1.0 if x_dot < 0.0 else 1.0
        resting += going and x_dot == 0.0
    if resting == 0:
        return 0
    sticking = 0
    for j in range(n):
        p = plant_of(block, j, plant)
        theta, theta_dot, x_dot = block[THETA + j], block[THETA_DOT + j], block[X_DOT + j]
        slip = dynamics.contact_phase(theta, theta_dot, x_dot, block[TORQUE + j], p)
        slip = slip if block[HALT + j] == UNDER_WAY else 1.0
        block[SLIP + j] = slip
        sticking += slip == 0.0
    return sticking


@inlined
def glide(block: np.ndarray, n: int, plant: Plant, h: float, may_stick: bool) -> None:
    """Takes every environment to which nothing happens through one substep, and marks the others."""
    use_widest_vectors()
    for j in range(n):
        p = plant_of(block, j, plant)
        theta, theta_dot, x, x_dot = block[THETA + j], block[THETA_DOT + j], block[X + j], block[X_DOT + j]
        slip, torque = block[SLIP + j], block[TORQUE + j]
        theta_1, theta_dot_1, x_1, x_dot_1, x_ddot, normal, smallest, lasts = dynamics.glide(
            theta, theta_dot, x, x_dot, slip, torque, p, h, may_stick
        )
        block[NEXT_THETA + j], block[NEXT_THETA_DOT + j] = theta_1, theta_dot_1
        block[NEXT_X + j], block[NEXT_X_DOT + j] = x_1, x_dot_1
        block[X_DDOT + j], block[FIRST_NORMAL_FORCE + j] = x_ddot, normal
        block[LEAST_NORMAL_FORCE + j] = smallest
        going = block[HALT + j] == UNDER_WAY
        smooth = lasts and task.termination(theta_1, normal) == 0
        block[EVENTFUL + j] = 1.0 if going and not smooth else 0.0
        commit = going and smooth
        block[THETA + j] = theta_1 if commit else theta
        block[THETA_DOT + j] = theta_dot_1 if commit else theta_dot
        block[X + j] = x_1 if commit else x
        block[X_DOT + j] = x_dot_1 if commit else x_dot
        moved = x_1 - x if commit else 0.0
        turned = dynamics.swept(theta_dot, theta_dot_1, theta_1 - theta, h) if commit else 0.0
        block[STEP_ENERGY + j] += abs(torque) * turned
        block[FORWARD + j] += max(0.0, moved)
        block[BACKWARD + j] += max(0.0, -moved)
        if may_stick:
            block[STUCK + j] += h if commit and slip == 0.0 else 0.0
        block[NORMAL_FORCE + j] = min(block[NORMAL_FORCE + j], normal if commit else math.inf)
        block[LARGEST_THETA + j] = max(block[LARGEST_THETA + j], abs(theta_1) if commit else 0.0)
        block[LARGEST_THETA_DOT + j] = max(block[LARGEST_THETA_DOT + j], abs(theta_dot_1) if commit else 0.0)


@jitable
def follow(block: np.ndarray, j: int, plant: Plant, h: float, elapsed: float) -> int:
    """Takes one environment through a substep in which something happens; returns by how many more stick afterwards."""
    p = plant_of(block, j, plant)
    torque = block[TORQUE + j]
    theta, theta_dot, x, x_dot = block[THETA + j], block[THETA_DOT + j], block[X + j], block[X_DOT + j]
    slip = block[SLIP + j]
    if block[LEAST_NORMAL_FORCE + j] >= 0.0:
        whole = dynamics.finish(
            block[NEXT_THETA + j],
            block[NEXT_THETA_DOT + j],
            block[NEXT_X + j],
            block[NEXT_X_DOT + j],
            slip,
            torque,
            p,
            h,
            block[X_DDOT + j],
            block[FIRST_NORMAL_FORCE + j],
        )
    else:
        whole = dynamics.piece(theta, theta_dot, x, x_dot, slip, torque, p, h)
    motion = dynamics.follow(theta, theta_dot, x, x_dot, slip, torque, p, whole)
    block[THETA + j], block[THETA_DOT + j] = motion.theta, motion.theta_dot
    block[X + j], block[X_DOT + j] = motion.x, motion.x_dot
    block[STEP_ENERGY + j] += abs(torque) * motion.swept
    block[FORWARD + j] += motion.forward
    block[BACKWARD + j] += motion.backward
    block[STUCK + j] += motion.stuck
    block[NORMAL_FORCE + j] = min(block[NORMAL_FORCE + j], motion.normal_force)
    block[LARGEST_THETA + j] = max(block[LARGEST_THETA + j], abs(motion.theta))
    block[LARGEST_THETA_DOT + j] = max(block[LARGEST_THETA_DOT + j], abs(motion.theta_dot))
    ended = task.termination(motion.theta, motion.normal_force)
    next_slip = dynamics.contact_phase(motion.theta, motion.theta_dot, motion.x_dot, torque, p)
    if ended != 0:
        block[TERMINATION + j] = ended
        block[HALT + j] = ENDING
        block[ELAPSED + j] = elapsed
        next_slip = 1.0
    block[SLIP + j] = next_slip
    return (1 if next_slip == 0.0 else 0) - (1 if slip == 0.0 else 0)


@inlined
def consult(block: np.ndarray, n: int, fixed: np.ndarray, cycle: int, settings: Settings, tick: float) -> None:
    """Asks the law for its torque at the present state, `tick` rows further in its reference of `cycle` rows."""
    use_widest_vectors()
    for j in range(n):
        clock = block[CLOCK + j] + (tick if block[HALT + j] != HALTED else 0.0)
        block[CLOCK + j] = clock if clock < cycle else 0.0
    # Environments that began together read the same line of the reference; where they read different ones, no compiler
    # vectorises the loop, which is therefore one of its own.
    first, apart = block[CLOCK], 0
    for j in range(n):
        apart += block[CLOCK + j] != first
    if apart == 0:
        line = load(fixed, CONSTANTS + np.int64(first) * REFERENCE_SIZE, 1, REFERENCE_SIZE)
        for j in range(n):
            store(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, line)
    else:
        for j in range(n):
            line = load(fixed, CONSTANTS + np.int64(block[CLOCK + j]) * REFERENCE_SIZE, 1, REFERENCE_SIZE)
            store(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, line)
    for j in range(n):
        row = load(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, REFERENCE_SIZE)
        memory = load(block, MEMORY + j, LANES, MEMORY_SIZE)
        torque, renewed = law(block[THETA + j], block[THETA_DOT + j], block[X + j], block[X_DOT + j], memory, row)
        halt = block[HALT + j]
        asked = halt != HALTED
        # Infinity must not pass for a torque that was clipped: infinity minus itself is NaN.
        clipped = task.clip(torque, settings.torque_limit) + (torque - torque)
        block[LAW_TORQUE + j] = clipped if asked else block[LAW_TORQUE + j]
        store(block, MEMORY + j, LANES, renewed if asked else memory)
        elapsed = block[ELAPSED + j] if asked else 0.0
        torque = block[TORQUE + j]
        block[DURATION + j] += tick * elapsed
        block[TORQUE_SQUARED + j] += tick * elapsed * torque * torque
        block[HALT + j] = UNDER_WAY if halt == UNDER_WAY else HALTED


@inlined
def settle(block: np.ndarray, n: int, plant: Plant, settings: Settings) -> None:
    """Ends an agent step: rewards and the sums of the episode."""
    use_widest_vectors()
    for j in range(n):
        active = block[ACTIVE + j] != 0.0
        share = 1.0 if active else 0.0
        weight = (block[MASS + j] + plant.m) * plant.g
        moved = block[X + j] - block[BEFORE_X + j]
        energy = block[STEP_ENERGY + j]
        terms = task.reward_terms(
            moved, energy, block[TERMINATION + j] != 0.0, settings.energy_weight, settings.termination_penalty
        )
        progress, energy_cost, penalty = terms
        block[REWARD + j] = progress + energy_cost + penalty if active else 0.0
        block[REWARD_PROGRESS + j] = progress if active else block[REWARD_PROGRESS + j]
        block[REWARD_ENERGY + j] = energy_cost if active else block[REWARD_ENERGY + j]
        block[REWARD_TERMINATION + j] = penalty if active else block[REWARD_TERMINATION + j]
        block[STEPS + j] += share
        block[ENERGY + j] += share * energy
        block[WEIGHT_DISTANCE + j] += share * weight * moved
        smallest = min(block[SMALLEST_NORMAL_RATIO + j], block[NORMAL_FORCE + j] / weight)
        block[SMALLEST_NORMAL_RATIO + j] = smallest if active else block[SMALLEST_NORMAL_RATIO + j]


@inlined
def observe(block: np.ndarray, n: int, begin: bool, settings: Settings, cycle: int, observations: np.ndarray) -> None:
    """Writes the observations of a block's environments that take part."""
    for j in range(n):
        if block[ACTIVE + j] != 0.0:
            task.write_observation(
                observations[j],
                (block[THETA + j], block[THETA_DOT + j], block[X_DOT + j]),
                0.0 if begin else block[ACTION + j],
                (
                    block[MEMORY + MEMORY_SIZE * LANES + j],
                    block[MEMORY + (MEMORY_SIZE + 1) * LANES + j],
                    block[CLOCK + j] / cycle,
                ),
                block[LAW_TORQUE + j],
                (block[MASS + j], block[MU + j]),
                settings.with_reference,
                settings.with_parameters,
            )


def advance(
    world: np.ndarray,
    first: int,
    last: int,
    begin: bool,
    fixed: np.ndarray,
    observations: np.ndarray,
) -> int:
    """One agent step of the environments first..last-1 that `Row.active` names; the others stand still.

    Args:
        world: shape (blocks, (ROWS + memory cells + columns of the reference) LANES), float64; changed.
        first: first environment, a multiple of LANES.
        last: one past the last environment.
        begin: begin an episode instead of taking a step: the law is asked for its first torque.
        fixed: plant, settings and the controller's table, from `pack`; M and mu come from `world`.
        observations: shape (environments, entries), float32; written.

    Returns:
        Index of an environment whose state or torque is no longer finite, or -1.
    """
    plant, settings = unpack(fixed, PIVOT_TORQUE_ON_CONTACT)
    cycle = (fixed.size - CONSTANTS) // REFERENCE_SIZE
    h = settings.physics_dt
    broken = -1
    for b in range(first // LANES, (last + LANES - 1) // LANES):
        block = world[b]
        n = last - b * LANES
        n = n if n < LANES else LANES
        if prepare(block, n, plant) == 0 and begin:
            continue
        for _ in range(1 if begin else settings.law_steps):
            if not begin:
                sticking = engage(block, n, plant, settings)
                for substep in range(settings.physics_steps):
                    if sticking > 0:
                        glide(block, n, plant, h, True)
                    else:
                        glide(block, n, plant, h, False)
                    for j in range(n):
                        if block[EVENTFUL + j] != 0.0:
                            sticking += follow(block, j, plant, h, (substep + 1) * h)
            consult(block, n, fixed, cycle, settings, 0.0 if begin else 1.0)
        if not begin:
            settle(block, n, plant, settings)
        observe(block, n, begin, settings, cycle, observations[b * LANES :])
        for j in range(n):
            if not math.isfinite(block[THETA_DOT + j] + block[LAW_TORQUE + j] + block[REWARD + j]):
                broken = b * LANES + j
    return broken


SIGNATURE = (
    types.float64[:, ::1],
    types.int64,
    types.int64,
    types.boolean,
    types.float64[::1],
    types.float32[:, ::1],
)


def build(
    law_function: Callable[..., Any],
    memory_size: int,
    reference_size: int,
    pivot_torque_on_contact: float,
    name: str = "a law",
) -> Any:
    """Compiles `advance` for one law, or loads it from numba's disk cache; says so where it has to compile.

    Args:
        law_function: the law, plain or jitted.
        memory_size: number of its memory cells.
        reference_size: number of columns of its reference table.
        pivot_torque_on_contact: 1.0 for the paper's normal force, 0.0 for Newton's.
        name: of the law, for the message.
    """
    source = law_function.py_func if isinstance(law_function, CPUDispatcher) else law_function
    shape = f"{memory_size}:{reference_size}:{pivot_torque_on_contact}"
    key = f"{fingerprint(source)}:{shape}:{_own_fingerprint()}"
    digest = hashlib.sha256(key.encode()).hexdigest()[:16]
    if digest not in _built:
        bindings: dict[str, Any] = {
            "law": inner(distinct(source, digest)),
            "MEMORY_SIZE": memory_size,
            "REFERENCE_SIZE": reference_size,
            "PIVOT_TORQUE_ON_CONTACT": pivot_torque_on_contact,
        }
        for function in (consult, observe):
            bindings[function.__name__] = inlined(rebound(function, f"{function.__name__}_{digest}", bindings))
        built = kernel(advance, digest, bindings)
        compile_now(built, SIGNATURE, f"the physics with {name}")
        _built[digest] = built
    return _built[digest]


_built: dict[str, Any] = {}


@lru_cache(maxsize=1)
def _own_fingerprint() -> str:
    """The part of the fingerprint that all laws share: the kernel, the task and the physics."""
    return fingerprint(advance)
