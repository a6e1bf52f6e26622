"""Tables of files whose libraries may end their process, or take all memory: they are read in another process.

This module is also its program:

    python -m stepgap.logs.tables.foreign_files KIND FILE COLUMNS SECONDS BYTES
"""

import sys
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from stepgap.base.errors import StepGapWarning
from stepgap.base.trial_process import answer_of, print_answer
from stepgap.logs.tables.hdf5 import read_hdf5
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.matlab import read_mat
from stepgap.logs.tables.parquet_logs import read_feather, read_parquet
from stepgap.records.steps_csv import RecordError

READERS: Final[Mapping[str, Callable[[Path, dict[str, str]], dict[str, LogTable]]]] = {
    "Feather": read_feather,
    "HDF5": partial(read_hdf5, False),
    "MAT": read_mat,
    "MAT 7.3": partial(read_hdf5, True),
    "Parquet": read_parquet,
}
"""Functions that read a file of a kind, and add what they leave out to a dictionary, with the reasons."""

_SECONDS: Final = 300  # longest time of a processor [s]
_MEMORY: Final = 4 * 2**30  # largest memory [bytes], of which addresses that libraries only reserve are a half


def read_foreign_file(kind: str, path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The tables of a file of a kind in `READERS`; what cannot be read is added to `unread`, with the reasons.

    Raises:
        RecordError: It cannot be read, ends its reader, or takes too much time or memory.
    """
    with TemporaryDirectory() as folder:
        columns = Path(folder) / "columns"
        try:
            answer = answer_of(__name__, [kind, str(path), str(columns)], "its library", _SECONDS, _MEMORY)
        except ValueError as error:
            raise RecordError(f"{path}: not a readable {kind} file, damaged or incomplete ({error})") from None
        if "refusal" in answer:
            raise RecordError(answer["refusal"])
        for message in answer["warnings"]:
            warnings.warn(message, StepGapWarning, stacklevel=2)
        unread.update(answer["unread"])
        tables = dict[str, LogTable]()
        with columns.open("rb") as file:
            for name, (source, names, repeated, left_out) in answer["tables"].items():
                values = {column: np.lib.format.read_array(file, allow_pickle=False) for column in names}
                tables[name] = LogTable(source, values, repeated=frozenset(repeated), unread=left_out)
        return tables


# ---- in the other process


def _read(kind: str, path: str, columns: str) -> dict[str, Any]:
    """Writes the columns of all tables, one after the other, and returns what else is in the tables."""
    unread = dict[str, str]()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", StepGapWarning)
        try:
            tables = READERS[kind](Path(path), unread)
        except RecordError as error:
            return {"refusal": str(error)}
    said = [str(warning.message) for warning in caught if issubclass(warning.category, StepGapWarning)]
    with Path(columns).open("wb") as file:
        for table in tables.values():
            for values in table.columns.values():
                np.lib.format.write_array(file, np.ascontiguousarray(values), allow_pickle=False)
    described = {
        name: (table.source, list(table.columns), sorted(table.repeated), dict(table.unread))
        for name, table in tables.items()
    }
    return {"unread": unread, "tables": described, "warnings": said}


if __name__ == "__main__":
    print_answer(partial(_read, *sys.argv[1:4]), int(sys.argv[4]), int(sys.argv[5]))
