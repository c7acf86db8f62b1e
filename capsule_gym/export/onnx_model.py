"""The network of a policy as an ONNX model."""

import json
from functools import partial
from typing import Any

import numpy as np

from capsule_gym.policies.network import Cell, Layer
from capsule_gym.policies.policy import Policy

OPERATOR_SET = 17
IR_VERSION = 8


class Graph:
    """The operations and constants of a model.

    Args:
        onnx: the package.
    """

    def __init__(self, onnx: Any) -> None:
        self._onnx = onnx
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, values: Any, dtype: Any) -> str:
        """Adds a constant and returns its name."""
        name = f"constant_{len(self.constants)}"
        array = np.asarray(values, dtype)
        self.constants.append(self._onnx.numpy_helper.from_array(array, name))
        return name

    def apply(self, operator: str, *inputs: str, result: str = "", **attributes: Any) -> str:
        """Adds an operation and returns the name of its result."""
        result = result or f"value_{len(self.nodes)}"
        node = self._onnx.helper.make_node(operator, inputs, [result], **attributes)
        self.nodes.append(node)
        return result

    def cast(self, value: str, dtype: Any) -> str:
        """Adds the conversion of a value to a number type."""
        number = self._onnx.helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
        return self.apply("Cast", value, to=number)

    def layer(self, value: str, layer: Layer, dtype: Any) -> str:
        """Adds a linear layer."""
        weights, bias = (self.constant(array, dtype) for array in layer)
        return self.apply("Gemm", value, weights, bias, transB=1)

    def columns(self, value: str, first: int, count: int) -> str:
        """Adds the choice of columns of a value."""
        start = self.constant([first], np.int64)
        end = self.constant([first + count], np.int64)
        axis = self.constant([1], np.int64)
        return self.apply("Slice", value, start, end, axis)


def _apply_cell(graph: Graph, cell: Cell, value: str, state: str, dtype: Any) -> tuple[str, str]:
    """Adds a step of the cell; returns its output and its next state."""
    units = cell.units
    from_inputs = graph.layer(value, (cell.weight_ih, cell.bias_ih), dtype)
    h = graph.columns(state, 0, units)
    from_h = graph.layer(h, (cell.weight_hh, cell.bias_hh), dtype)

    def parts(n: int) -> tuple[str, str]:
        return graph.columns(from_inputs, n * units, units), graph.columns(from_h, n * units, units)

    def gate(n: int, activation: str = "Sigmoid") -> str:
        return graph.apply(activation, graph.apply("Add", *parts(n)))

    if cell.kind == "gru":
        r = gate(0)
        z = gate(1)
        candidate_input, candidate_h = parts(2)
        reset_h = graph.apply("Mul", r, candidate_h)
        n = graph.apply("Tanh", graph.apply("Add", candidate_input, reset_h))
        # (1 - z) n + z h
        kept = graph.apply("Mul", z, graph.apply("Sub", h, n))
        output = graph.apply("Add", n, kept)
        return output, output
    i = gate(0)
    f = gate(1)
    g = gate(2, "Tanh")
    o = gate(3)
    kept = graph.apply("Mul", f, graph.columns(state, units, units))
    c = graph.apply("Add", kept, graph.apply("Mul", i, g))
    output = graph.apply("Mul", o, graph.apply("Tanh", c))
    return output, graph.apply("Concat", output, c, axis=1)


def _apply_check(graph: Graph) -> str:
    """Adds whether every entry of an observation is finite: 1.0 or 0.0, shape (n, 1)."""
    limit = graph.constant(np.inf, np.float32)
    finite = graph.apply("Less", graph.apply("Abs", "observation"), limit)
    return graph.apply("ReduceMin", graph.cast(finite, np.float32), axes=[1], keepdims=1)


def _keep_finite(graph: Graph, state: str, after: str, finite: str, size: int, dtype: Any) -> None:
    """Adds `next_state`: the state again, and one more dropped, where an entry is not finite."""
    accepted = graph.cast(finite, np.bool_)
    kept = graph.apply("Where", accepted, after, state)
    missing = graph.apply("Sub", graph.constant(1.0, dtype), graph.cast(finite, dtype))
    dropped = graph.apply("Add", graph.columns("state", size, 1), missing)
    graph.apply("Concat", kept, dropped, result="next_state", axis=1)


