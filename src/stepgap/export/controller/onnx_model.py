"""The corrected map as an ONNX model, built from the documented model: double precision, many steps at once."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from itertools import count
from typing import Any, Final, final

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.versions import INSTALL
from stepgap.step import Array, StepStatus

OPSET: Final = 17
"""Version of ONNX's operators, known to runtimes since 2022."""

IR_VERSION: Final = 8
"""Version of ONNX's files that belongs to these operators."""


def onnx_model(document: Mapping[str, Any]) -> bytes:
    """Content of an ONNX file: `state` (B, n) and `command` (B, m) to `next_state`, `std` (B, n) and `status` (B,).

    The next state is NaN where the step fails. Names and units are in the metadata of the model.

    Args:
        document: The model as `model_document` returns it.

    Raises:
        InputError: The package onnx is not installed.
    """
    onnx = _package()
    graph = _Graph(onnx)
    point = graph.op("Concat", "state", "command", axis=-1)
    nominal, status = _nominal(graph, document["nominal"], point)
    parts = [_regression(graph, each, point) for each in document["residual"]["regressions"]]
    mean, std = (graph.op("Concat", *columns, axis=-1) for columns in zip(*parts, strict=True))
    failed = graph.op("Not", graph.op("Equal", status, graph.constant(np.array(0))))
    moved = graph.op("Add", nominal, mean)
    next_state = graph.op("Where", graph.op("Unsqueeze", failed, graph.constant(np.array([1]))), graph.nan, moved)
    outputs = {"next_state": next_state, "std": std, "status": status}
    for name, value in outputs.items():
        graph.nodes.append(onnx.helper.make_node("Identity", [value], [name]))
    return _saved(onnx, graph, document)


@final
@dataclass(eq=False)
class _Graph:
    """A graph under construction; each method adds to it and returns the name of a value.

    Attributes:
        onnx: The package.
        nodes: Operations.
        constants: Constant arrays.
    """

    onnx: Any
    nodes: list[Any] = field(default_factory=list)
    constants: list[Any] = field(default_factory=list)
    numbers: Any = field(default_factory=count)

    def op(self, kind: str, *inputs: str, outputs: int = 1, **attributes: Any) -> str:
        """The first output of an operation."""
        return self.ops(kind, *inputs, outputs=outputs, **attributes)[0]

    def ops(self, kind: str, *inputs: str, outputs: int, **attributes: Any) -> list[str]:
        """All outputs of an operation."""
        names = [f"{kind}_{next(self.numbers)}" for _ in range(outputs)]
        self.nodes.append(self.onnx.helper.make_node(kind, list(inputs), names, **attributes))
        return names

    def constant(self, value: Array | Sequence[Any] | float) -> str:
        """A constant: integers of 64 bits, or doubles."""
        array = np.asarray(value)
        name = f"constant_{next(self.numbers)}"
        kind = np.int64 if array.dtype.kind in "iu" else np.float64
        self.constants.append(self.onnx.numpy_helper.from_array(np.array(array, kind, order="C"), name))
        return name

    def affine(self, value: str, origin: Any, scale: Any) -> str:
        """(value − origin) · scale."""
        shifted = self.op("Sub", value, self.constant(np.array(origin, float)))
        return self.op("Mul", shifted, self.constant(np.array(scale, float)))

    def times(self, value: str, matrix: Any) -> str:
        """Product value @ matrix."""
        return self.op("MatMul", value, self.constant(np.array(matrix, float)))

    def plus(self, *values: str) -> str:
        """Sum."""
        total = values[0]
        for value in values[1:]:
            total = self.op("Add", total, value)
        return total

    def product(self, values: Sequence[str]) -> str:
        """Product."""
        total = values[0]
        for value in values[1:]:
            total = self.op("Mul", total, value)
        return total

    def squares(self, value: str) -> str:
        """Sum of squares along the last axis, which is kept with length 1."""
        return self.op("ReduceSum", self.op("Mul", value, value), self.constant(np.array([-1])), keepdims=1)

    @property
    def nan(self) -> str:
        """Not a number."""
        return self.constant(np.nan)


