"""The corrected map as an ONNX model, built from the documented model: double precision, many steps at once."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any, Final, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.base.versions import optional_package
from stepgap.export.controller.formulas import corrections, nominal_state, scaled_point
from stepgap.export.controller.model_document import believed_regressions
from stepgap.step import StepStatus

OPSET: Final = 17  # Version of ONNX's operators, known to runtimes since 2022
IR_VERSION: Final = 8  # Version of ONNX's files that belongs to these operators


def onnx_model(document: Mapping[str, Any]) -> bytes:
    """Content of an ONNX file: `state` (B, n) and `command` (B, m) to `next_state`, `std` (B, n) and `status` (B,).

    The next state is NaN where the step fails. Names and units are in the metadata of the model.

    Args:
        document: The model as `model_document` returns it.

    Raises:
        InputError: The package onnx is not installed.
    """
    onnx = optional_package("onnx", "--to onnx", "onnx")
    graph = _Graph(onnx)
    point = graph.op("Concat", _Value(graph, "state"), _Value(graph, "command"), axis=-1)
    status = _status(graph, document["nominal"], point)
    parts = corrections(graph, document["residual"]["regressions"], believed_regressions(document), point)
    mean, std = (graph.joined(columns) for columns in zip(*parts, strict=True))
    failed = graph.op("Unsqueeze", graph.op("Not", graph.op("Equal", status, 0)), [1])
    moved = nominal_state(graph, document["nominal"], point) + mean
    outputs = {"next_state": graph.op("Where", failed, np.nan, moved), "std": std, "status": status}
    for name, value in outputs.items():
        graph.nodes.append(onnx.helper.make_node("Identity", [value.name], [name]))
    return _saved(onnx, graph, document)


@final
@dataclass(frozen=True, eq=False)
class _Value:
    """A value of a graph, with a row for each of many steps."""

    graph: "_Graph"
    name: str

    def __add__(self, other: "_Operand") -> "_Value":
        return self.graph.op("Add", self, other)

    def __sub__(self, other: "_Operand") -> "_Value":
        return self.graph.op("Sub", self, other)

    def __mul__(self, other: "_Operand") -> "_Value":
        return self.graph.op("Mul", self, other)

    def __truediv__(self, other: "_Operand") -> "_Value":
        return self.graph.op("Div", self, other)

    def __matmul__(self, other: "_Operand") -> "_Value":
        return self.graph.op("MatMul", self, other)


_Operand = _Value | ArrayLike
"""A value, or numbers that become a constant."""


@final
@dataclass(eq=False)
class _Graph:
    """A graph under construction, and the `Algebra` of its values: each method adds to it and returns a value.

    Attributes:
        onnx: The package.
        nodes: Operations.
        constants: Constant arrays.
    """

    onnx: Any
    nodes: list[Any] = field(default_factory=list)
    constants: list[Any] = field(default_factory=list)
    numbers: Any = field(default_factory=count)

    def op(self, kind: str, *inputs: _Operand, outputs: int = 1, **attributes: Any) -> _Value:
        """The last output of an operation."""
        names = [f"{kind}_{next(self.numbers)}" for _ in range(outputs)]
        values = [operand if isinstance(operand, _Value) else self.constant(operand) for operand in inputs]
        self.nodes.append(self.onnx.helper.make_node(kind, [value.name for value in values], names, **attributes))
        return _Value(self, names[-1])

    def constant(self, numbers: ArrayLike) -> _Value:
        """A constant: integers of 64 bits, or doubles."""
        array = np.asarray(numbers)
        name = f"constant_{next(self.numbers)}"
        kind = np.int64 if array.dtype.kind in "iu" else np.float64
        self.constants.append(self.onnx.numpy_helper.from_array(np.array(array, kind, order="C"), name))
        return _Value(self, name)

    def exp(self, x: _Value) -> _Value:
        return self.op("Exp", x)

    def cos(self, x: _Value) -> _Value:
        return self.op("Cos", x)

    def sqrt(self, x: _Value) -> _Value:
        return self.op("Sqrt", x)

    def clipped(self, x: _Value, lower: float, upper: float) -> _Value:
        return self.op("Clip", x, lower, upper)

    def joined(self, parts: Sequence[_Value]) -> _Value:
        return self.op("Concat", *parts, axis=1)

    def chosen(self, x: _Value, columns: NDArray[np.int64]) -> _Value:
        return self.op("Gather", x, columns, axis=1)

    def sum_of_squares(self, x: _Value) -> _Value:
        return self.op("ReduceSum", x * x, [-1], keepdims=1)

    def squared_distances(self, x: _Value, centres: NDArray[np.float64]) -> _Value:
        away = self.op("Unsqueeze", x, [1]) - centres
        return self.op("ReduceSum", away * away, [2], keepdims=0)


def _status(graph: _Graph, nominal: Mapping[str, Any], point: _Value) -> _Value:
    """Status codes (B,): of the nearest samples if most of them failed, or that the point is not finite."""
    total = graph.op("ReduceSum", point * 0.0, [-1], keepdims=0)  # zero times another number is not zero
    status: _Value | int = 0
    if nominal["kind"] != "affine" and nominal["samples"]["status"]:
        samples = nominal["samples"]
        neighbours = nominal["neighbours"]
        squared = graph.squared_distances(scaled_point(graph, nominal, point), np.array(samples["points"]))
        nearest = graph.op("TopK", squared, [neighbours], outputs=2, largest=0, axis=-1)
        near = graph.op("Gather", samples["status"], nearest, axis=0)
        bad = graph.op("Cast", graph.op("Greater", near, 0), to=graph.onnx.TensorProto.INT64)
        most = graph.op("Greater", graph.op("ReduceSum", bad, [-1], keepdims=0), neighbours // 2)
        status = graph.op("Where", most, graph.op("ReduceMax", near, axes=[-1], keepdims=0), 0)
    return graph.op("Where", graph.op("Equal", total, 0.0), status, int(StepStatus.INVALID))


def _saved(onnx: Any, graph: _Graph, document: Mapping[str, Any]) -> bytes:
    double = onnx.TensorProto.DOUBLE
    integer = onnx.TensorProto.INT64
    n = len(document["state"])
    m = len(document["command"])
    value = onnx.helper.make_tensor_value_info
    inputs = [value("state", double, ["steps", n]), value("command", double, ["steps", m])]
    outputs = [value(name, double, ["steps", n]) for name in ("next_state", "std")]
    outputs.append(value("status", integer, ["steps"]))
    made = onnx.helper.make_graph(graph.nodes, "stepgap_map", inputs, outputs, graph.constants)
    opsets = [onnx.helper.make_opsetid("", OPSET)]
    model = onnx.helper.make_model(made, opset_imports=opsets, producer_name="stepgap", ir_version=IR_VERSION)
    metadata = {key: json.dumps(document[key], ensure_ascii=False) for key in ("state", "command")}
    onnx.helper.set_model_props(model, {**metadata, "stepgap": document["stepgap"]})
    onnx.checker.check_model(model, full_check=True)
    return model.SerializeToString()
