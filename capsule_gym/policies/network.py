"""The network of a trained policy as the core takes it: one packed array.

The layers are computed by `capsule_gym/core/network.hpp`, in strict float64 and in a fixed order.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from capsule_gym.checks import require
from capsule_gym.core import _core, native

Layer = tuple[np.ndarray, np.ndarray]
# The recurrent cells by the number of their gates.
CELLS = {_core.GRU: "gru", _core.LSTM: "lstm"}
# Of a recurrent cell: its sums for several environments lie on the stack.
MOST_CELL_UNITS = 512


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


def check_array(
    name: str, array: np.ndarray, dtype: type, shape: tuple[int, ...], accepted: str
) -> None:
    """Raises an error for arrays of another dtype or shape, and for numbers that are not finite."""
    if array.dtype != dtype or array.shape != shape:
        wanted = f"{np.dtype(dtype).name} of shape {shape}, {accepted}"
        got = f"{array.dtype} of shape {array.shape}"
        raise ValueError(f"{name} must be {wanted}, got {got}")
    require(bool(np.isfinite(array).all()), name, "finite", array)


def check_cell(cell: Cell, width: int) -> int:
    """Checks a cell that reads `width` values, and returns the number of its units."""
    shape = cell.weight_hh.shape
    units = shape[1] if len(shape) == 2 else 0
    accepted = f"of 1 to {MOST_CELL_UNITS} units"
    require(1 <= units <= MOST_CELL_UNITS, "cell.weight_hh", accepted, shape)
    sizes = [gates * units for gates in CELLS]
    size = shape[0] if shape[0] in sizes else sizes[0]
    accepted = "with 3 gates for a GRU or 4 for an LSTM"
    check_array("cell.weight_hh", cell.weight_hh, np.float32, (size, units), accepted)
    check_array("cell.weight_ih", cell.weight_ih, np.float32, (size, width), accepted)
    check_array("cell.bias_ih", cell.bias_ih, np.float32, (size,), accepted)
    check_array("cell.bias_hh", cell.bias_hh, np.float32, (size,), accepted)
    return units
