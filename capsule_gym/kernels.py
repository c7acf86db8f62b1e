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
from collections.abc import Callable, Iterator
from functools import lru_cache
from itertools import repeat
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from numba import types
from numba.core import cgutils
from numba.core.errors import NumbaError
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
from capsule_gym.elementary import clip
from capsule_gym.observation import write_observation
from capsule_gym.parameters import Plant

# `task` itself does without numba, which takes most of a second to import.
for _function in (task.reward_terms, task.termination, task.continues, task.bounded):
    inlined(_function)

# Environments that one loop takes through a step together. Their rows lie side by side at offsets that the compiler
# knows, and one block stays in the first-level cache.
LANES = 64


class Quantities(NamedTuple):
    """A whole number for each quantity of one environment in `world`, in their order there."""

    # What `info` shows, under these names.
    theta: int
    theta_dot: int
    x: int
    x_dot: int
    M: int
    mu: int
    torque: int
    law_torque: int
    normal_force: int
    energy: int
    reward_progress: int
    reward_energy: int
    reward_termination: int
    # How the agent step has ended.
    reward: int
    termination: int
    steps: int
    # The episode's, down to `largest_theta_dot`.
    start_x: int
    duration: int
    episode_energy: int
    # Distance weighted with (M + m) g, J: the denominator of the cost of transport, also where M changes on the way.
    weight_distance: int
    torque_squared: int
    peak_torque: int
    forward: int
    backward: int
    stuck: int
    smallest_normal_ratio: int
    largest_theta: int
    largest_theta_dot: int
    # Row of the reference table that the law has seen last.
    clock: int
    # What the caller wants: the action, and 1.0 where the environment takes part in the step.
    action: int
    active: int
    # Of the running step: m / (M + m), x at its start, the phase of the contact, whether something happens in the
    # present substep, how far the environment has stopped, and the time that its present torque has acted.
    mass_ratio: int
    before_x: int
    slip: int
    eventful: int
    # What `dynamics.runge_kutta` returned for the present substep.
    next_theta: int
    next_theta_dot: int
    next_x: int
    next_x_dot: int
    x_ddot: int
    first_normal_force: int
    least_normal_force: int
    halt: int
    elapsed: int


# Each quantity's row of a block, and where that begins in the block's memory. numba takes plain integers in a tuple for
# constants, the members of an enumeration not.
Row = Quantities(*range(len(Quantities._fields)))
AT = Quantities(*(LANES * row for row in Row))
ROWS = len(Row)
# Where the law's memory begins; its line of the reference follows.
MEMORY = ROWS * LANES
# The values of `Row.halt`: under way; stopped in the present substep, its law to be asked once more; and at rest.
UNDER_WAY, ENDING, HALTED = 0.0, 1.0, 2.0
# As a plain integer, which numba takes for a constant.
DIVERGED = int(task.Termination.diverged)


class StepSettings(NamedTuple):
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


def pack(plant: Plant, settings: StepSettings, reference: np.ndarray) -> np.ndarray:
    """Plant, settings and the controller's table in one array, shape (CONSTANTS + table.size,).

    Numbers in a tuple, and every array more, would take longer to enter compiled code than a substep takes.
    """
    # Named, since numpy makes objects of integers that fit none of its own: to the kernel these would be addresses.
    return np.concatenate([np.array([*plant, *settings], np.float64), reference.ravel()], dtype=np.float64)


def check_arrays(**arrays: tuple[Any, type, tuple[int | None, ...]]) -> None:
    """Refuses what compiled code would read or write beyond: its raw entry points look at nothing of an array.

    Args:
        arrays: by name the array, its dtype, and its shape, with None for a length that does not matter.

    Raises:
        TypeError: if one is no contiguous, aligned array of that dtype and shape.
    """
    for name, (array, dtype, shape) in arrays.items():
        sound = isinstance(array, np.ndarray) and array.dtype == dtype and array.ndim == len(shape)
        sound = sound and all(size in (None, own) for size, own in zip(shape, array.shape, strict=True))
        if not (sound and array.flags.c_contiguous and array.flags.aligned and array.dtype.isnative):
            got = f"{array.dtype} of shape {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
            raise TypeError(f"{name} must be a contiguous array of {dtype.__name__} of shape {shape}, got {got}")


