"""The compiled step of the environment: the physics, the task and a control law, for any number of environments.

`step` is one agent step, from the action to the observation. `capsule_gym.layout` says where the numbers lie. Loops run
over the environments of a block and are vectorised; an environment in which an event happens (a change of the contact
phase, the end of the episode) is left out of the loop over its substep and left to `capsule_gym.events`.

The step is compiled once for each task (`capsule_gym.tasks`), for all laws. `build` compiles `evaluate_law` with a law
in it, which takes about a second, and the step calls it once per law period and block by its address, which follows
the settings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from capsule_gym import disturbances, dynamics, task
from capsule_gym.compilation import compile_entry, inlined, interleave_loops, intrinsic, rebound
from capsule_gym.elementary import clip
from capsule_gym.events import handle_events
from capsule_gym.layout import (
    AT,
    CONSTANTS,
    HALTED,
    HISTORY_ROWS,
    LANES,
    LAW,
    MEMORY,
    UNDER_WAY,
    VECTOR,
    StepSettings,
    load,
    plant_of,
    store,
    unpack,
)
from capsule_gym.objects import Entry
from capsule_gym.observation import write_observation
from capsule_gym.parameters import LEVEL, VARIED, Plant
from capsule_gym.tasks import speed


def no_law(
    theta: float, theta_dot: float, x: float, x_dot: float, memory: tuple[float, ...], reference: tuple[float, ...]
) -> tuple[float, tuple[float, ...]]:
    """The law of the direct-torque task: none, so that the residual torque is the whole torque."""
    return 0.0, memory


# Stands for the phase of a platform at rest until `step_smooth` has found it.
AT_REST = 2.0

# A table for a task without a law.
NO_REFERENCE = np.zeros((1, 2))

# `build` replaces these by the values of a law. A row is a line of the reference and, if the law reads it, the task's
# memory.
law: Callable[..., Any] = no_law
MEMORY_SIZE = 1
REFERENCE_SIZE = ROW_SIZE = NO_REFERENCE.shape[1]
# `build_advance` replaces these by the values of a plant and of a task.
PIVOT_TORQUE_ON_CONTACT = EXTENDED = 0.0
begin_task, reward, observe_task = speed.begin, speed.reward, speed.observe
TaskMemory = speed.Memory
TASK_ROWS = TASK_ENTRIES = 0


@inlined
def begin_step(block: np.ndarray, n: int, plant: Plant, begin: bool) -> int:
    """Begins an agent step, or an episode, of a block's environments; returns how many take part."""
    count = 0
    for j in range(n):
        active = block[AT.active + j] != 0.0
        block[AT.halt + j] = UNDER_WAY if active else HALTED
        block[AT.action + j] = clip(block[AT.action + j], 1.0)
        p = plant_of(block, j, plant)
        block[AT.mass_ratio + j] = p.m / (p.M + p.m)
        block[AT.before_x + j] = block[AT.x + j]
        block[AT.energy + j] = 0.0 if active else block[AT.energy + j]
        # The minimum over the step; at the start of an episode the weight, which `resets.renew` has written.
        block[AT.normal_force + j] = math.inf if active and not begin else block[AT.normal_force + j]
        count += active
    return count


@inlined
def apply_torque(block: np.ndarray, n: int, plant: Plant, settings: StepSettings) -> int:
    """Switches the torque; returns how many environments are at rest, whose phase of contact `step_smooth` finds."""
    period = settings.physics_steps * settings.physics_dt
    resting = 0
    for j in range(n):
        going = block[AT.halt + j] == UNDER_WAY
        law_torque, action = block[AT.law_torque + j], block[AT.action + j]
        rest = clip(settings.torque_limit * action - law_torque, settings.residual_limit)
        residual = rest if settings.total_torque else settings.residual_limit * action
        torque = clip(law_torque + residual, settings.torque_limit)
        if plant.extended >= VARIED:
            torque = disturbances.drive(block, j, torque, going, plant.extended == VARIED)
        torque = torque if going else block[AT.torque + j]
        x_dot = block[AT.x_dot + j]
        block[AT.torque + j] = torque
        block[AT.peak_torque + j] = max(abs(block[AT.peak_torque + j]), abs(torque))
        block[AT.elapsed + j] = period
        rests = going and x_dot == 0.0
        block[AT.slip + j] = AT_REST if rests else -1.0 if x_dot < 0.0 else 1.0
        resting += rests
    return resting


