"""The memory layout of the compiled step, and how compiled code reads and writes it.

The environments lie in one float64 array `world` of shape (blocks, rows, LANES): one row per quantity of `Row`, then
the memory of the control law, its row of the reference, the task's memory, and the history of states that late sensors
show (`capsule_gym.disturbances`). Within a block every loop runs over the environments, and
the compiler takes several at once. One environment is a block with one lane in use; threads share a batch by blocks.
The arithmetic is the same everywhere, and so are the results, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from capsule_gym.compilation import inlined, intrinsic, jitable
from capsule_gym.parameters import VARIED, Plant

# Environments that one loop takes through a step together. Their rows lie side by side at offsets that the compiler
# knows, and one block stays in the first-level cache.
LANES = 64
# Environments that the widest registers hold, or two of the others.
VECTOR = 8


class Quantities(NamedTuple):
    """The index of each quantity of one environment in `world`."""

    # Shown in `info` under these names.
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
    # The result of the agent step.
    reward: int
    termination: int
    steps: int
    # Sums and extreme values of the episode, down to `largest_theta_dot`.
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
    # Input of the step: the action, and 1.0 where the environment takes part.
    action: int
    active: int
    # Of the running step: m / (M + m), x at its start, the phase of the contact, whether something happens in the
    # present substep, how far the environment has stopped, and the time that its present torque has acted.
    mass_ratio: int
    before_x: int
    slip: int
    eventful: int
    # The result of `dynamics.smooth_step` for the present substep.
    next_theta: int
    next_theta_dot: int
    next_x: int
    next_x_dot: int
    theta_ddot: int
    x_ddot: int
    first_normal_force: int
    least_normal_force: int
    halt: int
    elapsed: int
    # Only where plants are varied, down to the end. The fields of `Plant` from m on.
    m: int
    l: int
    g: int
    k: int
    c: int
    static_ratio: int
    backward_ratio: int
    downhill: int
    viscous: int
    stribeck_excess: int
    stribeck_rate: int
    total_motor_friction: int
    push_force: int
    # Drawn by the episode: `CONSTANTS`,
    drawn_m: int
    drawn_l: int
    drawn_g: int
    drawn_k: int
    drawn_c: int
    drawn_static_ratio: int
    drawn_backward_ratio: int
    drawn_viscous: int
    drawn_stribeck_speed: int
    drawn_slope: int
    drawn_motor_friction: int
    # `DISTURBANCES`,
    theta_noise: int
    theta_dot_noise: int
    x_dot_noise: int
    theta_bias: int
    theta_dot_bias: int
    x_dot_bias: int
    theta_drift: int
    theta_dot_drift: int
    x_dot_drift: int
    drift_time: int
    theta_resolution: int
    theta_dot_resolution: int
    x_dot_resolution: int
    latency: int
    lag: int
    motor_friction: int
    torque_resolution: int
    push: int
    # and the key of its noise.
    key: int
    # Derived: the latency in periods, and the shares of drift and of motor lag after one period.
    delay: int
    drift_share: int
    motor_share: int
    # Entry of the history that was written last, in the first lane; readings so far.
    cursor: int
    readings: int
    # 1.0 in the first lane where every floor is level with Coulomb's friction alone, and nothing pushes.
    level: int
    # The motor's torque, N m; the drift of each sensor.
    motor: int
    drift_of_theta: int
    drift_of_theta_dot: int
    drift_of_x_dot: int
    # The state that the next reading shows; the last reading, with the integral of its x_dot.
    late_theta: int
    late_theta_dot: int
    late_x_dot: int
    read_theta: int
    read_theta_dot: int
    read_x: int
    read_x_dot: int
    # The true state, while the reading replaces it for the law.
    true_theta: int
    true_theta_dot: int
    true_x: int
    true_x_dot: int


# Number of the plant's constants from m on.
PLANT_ROWS = len(Plant._fields) - 5
# The row of each quantity in a block, and the offset of that row. numba treats plain integers in a tuple as constants,
# members of an enumeration not.
Row = Quantities(*range(len(Quantities._fields)))
AT = Quantities(*(LANES * row for row in Row))


class Event(NamedTuple):
    """An environment with an event in a substep: its place in the block, and quantities of `Row`."""

    place: float
    theta: float
    theta_dot: float
    x: float
    x_dot: float
    slip: float
    torque: float
    M: float
    mu: float
    mass_ratio: float
    next_theta: float
    next_theta_dot: float
    next_x: float
    next_x_dot: float
    theta_ddot: float
    x_ddot: float
    first_normal_force: float
    least_normal_force: float


# Offsets at which `capsule_gym.events` stores these environments, and the constants of their plants if these vary.
EVENTS = LANES * len(Row)
EVENT_ROWS = len(Event._fields)
EVENT_PLANTS = EVENTS + EVENT_ROWS * LANES
ROWS = len(Row) + EVENT_ROWS + PLANT_ROWS
# Number of rows of a state in the history.
HISTORY_ROWS = 3
# Offset of the law's memory; its line of the reference follows, then the task's memory.
MEMORY = ROWS * LANES
# The values of `Row.halt`: under way; stopped in the present substep, with one call of the law left; and halted.
UNDER_WAY, ENDING, HALTED = 0.0, 1.0, 2.0


class StepSettings(NamedTuple):
    """The settings of the compiled step; SI units. `settings.make_settings` derives them from an `EnvConfig`."""

    torque_limit: float
    residual_limit: float
    total_torque: bool
    physics_dt: float
    physics_steps: int
    law_steps: int
    energy_weight: float
    termination_penalty: float
    with_reference: bool
    with_parameters: bool
    # Columns of the controller's table.
    reference_size: int
    stack_size: int = 1
    # Disturbances: number of states in the history, whether law and agent observe the sensors, the sensors that exist,
    # and the measured velocity up to which the observation's `stick` is 1.
    history: int = 0
    law_reads: bool = False
    agent_reads: bool = False
    with_theta: bool = True
    with_theta_dot: bool = True
    with_x_dot: bool = True
    stick_threshold: float = 0.0


def pack(plant: Plant, settings: StepSettings, reference: np.ndarray, law: int = 0) -> np.ndarray:
    """Plant, settings, the law's address and the controller's table in one array, shape (CONSTANTS + table.size,).

    Passing a tuple of numbers, or a further array, to compiled code would take longer than a substep.
    """
    # With an explicit dtype: numpy makes objects of larger integers, which the kernel would read as addresses.
    constants = np.array([*plant, *settings, 0.0], np.float64)
    constants.view(np.int64)[LAW] = law
    return np.concatenate([constants, reference.ravel()], dtype=np.float64)


# Offsets in the array of `pack`: the settings, the bits of the law's address, and the controller's table.
SETTINGS = len(Plant._fields)
LAW = SETTINGS + len(StepSettings._fields)
CONSTANTS = LAW + 1


def _places(context: Any, builder: Any, kind: Any, array: Any, start: Any, stride: int, count: int) -> Iterator[Any]:
    """Addresses of `count` entries of a contiguous array, from `start` on, in steps of `stride`.

    With NUMBA_BOUNDSCHECK they are checked like indices (`make boundscheck`).
    """
    from numba import types
    from numba.core import cgutils

    own = context.make_array(kind)(context, builder, array)
    for n in range(count):
        offset = builder.add(start, context.get_constant(types.intp, n * stride))
        if context.enable_boundscheck:
            cgutils.do_boundscheck(context, builder, offset, own.nitems)
        yield builder.gep(own.data, [offset])


def _define_load(typing_context: Any, array: Any, start: Any, stride: Any, count: Any) -> Any:
    from numba import types

    size, step = count.literal_value, stride.literal_value

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        places = _places(context, builder, signature.args[0], arguments[0], arguments[1], step, size)
        return context.make_tuple(builder, signature.return_type, [builder.load(place) for place in places])

    return types.UniTuple(types.float64, size)(array, types.intp, stride, count), generate


@intrinsic(_define_load, prefer_literal=True)
def load(array: np.ndarray, start: int, stride: int, count: int) -> tuple[float, ...]:
    """The tuple of `count` entries of a contiguous float64 array from `start` on, in steps of `stride`; unchecked.

    The last two are compile-time constants. The bounds of slices would be checked at run time, which prevents the
    vectorisation of the loop around them.
    """
    return tuple(array[start : start + stride * count : stride].tolist())


def _define_store(typing_context: Any, array: Any, start: Any, stride: Any, values: Any) -> Any:
    from numba import types
    from numba.core import cgutils

    step = stride.literal_value
    # numba casts no named tuple to a plain one.
    kind = values if isinstance(values, types.BaseNamedTuple) else types.UniTuple(types.float64, len(values))

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        entries = cgutils.unpack_tuple(builder, arguments[3])
        places = _places(context, builder, signature.args[0], arguments[0], arguments[1], step, len(entries))
        for entry, place in zip(entries, places, strict=True):
            builder.store(entry, place)
        return context.get_dummy_value()

    return types.void(array, types.intp, stride, kind), generate


@intrinsic(_define_store, prefer_literal=True)
def store(array: np.ndarray, start: int, stride: int, values: tuple[float, ...]) -> None:
    """Writes a tuple, or a named tuple of floats, where `load` would read it."""
    array[start : start + stride * len(values) : stride] = values


def _define_record(typing_context: Any, array: Any, start: Any, kind: Any) -> Any:
    from numba import types

    hints = get_type_hints(kind.instance_class)
    compiled = {float: types.float64, int: types.int64, bool: types.boolean}
    fields = [compiled[hints[name]] for name in kind.instance_class._fields]
    result = types.BaseTuple.from_types(fields, kind.instance_class)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        places = _places(context, builder, signature.args[0], arguments[0], arguments[1], 1, len(fields))
        values = [
            context.cast(builder, builder.load(place), types.float64, field)
            for place, field in zip(places, fields, strict=True)
        ]
        return context.make_tuple(builder, result, values)

    return result(array, types.intp, kind), generate


@intrinsic(_define_record)
def record(array: np.ndarray, start: int, kind: Any) -> Any:
    """The named tuple of class `kind` whose fields are the entries of a float64 array from `start` on; unchecked.

    The class defines the order of the fields and their types: float, int or bool.
    """
    types = get_type_hints(kind)
    return kind(*(types[name](value) for name, value in zip(kind._fields, array[start:], strict=False)))


@jitable
def unpack(fixed: np.ndarray, pivot_torque_on_contact: float, extended: float) -> tuple[Plant, StepSettings]:
    """Plant and settings from an array of `pack`, with two fields that are compile-time constants."""
    plant = record(fixed, 0, Plant)
    plant = Plant(plant.M, plant.mu, plant.mass_ratio, pivot_torque_on_contact, extended, *plant[5:])
    return plant, record(fixed, SETTINGS, StepSettings)


@inlined
def plant_of(block: np.ndarray, j: int, plant: Plant) -> Plant:
    """The plant of one environment."""
    if plant.extended >= VARIED:
        own = load(block, AT.m + j, LANES, PLANT_ROWS)
        return Plant(block[AT.M + j], block[AT.mu + j], block[AT.mass_ratio + j], *plant[3:5], *own)
    return Plant(block[AT.M + j], block[AT.mu + j], block[AT.mass_ratio + j], *plant[3:])