# Where `pack` begins with the settings, and with the controller's table.
SETTINGS = len(Plant._fields)
CONSTANTS = SETTINGS + len(StepSettings._fields)


def no_law(
    theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
) -> tuple[float, tuple[float, ...]]:
    """The law of the direct-torque task: none, so that the residual torque is the whole torque."""
    return 0.0, memory


def _places(context: Any, builder: Any, kind: Any, array: Any, start: Any, stride: int, count: int) -> Iterator[Any]:
    """Where `count` entries of a contiguous array lie, from `start` on, in steps of `stride`.

    NUMBA_BOUNDSCHECK has them checked like what is indexed (`make boundscheck`).
    """
    own = context.make_array(kind)(context, builder, array)
    for n in range(count):
        offset = builder.add(start, context.get_constant(types.intp, n * stride))
        if context.enable_boundscheck:
            cgutils.do_boundscheck(context, builder, offset, own.nitems)
        yield builder.gep(own.data, [offset])


@intrinsic(prefer_literal=True)
def load(typing_context: Any, array: Any, start: Any, stride: Any, count: Any) -> Any:
    """The tuple of `count` entries of a contiguous float64 array from `start` on, in steps of `stride`; unchecked.

    The last two are constants of the compiler's. Slices would do as well, were their bounds not checked at run time,
    which keeps the loop around them from vectorising.
    """
    size, step = count.literal_value, stride.literal_value

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        places = _places(context, builder, signature.args[0], arguments[0], arguments[1], step, size)
        return context.make_tuple(builder, signature.return_type, [builder.load(place) for place in places])

    return types.UniTuple(types.float64, size)(array, types.intp, stride, count), generate


@intrinsic(prefer_literal=True)
def store(typing_context: Any, array: Any, start: Any, stride: Any, values: Any) -> Any:
    """Writes a tuple where `load` would read it."""
    step = stride.literal_value

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        entries = cgutils.unpack_tuple(builder, arguments[3])
        places = _places(context, builder, signature.args[0], arguments[0], arguments[1], step, len(entries))
        for entry, place in zip(entries, places, strict=True):
            builder.store(entry, place)
        return context.get_dummy_value()

    return types.void(array, types.intp, stride, types.UniTuple(types.float64, len(values))), generate


@intrinsic
def record(typing_context: Any, array: Any, start: Any, kind: Any) -> Any:
    """The named tuple of class `kind` whose fields are the entries of a float64 array from `start` on; unchecked.

    The class says the order of the fields and their types: float, int or bool.
    """
    hints = get_type_hints(kind.instance_class)
    compiled = {float: types.float64, int: types.int64, bool: types.boolean}
    fields = [compiled[hints[name]] for name in kind.instance_class._fields]
    if len(set(fields)) == 1:
        result = types.NamedUniTuple(fields[0], len(fields), kind.instance_class)
    else:
        result = types.NamedTuple(fields, kind.instance_class)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        places = _places(context, builder, signature.args[0], arguments[0], arguments[1], 1, len(fields))
        entries = [builder.load(place) for place in places]
        values = map(context.cast, repeat(builder), entries, repeat(types.float64), fields)
        return context.make_tuple(builder, result, list(values))

    return result(array, types.intp, kind), generate


@jitable
def unpack(fixed: np.ndarray, pivot_torque_on_contact: float) -> tuple[Plant, StepSettings]:
    """Plant and settings out of what `pack` has packed, but for the constant that the compiler is to know."""
    plant = record(fixed, 0, Plant)
    return Plant(plant.M, plant.mu, plant.mass_ratio, pivot_torque_on_contact, *plant[4:]), record(
        fixed, SETTINGS, StepSettings
    )


# A table for a task without a law.
NO_REFERENCE = np.zeros((1, 2))

