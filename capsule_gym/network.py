"""A trained policy in strict float64, for any number of environments: inputs, layers, action, whole episodes.

An environment is a lane, as in `capsule_gym.kernels`: every loop runs over LANES environments, and the compiler
vectorises it. Each unit adds its inputs in their order, bias first, by fused multiply-adds, so that an action depends
only on its own observation, not on the batch or the instruction set.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from capsule_gym import kernels
from capsule_gym.checks import check_count
from capsule_gym.compilation import cached_entry, inlined, jitable, stay_apart, use_widest_vectors
from capsule_gym.config import EnvConfig, find_task
from capsule_gym.elementary import clip, fma, log, tanh
from capsule_gym.layout import AT, LANES, load, record, store
from capsule_gym.observation import CELLS, ESTIMATES, estimates, identify, observation_names
from capsule_gym.parameters import Capsule

if TYPE_CHECKING:
    from capsule_gym.policy import Policy
    from capsule_gym.simulation import Simulation

# Units that are computed together, and inputs that are added to them at once: the registers of AVX2 and AVX-512 hold
# no more. Every width is padded with zeros to a multiple.
TILE = 4
# Up to this many lanes are computed as they are; more of them with all LANES, whose number the compiler knows.
FEW = 8
# Float64 in a cache line.
LINE = 8

Layer = tuple[np.ndarray, np.ndarray]


class Header(NamedTuple):
    """The header of a packed network; SI units."""

    layers: int  # number of layers
    relu: bool  # whether max(0, .) follows the hidden layers, else tanh
    tanh_squashing: bool  # whether tanh brings the last output to [-1, 1], else it is clipped
    clip: float  # largest size of a normalised input
    inputs: int  # number of inputs
    observed: int  # number of inputs that are the environment's observation
    identifies: bool  # whether the estimates of M and mu follow the observation
    observes_energy_weight: bool  # whether the logarithm of the energy weight follows
    log_energy_weight: float  # the logarithm of the weight in cm/J; 0.0 if it is not observed
    outputs_torque: bool  # whether the output is the total torque, from which the law's torque is subtracted
    has_law: bool  # whether there is a law whose torque is subtracted
    torque_limit: float  # N m
    residual_limit: float  # N m
    m: float  # mass of the ball, kg
    l: float  # length of the pendulum, m
    g: float  # gravitational acceleration, m/s^2
    dt: float  # time between two actions, s


# Offset of the widths in a packed network.
HEADER = len(Header._fields)
LAW_TORQUE = observation_names(True, False).index("law_torque")
# Total torque, in torque limits, above which the action is the whole residual: the law's torque may change before the
# next action, and the torque limit then keeps the sum at the limit.
SATURATION = 0.9


def input_names(observation: Sequence[str], identifies: bool, observes_energy_weight: bool) -> tuple[str, ...]:
    """The inputs of a network in order: the environment's observation and what the policy adds to it."""
    return (
        *observation,
        *(ESTIMATES if identifies else ()),
        *(("log_energy_weight",) if observes_energy_weight else ()),
    )


def make_header(options: EnvConfig, *, identifies: bool, observes_energy_weight: bool, **network: Any) -> Header:
    """The header of a network that acts in an environment with these options.

    `network` are the header's `layers`, `relu`, `tanh_squashing`, `clip` and `outputs_torque`.
    """
    capsule = options.capsule or Capsule()
    own = find_task(options.task).entries
    entries = observation_names(options.controller is not None, options.observe_parameters, own, options.stack_size)
    return Header(
        **network,
        inputs=len(input_names(entries, identifies, observes_energy_weight)),
        observed=len(entries),
        identifies=identifies,
        observes_energy_weight=observes_energy_weight,
        log_energy_weight=log(options.energy_weight) if observes_energy_weight else 0.0,
        has_law=network["outputs_torque"] and options.controller is not None,
        torque_limit=options.torque_limit,
        residual_limit=options.torque_limit if options.residual_limit is None else options.residual_limit,
        m=capsule.m,
        l=capsule.l,
        g=capsule.g,
        dt=options.control_dt,
    )