def _apply_network(graph: Graph, policy: Policy, scale: np.ndarray, *, single: bool) -> None:
    """Adds the operations from `observation`, and of a recurrent policy `state`, to `action`."""
    real = np.float32 if single else np.float64
    hidden = hidden_type(policy, single=single)
    activation = policy.activation.capitalize()
    value = graph.cast("observation", hidden)
    value = graph.apply("Sub", value, graph.constant(policy.mean, hidden))
    value = graph.apply("Mul", value, graph.constant(scale, hidden))
    limits = (graph.constant(end, hidden) for end in (-policy.clip, policy.clip))
    inputs = value = graph.apply("Clip", value, *limits)
    layers = policy.layers
    finite = _apply_check(graph)
    if policy.cell is not None:
        for layer in policy.layers:
            value = graph.apply(activation, graph.layer(value, layer, hidden))
        size = cell_state_size(policy.cell)
        state = graph.columns("state", 0, size)
        value, after = _apply_cell(graph, policy.cell, value, state, hidden)
        _keep_finite(graph, state, after, finite, size, hidden)
        layers = policy.head
        if layers[0][0].shape[1] > policy.cell.units:
            value = graph.apply("Concat", value, inputs, axis=1)
    *before, last = layers
    for layer in before:
        value = graph.apply(activation, graph.layer(value, layer, hidden))
    value = graph.layer(graph.cast(value, real), last, real)
    if policy.squashing == "tanh":
        value = graph.apply("Tanh", value)
    ends = (graph.constant(end, real) for end in (-1.0, 1.0))
    action = graph.cast(graph.apply("Clip", value, *ends), np.float32)
    accepted = graph.cast(finite, np.bool_)
    graph.apply("Where", accepted, action, graph.constant(0.0, np.float32), result="action")


def cell_state_size(cell: Cell) -> int:
    """Numbers in the state of a cell: h, and for an LSTM c."""
    return cell.units * (1 if cell.kind == "gru" else 2)


def hidden_type(policy: Policy, *, single: bool) -> Any:
    """The number type of all layers but the last, and of the state."""
    # Policies that end with tanh are steep: they amplify rounding errors before the last layer
    # up to 80 times.
    return np.float32 if single and policy.squashing != "tanh" else np.float64


def to_onnx(policy: Policy, scale: np.ndarray, metadata: dict[str, Any], *, single: bool) -> bytes:
    """The model, which computes in float or in double.

    Args:
        policy: the policy.
        scale: factors of the centred inputs.
        metadata: what the model says about itself, by name.
        single: compute in float.
    """
    try:
        import onnx
    except ImportError as error:
        raise ImportError('--onnx needs onnx: pip install "capsule-gym[export]"') from error
    graph = Graph(onnx)
    _apply_network(graph, policy, scale, single=single)
    helper = onnx.helper
    tensor = partial(helper.make_tensor_value_info, elem_type=onnx.TensorProto.FLOAT)
    inputs = [tensor("observation", shape=["n", policy.entries])]
    outputs = [tensor("action", shape=["n", 1])]
    if policy.cell is not None:
        # The last one counts the observations that were not finite.
        size = cell_state_size(policy.cell) + 1
        number = helper.np_dtype_to_tensor_dtype(np.dtype(hidden_type(policy, single=single)))
        state = partial(helper.make_tensor_value_info, elem_type=number, shape=["n", size])
        inputs.append(state("state"))
        outputs.append(state("next_state"))
    description = helper.make_graph(
        graph.nodes,
        policy.name,
        inputs,
        outputs,
        graph.constants,
        doc_string=policy.description,
    )
    operator_sets = [helper.make_opsetid("", OPERATOR_SET)]
    model = helper.make_model(description, opset_imports=operator_sets, ir_version=IR_VERSION)
    helper.set_model_props(model, {name: json.dumps(value) for name, value in metadata.items()})
    onnx.checker.check_model(model)
    return model.SerializeToString()