# Bound anew, per law, in the copies that `build` makes; so are the functions below that call each other.
law: Callable[..., Any] = no_law
MEMORY_SIZE = 1
REFERENCE_SIZE = NO_REFERENCE.shape[1]
PIVOT_TORQUE_ON_CONTACT = 0.0


@inlined
def plant_of(block: np.ndarray, j: int, plant: Plant) -> Plant:
    """The plant of one environment."""
    return Plant(block[AT.M + j], block[AT.mu + j], block[AT.mass_ratio + j], *plant[3:])


@inlined
def begin_step(block: np.ndarray, n: int, plant: Plant, begin: bool) -> int:
    """Begins an agent step, or an episode, of a block's environments; returns how many take part."""
    use_widest_vectors()
    count = 0
    for j in range(n):
        active = block[AT.active + j] != 0.0
        block[AT.halt + j] = UNDER_WAY if active else HALTED
        block[AT.action + j] = clip(block[AT.action + j], 1.0)
        block[AT.mass_ratio + j] = plant.m / (block[AT.M + j] + plant.m)
        block[AT.before_x + j] = block[AT.x + j]
        block[AT.energy + j] = 0.0 if active else block[AT.energy + j]
        # The smallest of the step is to come; an episode begins with what it is given.
        block[AT.normal_force + j] = math.inf if active and not begin else block[AT.normal_force + j]
        count += active
    return count


@inlined
def apply_torque(block: np.ndarray, n: int, plant: Plant, settings: StepSettings) -> int:
    """Switches the torque and finds the phases of contact under it; returns how many environments stick."""
    use_widest_vectors()
    period = settings.physics_steps * settings.physics_dt
    resting = 0
    for j in range(n):
        going = block[AT.halt + j] == UNDER_WAY
        residual = settings.residual_limit * block[AT.action + j]
        torque = clip(block[AT.law_torque + j] + residual, settings.torque_limit)
        torque = torque if going else block[AT.torque + j]
        x_dot = block[AT.x_dot + j]
        block[AT.torque + j] = torque
        block[AT.peak_torque + j] = max(block[AT.peak_torque + j], abs(torque))
        block[AT.elapsed + j] = period
        block[AT.slip + j] = -1.0 if x_dot < 0.0 else 1.0
        resting += going and x_dot == 0.0
    if resting == 0:
        return 0
    sticking = 0
    for j in range(n):
        p = plant_of(block, j, plant)
        theta, theta_dot, x_dot = block[AT.theta + j], block[AT.theta_dot + j], block[AT.x_dot + j]
        slip = dynamics.contact_phase(theta, theta_dot, x_dot, block[AT.torque + j], p)
        slip = slip if block[AT.halt + j] == UNDER_WAY else 1.0
        block[AT.slip + j] = slip
        sticking += slip == 0.0
    return sticking


