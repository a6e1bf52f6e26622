"""Steps as a Parquet file, for data frames; unit and meaning of a column are in its metadata."""

from collections.abc import Sequence
from importlib import import_module
from io import BytesIO
from typing import Any

from stepgap.base.errors import InputError
from stepgap.base.versions import INSTALL
from stepgap.records.step_columns import Column


def parquet_file(columns: Sequence[Column]) -> bytes:
    """Content of the Parquet file.

    Raises:
        InputError: pyarrow is not installed.
    """
    arrow, parquet = _module("pyarrow"), _module("pyarrow.parquet")
    arrays = [arrow.array(column.values) for column in columns]
    fields = [
        arrow.field(column.name, array.type, metadata={"unit": column.unit, "meaning": column.meaning})
        for column, array in zip(columns, arrays, strict=True)
    ]
    stream = BytesIO()
    parquet.write_table(arrow.Table.from_arrays(arrays, schema=arrow.schema(fields)), stream)
    return stream.getvalue()


def _module(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError:
        raise InputError(f"--to parquet needs pyarrow: {INSTALL} 'stepgap[parquet]'") from None
