"""The network of a trained policy as the core takes it: one packed array.

The layers are computed by `capsule_gym/core/network.hpp`, in strict float64 and in a fixed order.
"""

from collections.abc import Sequence

import numpy as np

from capsule_gym.core import _core, native

Layer = tuple[np.ndarray, np.ndarray]


def pack(
    layers: Sequence[Layer],
    mean: np.ndarray,
    scale: np.ndarray,
    *,
    relu: bool,
    tanh_squashing: bool,
    clip: float,
) -> np.ndarray:
    """A network in one array, as `act_together` in `core/network.hpp` takes it.

    Args:
        layers: weights (outputs, inputs) and biases (outputs,) of each layer, in order; the last
            has one output.
        mean: subtracted from the inputs, shape (inputs,).
        scale: factors of the differences, shape (inputs,).
        relu: whether the activation of the hidden layers is max(0, .), else it is tanh.
        tanh_squashing: whether tanh brings the output to [-1, 1], else it is clipped.
        clip: largest size of a scaled input.

    Returns:
        Float64, aligned to 64 bytes: the header, the widths, mean, scale, and each layer's biases
        and weights.
    """
    header = np.array([len(layers), relu, tanh_squashing, clip])
    widths = np.array([len(mean), *(len(bias) for _, bias in layers)])
    parts = [header, widths, mean, scale]
    for weights, bias in layers:
        # A row of weights for each input, as long as the padded biases.
        padding = -len(bias) % _core.PADDING
        parts.append(bias)
        parts.append(np.pad(weights.T, ((0, 0), (0, padding))))
    padded = [np.pad(part.ravel(), (0, -part.size % _core.PADDING)) for part in parts]
    packed = native.aligned_zeros((sum(part.size for part in padded),))
    return np.concatenate(padded, out=packed)
