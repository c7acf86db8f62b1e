"""The network of a policy as an ONNX model."""

from functools import partial
from typing import Any

import numpy as np

from capsule_gym.policies.policy import Policy

OPERATOR_SET = 17
IR_VERSION = 8


def _operations(policy: Policy, scale: np.ndarray, *, single: bool) -> list[tuple[Any, ...]]:
    """Operations, each on the result of the one before: operator, number type, constants."""
    real = np.float32 if single else np.float64
    # Policies that end with tanh are steep: they amplify rounding errors before the last layer
    # up to 80 times.
    hidden = np.float64 if policy.squashing == "tanh" else real
    *layers, last = policy.layers
    operations: list[tuple[Any, ...]] = [
        ("Cast", hidden),
        ("Sub", hidden, policy.mean),
        ("Mul", hidden, scale),
        ("Clip", hidden, -policy.clip, policy.clip),
    ]
    for layer in layers:
        operations += [("Gemm", hidden, *layer), (policy.activation.capitalize(), hidden)]
    operations += [("Cast", real), ("Gemm", real, *last)]
    if policy.squashing == "tanh":
        operations.append(("Tanh", real))
    operations += [("Clip", real, -1.0, 1.0), ("Cast", np.float32)]
    return operations


def to_onnx(policy: Policy, scale: np.ndarray, *, single: bool) -> bytes:
    """The model, which computes in float or in double; `scale` multiplies the centred inputs."""
    try:
        from onnx import TensorProto, checker, helper, numpy_helper
    except ImportError as error:
        raise ImportError('--onnx needs onnx: pip install "capsule-gym[export]"') from error
    operations = _operations(policy, scale, single=single)
    nodes = []
    initializers = []
    source = "observation"
    for n, (operator, dtype, *constants) in enumerate(operations, 1):
        names = [f"constant_{n - 1}_{k}" for k in range(len(constants))]
        for name, constant in zip(names, constants, strict=True):
            array = np.asarray(constant, dtype)
            initializers.append(numpy_helper.from_array(array, name))
        attributes: dict[str, Any] = {}
        if operator == "Cast":
            attributes["to"] = helper.np_dtype_to_tensor_dtype(np.dtype(dtype))
        elif operator == "Gemm":
            attributes["transB"] = 1
        result = "action" if n == len(operations) else f"value_{n}"
        nodes.append(helper.make_node(operator, [source, *names], [result], **attributes))
        source = result
    tensor = partial(helper.make_tensor_value_info, elem_type=TensorProto.FLOAT)
    graph = helper.make_graph(
        nodes,
        policy.name,
        [tensor("observation", shape=["n", policy.entries])],
        [tensor("action", shape=["n", 1])],
        initializers,
        doc_string=policy.description,
    )
    operator_sets = [helper.make_opsetid("", OPERATOR_SET)]
    model = helper.make_model(graph, opset_imports=operator_sets, ir_version=IR_VERSION)
    checker.check_model(model)
    return model.SerializeToString()