@inlined
def step_smooth(block: np.ndarray, n: int, plant: Plant, h: float, may_stick: bool) -> int:
    """Takes every environment without an event through one substep, and marks the others.

    Returns:
        How many environments stick at its start.
    """
    sticking = 0
    for j in range(n):
        p = plant_of(block, j, plant)
        theta, theta_dot, x, x_dot = block[AT.theta + j], block[AT.theta_dot + j], block[AT.x + j], block[AT.x_dot + j]
        slip, torque = block[AT.slip + j], block[AT.torque + j]
        if may_stick:
            at_rest = dynamics.phase_at_rest(theta, theta_dot, torque, p)
            slip = at_rest if slip == AT_REST else slip
            block[AT.slip + j] = slip
            sticking += slip == 0.0
        theta_1, theta_dot_1, x_1, x_dot_1, theta_ddot, x_ddot, normal, smallest, lasts = dynamics.smooth_step(
            theta, theta_dot, x, x_dot, slip, torque, p, h, may_stick
        )
        block[AT.next_theta + j], block[AT.next_theta_dot + j] = theta_1, theta_dot_1
        block[AT.next_x + j], block[AT.next_x_dot + j] = x_1, x_dot_1
        block[AT.theta_ddot + j], block[AT.x_ddot + j] = theta_ddot, x_ddot
        block[AT.first_normal_force + j], block[AT.least_normal_force + j] = normal, smallest
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
        # None of these is negative. Without `abs` LLVM makes masked stores of them, of 40 instructions each on Zen.
        block[AT.normal_force + j] = min(abs(block[AT.normal_force + j]), normal if commit else math.inf)
        block[AT.largest_theta + j] = max(abs(block[AT.largest_theta + j]), abs(theta_1) if commit else 0.0)
        block[AT.largest_theta_dot + j] = max(abs(block[AT.largest_theta_dot + j]), abs(theta_dot_1) if commit else 0.0)
    return sticking


@inlined
def is_level(block: np.ndarray, n: int) -> float:
    """Whether every floor is level with Coulomb's friction alone, and nothing pushes: 1.0 or 0.0."""
    others = 0
    for j in range(n):
        level = block[AT.downhill + j] == 0.0 and block[AT.viscous + j] == 0.0 and block[AT.stribeck_excess + j] == 0.0
        others += not (level and block[AT.push + j] == 0.0)
    return 1.0 if others == 0 else 0.0


@inlined
def hold_torque(block: np.ndarray, n: int, plant: Plant, settings: StepSettings) -> None:
    """One period of the law: the torque, and the substeps."""
    # u = clip(law torque + residual), constant until the law is called again.
    may_stick = apply_torque(block, n, plant, settings)
    h = settings.physics_dt
    for substep in range(settings.physics_steps):
        # Where nothing sticks the compiler leaves out a third of the work.
        if may_stick > 0:
            may_stick = step_smooth(block, n, plant, h, True)
        else:
            step_smooth(block, n, plant, h, False)
        may_stick += handle_events(block, n, plant, h, (substep + 1) * h)


@inlined
def hold_varied(block: np.ndarray, n: int, plant: Plant, settings: StepSettings) -> None:
    """`hold_torque` for varied plants, of which most have level floors: a tenth faster on these."""
    if block[AT.level] != 0.0:
        hold_torque(block, n, Plant(*plant[:4], LEVEL, *plant[5:]), settings)
    else:
        hold_torque(block, n, plant, settings)


