"""The network of a trained policy for the core: its packed arrays, and whole episodes.

The layers are computed by `capsule_gym/core/network.hpp`, in strict float64 and in a fixed order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from capsule_gym import _core, native
from capsule_gym.checks import check_count

if TYPE_CHECKING:
    from capsule_gym.policy import Policy
    from capsule_gym.simulation import Simulation

Layer = tuple[np.ndarray, np.ndarray]


def pack(
    layers: Sequence[Layer], mean: np.ndarray, scale: np.ndarray, *, relu: bool, tanh_squashing: bool, clip: float
) -> np.ndarray:
    """A network in one array, as `act_together` in `core/network.hpp` takes it.

    Args:
        layers: weights (outputs, inputs) and biases (outputs,) of each layer, in order; the last has one output.
        mean: subtracted from the inputs, shape (inputs,).
        scale: factors of the differences, shape (inputs,).
        relu: whether the activation of the hidden layers is max(0, .), else it is tanh.
        tanh_squashing: whether tanh brings the output to [-1, 1], else it is clipped.
        clip: largest size of a scaled input.

    Returns:
        Float64, aligned to 64 bytes: the header, the widths, mean, scale, and each layer's biases and weights.
    """
    widths = np.array([len(mean), *(len(bias) for _, bias in layers)])
    parts = [np.array([len(layers), relu, tanh_squashing, clip]), widths, mean, scale]
    for weights, bias in layers:
        parts += [bias, np.pad(weights.T, ((0, 0), (0, -len(bias) % _core.PADDING)))]
    padded = [np.pad(part.ravel(), (0, -part.size % _core.PADDING)) for part in parts]
    packed = native.aligned_zeros((sum(part.size for part in padded),))
    return np.concatenate(padded, out=packed)


def rollout(simulation: Simulation, policy: Policy, steps: int) -> dict[str, np.ndarray]:
    """Runs a policy in every environment of a simulation after `reset`, each to the end of its episode.

    The results are those of a batch that is stepped with the policy, bit for bit.

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
    simulation._everyone = False
    simulation.run(
        lambda first, last: native.call("run_episodes", simulation._fields, first, last, steps, policy._network)
    )
    return simulation.metrics(np.arange(simulation.num_envs), steps)
