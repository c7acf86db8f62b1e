"""The compiled step of the environment: the physics, the task and a control law, for any number of environments.

`step` is one agent step, from the action to the observation. `capsule_gym.layout` says where the numbers lie. Loops run
over the environments of a block and are vectorised; an environment in which an event happens (a change of the contact
phase, the end of the episode) is left out of the loop over its substep and integrated by itself.

The step is compiled once for all control laws. `build` compiles `evaluate_law` with a law in it, which takes about a
second, and the step calls it once per law period and block by its address, which stands beside the settings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any
from uuid import uuid4

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import NumbaError
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic

from capsule_gym import dynamics, task
from capsule_gym.compilation import (
    distinct,
    fingerprint,
    inlined,
    inner,
    jitable,
    kernel,
    use_widest_vectors,
)
from capsule_gym.controller import first_cause
from capsule_gym.elementary import clip
from capsule_gym.layout import (
    AT,
    CONSTANTS,
    ENDING,
    HALTED,
    LANES,
    LAW,
    MEMORY,
    UNDER_WAY,
    StepSettings,
    load,
    plant_of,
    store,
    unpack,
)
from capsule_gym.observation import write_observation
from capsule_gym.parameters import Plant

# `task` itself is imported without numba, which takes most of a second.
for _function in (task.reward_terms, task.termination, task.continues, task.bounded):
    inlined(_function)

# As a plain integer, which numba takes for a constant.
DIVERGED = int(task.Termination.diverged)


def no_law(
    theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
) -> tuple[float, tuple[float, ...]]:
    """The law of the direct-torque task: none, so that the residual torque is the whole torque."""
    return 0.0, memory


# A table for a task without a law.
NO_REFERENCE = np.zeros((1, 2))

# `build` gives these the values of a law, and `build_advance` the last one its own.
law: Callable[..., Any] = no_law
MEMORY_SIZE = 1
REFERENCE_SIZE = NO_REFERENCE.shape[1]
PIVOT_TORQUE_ON_CONTACT = 0.0


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
        # The minimum over the step; at the start of an episode the weight, which `resets.renew` has written.
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
def evaluate_law(block: np.ndarray, n: int, fixed: np.ndarray, cycle: int, torque_limit: float, tick: float) -> None:
    """Calls the law with the present state of a block's environments, `tick` rows further in its reference.

    Args:
        block: one block of `world`; changed.
        n: environments in it.
        fixed: from `capsule_gym.layout.pack`; holds the reference.
        cycle: rows of the reference.
        torque_limit: N m.
        tick: 1.0, or 0.0 for the first call of an episode.
    """
    use_widest_vectors()
    for j in range(n):
        clock = block[AT.clock + j] + (tick if block[AT.halt + j] != HALTED else 0.0)
        block[AT.clock + j] = clock if clock < cycle else 0.0
    # Environments that began together read the same line of the reference; where they read different ones, no compiler
    # vectorises the loop, which is therefore one of its own.
    first, others = block[AT.clock], 0
    for j in range(n):
        others += block[AT.clock + j] != first
    if others == 0:
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
        called = halt != HALTED
        # Infinity must not pass for a clipped torque: infinity minus itself is NaN. The state stays as the law saw it.
        clipped = clip(torque, torque_limit) + (torque - torque)
        block[AT.law_torque + j] = clipped if called else block[AT.law_torque + j]
        store(block, MEMORY + j, LANES, renewed if called else memory)
        elapsed = block[AT.elapsed + j] if called else 0.0
        torque = block[AT.torque + j]
        block[AT.duration + j] += tick * elapsed
        block[AT.torque_squared + j] += tick * elapsed * torque * torque
        block[AT.halt + j] = UNDER_WAY if halt == UNDER_WAY and clipped == clipped else HALTED


LAW_SIGNATURE = (types.float64[::1], types.int64, types.float64[::1], types.int64, types.float64, types.float64)


@intrinsic
def call_law(typing_context: Any, block: Any, n: Any, fixed: Any, cycle: Any, torque_limit: Any, tick: Any) -> Any:
    """Calls a compiled `evaluate_law`, whose address `fixed` holds, with these arguments."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        convention = context.call_conv
        table = context.make_array(signature.args[2])(context, builder, arguments[2])
        number = ir.IntType(64)
        address = builder.load(builder.bitcast(builder.gep(table.data, [number(LAW)]), number.as_pointer()))
        function = builder.inttoptr(address, convention.get_function_type(types.none, signature.args).as_pointer())
        status, _ = convention.call_function(builder, function, types.none, signature.args, arguments)
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return context.get_dummy_value()

    return types.none(*LAW_SIGNATURE), generate


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
    # The present line of the reference is the last part of a block.
    reference = block.size - settings.reference_size * LANES
    for j in range(n):
        if block[AT.active + j] != 0.0:
            write_observation(
                observations[j],
                (block[AT.theta + j], block[AT.theta_dot + j], block[AT.x_dot + j]),
                0.0 if begin else block[AT.action + j],
                (
                    block[reference + j],
                    block[reference + LANES + j],
                    block[AT.clock + j] / cycle,
                ),
                block[AT.law_torque + j],
                (block[AT.M + j], block[AT.mu + j]),
                settings.with_reference,
                settings.with_parameters,
            )


