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
    """The quantities of one environment in `world`, those that are read or written together side by side."""

    # The state, the plant, and what drives it: m / (M + m), the phase of the contact, the torque, and whether the
    # environment is under way.
    theta = 0
    theta_dot = auto()
    x = auto()
    x_dot = auto()
    M = auto()
    mu = auto()
    mass_ratio = auto()
    slip = auto()
    torque = auto()
    halt = auto()
    # Sums of the running step (energy and normal force) and of the episode.
    step_energy = auto()
    normal_force = auto()
    forward = auto()
    backward = auto()
    stuck = auto()
    largest_theta = auto()
    largest_theta_dot = auto()
    # What comes of the step.
    law_torque = auto()
    reward = auto()
    reward_progress = auto()
    reward_energy = auto()
    reward_termination = auto()
    termination = auto()
    steps = auto()
    # The rest of the episode's: the distance is weighted with (M + m) g, J, for a cost of transport also where M
    # changes on the way.
    energy = auto()
    weight_distance = auto()
    smallest_normal_ratio = auto()
    duration = auto()
    torque_squared = auto()
    peak_torque = auto()
    start_x = auto()
    # What the caller wants: the action, and 1.0 where the environment takes part in the step.
    action = auto()
    active = auto()
    # Of the running step: x at its start, the row of the reference that the law has seen last, how long the present
    # torque has acted, and whether something happens in the present substep.
    before_x = auto()
    clock = auto()
    elapsed = auto()
    eventful = auto()
    # What `dynamics.runge_kutta` returned for the present substep.
    next_theta = auto()
    next_theta_dot = auto()
    next_x = auto()
    next_x_dot = auto()
    x_ddot = auto()
    first_normal_force = auto()
    least_normal_force = auto()


# The rows that infos show.
SHOWN = Row.steps + 1

# Where each row begins in a block. numba compiles plain integers and floats, no enum members, as constants.
(
    THETA, THETA_DOT, X, X_DOT, MASS, MU, MASS_RATIO, SLIP, TORQUE, HALT,
    STEP_ENERGY, NORMAL_FORCE, FORWARD, BACKWARD, STUCK, LARGEST_THETA, LARGEST_THETA_DOT,
    LAW_TORQUE, REWARD, REWARD_PROGRESS, REWARD_ENERGY, REWARD_TERMINATION, TERMINATION, STEPS,
    ENERGY, WEIGHT_DISTANCE, SMALLEST_NORMAL_RATIO, DURATION, TORQUE_SQUARED, PEAK_TORQUE, START_X, ACTION, ACTIVE,
    BEFORE_X, CLOCK, ELAPSED, EVENTFUL,
    NEXT_THETA, NEXT_THETA_DOT, NEXT_X, NEXT_X_DOT, X_DDOT, FIRST_NORMAL_FORCE, LEAST_NORMAL_FORCE,
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


def pack(plant: Plant, settings: Settings) -> np.ndarray:
    """Plant and settings in one array: a tuple of numbers takes ten times as long to enter compiled code."""
    return np.array([*plant, *settings], dtype=np.float64)


@jitable
def unpack(constants: np.ndarray, pivot_torque_on_contact: float) -> tuple[Plant, Settings]:
    """What `pack` has packed, but for the constant that the compiler is to know."""
    c = constants
    plant = Plant(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], pivot_torque_on_contact, c[10])
    return plant, Settings(
        c[11], c[12], c[13], np.int64(c[14]), np.int64(c[15]), c[16], c[17], c[18] != 0.0, c[19] != 0.0
    )


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
NO_REFERENCE.setflags(write=False)

# Bound anew, per law, in the copies that `build` makes; so are the functions below that call each other.
law: Callable[..., Any] = no_law
MEMORY_SIZE = 1
REFERENCE_SIZE = 2
PIVOT_TORQUE_ON_CONTACT = 0.0


@inlined
def on_floor(plant: Plant, M: float, mu: float, mass_ratio: float) -> Plant:
    """The plant of one environment."""
    return Plant(
        M,
        plant.m,
        plant.l,
        plant.g,
        plant.k,
        plant.c,
        mu,
        plant.static_ratio,
        plant.backward_ratio,
        plant.pivot_torque_on_contact,
        mass_ratio,
    )