# `step_of` replaces this for varied plants: a branch in `step` would double the code that is compiled for others.
hold = hold_torque


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
    # The only row of a reference stays where the first call has written it.
    if cycle > 1 or tick == 0.0:
        for j in range(n):
            clock = block[AT.clock + j] + (tick if block[AT.halt + j] != HALTED else 0.0)
            block[AT.clock + j] = clock if clock < cycle else 0.0
        # Environments that began together read the same line of the reference. The loop over different lines is not
        # vectorised, and therefore separate.
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
        # The task's memory follows the line.
        row = load(block, MEMORY + MEMORY_SIZE * LANES + j, LANES, ROW_SIZE)
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


# numba signatures of `evaluate_law` and `advance`.
LAW_SIGNATURE = "void(float64[::1], int64, float64[::1], int64, float64, float64)"
SIGNATURE = "int64(float64[:, ::1], int64, int64, boolean, float64[::1], float32[:, ::1])"


def _call(context: Any, builder: Any, address: Any, signature: Any, arguments: Any) -> Any:
    """Generates a call of a compiled function by its address."""
    from numba.core import cgutils

    convention, (result, kinds) = context.call_conv, (signature.return_type, signature.args)
    function = builder.inttoptr(address, convention.get_function_type(result, kinds).as_pointer())
    status, value = convention.call_function(builder, function, result, kinds, arguments)
    with cgutils.if_unlikely(builder, status.is_error):
        convention.return_status_propagate(builder, status)
    return value


def _define_call_law(typing_context: Any, block: Any, n: Any, fixed: Any, cycle: Any, limit: Any, tick: Any) -> Any:
    from numba import types
    from numba.core.sigutils import normalize_signature

    given, result = normalize_signature(LAW_SIGNATURE)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number, table = context.get_value_type(types.int64), context.make_array(given[2])
        place = builder.gep(table(context, builder, arguments[2]).data, [number(LAW)])
        address = builder.load(builder.bitcast(place, number.as_pointer()))
        _call(context, builder, address, signature, arguments)
        return context.get_dummy_value()

    return result(*given), generate


@intrinsic(_define_call_law)
def call_law(block: np.ndarray, n: int, fixed: np.ndarray, cycle: int, torque_limit: float, tick: float) -> None:
    """Calls a compiled `evaluate_law`, whose address `fixed` holds, with these arguments."""
    raise NotImplementedError("only compiled code calls a law by its address")


def _define_call_advance(
    typing_context: Any, address: Any, world: Any, first: Any, last: Any, begin: Any, fixed: Any, observations: Any
) -> Any:
    from numba import types
    from numba.core.sigutils import normalize_signature

    given, result = normalize_signature(SIGNATURE)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _call(context, builder, arguments[0], result(*given), arguments[1:])

    return result(types.int64, *given), generate


@intrinsic(_define_call_advance)
def call_advance(
    address: int, world: np.ndarray, first: int, last: int, begin: bool, fixed: np.ndarray, observations: np.ndarray
) -> int:
    """Calls a compiled `advance` by its address with the other arguments."""
    raise NotImplementedError("only compiled code calls the step by its address")


@inlined
def start_task(block: np.ndarray, n: int, end: int) -> None:
    """Initialises the task's memory, which ends at `end`, in the environments whose episodes begin."""
    at = end - TASK_ROWS * LANES
    for j in range(n):
        memory = TaskMemory(*load(block, at + j, LANES, TASK_ROWS))
        begun = begin_task(block[AT.x + j], memory)
        store(block, at + j, LANES, begun if block[AT.active + j] != 0.0 else memory)


