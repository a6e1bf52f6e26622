"""A network in an ONNX file: a vector in, a vector out."""

import re
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from stepgap.base.errors import InputError, StepGapError, message_of
from stepgap.base.files import read_bounded
from stepgap.base.versions import optional_package
from stepgap.step import Array

LARGEST_NETWORK: Final = 2**28  # Largest file of a network that is read [bytes]

_EXTERNAL: Final = re.compile(rb"(?:\x0a|\x8a\x80{0,8}\x00)(?:\x08|\x88\x80{0,8}\x00)location")
"""Begins, in the encoding of ONNX, the entry of a tensor that says in which other file its numbers are; the two numbers
of field and length may have more bytes than they need."""

_REMEDY: Final = "export the policy by torch.onnx.export or your training program as one ONNX file"


class OnnxNetwork:
    """A network without memory, which runs in one thread, so that the same input gives the same output.

    The operators are those of onnxruntime alone, and all numbers are in the file itself.

    Args:
        path: The file.

    Raises:
        InputError: It cannot be read, is larger than `LARGEST_NETWORK`, or has other inputs or outputs.
    """

    def __init__(self, path: Path):
        runtime = optional_package("onnxruntime", f"{path}: a policy", "policy")
        content = read_network(path)
        options = runtime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # of any kind, from onnxruntime
            raise InputError(f"{path}: onnxruntime cannot load it: {_in_short(error)}; {_REMEDY}") from None
        self._path = path
        self._input, self._rank, self.input_size = _vector(self._session.get_inputs(), "input", path)
        self._output, _, self.output_size = _vector(self._session.get_outputs(), "output", path)

    @property
    def metadata(self) -> dict[str, str]:
        """What the file says of the network, by names."""
        return dict(self._session.get_modelmeta().custom_metadata_map)

    def __call__(self, values: Array) -> Array:
        """Output of the network; shape (`output_size`,).

        Args:
            values: Input; shape (`input_size`,).

        Raises:
            StepGapError: The network cannot be computed, or its output has not this shape and finite numbers.
        """
        shape = (1,) * (self._rank - 1) + (self.input_size,)
        try:
            (found,) = self._session.run([self._output], {self._input: values.astype(np.float32).reshape(shape)})
        except Exception as error:  # of any kind, from onnxruntime
            raise StepGapError(f"{self._path}: onnxruntime cannot run it: {_in_short(error)}") from None
        output = np.asarray(found, float).ravel()
        if output.shape != (self.output_size,) or not np.isfinite(output).all():
            raise StepGapError(f"{self._path}: its output is not {self.output_size} finite numbers; train it again")
        return output

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self  # it has no memory


def read_network(path: Path) -> bytes:
    """Content of the file of a network.

    Raises:
        InputError: It cannot be read, is larger than `LARGEST_NETWORK`, or needs another file.
    """
    try:
        content = read_bounded(path, LARGEST_NETWORK)
    except OSError as error:
        raise InputError(f"{message_of(error)}; {_REMEDY}") from None
    if _EXTERNAL.search(content):
        raise InputError(f"{path}: some of its numbers are in another file; {_REMEDY} (external_data=False)")
    return content


def _vector(ends: list[Any], what: str, path: Path) -> tuple[str, int, int]:
    """Name, rank and size of the only input or output of a network."""
    if len(ends) != 1:
        names = ", ".join(each.name for each in ends)
        raise InputError(f"{path}: it has {len(ends)} {what}s ({names:.200}), but only one can be given; {_REMEDY}")
    (end,) = ends
    *batch, size = end.shape or [None]
    fixed = any(type(each) is int and each != 1 for each in batch)
    if end.type != "tensor(float)" or type(size) is not int or len(batch) > 1 or fixed:
        wanted = "it must be tensor(float) [1, N]"
        raise InputError(f"{path}: its {what} {end.name:.80} is {end.type} {end.shape}, but {wanted}; {_REMEDY}")
    return end.name, len(batch) + 1, size


def _in_short(error: Exception) -> str:
    return f"{' '.join(str(error).split()):.200}" or type(error).__name__
