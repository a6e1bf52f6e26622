"""A network in an ONNX file: a vector in, a vector out."""

from pathlib import Path
from typing import Any, Self

import numpy as np

from stepgap.base.errors import InputError, StepGapError
from stepgap.base.versions import optional_package
from stepgap.mujoco_robots.velocity.policy.onnx_file import REMEDY, read_network
from stepgap.step import Array


class OnnxNetwork:
    """A network without memory, which runs in one thread, so that the same input gives the same output.

    The operators are those of onnxruntime alone. Its numbers may be in files beside it (`onnx_file`).

    Attributes:
        input_size: Size of its input.
        output_size: Size of its output.
        ends: Names of its input and its output.
        metadata: What the file says of it, by names.

    Raises:
        InputError: It cannot be read, is too large, has other inputs or outputs, or a name that is not UTF-8.
    """

    def __init__(self, path: Path):
        runtime = optional_package("onnxruntime", f"{path}: a policy", "policy")
        content = read_network(path)
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            processor = ["CPUExecutionProvider"]  # with a fallback, a failure is printed and tried once more
            self._session = runtime.InferenceSession(content, options, providers=processor, enable_fallback=0)
        except Exception as error:  # of any kind, from onnxruntime
            raise InputError(f"{path}: onnxruntime cannot load it: {_in_short(error)}; {REMEDY}") from None
        self._path = path
        try:
            self._input, self._rank, self.input_size = _vector(self._session.get_inputs(), "input", path)
            self._output, _, self.output_size = _vector(self._session.get_outputs(), "output", path)
            self.ends = self._input, self._output
            self.metadata = dict(self._session.get_modelmeta().custom_metadata_map)
        except UnicodeDecodeError as error:
            raise InputError(
                f"{path}: a name or text in it, '{_in_short(error)}', is not UTF-8; {REMEDY}, with another one"
            ) from None

    def __call__(self, values: Array) -> Array:
        """Output of the network; shape (`output_size`,).

        Args:
            values: Input; shape (`input_size`,).

        Raises:
            StepGapError: The network cannot be computed, or its output has not this shape and finite numbers.
        """
        shape = (1,) * (self._rank - 1) + (self.input_size,)
        try:
            (outputs,) = self._session.run([self._output], {self._input: values.astype(np.float32).reshape(shape)})
        except Exception as error:  # of any kind, from onnxruntime
            raise StepGapError(f"{self._path}: onnxruntime cannot run it: {_in_short(error)}") from None
        output = np.asarray(outputs, float).ravel()
        if output.shape != (self.output_size,) or not np.isfinite(output).all():
            raise StepGapError(f"{self._path}: its output is not {self.output_size} finite numbers; train it again")
        return output

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self  # it has no memory


def _vector(ends: list[Any], what: str, path: Path) -> tuple[str, int, int]:
    """Name, rank and size of the only input or output of a network."""
    if len(ends) != 1:
        names = ", ".join(end.name for end in ends)
        raise InputError(f"{path}: it has {len(ends)} {what}s ({names:.200}), but only one can be given; {REMEDY}")
    (end,) = ends
    *batch, size = end.shape or [None]
    fixed = any(type(length) is int and length != 1 for length in batch)
    if end.type != "tensor(float)" or type(size) is not int or len(batch) > 1 or fixed:
        wanted = "it must be tensor(float) [1, N]"
        raise InputError(f"{path}: its {what} {end.name:.80} is {end.type} {end.shape}, but {wanted}; {REMEDY}")
    return end.name, len(batch) + 1, size


def _in_short(error: Exception) -> str:
    """The message of an error; where it cannot be decoded, with numbers of the bytes that are not UTF-8."""
    text = bytes(error.object).decode("utf-8", "backslashreplace") if isinstance(error, UnicodeDecodeError) else error
    return f"{' '.join(str(text).split()):.200}" or type(error).__name__
