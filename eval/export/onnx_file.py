"""The ONNX export: `policy.onnx`, from whole inputs (n, i) to actions (n, a), float32.

For an input with NaN or infinity the actions are NaN, because an ONNX graph cannot refuse it otherwise.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from inclined_landing.envs.policy import Policy
from inclined_landing.eval.export.vectors import Vectors
from inclined_landing.models.base import storage
from inclined_landing.models.base.errors import optional

with optional():
    import onnx
    from onnx import TensorProto, helper, numpy_helper

OPSET = 17
_IR_VERSION = 8  # of the same age


def write(folder: Path, policy: Policy, contract: dict, vectors: Vectors) -> None:
    """Write policy.onnx into `folder`, with its contract as metadata."""
    nodes: list = []
    constants: list = []

    def constant(name: str, value) -> str:
        constants.append(numpy_helper.from_array(np.asarray(value, np.float32), name))
        return name

    def node(kind: str, *inputs: str, name: str, **attributes) -> str:
        nodes.append(helper.make_node(kind, list(inputs), [name], name=name, **attributes))
        return name

    def clipped(x: str, limit: float, name: str) -> str:
        if math.isinf(limit):
            return x
        return node("Clip", x, constant(f"{name}_low", -limit), constant(f"{name}_high", limit), name=name)

    x = node("Sub", "input", constant("centre", policy.centre), name="centred")
    x = node("Div", x, constant("scale", policy.scale), name="divided")
    x = clipped(x, policy.limit, "scaled")
    for k, (weight, bias) in enumerate(zip(policy.weights, policy.biases)):
        if k:
            x = node("Relu" if policy.activation == "ReLU" else "Tanh", x, name=f"hidden_{k}")
        x = node("MatMul", x, constant(f"weight_{k}", weight), name=f"product_{k}")
        x = node("Add", x, constant(f"bias_{k}", bias), name=f"sum_{k}")
    if policy.squashed:
        x = node("Tanh", clipped(x, policy.bound, "bounded"), name="squashed")
    x = clipped(x, 1.0, "limited")
    # 0 for numbers, NaN for NaN and infinity, which clipping would hide.
    zeros = node("Mul", "input", constant("zero", 0.0), name="zeros")
    axes = helper.make_tensor("axes", TensorProto.INT64, [1], [1])
    constants.append(axes)
    nodes.append(helper.make_node("ReduceSum", [zeros, "axes"], ["doubt"], name="doubt", keepdims=1))
    node("Add", x, "doubt", name="action")
    input_info = helper.make_tensor_value_info("input", TensorProto.FLOAT, ["n", len(policy.centre)])
    output_info = helper.make_tensor_value_info("action", TensorProto.FLOAT, ["n", len(policy.biases[-1])])
    graph = helper.make_graph(nodes, "landing_policy", [input_info], [output_info], constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=_IR_VERSION)
    model.producer_name = "inclined-landing"
    helper.set_model_props(
        model, {"contract": storage.to_json(contract), "policy_sha256": contract["policy"]["sha256"]}
    )
    onnx.checker.check_model(model, full_check=True)
    storage.write_bytes(folder / "policy.onnx", model.SerializeToString(deterministic=True))