def _nominal(graph: _Graph, nominal: Mapping[str, Any], point: str) -> tuple[str, str]:
    """Next states (B, n) and status codes (B,) of the nominal map."""
    finite = _all_finite(graph, point)
    if nominal["kind"] == "affine":
        origin = [*nominal["state"], *nominal["command"]]
        moved = graph.times(graph.affine(point, origin, np.ones(len(origin))), np.transpose(nominal["matrix"]))
        return graph.plus(moved, graph.constant(np.array(nominal["next_state"]))), _valid(graph, finite)
    scaled = graph.affine(point, nominal["centre"], 1 / np.array(nominal["scale"]))
    inside = graph.op("Clip", scaled, graph.constant(-1.0), graph.constant(1.0))
    beyond = graph.op("Sub", scaled, inside)
    factors, derivatives = _legendre(graph, inside, np.array(nominal["degrees"]))
    terms = [graph.product(factors)]
    for axis, derivative in enumerate(derivatives):
        by_axis = graph.product([*factors[:axis], derivative, *factors[axis + 1 :]])
        terms.append(graph.op("Mul", by_axis, _column(graph, beyond, axis)))
    return graph.times(graph.plus(*terms), nominal["weights"]), _status(graph, nominal, scaled, finite)


def _legendre(graph: _Graph, inside: str, degrees: Any) -> tuple[list[str], list[str]]:
    """Factor of each coordinate in every product (B, T), and its derivative."""
    most = degrees.max(initial=1)
    zero = graph.op("Mul", inside, graph.constant(0.0))
    one = graph.op("Add", zero, graph.constant(1.0))
    values, derivatives = [one, inside], [zero, one]
    for k in range(1, most):
        ahead = graph.op("Mul", graph.constant((2 * k + 1) / (k + 1)), graph.op("Mul", inside, values[k]))
        values.append(graph.op("Sub", ahead, graph.op("Mul", graph.constant(k / (k + 1)), values[k - 1])))
        grown = graph.op("Mul", graph.constant(float(2 * k + 1)), values[k])
        derivatives.append(graph.op("Add", derivatives[k - 1], grown))
    last = graph.constant(np.array([2]))
    stacks = [
        graph.op("Concat", *(graph.op("Unsqueeze", each, last) for each in parts), axis=2)
        for parts in (values, derivatives)
    ]
    chosen = [
        [
            graph.op("Gather", graph.op("Gather", stack, graph.constant(np.array(i)), axis=1), columns, axis=1)
            for i, columns in enumerate(map(graph.constant, degrees.T))
        ]
        for stack in stacks
    ]
    return chosen[0], chosen[1]