@inlined
def step_smooth(block: np.ndarray, n: int, plant: Plant, h: float, may_stick: bool) -> None:
    """Takes every environment to which nothing happens through one substep, and marks the others."""
    use_widest_vectors()
    for j in range(n):
        p = plant_of(block, j, plant)
        theta, theta_dot, x, x_dot = block[AT.theta + j], block[AT.theta_dot + j], block[AT.x + j], block[AT.x_dot + j]
        slip, torque = block[AT.slip + j], block[AT.torque + j]
        theta_1, theta_dot_1, x_1, x_dot_1, x_ddot, normal, smallest, lasts = dynamics.smooth_step(
            theta, theta_dot, x, x_dot, slip, torque, p, h, may_stick
        )
        block[AT.next_theta + j], block[AT.next_theta_dot + j] = theta_1, theta_dot_1
        block[AT.next_x + j], block[AT.next_x_dot + j] = x_1, x_dot_1
        block[AT.x_ddot + j], block[AT.first_normal_force + j] = x_ddot, normal
        block[AT.least_normal_force + j] = smallest
        going = block[AT.halt + j] == UNDER_WAY
        smooth = lasts and task.continues(theta_1, normal)
        block[AT.eventful + j] = 1.0 if going and not smooth else 0.0
        commit = going and smooth
        block[AT.theta + j] = theta_1 if commit else theta
        block[AT.theta_dot + j] = theta_dot_1 if commit else theta_dot
        block[AT.x + j] = x_1 if commit else x
        block[AT.x_dot + j] = x_dot_1 if commit else x_dot
        moved = x_1 - x if commit else 0.0
        turned = dynamics.swept(theta_dot, theta_dot_1, theta_1 - theta, h) if commit else 0.0
        block[AT.energy + j] += abs(torque) * turned
        block[AT.forward + j] += max(0.0, moved)
        block[AT.backward + j] += max(0.0, -moved)
        if may_stick:
            block[AT.stuck + j] += h if commit and slip == 0.0 else 0.0
        block[AT.normal_force + j] = min(block[AT.normal_force + j], normal if commit else math.inf)
        block[AT.largest_theta + j] = max(block[AT.largest_theta + j], abs(theta_1) if commit else 0.0)
        block[AT.largest_theta_dot + j] = max(block[AT.largest_theta_dot + j], abs(theta_dot_1) if commit else 0.0)


@jitable
def step_with_events(block: np.ndarray, j: int, plant: Plant, h: float, elapsed: float) -> int:
    """Takes one environment through a substep in which something happens; returns by how many more stick afterwards."""
    p = plant_of(block, j, plant)
    torque = block[AT.torque + j]
    theta, theta_dot, x, x_dot = block[AT.theta + j], block[AT.theta_dot + j], block[AT.x + j], block[AT.x_dot + j]
    slip = block[AT.slip + j]
    start = dynamics.Phase(theta, theta_dot, x, x_dot, slip, torque, p)
    if block[AT.least_normal_force + j] >= 0.0:
        theta_1, theta_dot_1 = block[AT.next_theta + j], block[AT.next_theta_dot + j]
        x_1, x_dot_1 = block[AT.next_x + j], block[AT.next_x_dot + j]
        end = dynamics.Phase(theta_1, theta_dot_1, x_1, x_dot_1, slip, torque, p)
        whole = dynamics.finish(end, h, block[AT.x_ddot + j], block[AT.first_normal_force + j])
    else:
        whole = dynamics.piece(start, h)
    motion = dynamics.event_step(start, whole)
    whole_motion = motion.theta + motion.x + motion.swept + motion.normal_force
    if not (task.bounded(motion.theta_dot, motion.x_dot) and math.isfinite(whole_motion)):
        # The substep is none: the environment stays where that has begun.
        normal = dynamics.accelerations(theta, theta_dot, slip, torque, p)[2]
        block[AT.normal_force + j] = min(block[AT.normal_force + j], normal)
        block[AT.termination + j] = DIVERGED
        block[AT.halt + j] = ENDING
        block[AT.elapsed + j] = elapsed - h
        block[AT.slip + j] = 1.0
        return -1 if slip == 0.0 else 0
    block[AT.theta + j], block[AT.theta_dot + j] = motion.theta, motion.theta_dot
    block[AT.x + j], block[AT.x_dot + j] = motion.x, motion.x_dot
    block[AT.energy + j] += abs(torque) * motion.swept
    block[AT.forward + j] += motion.forward
    block[AT.backward + j] += motion.backward
    block[AT.stuck + j] += motion.stuck
    block[AT.normal_force + j] = min(block[AT.normal_force + j], motion.normal_force)
    block[AT.largest_theta + j] = max(block[AT.largest_theta + j], abs(motion.theta))
    block[AT.largest_theta_dot + j] = max(block[AT.largest_theta_dot + j], abs(motion.theta_dot))
    ended = task.termination(motion.theta, motion.normal_force)
    next_slip = dynamics.contact_phase(motion.theta, motion.theta_dot, motion.x_dot, torque, p)
    if ended != 0:
        block[AT.termination + j] = ended
        block[AT.halt + j] = ENDING
        block[AT.elapsed + j] = elapsed
        next_slip = 1.0
    block[AT.slip + j] = next_slip
    return (1 if next_slip == 0.0 else 0) - (1 if slip == 0.0 else 0)