@inlined
def finish_step(block: np.ndarray, n: int, plant: Plant, settings: StepSettings, end: int) -> None:
    """Ends an agent step: rewards, the task's memory, which ends at `end`, and the sums of the episode."""
    dt = settings.law_steps * settings.physics_steps * settings.physics_dt
    at = end - TASK_ROWS * LANES
    for j in range(n):
        p = plant_of(block, j, plant)
        active = block[AT.active + j] != 0.0
        share = 1.0 if active else 0.0
        mass = p.M + p.m
        weight = mass * p.g
        moved = block[AT.x + j] - block[AT.before_x + j]
        energy = block[AT.energy + j]
        memory = TaskMemory(*load(block, at + j, LANES, TASK_ROWS))
        gain, renewed = reward(block[AT.x + j], block[AT.x_dot + j], moved, dt, memory)
        store(block, at + j, LANES, renewed if active else memory)
        energy_cost = -settings.energy_weight * energy
        penalty = -settings.termination_penalty if block[AT.termination + j] != 0.0 else 0.0
        block[AT.reward + j] = gain + energy_cost + penalty if active else 0.0
        block[AT.reward_progress + j] = gain if active else block[AT.reward_progress + j]
        block[AT.reward_energy + j] = energy_cost if active else block[AT.reward_energy + j]
        block[AT.reward_termination + j] = penalty if active else block[AT.reward_termination + j]
        block[AT.steps + j] += share
        block[AT.episode_energy + j] += share * energy
        gravity = math.sqrt(p.g * p.g + p.downhill * p.downhill) if plant.extended != 0.0 else p.g
        block[AT.weight_distance + j] += share * (mass * gravity) * moved
        smallest = min(block[AT.smallest_normal_ratio + j], block[AT.normal_force + j] / weight)
        block[AT.smallest_normal_ratio + j] = smallest if active else block[AT.smallest_normal_ratio + j]


