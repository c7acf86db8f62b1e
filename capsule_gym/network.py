"""The network of a trained policy for the core: its header, its packed arrays, its inputs and whole episodes.

The layers are computed by `capsule_gym/core/network.hpp`, in strict float64 and in a fixed order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from capsule_gym import _core, native
from capsule_gym._core import ESTIMATES
from capsule_gym.checks import check_count
from capsule_gym.config import EnvConfig
from capsule_gym.observation import observation_entries
from capsule_gym.parameters import Capsule

if TYPE_CHECKING:
    from capsule_gym.policy import Policy
    from capsule_gym.simulation import Simulation

Layer = tuple[np.ndarray, np.ndarray]
# The values of the header by the names that `core/network.hpp` documents; conditions are 0.0 or 1.0.
Header = dict[str, float]


def make_header(options: EnvConfig, *, identifies: bool, **network: Any) -> Header:
    """The header of a network that acts in an environment with these options.

    `network` are the header's `layers`, `relu`, `tanh_squashing` and `clip`.
    """
    capsule, observed = options.capsule or Capsule(), len(observation_entries(options))
    header = {**network, "inputs": observed + len(ESTIMATES) * identifies, "observed": observed}
    header |= {"identifies": identifies, "m": capsule.m, "l": capsule.l, "g": capsule.g, "dt": options.control_dt}
    return {name: float(value) for name, value in header.items()}


def pack(layers: Sequence[Layer], mean: np.ndarray, scale: np.ndarray, header: Header) -> np.ndarray:
    """A network in one array, as `act_together` in `core/network.hpp` takes it.

    Layers are weights (outputs, inputs) and biases (outputs,), in order; the last has one output. The mean is
    subtracted from the inputs, and the difference multiplied by the scale, both of shape (inputs,).

    Returns:
        Float64, aligned to 64 bytes: the header, the widths, mean, scale, and each layer's biases and weights.
    """
    widths = np.array([len(mean), *(len(bias) for _, bias in layers)])
    parts = [native.ordered(_core.NETWORK, header), widths, mean, scale]
    for weights, bias in layers:
        parts += [bias, np.pad(weights.T, ((0, 0), (0, -len(bias) % _core.PADDING)))]
    padded = [np.pad(part.ravel(), (0, -part.size % _core.PADDING)) for part in parts]
    packed = native.aligned_zeros((sum(part.size for part in padded),))
    return np.concatenate(padded, out=packed)


def write_inputs(header: Header, observations: np.ndarray, memory: np.ndarray, inputs: np.ndarray) -> None:
    """Writes the inputs of a network, shape (n, inputs), float32: the observation and what the policy adds to it.

    Args:
        header: the network's header.
        observations: shape (n, at least the observed entries), float32, C-contiguous; further entries are ignored.
        memory: the filter of M and mu, shape (n * _core.CELLS,), float64, 0.0 at the start of an episode; changed. Not
            read without identification.
        inputs: written.
    """
    values = native.ordered(_core.NETWORK, header)
    native.call("write_inputs", values, observations, *observations.shape[::-1], memory, inputs)


def act(network: np.ndarray, observations: np.ndarray, memory: np.ndarray) -> np.ndarray:
    """The actions, shape (n, 1), float32, in [-1, 1], of any number of environments; threads may share the network.

    Args:
        network: from `pack`.
        observations: shape (n, entries), float32, C-contiguous.
        memory: as for `write_inputs`.
    """
    actions = np.empty((len(observations), 1), np.float32)
    addresses = native.address(network), native.address(observations)
    _core.call("act", *addresses, *observations.shape[::-1], native.address(memory), native.address(actions))
    return actions


def rollout(simulation: Simulation, policy: Policy, steps: int) -> dict[str, np.ndarray]:
    """Runs a policy in every environment of a simulation after `reset`, each to the end of its episode.

    The results are those of a batch that is stepped with `policy.start(..)`, bit for bit. The policy's memory starts
    with the call.

    Args:
        simulation: the simulation, which is changed.
        policy: the policy.
        steps: number of agent steps, at least 1, and length of a whole episode in the metrics.

    Returns:
        `simulation.metrics` of every environment.

    Raises:
        ValueError: if the policy does not fit the observation; errors of a law are those of `Simulation.step`.
    """
    check_count("steps", steps)
    entries = simulation.observations.shape[1]
    if policy.entries != entries:
        raise ValueError(
            f"policy must take the observations of the simulation, {entries} entries, got {policy.name!r}, which takes "
            f"{policy.entries}"
        )
    memory = np.zeros(simulation.num_envs * _core.CELLS)
    simulation._everyone = False
    simulation.run(
        lambda first, last: native.call("run_episodes", simulation._fields, first, last, steps, policy._network, memory)
    )
    return simulation.metrics(np.arange(simulation.num_envs), steps)