@inlined
def prepare(block: np.ndarray, n: int, plant: Plant) -> int:
    """Begins an agent step of a block's environments; returns how many take part."""
    use_widest_vectors()
    count = 0
    for j in range(n):
        active = block[ACTIVE + j] != 0.0
        energy, normal = load(block, STEP_ENERGY + j, LANES, 2)
        store(block, STEP_ENERGY + j, LANES, (0.0 if active else energy, math.inf if active else normal))
        block[HALT + j] = UNDER_WAY if active else HALTED
        block[ACTION + j] = task.clip(block[ACTION + j], 1.0)
        block[MASS_RATIO + j] = plant.m / (block[MASS + j] + plant.m)
        block[BEFORE_X + j] = block[X + j]
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
        store(block, SLIP + j, LANES, (-1.0 if x_dot < 0.0 else 1.0, torque))
        block[PEAK_TORQUE + j] = max(block[PEAK_TORQUE + j], abs(torque))
        block[ELAPSED + j] = period
        resting += going and x_dot == 0.0
    if resting == 0:
        return 0
    sticking = 0
    for j in range(n):
        theta, theta_dot, _, x_dot, M, mu, mass_ratio, _, torque, halt = load(block, THETA + j, LANES, 10)
        slip = dynamics.contact_phase(theta, theta_dot, x_dot, torque, on_floor(plant, M, mu, mass_ratio))
        slip = slip if halt == UNDER_WAY else 1.0
        block[SLIP + j] = slip
        sticking += slip == 0.0
    return sticking


@inlined
def glide(block: np.ndarray, n: int, plant: Plant, h: float, may_stick: bool) -> None:
    """Takes every environment to which nothing happens through one substep, and marks the others."""
    use_widest_vectors()
    for j in range(n):
        theta, theta_dot, x, x_dot, M, mu, mass_ratio, slip, torque, halt = load(block, THETA + j, LANES, 10)
        energy, least, forward, backward, stuck, largest, fastest = load(block, STEP_ENERGY + j, LANES, 7)
        p = on_floor(plant, M, mu, mass_ratio)
        theta_1, theta_dot_1, x_1, x_dot_1, x_ddot, normal, smallest, lasts = dynamics.glide(
            theta, theta_dot, x, x_dot, slip, torque, p, h, may_stick
        )
        store(block, NEXT_THETA + j, LANES, (theta_1, theta_dot_1, x_1, x_dot_1, x_ddot, normal, smallest))
        going = halt == UNDER_WAY
        smooth = lasts and task.termination(theta_1, normal) == 0
        commit = going and smooth
        block[EVENTFUL + j] = 1.0 if going and not smooth else 0.0
        end_theta, end_theta_dot = theta_1 if commit else theta, theta_dot_1 if commit else theta_dot
        end_x, end_x_dot = x_1 if commit else x, x_dot_1 if commit else x_dot
        store(block, THETA + j, LANES, (end_theta, end_theta_dot, end_x, end_x_dot))
        moved = end_x - x
        turned = dynamics.swept(theta_dot, theta_dot_1, theta_1 - theta, h) if commit else 0.0
        sums = (
            energy + abs(torque) * turned,
            min(least, normal if commit else math.inf),
            forward + max(0.0, moved),
            backward + max(0.0, -moved),
            stuck + (h if may_stick and commit and slip == 0.0 else 0.0),
            max(largest, abs(end_theta)),
            max(fastest, abs(end_theta_dot)),
        )
        store(block, STEP_ENERGY + j, LANES, sums)


@jitable
def follow(block: np.ndarray, j: int, plant: Plant, h: float, elapsed: float) -> int:
    """Takes one environment through a substep in which something happens; returns by how many more stick afterwards."""
    theta, theta_dot, x, x_dot, M, mu, mass_ratio, slip, torque, _ = load(block, THETA + j, LANES, 10)
    energy, least, forward, backward, stuck, largest, fastest = load(block, STEP_ENERGY + j, LANES, 7)
    theta_1, theta_dot_1, x_1, x_dot_1, x_ddot, normal, smallest = load(block, NEXT_THETA + j, LANES, 7)
    p = on_floor(plant, M, mu, mass_ratio)
    if smallest >= 0.0:
        whole = dynamics.finish(theta_1, theta_dot_1, x_1, x_dot_1, slip, torque, p, h, x_ddot, normal)
    else:
        whole = dynamics.piece(theta, theta_dot, x, x_dot, slip, torque, p, h)
    motion = dynamics.follow(theta, theta_dot, x, x_dot, slip, torque, p, whole)
    store(block, THETA + j, LANES, (motion.theta, motion.theta_dot, motion.x, motion.x_dot))
    sums = (
        energy + abs(torque) * motion.swept,
        min(least, motion.normal_force),
        forward + motion.forward,
        backward + motion.backward,
        stuck + motion.stuck,
        max(largest, abs(motion.theta)),
        max(fastest, abs(motion.theta_dot)),
    )
    store(block, STEP_ENERGY + j, LANES, sums)
    next_slip = dynamics.contact_phase(motion.theta, motion.theta_dot, motion.x_dot, torque, p)
    ended = task.termination(motion.theta, motion.normal_force)
    if ended != 0:
        block[TERMINATION + j] = ended
        block[HALT + j] = ENDING
        block[ELAPSED + j] = elapsed
        next_slip = 1.0
    block[SLIP + j] = next_slip
    return (1 if next_slip == 0.0 else 0) - (1 if slip == 0.0 else 0)