def _status(graph: _Graph, nominal: Mapping[str, Any], scaled: str, finite: str) -> str:
    """Status codes (B,): of the nearest samples if most of them failed."""
    samples, neighbours = nominal["samples"], nominal["neighbours"]
    if not samples["status"]:
        return _valid(graph, finite)
    across = graph.op("Unsqueeze", scaled, graph.constant(np.array([1])))
    squared = graph.squares(graph.op("Sub", across, graph.constant(np.array(samples["points"]))))
    flat = graph.op("Squeeze", squared, graph.constant(np.array([2])))
    _, nearest = graph.ops("TopK", flat, graph.constant(np.array([neighbours])), outputs=2, largest=0, axis=-1)
    found = graph.op("Gather", graph.constant(np.array(samples["status"])), nearest, axis=0)
    zero = graph.constant(np.array(0))
    bad = graph.op("Cast", graph.op("Greater", found, zero), to=_int64(graph))
    last = graph.constant(np.array([-1]))
    most = graph.op("Greater", graph.op("ReduceSum", bad, last, keepdims=0), graph.constant(np.array(neighbours // 2)))
    worst = graph.op("ReduceMax", found, axes=[-1], keepdims=0)
    return graph.op("Where", finite, graph.op("Where", most, worst, zero), _invalid(graph))


def _int64(graph: _Graph) -> int:
    """ONNX's number of the type int64."""
    return graph.onnx.TensorProto.INT64


def _valid(graph: _Graph, finite: str) -> str:
    return graph.op("Where", finite, graph.constant(np.array(0)), _invalid(graph))


def _invalid(graph: _Graph) -> str:
    return graph.constant(np.array(int(StepStatus.INVALID)))


def _all_finite(graph: _Graph, point: str) -> str:
    """Whether all numbers of a point are finite; (B,). Zero times another number is not zero."""
    zero = graph.op("Mul", point, graph.constant(0.0))
    total = graph.op("ReduceSum", zero, graph.constant(np.array([-1])), keepdims=0)
    return graph.op("Equal", total, graph.constant(0.0))


def _regression(graph: _Graph, part: Mapping[str, Any], point: str) -> tuple[str, str]:
    """Mean and standard deviation of a regression; (B, 1) each."""
    if part["kind"] == "zero":
        zero = graph.op("Mul", point, graph.constant(0.0))
        nothing = graph.op("ReduceSum", zero, graph.constant(np.array([-1])), keepdims=1)
        return nothing, nothing
    if part["kind"] == "polynomial":
        return _polynomial(graph, part, point)
    return _gaussian_process(graph, part, point)


def _polynomial(graph: _Graph, part: Mapping[str, Any], point: str) -> tuple[str, str]:
    scaled = graph.affine(point, part["centre"], 1 / np.array(part["scale"]))
    degrees = np.array(part["degrees"])
    one = graph.op("Add", graph.op("Mul", scaled, graph.constant(0.0)), graph.constant(1.0))
    powers = [one]
    for _ in range(degrees.max(initial=0)):
        powers.append(graph.op("Mul", powers[-1], scaled))
    last = graph.constant(np.array([2]))
    stack = graph.op("Concat", *(graph.op("Unsqueeze", each, last) for each in powers), axis=2)
    factors = [
        graph.op("Gather", graph.op("Gather", stack, graph.constant(np.array(i)), axis=1), graph.constant(each), axis=1)
        for i, each in enumerate(degrees.T)
    ]
    basis = graph.product(factors)
    factor = np.linalg.cholesky(np.array(part["covariance"]))
    mean = graph.times(basis, np.array(part["weights"])[:, None])
    return mean, graph.op("Sqrt", graph.squares(graph.times(basis, factor)))


def _gaussian_process(graph: _Graph, part: Mapping[str, Any], point: str) -> tuple[str, str]:
    length, centres = np.array(part["length_scale"]), np.array(part["centres"])
    scaled = graph.op("Div", point, graph.constant(length))
    across = graph.op("Unsqueeze", scaled, graph.constant(np.array([1])))
    squared = graph.squares(graph.op("Sub", across, graph.constant(centres / length)))
    kernel = _kernel(graph, part["kernel"], graph.op("Squeeze", squared, graph.constant(np.array([2]))))
    linear = graph.affine(point, part["origin"], np.ones(len(length)))
    from_slopes = graph.times(linear, np.array(part["slopes"])[:, None])
    mean = graph.plus(graph.times(kernel, np.array(part["weights"])[:, None]), from_slopes)
    mean = graph.plus(mean, graph.constant(float(part["constant"])))
    return mean, _process_std(graph, part, kernel, linear)


def _process_std(graph: _Graph, part: Mapping[str, Any], kernel: str, linear: str) -> str:
    """Standard deviation, with the inverse factors as ONNX has no triangular solution; (B, 1)."""
    white = graph.times(kernel, np.linalg.inv(np.array(part["centre_factor"])).T)
    scaled = graph.op("Mul", linear, graph.constant(np.array(part["slope_scale"])))
    one = graph.op("Add", graph.op("Mul", _column(graph, linear, 0), graph.constant(0.0)), graph.constant(1.0))
    features = graph.op("Concat", white, scaled, one, axis=-1)
    rows = np.linalg.inv(np.array(part["weight_factor"]))
    response = graph.times(features, (rows[:-1] if part["constant_is_exact"] else rows).T)
    conditional_variance = graph.op("Sub", graph.constant(1.0), graph.squares(white))
    variance = graph.plus(graph.op("Max", conditional_variance, graph.constant(0.0)), graph.squares(response))
    return graph.op("Mul", graph.constant(float(part["signal_std"])), graph.op("Sqrt", variance))


def _kernel(graph: _Graph, name: str, squared: str) -> str:
    """Covariance of f at squared distances."""
    if name == "squared exponential":
        return graph.op("Exp", graph.op("Mul", squared, graph.constant(-0.5)))
    r = graph.op("Sqrt", graph.op("Mul", squared, graph.constant(5.0)))
    third = graph.op("Mul", graph.op("Mul", r, r), graph.constant(1 / 3))
    polynomial = graph.plus(r, third, graph.constant(1.0))
    return graph.op("Mul", polynomial, graph.op("Exp", graph.op("Neg", r)))


def _column(graph: _Graph, value: str, axis: int) -> str:
    """A column of (B, d); shape (B, 1)."""
    return graph.op("Gather", value, graph.constant(np.array([axis])), axis=1)


def _saved(onnx: Any, graph: _Graph, document: Mapping[str, Any]) -> bytes:
    """The finished model, checked by ONNX."""
    double, integer = onnx.TensorProto.DOUBLE, onnx.TensorProto.INT64
    n, m = len(document["state"]), len(document["command"])
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


def _package() -> Any:
    try:
        return import_module("onnx")
    except ImportError:
        raise InputError(f"--to onnx needs onnx: {INSTALL} 'stepgap[onnx]'") from None
