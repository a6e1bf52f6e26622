"""Files of Arrow: Parquet and Feather."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from stepgap.logs.tables.arrays import numbers_or_labels
from stepgap.logs.tables.files import check_file_size, leaving_out, library, reading
from stepgap.logs.tables.log_table import MOST_ELEMENTS, MOST_NUMBERS, LogColumn, LogTable, check_size
from stepgap.logs.tables.messages import too_long

PARQUET_MAGIC = b"PAR1"
FEATHER_MAGIC = b"ARROW1\0\0"

_LARGEST_COLUMN = 16 * MOST_NUMBERS  # Largest column that is read, decompressed [bytes]


def read_parquet(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The columns of numbers, times [s] and text; fields of structs as NAME.FIELD, elements of lists as NAME[0].

    Columns that cannot be read are added to `unread`, with the reasons.
    """
    arrow = library("pyarrow", path, "parquet")
    parquet = library("pyarrow.parquet", path, "parquet")
    library("pyarrow.compute", path, "parquet")
    check_file_size(path)
    columns: dict[str, LogColumn] = {}
    # Times in the 96 bits of Spark may be later than 2262, where nanoseconds end.
    options = {"page_checksum_verification": True, "coerce_int96_timestamp_unit": "us"}
    with reading(path, "Parquet"), parquet.ParquetFile(path, **options) as file:
        groups = [file.metadata.row_group(number) for number in range(file.metadata.num_row_groups)]
        chunks = [group.column(number) for group in groups for number in range(group.num_columns)]
        check_size(str(path), float(sum(chunk.num_values for chunk in chunks)))
        names = list(file.schema_arrow.names)
        repeated = frozenset(name for name in names if names.count(name) > 1)
        for name in dict.fromkeys(names):
            with leaving_out(name, unread):
                _check_bytes(name, chunks)
                table = file.read(columns=[name])  # a name with dots selects the fields of structs, too
                if name not in repeated and name in table.column_names:
                    _add_columns(name, table.column(name), arrow, columns, unread, str(path))
        return {"": LogTable(str(path), columns, repeated=repeated)} if columns or not unread else {}


def read_feather(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The columns of a Feather file of version 2, as of `read_parquet`."""
    arrow = library("pyarrow", path, "parquet")
    ipc = library("pyarrow.ipc", path, "parquet")
    library("pyarrow.compute", path, "parquet")
    check_file_size(path)
    columns: dict[str, LogColumn] = {}
    with reading(path, "Feather"), arrow.OSFile(str(path)) as file:
        table = ipc.open_file(file).read_all()
        table.validate(full=True)
        check_size(str(path), float(table.num_rows) * table.num_columns)
        names = table.column_names
        repeated = frozenset(name for name in names if names.count(name) > 1)
        for name in names:
            with leaving_out(name, unread):
                if name not in repeated:
                    _add_columns(name, table.column(name), arrow, columns, unread, str(path))
        return {"": LogTable(str(path), columns, repeated=repeated)} if columns or not unread else {}


def _check_bytes(name: str, chunks: Sequence[Any]) -> None:
    """Raises ValueError if a column, which may be one of several with the same begin of their names, is too large."""
    of_name = [chunk for chunk in chunks if f"{chunk.path_in_schema}.".startswith(f"{name}.")]
    if sum(chunk.total_uncompressed_size for chunk in of_name) > _LARGEST_COLUMN:
        raise ValueError(f"larger than {_LARGEST_COLUMN} bytes when decompressed")


def _add_columns(
    name: str, column: Any, arrow: Any, columns: dict[str, LogColumn], unread: dict[str, str], source: str
) -> None:
    for part, values in _parts(name, column, arrow):
        if isinstance(values, str):
            unread[part] = values
            continue
        with leaving_out(part, unread):
            numbers = _values(values, arrow)
            if numbers is None:
                raise ValueError(f"values of type {values.type}, neither numbers nor text")
            check_size(source, (len(columns) + 1.0) * len(numbers))
            columns[part] = numbers


def _parts(name: str, column: Any, arrow: Any) -> Iterator[tuple[str, Any]]:
    """Yields the parts of a column that are no structs and lists; instead of lists that are too long, it yields why."""
    kind = arrow.types
    if isinstance(column.type, arrow.BaseExtensionType):
        column = column.cast(column.type.storage_type)
    if kind.is_struct(column.type):
        for field, values in zip(column.type, column.flatten(), strict=True):
            yield from _parts(f"{name}.{field.name}", values, arrow)
    elif kind.is_list(column.type) or kind.is_large_list(column.type) or kind.is_fixed_size_list(column.type):
        compute = arrow.compute
        longest = compute.max(compute.list_value_length(column)).as_py() or 0
        if longest > MOST_ELEMENTS:
            yield name, too_long(longest)
            return
        for index in range(longest):
            one = compute.list_slice(column, index, index + 1, return_fixed_size_list=True)
            yield from _parts(f"{name}[{index}]", compute.list_element(one, 0), arrow)
    else:
        yield name, column


def _values(column: Any, arrow: Any) -> LogColumn | None:
    """The numbers or labels of a column; None for any other type."""
    kind = arrow.types
    if kind.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if kind.is_decimal(column.type) or kind.is_null(column.type):
        column = column.cast(arrow.float64())
    if kind.is_string(column.type) or kind.is_large_string(column.type):
        return numbers_or_labels(column.fill_null("").to_numpy().astype(str))
    if kind.is_time(column.type):
        whole = arrow.int32() if kind.is_time32(column.type) else arrow.int64()
        column = column.cast(whole).cast(arrow.int64()).cast(arrow.duration(column.type.unit))
    if kind.is_boolean(column.type):
        column = column.cast(arrow.uint8())
    has_numbers = kind.is_integer(column.type) or kind.is_floating(column.type) or kind.is_temporal(column.type)
    return numbers_or_labels(column.to_numpy()) if has_numbers else None
