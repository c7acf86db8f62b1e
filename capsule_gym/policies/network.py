"""The network of a trained policy as the core takes it: one packed array.

The layers are computed by `capsule_gym/core/network.hpp`, in strict float64 and in a fixed order.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from capsule_gym.core import _core, native

Layer = tuple[np.ndarray, np.ndarray]
# The recurrent cells by the number of their gates.
CELLS = {3: "gru", 4: "lstm"}


class Cell(NamedTuple):
    """A recurrent cell: the parameters of `torch.nn.GRU` or `torch.nn.LSTM` of one layer, float32.

    Attributes:
        weight_ih: weights of the inputs, shape (gates * units, inputs), with 3 gates for a GRU and
            4 for an LSTM.
        weight_hh: weights of the hidden state, shape (gates * units, units).
        bias_ih: biases, shape (gates * units,).
        bias_hh: biases, shape (gates * units,).
    """

    weight_ih: np.ndarray
    weight_hh: np.ndarray
    bias_ih: np.ndarray
    bias_hh: np.ndarray

    @property
    def units(self) -> int:
        """The number of units."""
        return int(self.weight_hh.shape[1])

    @property
    def gates(self) -> int:
        """The number of gates."""
        return len(self.weight_hh) // self.units

    @property
    def kind(self) -> str:
        """The cell's kind, "gru" or "lstm"."""
        return CELLS[self.gates]

    @property
    def memory_size(self) -> int:
        """Length of the memory of an episode: h and for an LSTM c, each padded."""
        padded = self.units + -self.units % _core.PADDING
        return padded if self.kind == "gru" else 2 * padded


def pack(
    layers: Sequence[Layer],
    mean: np.ndarray,
    scale: np.ndarray,
    *,
    relu: bool,
    tanh_squashing: bool,
    clip: float,
    cell: Cell | None = None,
    head: Sequence[Layer] = (),
) -> np.ndarray:
    """A network in one array, as `act_together` in `core/network.hpp` takes it.

    Args:
        layers: weights (outputs, inputs) and biases (outputs,) of each layer, in order, the last
            with one output; or those before the cell.
        mean: subtracted from the inputs, shape (inputs,).
        scale: factors of the differences, shape (inputs,).
        relu: whether the activation of the hidden layers is max(0, .), else it is tanh.
        tanh_squashing: whether tanh brings the output to [-1, 1], else it is clipped.
        clip: largest size of a scaled input.
        cell: the recurrent cell, if any.
        head: the layers after the cell, the last with one output. The first may read the scaled
            inputs after the output of the cell.

    Returns:
        Float64, aligned to 64 bytes: the header, the widths, mean, scale, and each layer's biases
        and weights.
    """
    gates = units = skip = 0
    if cell:
        gates = cell.gates
        units = cell.units
        skip = head[0][0].shape[1] > units
    else:
        head = layers
        layers = ()
    header = [len(layers), len(head), relu, tanh_squashing, clip, gates, units, skip]
    widths = [len(mean), *(len(bias) for _, bias in (*layers, *head))]
    parts = [np.array(header, np.float64), np.array(widths), mean, scale]
    for weights, bias in layers:
        parts += _pack_layer(weights, bias)
    if cell:
        parts += _pack_layer(cell.weight_ih, cell.bias_ih, gates)
        parts += _pack_layer(cell.weight_hh, cell.bias_hh, gates)
    for weights, bias in head:
        parts += _pack_layer(weights, bias)
    padded = [np.pad(part.ravel(), (0, -part.size % _core.PADDING)) for part in parts]
    packed = native.aligned_zeros((sum(part.size for part in padded),))
    return np.concatenate(padded, out=packed)


def _pack_layer(weights: np.ndarray, bias: np.ndarray, gates: int = 1) -> list[np.ndarray]:
    """The biases, and a row of weights for each input; each gate is padded by itself."""
    units = len(bias) // gates
    padding = -units % _core.PADDING
    by_gate = np.pad(bias.reshape(gates, units), ((0, 0), (0, padding)))
    rows = np.pad(weights.T.reshape(-1, gates, units), ((0, 0), (0, 0), (0, padding)))
    return [by_gate, rows]