@inlined
def step(
    block: np.ndarray,
    n: int,
    begin: bool,
    fixed: np.ndarray,
    plant: Plant,
    settings: StepSettings,
    observations: np.ndarray,
) -> None:
    """One agent step of a block of environments, or with `begin` the first call of the law in an episode.

    Args:
        block: one block of `world`; changed.
        n: environments in it.
        begin: begin an episode instead of taking a step.
        fixed: from `capsule_gym.layout.pack`, with the next two.
        plant: what the environments' plants have in common.
        settings: of the environment.
        observations: of the block's environments; written.
    """
    h = settings.physics_dt
    cycle = (fixed.size - CONSTANTS) // settings.reference_size
    # The action is clipped to [-1, 1].
    if begin_step(block, n, plant, begin) == 0 and begin:
        return
    for _ in range(1 if begin else settings.law_steps):
        if not begin:
            # u = clip(law torque + residual_limit action), constant until the law is called again.
            sticking = apply_torque(block, n, plant, settings)
            for substep in range(settings.physics_steps):
                # Where nothing sticks the compiler leaves out a third of the work.
                if sticking > 0:
                    step_smooth(block, n, plant, h, True)
                else:
                    step_smooth(block, n, plant, h, False)
                for j in range(n):
                    if block[AT.eventful + j] != 0.0:
                        # Stick, slip, and the end of the episode (`task.termination`).
                        sticking += step_with_events(block, j, plant, h, (substep + 1) * h)
        # `evaluate_law`: the torque until the next call.
        call_law(block, n, fixed, cycle, settings.torque_limit, 0.0 if begin else 1.0)
    if not begin:
        # The reward (`task.reward_terms`) and the sums of the episode.
        finish_step(block, n, plant, settings)
    observe(block, n, begin, settings, cycle, observations)


def advance(world: np.ndarray, first: int, last: int, begin: bool, fixed: np.ndarray, observations: np.ndarray) -> int:
    """`step` of the environments first..last-1 that `Row.active` names; the others stand still.

    Args:
        world: shape (blocks, (ROWS + memory cells + columns of the reference) LANES), float64; changed.
        first: first environment, a multiple of LANES.
        last: one past the last environment.
        begin: begin an episode instead of taking a step: the law is called for its first torque.
        fixed: plant, settings and the controller's table, from `pack`; M and mu come from `world`.
        observations: shape (environments, entries), float32; written.

    Returns:
        Index of an environment whose law returned no finite torque, or -1.
    """
    plant, settings = unpack(fixed, PIVOT_TORQUE_ON_CONTACT)
    broken = -1
    for b in range(first // LANES, (last + LANES - 1) // LANES):
        block = world[b]
        n = last - b * LANES
        n = n if n < LANES else LANES
        step(block, n, begin, fixed, plant, settings, observations[b * LANES :])
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


@cache
def build_advance(pivot_torque_on_contact: float) -> Any:
    """`advance` as a numba dispatcher, compiled or loaded from the disk cache; says so where it has to compile.

    Args:
        pivot_torque_on_contact: 1.0 for the paper's normal force, 0.0 for Newton's.
    """
    digest = f"{fingerprint(advance)}_{pivot_torque_on_contact:g}"
    built = kernel(advance, digest, {"PIVOT_TORQUE_ON_CONTACT": pivot_torque_on_contact}, "the physics")
    built.compile(SIGNATURE)
    return built


def bind_law(law_function: Callable[..., Any], digest: str, memory_size: int, reference_size: int) -> dict[str, Any]:
    """The globals of `evaluate_law` for a law.

    Args:
        law_function: the law, plain or jitted.
        digest: for the names of what is compiled: no two laws may have the same.
        memory_size: number of its memory cells.
        reference_size: number of columns of its reference table.
    """
    source = law_function.py_func if isinstance(law_function, CPUDispatcher) else law_function
    compiled = inner(distinct(source, digest), forceinline=True)
    return {"law": compiled, "MEMORY_SIZE": memory_size, "REFERENCE_SIZE": reference_size}


def build(law_function: Callable[..., Any], memory_size: int, reference_size: int, name: str = "a law") -> Any:
    """`evaluate_law` with a law in it as a numba dispatcher, compiled or loaded from the disk cache.

    Args:
        law_function: the law, plain or jitted.
        memory_size: number of its memory cells.
        reference_size: number of columns of its reference table.
        name: of the law, for the messages.

    Raises:
        TypeError: if the law is nothing that numba compiles.
    """
    source = law_function.py_func if isinstance(law_function, CPUDispatcher) else law_function
    content, digest = fingerprint(source), None
    if content is not None:
        digest = f"{content}_{memory_size}_{reference_size}_{_law_fingerprint()}"
        if digest in _built:
            return _built[digest]
    built = kernel(evaluate_law, digest, bind_law(source, digest or uuid4().hex, memory_size, reference_size), name)
    try:
        built.compile(LAW_SIGNATURE)
    except (NumbaError, NotImplementedError, ValueError) as error:
        raise TypeError(
            f"{name} must be a function that numba compiles, of numbers and tuples of numbers, and return "
            f"(torque, memory) with {memory_size} cells of memory; numba says: {first_cause(error)}"
        ) from error
    if digest is not None:
        _built[digest] = built
    return built


def address(compiled: Any) -> int:
    """Where the machine code of what `build` returns lies; it stays there as long as that is referred to."""
    result = next(iter(compiled.overloads.values()))
    found: int = result.library.get_pointer_to_function(result.fndesc.llvm_func_name)
    return found


_built: dict[str, Any] = {}


@cache
def _law_fingerprint() -> str | None:
    """The part of a law's fingerprint that all laws share."""
    return fingerprint(evaluate_law)