@inlined
def consult(block: np.ndarray, n: int, reference: np.ndarray, settings: Settings, tick: float) -> None:
    """Asks the law for its torque at the present state, `tick` rows further in its reference."""
    use_widest_vectors()
    # A loop of its own: where the environments read the table at different places, no compiler vectorises it.
    for j in range(n):
        clock = block[CLOCK + j] + (tick if block[HALT + j] != HALTED else 0.0)
        clock = clock if clock < reference.shape[0] else 0.0
        block[CLOCK + j] = clock
        row = load(reference, np.int64(clock) * REFERENCE_SIZE, 1, REFERENCE_SIZE)
        store(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, row)
    for j in range(n):
        row = load(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, REFERENCE_SIZE)
        memory = load(block, MEMORY + j, LANES, MEMORY_SIZE)
        theta, theta_dot, x, x_dot = load(block, THETA + j, LANES, 4)
        torque, renewed = law(theta, theta_dot, x, x_dot, memory, row)
        halt = block[HALT + j]
        asked = halt != HALTED
        # Infinity must not pass for a torque that was clipped: infinity minus itself is NaN.
        clipped = task.clip(torque, settings.torque_limit) + (torque - torque)
        block[LAW_TORQUE + j] = clipped if asked else block[LAW_TORQUE + j]
        store(block, MEMORY + j, LANES, renewed if asked else memory)
        elapsed = tick * block[ELAPSED + j] if asked else 0.0
        duration, squared = load(block, DURATION + j, LANES, 2)
        applied = block[TORQUE + j]
        store(block, DURATION + j, LANES, (duration + elapsed, squared + elapsed * applied * applied))
        block[HALT + j] = UNDER_WAY if halt == UNDER_WAY else HALTED


@inlined
def settle(block: np.ndarray, n: int, plant: Plant, settings: Settings) -> None:
    """Ends an agent step: rewards and the sums of the episode."""
    use_widest_vectors()
    for j in range(n):
        active = block[ACTIVE + j] != 0.0
        weight = (block[MASS + j] + plant.m) * plant.g
        moved = block[X + j] - block[BEFORE_X + j]
        energy, normal = load(block, STEP_ENERGY + j, LANES, 2)
        _, progress, cost, penalty, termination, steps = load(block, REWARD + j, LANES, 6)
        if active:
            progress, cost, penalty = task.reward_terms(
                moved, energy, termination != 0.0, settings.energy_weight, settings.termination_penalty
            )
        reward = progress + cost + penalty if active else 0.0
        share = 1.0 if active else 0.0
        store(block, REWARD + j, LANES, (reward, progress, cost, penalty, termination, steps + share))
        spent, carried, least = load(block, ENERGY + j, LANES, 3)
        least = min(least, normal / weight) if active else least
        store(block, ENERGY + j, LANES, (spent + share * energy, carried + share * weight * moved, least))


@inlined
def observe(block: np.ndarray, n: int, begin: bool, settings: Settings, cycle: int, observations: np.ndarray) -> None:
    """Writes the observations of block b where its environments take part."""
    for j in range(n):
        if block[ACTIVE + j] != 0.0:
            theta, theta_dot, _, x_dot, M, mu = load(block, THETA + j, LANES, 6)
            theta_d, theta_d_dot = load(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, 2)
            task.write_observation(
                observations[j],
                (theta, theta_dot, x_dot),
                0.0 if begin else block[ACTION + j],
                (theta_d, theta_d_dot, block[CLOCK + j] / cycle),
                block[LAW_TORQUE + j],
                (M, mu),
                settings.with_reference,
                settings.with_parameters,
            )


def advance(
    world: np.ndarray,
    first: int,
    last: int,
    begin: bool,
    constants: np.ndarray,
    reference: np.ndarray,
    observations: np.ndarray,
) -> int:
    """One agent step of the environments first..last-1 that `Row.active` names; the others stand still.

    Args:
        world: shape (blocks, (ROWS + memory cells + columns of the reference) LANES), float64; changed.
        first: first environment, a multiple of LANES.
        last: one past the last environment.
        begin: begin an episode instead of taking a step: the law is asked for its first torque.
        constants: plant and settings, from `pack`; M and mu come from `world`.
        reference: the controller's table.
        observations: shape (environments, entries), float32; written.

    Returns:
        Index of an environment whose state or torque is no longer finite, or -1.
    """
    plant, settings = unpack(constants, PIVOT_TORQUE_ON_CONTACT)
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
            consult(block, n, reference, settings, 0.0 if begin else 1.0)
        if not begin:
            settle(block, n, plant, settings)
        observe(block, n, begin, settings, reference.shape[0], observations[b * LANES :])
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
    types.Array(types.float64, 2, "C", readonly=True),
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