@inlined
def call_controller(
    block: np.ndarray, n: int, fixed: np.ndarray, cycle: int, settings: StepSettings, tick: float
) -> None:
    """Asks the law for its torque at the present state, `tick` rows further in its reference of `cycle` rows."""
    use_widest_vectors()
    for j in range(n):
        clock = block[AT.clock + j] + (tick if block[AT.halt + j] != HALTED else 0.0)
        block[AT.clock + j] = clock if clock < cycle else 0.0
    # Environments that began together read the same line of the reference; where they read different ones, no compiler
    # vectorises the loop, which is therefore one of its own.
    first, apart = block[AT.clock], 0
    for j in range(n):
        apart += block[AT.clock + j] != first
    if apart == 0:
        line = load(fixed, CONSTANTS + np.int64(first) * REFERENCE_SIZE, 1, REFERENCE_SIZE)
        for j in range(n):
            store(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, line)
    else:
        for j in range(n):
            line = load(fixed, CONSTANTS + np.int64(block[AT.clock + j]) * REFERENCE_SIZE, 1, REFERENCE_SIZE)
            store(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, line)
    for j in range(n):
        row = load(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, REFERENCE_SIZE)
        memory = load(block, MEMORY + j, LANES, MEMORY_SIZE)
        torque, renewed = law(
            block[AT.theta + j], block[AT.theta_dot + j], block[AT.x + j], block[AT.x_dot + j], memory, row
        )
        halt = block[AT.halt + j]
        asked = halt != HALTED
        # Infinity must not pass for a torque that was clipped: infinity minus itself is NaN. The state stays what the
        # law was asked about.
        clipped = clip(torque, settings.torque_limit) + (torque - torque)
        block[AT.law_torque + j] = clipped if asked else block[AT.law_torque + j]
        store(block, MEMORY + j, LANES, renewed if asked else memory)
        elapsed = block[AT.elapsed + j] if asked else 0.0
        torque = block[AT.torque + j]
        block[AT.duration + j] += tick * elapsed
        block[AT.torque_squared + j] += tick * elapsed * torque * torque
        block[AT.halt + j] = UNDER_WAY if halt == UNDER_WAY and clipped == clipped else HALTED


@inlined
def finish_step(block: np.ndarray, n: int, plant: Plant, settings: StepSettings) -> None:
    """Ends an agent step: rewards and the sums of the episode."""
    use_widest_vectors()
    for j in range(n):
        active = block[AT.active + j] != 0.0
        share = 1.0 if active else 0.0
        weight = (block[AT.M + j] + plant.m) * plant.g
        moved = block[AT.x + j] - block[AT.before_x + j]
        energy = block[AT.energy + j]
        terms = task.reward_terms(
            moved, energy, block[AT.termination + j] != 0.0, settings.energy_weight, settings.termination_penalty
        )
        progress, energy_cost, penalty = terms
        block[AT.reward + j] = progress + energy_cost + penalty if active else 0.0
        block[AT.reward_progress + j] = progress if active else block[AT.reward_progress + j]
        block[AT.reward_energy + j] = energy_cost if active else block[AT.reward_energy + j]
        block[AT.reward_termination + j] = penalty if active else block[AT.reward_termination + j]
        block[AT.steps + j] += share
        block[AT.episode_energy + j] += share * energy
        block[AT.weight_distance + j] += share * weight * moved
        smallest = min(block[AT.smallest_normal_ratio + j], block[AT.normal_force + j] / weight)
        block[AT.smallest_normal_ratio + j] = smallest if active else block[AT.smallest_normal_ratio + j]


