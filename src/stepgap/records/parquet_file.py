"""Steps as a Parquet file, for data frames; unit and meaning of a column are in its metadata."""

from collections.abc import Sequence
from io import BytesIO

from stepgap.base.versions import optional_package
from stepgap.records.step_columns import Column


def parquet_file(columns: Sequence[Column]) -> bytes:
    """Content of the Parquet file.

    Raises:
        InputError: pyarrow is not installed.
    """
    arrow, parquet = (optional_package(name, "--to parquet", "parquet") for name in ("pyarrow", "pyarrow.parquet"))
    arrays = [arrow.array(column.values) for column in columns]
    fields = [
        arrow.field(column.name, array.type, metadata={"unit": column.unit, "meaning": column.meaning})
        for column, array in zip(columns, arrays, strict=True)
    ]
    stream = BytesIO()
    parquet.write_table(arrow.Table.from_arrays(arrays, schema=arrow.schema(fields)), stream)
    return stream.getvalue()
