"""Command tables as files: plain arrays in NumPy's npz, checked completely before they are used."""

from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from zipfile import BadZipFile, ZipFile

import numpy as np
from numpy.typing import NDArray

from stepgap.base.files import write_whole
from stepgap.control.command_table import CommandTable
from stepgap.step import Quantity, StepSpace

LARGEST_TABLE = 2**30
"""Largest table that is read, compressed or not [bytes]."""
TABLE_SCHEMA = 1
ARRAY_KINDS = {
    "schema": "i", "state": "U", "command": "U", "units": "U", "ranges": "f",
    "commands": "f", "predicted": "f", "reached": "b", "statuses": "i",
}  # fmt: skip
"""Arrays of a file and the kind of their entries, in NumPy's letters."""


def write_table(path: str | Path, table: CommandTable) -> None:
    """Writes a table; its size is about 8 (m + n) bytes for each node."""
    space, content = table.space, BytesIO()
    quantities = (*space.state, *space.command)
    np.savez(
        content,
        schema=np.array(TABLE_SCHEMA),
        state=np.array(space.state_names),
        command=np.array(space.command_names),
        units=np.array([quantity.unit for quantity in quantities]),
        ranges=np.array([[quantity.lower, quantity.upper] for quantity in quantities]),
        commands=table.commands,
        predicted=table.predicted,
        reached=table.reached,
        statuses=table.statuses,
    )
    write_whole(Path(path), content.getvalue())


def read_table(path: str | Path) -> CommandTable:
    """Reads a table.

    Raises:
        ValueError: The file is not a command table; the message names it and the reason.
        OSError: The file cannot be read.
    """
    wanted = "it must be a command table as `stepgap map --table` writes it"
    try:
        if Path(path).stat().st_size > LARGEST_TABLE:
            raise ValueError(f"larger than {LARGEST_TABLE} bytes")
        with ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > LARGEST_TABLE:
                raise ValueError(f"it unpacks to more than {LARGEST_TABLE} bytes")
        with np.load(path, allow_pickle=False) as members:
            arrays = {name: members[name] for name in members.files}
        return _table_of(arrays)
    except (BadZipFile, EOFError, NotImplementedError, SyntaxError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: {' '.join(str(error).split())}; {wanted}") from None


def _table_of(arrays: Mapping[str, NDArray[np.generic]]) -> CommandTable:
    """Converts the arrays of a file to a table; ValueError if they are not those of one."""
    if arrays.keys() != ARRAY_KINDS.keys():
        raise ValueError(f"it contains {', '.join(arrays) or 'nothing'} instead of {', '.join(ARRAY_KINDS)}")
    for name, kind in ARRAY_KINDS.items():
        if arrays[name].dtype.kind != kind:
            raise ValueError(f"{name} has entries of type {arrays[name].dtype}")
    if arrays["schema"].shape != () or arrays["schema"] != TABLE_SCHEMA:
        raise ValueError(f"its schema is {arrays['schema']}, but this version reads {TABLE_SCHEMA}")
    n, names = len(arrays["state"]), [*arrays["state"].tolist(), *arrays["command"].tolist()]
    if arrays["units"].shape != (len(names),) or arrays["ranges"].shape != (len(names), 2):
        raise ValueError("units and ranges must be given for each coordinate")
    ranges = arrays["ranges"].astype(float).tolist()
    quantities = [
        Quantity(*row) for row in zip(names, arrays["units"].tolist(), *zip(*ranges, strict=True), strict=True)
    ]
    return CommandTable(
        StepSpace(tuple(quantities[:n]), tuple(quantities[n:])),
        arrays["commands"].astype(float),
        arrays["predicted"].astype(float),
        arrays["reached"].astype(bool),
        arrays["statuses"].astype(np.int64),
    )
