"""Parquet files."""

from pathlib import Path

from stepgap.logs.tables.arrays import numbers_or_labels
from stepgap.logs.tables.files import check_file_size
from stepgap.logs.tables.libraries import library, reading
from stepgap.logs.tables.log_table import LogTable, check_size

PARQUET_MAGIC = b"PAR1"


def read_parquet(path: Path) -> dict[str, LogTable]:
    """The columns of numbers, times [s] and text; the fields of structs as NAME.FIELD."""
    arrow, parquet = library("pyarrow", path, "parquet"), library("pyarrow.parquet", path, "parquet")
    check_file_size(path)
    with reading(path, "Parquet"), parquet.ParquetFile(path) as file:
        check_size(str(path), float(file.metadata.num_rows) * file.metadata.num_columns)
        table = file.read()
        while any(arrow.types.is_struct(column.type) for column in table.schema):
            table = table.flatten()
        columns, repeated = {}, frozenset(name for name in table.column_names if table.column_names.count(name) > 1)
        for name, column in zip(table.column_names, table.columns, strict=True):
            kind = arrow.types
            if kind.is_decimal(column.type):
                column = column.cast(arrow.float64())
            if kind.is_dictionary(column.type):
                column = column.cast(column.type.value_type)
            if kind.is_string(column.type) or kind.is_large_string(column.type):
                column = column.fill_null("")
                values = column.to_numpy().astype(str)
            elif kind.is_boolean(column.type):
                values = column.cast(arrow.uint8()).to_numpy()
            elif kind.is_integer(column.type) or kind.is_floating(column.type) or kind.is_temporal(column.type):
                values = column.to_numpy()
            else:
                continue
            found = numbers_or_labels(values)
            if found is not None and name not in repeated:
                columns[name] = found
        return {"": LogTable(str(path), columns, repeated=repeated)}
