"""The file of a network, with the numbers that lie in other files beside it, as one ONNX file.

PyTorch writes large networks as `policy.onnx` and `policy.onnx.data`. A tensor of the first file then has the name of
the second one (`location`), and where in it its numbers are. They are put into the tensor here, so that nothing else
opens a file that a network names. The encoding is that of Protocol Buffers, and the fields are those of onnx.proto3.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from stepgap.base.errors import InputError, message_of
from stepgap.base.files import read_bounded

LARGEST_NETWORK: Final = 2**28  # Largest total size of the files of a network [bytes]

REMEDY: Final = "export the policy by torch.onnx.export or your training program as one ONNX file"

_KEY: Final = b"location"  # Key of the entry of a tensor that says in which other file its numbers are

_TORCH: Final = b"PK\x03\x04"  # How archives begin: PyTorch writes all of its files as such

_MESSAGES: Final[Mapping[str, Mapping[int, str]]] = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node", 11: "attribute"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
}
"""Messages that have tensors: kinds of their parts by the number of the field."""

_RAW: Final = 9  # Field of a tensor: its numbers
_ENTRIES: Final = 13  # Where they are, if that is outside
_LOCATION: Final = 14  # Whether it is
_VARINT: Final = 0  # Kind of the encoding of a field: a number
_BYTES: Final = 2  # Another one: bytes with their length
_FIXED: Final = {1: 8, 5: 4}  # Sizes of fields by other kinds of the encoding [bytes]
_DAMAGED: Final = f"it is no ONNX file, or damaged; {REMEDY}"
_DEEPEST: Final = 100  # Largest depth of messages within each other


def read_network(path: Path) -> bytes:
    """Content of the file of a network, with all of its numbers.

    Raises:
        InputError: It cannot be read, is larger than `LARGEST_NETWORK`, or a file with its numbers is missing, does not
            lie beside it, or is too short.
    """
    try:
        content = read_bounded(path, LARGEST_NETWORK)
    except OSError as error:
        raise InputError(f"{message_of(error)}; {REMEDY}") from None
    if content.startswith(_TORCH):
        raise InputError(
            f"{path}: this is a file of PyTorch, not ONNX. Without memory (LSTM, GRU), N inputs: import torch; "
            f"policy = torch.jit.load({path.name!r}).eval(); "
            f"torch.onnx.export(policy, torch.zeros(1, N), {path.stem + '.onnx'!r}, dynamo=False)"
        )
    if _KEY not in content:
        return content
    try:
        return _Numbers(path).within(content, "model", 0)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


class _Numbers:
    """The numbers of a network that are in other files.

    Args:
        path: The file of the network.
    """

    def __init__(self, path: Path):
        self._path = path
        self._files: dict[str, bytes] = {}
        self._left = LARGEST_NETWORK

    def within(self, content: bytes, kind: str, depth: int) -> bytes:
        """A message, in which each tensor has its numbers."""
        if depth > _DEEPEST:
            raise ValueError(f"its parts are nested more than {_DEEPEST} deep; {REMEDY}")
        parts = []
        for field, encoding, whole, inner in _fields(content):
            child = _MESSAGES[kind].get(field) if encoding == _BYTES else None
            if child is None:
                parts.append(whole)
            else:
                changed = self._tensor(inner) if child == "tensor" else self.within(inner, child, depth + 1)
                parts.append(_field(field, changed))
        return b"".join(parts)

    def _tensor(self, content: bytes) -> bytes:
        """A tensor with its numbers."""
        entries: dict[bytes, bytes] = {}
        parts = []
        outside = False
        for field, encoding, whole, inner in _fields(content):
            if field == _ENTRIES and encoding == _BYTES:
                pair = {number: value for number, _, _, value in _fields(inner)}
                entries[pair.get(1, b"")] = pair.get(2, b"")
            elif field == _LOCATION:
                outside = inner == b"\x01"
            elif field not in (_ENTRIES, _LOCATION):
                parts.append(whole)
        return b"".join([*parts, _field(_RAW, self._raw(entries))] if outside else parts)

    def _raw(self, entries: Mapping[bytes, bytes]) -> bytes:
        """Numbers of a tensor with these entries, as they are in their file."""
        location = entries.get(_KEY, b"").decode("utf-8", "backslashreplace")
        content = self._content(location)
        try:
            begin = int(entries.get(b"offset") or 0)
            length = int(entries.get(b"length") or max(0, len(content) - begin))
        except ValueError:
            raise ValueError(f"it has no place for its numbers in {location!r:.200}; {REMEDY}") from None
        if not 0 <= begin <= begin + length <= len(content):
            raise ValueError(
                f"its numbers are in {location!r:.200}, which is shorter than they are; copy this file once more"
            )
        self._left -= length
        if self._left < 0:
            raise ValueError(f"its numbers are larger than {LARGEST_NETWORK} bytes, so they are not read")
        return content[begin : begin + length]

    def _content(self, location: str) -> bytes:
        if location not in self._files:
            folder = self._path.parent
            path = folder / location.replace("\0", "\\0")
            where = f"some of its numbers are in another file, {location!r:.200}"
            if not _is_file(path):
                raise ValueError(f"{where}, which is not beside it; copy it there, too, or {_in_one_file(self._path)}")
            if not path.resolve().is_relative_to(folder.resolve()):  # a link is where it leads to
                raise ValueError(
                    f"{where}, which does not lie beside it, so it is not read; {_in_one_file(self._path)}"
                )
            self._files[location] = read_bounded(path, LARGEST_NETWORK)
        return self._files[location]


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # such as a name that is too long
        return False


def _in_one_file(path: Path) -> str:
    return f"where both are, save them in one file: onnx.save(onnx.load({path.name!r}), 'one_file.onnx')"


def _fields(content: bytes) -> Iterator[tuple[int, int, bytes, bytes]]:
    """Fields of a message: number, kind of the encoding, the whole field, and its content."""
    start = 0
    while start < len(content):
        tag, at = _varint(content, start)
        if tag >= 2**32:
            raise ValueError(_DAMAGED)
        encoding = tag & 7
        if encoding == _VARINT:
            value, end = _varint(content, at)
            inner = value.to_bytes((value.bit_length() + 7) // 8 or 1, "little")
        else:
            length = _FIXED.get(encoding, -1)
            if encoding == _BYTES:
                length, at = _varint(content, at)
            end = at + length
            inner = content[at:end]
        if not at <= end <= len(content):
            raise ValueError(_DAMAGED)
        yield tag >> 3, encoding, content[start:end], inner
        start = end


def _varint(content: bytes, at: int) -> tuple[int, int]:
    """A number of one to ten bytes, with seven bits in each, and where it ends."""
    number = 0
    for shift in range(0, 70, 7):
        if at >= len(content):
            break
        byte = content[at]
        at += 1
        number |= (byte & 127) << shift
        if byte < 128:
            return number, at
    raise ValueError(_DAMAGED)


def _field(number: int, content: bytes) -> bytes:
    """A field with bytes."""
    return b"".join([_encoded(8 * number + _BYTES), _encoded(len(content)), content])


def _encoded(number: int) -> bytes:
    parts = bytearray()
    while number > 127:
        parts.append(number & 127 | 128)
        number >>= 7
    return bytes([*parts, number])
