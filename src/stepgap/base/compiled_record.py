"""Memory that Python and compiled code share: a named tuple of numbers as one NumPy record.

Numba unpacks and packs a named tuple field by field at every call from Python, which takes some 10 µs for fifty
numbers; passing the address of a record takes 0.1 µs. Compiled code reads `record.field` as it reads a named tuple, so
the same functions accept both; `loaded` and `assign` read and write a complete named tuple.
"""

from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, get_type_hints

import numpy as np
from numba.core import types
from numba.core.typing.templates import signature
from numba.extending import intrinsic
from numpy.typing import NDArray

Record = NDArray[np.void]
"""One record, as an array of shape (1,)."""

_NUMBER = {float: np.float64, int: np.int64, bool: np.int64}
_COMPILED = {float: types.float64, int: types.int64, bool: types.int64}


@cache
def record_type(kind: type) -> np.dtype[np.void]:
    """The NumPy type with the fields of a named tuple or dataclass of numbers, which may be nested.

    It is the same object at every call, because Numba needs 4 µs per call to recognise another one.
    """
    hints = get_type_hints(kind)
    return np.dtype([(name, _field_type(hints[name])) for name in _names(kind)])


def as_record(value: Any) -> Record:
    """Returns a record with the numbers of a named tuple or dataclass."""
    return np.array([_plain(value)], record_type(type(value)))


def from_record(kind: Any, record: np.void | Record) -> Any:
    """Returns a named tuple of the given kind with the numbers of a record."""
    hints = get_type_hints(kind)
    record = record[0] if isinstance(record, np.ndarray) else record
    return kind(*(_value(hints[name], record[name]) for name in _names(kind)))


@intrinsic
def loaded(typing_context, record, kind):
    """Returns a named tuple of the given kind with the numbers of a record; for compiled code."""
    tuple_kind = _compiled_kind(kind.instance_class)

    def generate(context, builder, sig, arguments):
        return _load(context, builder, (sig.args[0], sig.return_type), arguments[0])

    return signature(tuple_kind, record, kind), generate


@intrinsic
def assign(typing_context, record, value):
    """Writes the fields of a named tuple to the fields of a record with the same names; for compiled code."""

    def generate(context, builder, sig, arguments):
        _store(context, builder, sig.args, arguments)
        return context.get_dummy_value()

    return signature(types.none, record, value), generate


def _compiled_kind(kind):
    """Numba's type of the named tuple that a record stores."""
    hints = get_type_hints(kind)
    inner = [
        _COMPILED[hints[name]] if hints[name] in _COMPILED else _compiled_kind(hints[name]) for name in _names(kind)
    ]
    return types.BaseTuple.from_types(inner, kind)


def _load(context, builder, kinds, record):
    """Generates the code of `loaded`; a nested named tuple is read field by field."""
    record_kind, tuple_kind = kinds
    values = []
    for name, kind in zip(tuple_kind.fields, tuple_kind.types, strict=True):
        value = context.get_getattr(record_kind, name)(context, builder, record_kind, record, name)
        if isinstance(kind, types.BaseNamedTuple):
            value = _load(context, builder, (record_kind.typeof(name), kind), value)
        values.append(value)
    return context.make_tuple(builder, tuple_kind, values)


def _store(context, builder, kinds, values):
    """Generates the code of `assign`; a nested named tuple is written field by field."""
    record_kind, tuple_kind = kinds
    record, value = values
    for index, (name, kind) in enumerate(zip(tuple_kind.fields, tuple_kind.types, strict=True)):
        element = builder.extract_value(value, index)
        if isinstance(kind, types.BaseNamedTuple):
            inner_kind = record_kind.typeof(name)
            inner = context.get_getattr(record_kind, name)(context, builder, record_kind, record, name)
            _store(context, builder, (inner_kind, kind), (inner, element))
        else:
            store = context.get_setattr(name, signature(types.none, record_kind, kind))
            store(builder, (record, element))


def _names(kind: Any) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind)) if is_dataclass(kind) else kind._fields


def _field_type(kind: type) -> Any:
    return _NUMBER[kind] if kind in _NUMBER else record_type(kind)


def _plain(value: Any) -> Any:
    if isinstance(value, int | float | np.generic):  # numbers and truths of numpy, too
        return value
    return tuple(_plain(getattr(value, name)) for name in _names(type(value)))


def _value(kind: type, value: Any) -> Any:
    return kind(value) if kind in _NUMBER else from_record(kind, value)
