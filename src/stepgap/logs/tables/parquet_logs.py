"""Parquet files."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from stepgap.logs.tables.arrays import numbers_or_labels
from stepgap.logs.tables.files import check_file_size
from stepgap.logs.tables.libraries import leaving_out, library, reading
from stepgap.logs.tables.log_table import LogColumn, LogTable, check_size
from stepgap.logs.tables.messages import MOST_ELEMENTS

PARQUET_MAGIC = b"PAR1"


def read_parquet(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The columns of numbers, times [s] and text; fields of structs as NAME.FIELD, elements of lists as NAME[0].

    Columns that cannot be read are added to `unread`, with the reasons.
    """
    arrow, parquet = library("pyarrow", path, "parquet"), library("pyarrow.parquet", path, "parquet")
    library("pyarrow.compute", path, "parquet")
    check_file_size(path)
    found: dict[str, LogColumn] = {}
    with reading(path, "Parquet"), parquet.ParquetFile(path) as file:
        groups = [file.metadata.row_group(number) for number in range(file.metadata.num_row_groups)]
        sizes = [group.column(number).num_values for group in groups for number in range(group.num_columns)]
        check_size(str(path), float(sum(sizes)))
        names = list(file.schema_arrow.names)
        repeated = frozenset(name for name in names if names.count(name) > 1)
        for name in dict.fromkeys(names):
            with leaving_out(name, unread):
                table = file.read(columns=[name])  # a name with dots selects the fields of structs, too
                if name not in repeated and name in table.column_names:
                    _add_columns(name, table.column(name), arrow, found, unread, str(path))
        return {"": LogTable(str(path), found, repeated=repeated)} if found or not unread else {}


def _add_columns(
    name: str, column: Any, arrow: Any, found: dict[str, LogColumn], unread: dict[str, str], source: str
) -> None:
    """Adds a column, the fields of a struct, or the elements of a list."""
    for part, values in _parts(name, column, arrow):
        with leaving_out(part, unread):
            numbers = _values(values, arrow)
            if numbers is None:
                raise ValueError(f"values of type {values.type}, neither numbers nor text")
            check_size(source, (len(found) + 1.0) * len(numbers))
            found[part] = numbers


def _parts(name: str, column: Any, arrow: Any) -> Iterator[tuple[str, Any]]:
    """Yields the parts of a column that are no structs and lists; lists that are longer than others are left out."""
    kind = arrow.types
    if isinstance(column.type, arrow.BaseExtensionType):
        column = column.cast(column.type.storage_type)
    if kind.is_struct(column.type):
        for field, values in zip(column.type, column.flatten(), strict=True):
            yield from _parts(f"{name}.{field.name}", values, arrow)
    elif kind.is_list(column.type) or kind.is_large_list(column.type) or kind.is_fixed_size_list(column.type):
        compute = arrow.compute
        longest = compute.max(compute.list_value_length(column)).as_py() or 0
        for index in range(longest if longest <= MOST_ELEMENTS else 0):
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
    if kind.is_boolean(column.type):
        column = column.cast(arrow.uint8())
    known = kind.is_integer(column.type) or kind.is_floating(column.type) or kind.is_temporal(column.type)
    return numbers_or_labels(column.to_numpy()) if known else None