@inlined
def observe(
    block: np.ndarray,
    n: int,
    begin: bool,
    plant: Plant,
    settings: StepSettings,
    cycle: int,
    end: int,
    observations: np.ndarray,
) -> None:
    """Writes the observations of a block's environments that take part; the task's memory ends there."""
    # The present line of the reference stands before it.
    at = end - TASK_ROWS * LANES
    reference = at - settings.reference_size * LANES
    entries = observations.shape[1] // settings.stack_size
    for j in range(n):
        if block[AT.active + j] != 0.0:
            # Shifts the stacked observations; at the start of an episode all of them are the first.
            for entry in range(observations.shape[1] - 1, entries - 1, -1):
                observations[j, entry] = observations[j, entry - entries]
            state = block[AT.theta + j], block[AT.theta_dot + j], block[AT.x_dot + j]
            if plant.extended == VARIED and settings.agent_reads:
                state = disturbances.reading(block, j)
            write_observation(
                observations[j],
                state,
                settings.stick_threshold,
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
            memory = TaskMemory(*load(block, at + j, LANES, TASK_ROWS))
            observe_task(observations[j, entries - TASK_ENTRIES :], block[AT.x + j], memory)
            if begin:
                for entry in range(entries, observations.shape[1]):
                    observations[j, entry] = observations[j, entry - entries]


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
        plant: the constants that the environments' plants share.
        settings: settings of the environment.
        observations: observations of the block's environments; written.
    """
    cycle = (fixed.size - CONSTANTS) // settings.reference_size
    # The end of the task's memory.
    end = block.size - HISTORY_ROWS * settings.history * LANES
    # Whole vectors: environments behind the last one are inactive. LLVM interleaves only where it knows the bound.
    width = n if n == 1 else min((n + VECTOR - 1) // VECTOR * VECTOR, LANES)
    if begin and plant.extended == VARIED:
        disturbances.begin(block, n, settings)
    # The action is clipped to [-1, 1].
    if begin_step(block, width, plant, begin) == 0 and begin:
        return
    if begin:
        start_task(block, n, end)
    elif plant.extended == VARIED:
        block[AT.level] = is_level(block, n)
    for tick in range(1 if begin else settings.law_steps):
        if not begin:
            hold(block, width, plant, settings)
        if plant.extended == VARIED:
            # Law and agent observe a past state with sensor errors.
            disturbances.measure(block, n, settings, begin, tick + 1 == settings.law_steps)
        # `evaluate_law`: the torque until the next call.
        call_law(block, n, fixed, cycle, settings.torque_limit, 0.0 if begin else 1.0)
        if plant.extended == VARIED:
            disturbances.restore_state(block, n, settings)
    if not begin:
        # The reward (`Task.reward`) and the sums of the episode.
        finish_step(block, n, plant, settings, end)
    observe(block, n, begin, plant, settings, cycle, end, observations)


def advance(world: np.ndarray, first: int, last: int, begin: bool, fixed: np.ndarray, observations: np.ndarray) -> int:
    """`step` of the environments first..last-1 that `Row.active` names; the others do not change.

    Args:
        world: shape (blocks, rows LANES), float64, with the rows of `settings.count_rows`; changed.
        first: first environment, a multiple of LANES.
        last: one past the last environment.
        begin: begin an episode instead of taking a step: the law is called for its first torque.
        fixed: plant, settings and the controller's table, from `pack`; M and mu come from `world`.
        observations: shape (environments, entries), float32; written.

    Returns:
        Index of an environment whose law returned a torque that is not finite, or -1.
    """
    interleave_loops()
    plant, settings = unpack(fixed, PIVOT_TORQUE_ON_CONTACT, EXTENDED)
    broken = -1
    for b in range(first // LANES, (last + LANES - 1) // LANES):
        block = world[b]
        n = min(max(last - b * LANES, 0), LANES)
        step(block, n, begin, fixed, plant, settings, observations[b * LANES :])
        for j in range(n):
            if block[AT.active + j] != 0.0 and not math.isfinite(block[AT.law_torque + j]):
                broken = b * LANES + j
    return broken


def step_of(own: task.Task, extended: float) -> Any:
    """`step` with a task's functions in it, for plants of that kind."""
    bindings = {
        **{"begin_task": own.begin, "reward": own.reward, "observe_task": own.observe},
        **{"TaskMemory": own.memory, "TASK_ROWS": own.rows, "TASK_ENTRIES": len(own.entries)},
    }
    parts = {function.__name__: inlined(rebound(function, bindings)) for function in (start_task, finish_step, observe)}
    return inlined(rebound(step, {**parts, "hold": hold_varied if extended == VARIED else hold_torque}))


@cache
def build_advance(pivot_torque_on_contact: float, extended: float, own: task.Task) -> Entry:
    """`advance` as compiled code.

    Args:
        pivot_torque_on_contact: 1.0 for the paper's normal force, 0.0 for Newton's.
        extended: `Plant.extended`: 1.0 for plants with more than Coulomb's friction on a level floor, 2.0 for plants
            that differ in more than M and mu, and for disturbances.
        own: the task.
    """
    bindings: dict[str, Any] = {"PIVOT_TORQUE_ON_CONTACT": pivot_torque_on_contact, "EXTENDED": extended}
    if own.memory is not TaskMemory or extended == VARIED:
        bindings["step"] = step_of(own, extended)
    return compile_entry(advance, SIGNATURE, f"the physics with the task {own.name}", bindings)


def build(
    law_function: Callable[..., Any], memory_size: int, reference_size: int, task_size: int = 0, name: str = "a law"
) -> Entry:
    """`evaluate_law` with a law in it as compiled code.

    Args:
        law_function: the law, plain or jitted.
        memory_size: number of its memory cells.
        reference_size: number of columns of its reference table.
        task_size: size of the task's memory, where the law reads it, else 0.
        name: name of the law in messages.

    Raises:
        TypeError: if numba cannot compile the law.
    """
    bindings = {"law": law_function, "MEMORY_SIZE": memory_size, "REFERENCE_SIZE": reference_size}
    bindings["ROW_SIZE"] = reference_size + task_size
    try:
        return compile_entry(evaluate_law, LAW_SIGNATURE, name, bindings)
    except TypeError as error:
        raise TypeError(
            f"{name} must be a function that numba compiles, of numbers and tuples of numbers, without making arrays "
            f"or lists, and return (torque, memory) with {memory_size} cells of memory; {error}"
        ) from error