def padded(width: int) -> int:
    """The smallest multiple of TILE that is not below a width."""
    return -(-width // TILE) * TILE


def pack(layers: Sequence[Layer], mean: np.ndarray, scale: np.ndarray, header: Header) -> np.ndarray:
    """A network in one array, as compiled code takes it.

    Layers are weights (outputs, inputs) and biases (outputs,), in order; the last has one output. The mean is
    subtracted from the inputs, and the difference multiplied by the scale, both of shape (inputs,).

    Returns:
        Float64: the header, the padded widths, mean, scale, and each layer's biases and weights, row by row.
    """
    entries = len(mean)
    widths = [padded(entries), *(padded(len(bias)) for _, bias in layers)]
    normalisation = np.pad(np.array([mean, scale], np.float64), ((0, 0), (0, widths[0] - entries)))
    parts = [np.array([*header, *widths], np.float64), normalisation.ravel()]
    for (weights, bias), inputs, outputs in zip(layers, widths[:-1], widths[1:], strict=True):
        below, right = outputs - len(bias), inputs - weights.shape[1]
        parts += [np.pad(bias, (0, below)), np.pad(weights, ((0, below), (0, right))).ravel()]
    return np.concatenate(parts, dtype=np.float64)


def make_workspace(network: np.ndarray) -> np.ndarray:
    """The working memory of `forward`, shape (2, units of the widest layer times LANES)."""
    layers = int(network[Header._fields.index("layers")])
    size = LANES * int(network[HEADER : HEADER + layers + 1].max())
    room = np.zeros(2 * size + LINE)
    # A wide load that crosses a cache line takes twice as long.
    start = -(room.ctypes.data // 8) % LINE
    return room[start : start + 2 * size].reshape(2, size)


@inlined
def normalise(network: np.ndarray, inputs: np.ndarray, first: int, n: int, values: np.ndarray) -> None:
    """Writes the normalised inputs first..first + n - 1 into the lanes; the padding of their width stays zero."""
    header = record(network, 0, Header)
    widths, width = header.layers + 1, int(network[HEADER])
    for i in range(header.inputs):
        mean, scale = network[HEADER + widths + i], network[HEADER + widths + width + i]
        for j in range(n):
            values[i * LANES + j] = clip((inputs[first + j, i] - mean) * scale, header.clip)


@inlined
def add(total: float, weights: tuple[float, ...], inputs: tuple[float, ...]) -> float:
    """The total with TILE products added, in their order."""
    total = fma(weights[0], inputs[0], total)
    total = fma(weights[1], inputs[1], total)
    total = fma(weights[2], inputs[2], total)
    return fma(weights[3], inputs[3], total)


@inlined
def add_tile(
    weights: np.ndarray, at: int, inputs: int, n: int, values: np.ndarray, i: int, sums: np.ndarray, k: int
) -> None:
    """Adds the inputs i, i + 1, .. of n lanes to the sums k, k + 1, .., with the weights that begin at `at`."""
    w0, w1 = load(weights, at, 1, TILE), load(weights, at + inputs, 1, TILE)
    w2, w3 = load(weights, at + 2 * inputs, 1, TILE), load(weights, at + 3 * inputs, 1, TILE)
    for j in range(n):
        x = load(values, i * LANES + j, LANES, TILE)
        s0, s1, s2, s3 = load(sums, k * LANES + j, LANES, TILE)
        store(sums, k * LANES + j, LANES, (add(s0, w0, x), add(s1, w1, x), add(s2, w2, x), add(s3, w3, x)))


@jitable
def affine(bias: np.ndarray, weights: np.ndarray, n: int, values: np.ndarray, sums: np.ndarray) -> None:
    """The outputs of a layer for n lanes in `values`, before its activation.

    It is a separate function with its own arrays: if the compiler can tell that they do not overlap, it tries to keep
    all sums of a tile in registers, of which there are too few, and the loop takes half as long again.
    """
    use_widest_vectors()
    stay_apart()
    inputs = weights.size // bias.size
    for k in range(0, bias.size, TILE):
        start = load(bias, k, 1, TILE)
        for j in range(n):
            store(sums, k * LANES + j, LANES, start)
        for i in range(0, inputs, TILE):
            if n > FEW:
                add_tile(weights, k * inputs + i, inputs, LANES, values, i, sums, k)
            else:
                add_tile(weights, k * inputs + i, inputs, n, values, i, sums, k)


@inlined
def activate(sums: np.ndarray, units: int, n: int, relu: bool) -> None:
    """Applies the activation to the sums of some units."""
    use_widest_vectors()
    for k in range(units):
        for j in range(k * LANES, k * LANES + n):
            total = load(sums, j, 1, 1)[0]
            # NaN stays NaN.
            store(sums, j, 1, ((0.0 if total < 0.0 else total) if relu else tanh(total),))


@jitable
def forward(network: np.ndarray, inputs: np.ndarray, first: int, n: int, lanes: np.ndarray) -> int:
    """The row of `lanes`, from `make_workspace`, with the outputs of n <= LANES environments from `first` on."""
    header = record(network, 0, Header)
    layers = header.layers
    values, sums = lanes[0], lanes[1]
    normalise(network, inputs, first, n, values)
    at = HEADER + layers + 1 + 2 * int(network[HEADER])
    for layer in range(layers):
        width, outputs = int(network[HEADER + layer]), int(network[HEADER + layer + 1])
        end = at + outputs + outputs * width
        affine(network[at : at + outputs], network[at + outputs : end], n, values, sums)
        if layer < layers - 1:
            activate(sums, outputs, n, header.relu)
        values, sums = sums, values
        at = end
    if header.tanh_squashing:
        activate(values, 1, n, False)
    return layers % 2


@jitable
def write_inputs(
    network: np.ndarray, observations: np.ndarray, first: int, n: int, memory: np.ndarray, inputs: np.ndarray
) -> None:
    """Writes the network's inputs of environments first..first + n - 1 into the same rows of `inputs`.

    The arrays are those of `act_batch`.
    """
    header = record(network, 0, Header)
    for i in range(first, first + n):
        column = header.observed
        for k in range(column):
            inputs[i, k] = observations[i, k]
        if header.identifies:
            cells = load(memory, i * CELLS, 1, CELLS)
            theta, theta_dot, x_dot = observations[i, 0], observations[i, 1], observations[i, 2]
            cells = identify(cells, theta, theta_dot, x_dot, header.m, header.l, header.g, header.dt)
            store(memory, i * CELLS, 1, cells)
            for value in estimates(cells):
                inputs[i, column] = value
                column += 1
        if header.observes_energy_weight:
            inputs[i, column] = header.log_energy_weight


@inlined
def to_action(
    header: Header,  # of the network
    output: float,  # the action or, with `outputs_torque`, the total torque in torque limits
    law_torque: float,  # torque of the law at this instant, N m
) -> float:
    """The action in [-1, 1] for an output of the network."""
    wanted = clip(output, 1.0)
    if not header.outputs_torque:
        return wanted
    if abs(wanted) > SATURATION:
        return 1.0 if wanted > 0.0 else -1.0
    return clip((header.torque_limit * wanted - law_torque) / header.residual_limit, 1.0)


@jitable
def act_lanes(
    network: np.ndarray,
    observations: np.ndarray,
    first: int,
    n: int,
    memory: np.ndarray,
    inputs: np.ndarray,
    lanes: np.ndarray,
) -> int:
    """The row of `lanes` with the actions in [-1, 1] of n <= LANES environments from `first` on.

    The arrays are those of `act_batch`; `lanes` is from `make_workspace`.
    """
    header = record(network, 0, Header)
    if header.identifies or header.observes_energy_weight:
        write_inputs(network, observations, first, n, memory, inputs)
        row = forward(network, inputs, first, n, lanes)
    else:
        row = forward(network, observations, first, n, lanes)
    for j in range(n):
        law_torque = observations[first + j, LAW_TORQUE] if header.has_law else 0.0
        lanes[row, j] = to_action(header, lanes[row, j], law_torque)
    return row


def act_batch(
    network: np.ndarray,  # from `pack`
    observations: np.ndarray,  # shape (n, entries), float32
    memory: np.ndarray,  # shape (n * CELLS,), float64, changed; not read without identification
    inputs: np.ndarray,  # shape (n, at least the inputs), float32, written if the policy adds to the observation
    lanes: np.ndarray,  # from `make_workspace`
    actions: np.ndarray,  # shape (n, 1), float32; written
) -> None:
    """The actions of any number of environments."""
    for first in range(0, len(observations), LANES):
        n = min(LANES, len(observations) - first)
        found = lanes[act_lanes(network, observations, first, n, memory, inputs, lanes)]
        for j in range(n):
            actions[first + j, 0] = found[j]


def compiled_act_batch() -> Callable[..., int]:
    """`act_batch` as compiled code."""
    rows, numbers = "float32[:, ::1]", "float64[::1]"
    signature = f"void({numbers}, {rows}, {numbers}, {rows}, float64[:, ::1], {rows})"
    return cached_entry(act_batch, signature, "the network of trained policies").call


def run_episodes(
    advance: int,  # address of the compiled `kernels.advance`
    world: np.ndarray,  # see `kernels.advance`; changed
    first: int,  # first environment, a multiple of LANES
    last: int,  # one past the last
    steps: int,  # number of agent steps
    control_dt: float,  # length of an agent step, s
    fixed: np.ndarray,  # plant, settings and the controller's table
    observations: np.ndarray,  # changed
    network: np.ndarray,  # see `act_batch`
    changes: np.ndarray,  # rows of environment, time (s), M (kg) and mu, those of an environment in order of time
    memory: np.ndarray,  # see `act_batch`, also for the next two; changed
    inputs: np.ndarray,
    lanes: np.ndarray,
) -> int:
    """Steps the environments first..last-1, each until its episode ends.

    Returns:
        Index of an environment whose law returned a torque that is not finite, or -1.
    """
    for b in range(first // LANES, (last + LANES - 1) // LANES):
        block, start = world[b], b * LANES
        n = min(LANES, last - start)
        for _ in range(steps):
            going = 0
            for j in range(n):
                active = block[AT.termination + j] == 0.0
                block[AT.active + j] = 1.0 if active else 0.0
                going += active
            actions = lanes[act_lanes(network, observations, start, n, memory, inputs, lanes)]
            for j in range(n):
                # Rounded to float32 like an action of the environment.
                block[AT.action + j] = np.float32(actions[j])
            for k in range(len(changes)):
                j = int(changes[k, 0]) - start
                if 0 <= j < n and changes[k, 1] <= block[AT.steps + j] * control_dt + 1e-9:
                    block[AT.M + j], block[AT.mu + j] = changes[k, 2], changes[k, 3]
            broken = kernels.call_advance(advance, world, start, start + n, False, fixed, observations)
            if broken >= 0:
                return broken
            # One more step than needed, so that the final state is that of a loop in Python.
            if going == 0:
                break
    return -1


def _compiled_episodes() -> Callable[..., int]:
    """`run_episodes` as compiled code, for all laws."""
    numbers, table, rows = "float64[::1]", "float64[:, ::1]", "float32[:, ::1]"
    given = f"int64, {table}, int64, int64, int64, float64, {numbers}, {rows}, {numbers}, {table}"
    signature = f"int64({given}, {numbers}, {rows}, {table})"
    return cached_entry(run_episodes, signature, "the episodes of trained policies").call


def rollout(simulation: Simulation, policy: Policy, steps: int) -> dict[str, np.ndarray]:
    """Runs a policy in every environment of a simulation.

    An environment stops at the end of its episode. The results are those of a batch that is stepped with
    `policy.start(..)`, bit for bit. The policy's memory starts with the call.

    Args:
        simulation: the simulation after `reset`; it is changed.
        policy: the policy.
        steps: number of agent steps, at least 1, and length of a whole episode in the metrics.

    Returns:
        `simulation.metrics` of every environment.

    Raises:
        ValueError: if the policy does not fit the observation, or a user's control law returned a torque that is not
            finite.
    """
    check_count("steps", steps)
    entries = simulation.observations.shape[1]
    if policy.entries != entries:
        raise ValueError(
            f"policy must take the observations of the simulation, {entries} entries, got {policy.name!r}, which takes "
            f"{policy.entries}"
        )
    changes = np.array(
        [(i, *change) for i, schedule in simulation._changes.items() for change in schedule], np.float64
    ).reshape(-1, 4)
    blocks = simulation.world.reshape(len(simulation.world), -1)
    compiled, network = _compiled_episodes(), policy._network
    step, count = simulation._kernel.address, len(simulation.observations)
    given = steps, simulation.options.control_dt, simulation.fixed, simulation.observations, network, changes
    memory, inputs = np.zeros(count * CELLS), np.empty((count, len(policy.mean)), np.float32)

    def run(first: int, last: int) -> int:
        return compiled(step, blocks, first, last, *given, memory, inputs, make_workspace(network))

    broken = max(simulation.share(run))
    # The schedules of changes stay as they are: the next step applies due changes again.
    simulation._everyone = False
    if broken >= 0:
        simulation._report(broken)
    return simulation.metrics(np.arange(simulation.num_envs), steps)