@inlined
def observe(
    block: np.ndarray, n: int, begin: bool, settings: StepSettings, cycle: int, observations: np.ndarray
) -> None:
    """Writes the observations of a block's environments that take part."""
    for j in range(n):
        if block[AT.active + j] != 0.0:
            write_observation(
                observations[j],
                (block[AT.theta + j], block[AT.theta_dot + j], block[AT.x_dot + j]),
                0.0 if begin else block[AT.action + j],
                (
                    block[MEMORY + MEMORY_SIZE * LANES + j],
                    block[MEMORY + (MEMORY_SIZE + 1) * LANES + j],
                    block[AT.clock + j] / cycle,
                ),
                block[AT.law_torque + j],
                (block[AT.M + j], block[AT.mu + j]),
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
        Index of an environment whose law returned no finite torque, or -1.
    """
    plant, settings = unpack(fixed, PIVOT_TORQUE_ON_CONTACT)
    cycle = (fixed.size - CONSTANTS) // REFERENCE_SIZE
    h = settings.physics_dt
    broken = -1
    for b in range(first // LANES, (last + LANES - 1) // LANES):
        block = world[b]
        n = last - b * LANES
        n = n if n < LANES else LANES
        if begin_step(block, n, plant, begin) == 0 and begin:
            continue
        for _ in range(1 if begin else settings.law_steps):
            if not begin:
                sticking = apply_torque(block, n, plant, settings)
                for substep in range(settings.physics_steps):
                    if sticking > 0:
                        step_smooth(block, n, plant, h, True)
                    else:
                        step_smooth(block, n, plant, h, False)
                    for j in range(n):
                        if block[AT.eventful + j] != 0.0:
                            sticking += step_with_events(block, j, plant, h, (substep + 1) * h)
            call_controller(block, n, fixed, cycle, settings, 0.0 if begin else 1.0)
        if not begin:
            finish_step(block, n, plant, settings)
        observe(block, n, begin, settings, cycle, observations[b * LANES :])
        for j in range(n):
            if block[AT.active + j] != 0.0 and not math.isfinite(block[AT.law_torque + j]):
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


def bind(
    law_function: Callable[..., Any], digest: str, memory_size: int, reference_size: int, pivot_torque_on_contact: float
) -> dict[str, Any]:
    """The globals that `advance` needs to have another value with a law.

    Args:
        law_function: the law, plain.
        digest: for the names of what is compiled: no two laws may have the same.
        memory_size: number of its memory cells.
        reference_size: number of columns of its reference table.
        pivot_torque_on_contact: 1.0 for the paper's normal force, 0.0 for Newton's.
    """
    bindings: dict[str, Any] = {
        "law": inner(distinct(law_function, digest)),
        "MEMORY_SIZE": memory_size,
        "REFERENCE_SIZE": reference_size,
        "PIVOT_TORQUE_ON_CONTACT": pivot_torque_on_contact,
    }
    for function in (call_controller, observe):
        bindings[function.__name__] = inlined(rebound(function, f"{function.__name__}_{digest}", bindings))
    return bindings


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
        name: of the law, for the messages.

    Raises:
        TypeError: if the law is nothing that numba compiles.
    """
    source = law_function.py_func if isinstance(law_function, CPUDispatcher) else law_function
    shape = f"{memory_size}:{reference_size}:{pivot_torque_on_contact}"
    key = f"{fingerprint(source)}:{shape}:{_own_fingerprint()}"
    digest = hashlib.sha256(key.encode()).hexdigest()[:16]
    if digest not in _built:
        built = kernel(advance, digest, bind(source, digest, memory_size, reference_size, pivot_torque_on_contact))
        try:
            compile_now(built, SIGNATURE, f"the physics with {name}")
        except (NumbaError, NotImplementedError, ValueError) as error:
            raise TypeError(
                f"{name} must be a function that numba compiles, of numbers and tuples of numbers, and return "
                f"(torque, memory) with {memory_size} cells of memory; numba says: {error}"
            ) from error
        _built[digest] = built
    return _built[digest]


_built: dict[str, Any] = {}


@lru_cache(maxsize=1)
def _own_fingerprint() -> str:
    """The part of the fingerprint that all laws share: the kernel, the task and the physics."""
    return fingerprint(advance)
