"""Structures of vendors: the signals of Simulink, ControlDesk and MATLAB's h5write, whatever axis their rows have."""

import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.arrays import tables_of_arrays
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.reading import read_log_tables

ROWS = 250
T = np.arange(ROWS) / 100.0
Q = np.stack([np.sin(T), np.cos(T)])


def structs(**fields: list[Any]) -> np.ndarray:
    """An array of structs, as MATLAB's 1xN struct."""
    count = len(next(iter(fields.values())))
    array = np.zeros((1, count), [(name, object) for name in fields])
    for name, values in fields.items():
        for index, value in enumerate(values):
            array[name][0, index] = value
    return array


def structure_with_time(matrix: bool) -> dict[str, Any]:
    """Simulink's To Workspace: a vector has a row for each time, a matrix is of rows, columns and times."""
    values = [Q.T, Q.reshape(2, 1, ROWS)] if matrix else [Q[:1].T, Q[1:].T]
    signals = structs(values=values, dimensions=[2.0, np.array([2.0, 1.0])], label=["", "height"])
    return {"simout": {"time": T[:, None], "signals": signals, "blockName": "walker/Scope"}}


def control_desk() -> dict[str, Any]:
    """A recording of dSPACE ControlDesk."""
    x = structs(Name=["Time"], Data=[T[None, :]], Unit=["s"])
    y = structs(Name=["height", "push"], Data=[Q[:1], Q[1:]], XIndex=[1.0, 1.0])
    return {"rec1": {"X": x, "Y": y, "Description": structs(General=["none"]), "RTProgram": "hop.sdf"}}


def mat(path: Path, variables: dict[str, Any]) -> Path:
    savemat(path, variables)
    return path


def mat73(path: Path, variables: dict[str, Any]) -> Path:
    """As MATLAB's `save -v7.3`: dimensions reversed, arrays of structs and cells by references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            _store(file, file, name, value)
    content = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM" + content[128:])
    return path


def _store(file: Any, group: Any, name: str, value: Any) -> Any:
    if isinstance(value, dict) or (isinstance(value, np.ndarray) and value.dtype.names):
        inner = group.create_group(name)
        inner.attrs["MATLAB_class"] = np.bytes_("struct")
        fields = value.items() if isinstance(value, dict) else [(one, value[one]) for one in value.dtype.names]
        for field, content in fields:
            if isinstance(value, dict) or value.size == 1:
                _store(file, inner, field, content if isinstance(value, dict) else content.item())
            else:
                inner.create_dataset(field, data=_references(file, content), dtype=h5py.ref_dtype)
        return inner
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        stored = group.create_dataset(name, data=_references(file, value), dtype=h5py.ref_dtype)
        stored.attrs["MATLAB_class"] = np.bytes_("cell")
        return stored
    is_text = isinstance(value, str)
    numbers = np.array([[ord(letter)] for letter in value or " "], np.uint16) if is_text else np.atleast_2d(value).T
    stored = group.create_dataset(name, data=numbers)
    stored.attrs["MATLAB_class"] = np.bytes_("char" if is_text else "double")
    return stored


def _references(file: Any, values: np.ndarray) -> np.ndarray:
    hidden = file.require_group("#refs#")
    stored = [_store(file, hidden, f"r{len(hidden)}", value) for value in values.ravel().tolist()]
    return np.array([[one.ref] for one in stored], h5py.ref_dtype)


@pytest.mark.parametrize("write", [mat, mat73])
@pytest.mark.parametrize("matrix", [False, True])
def test_signals_of_simulink(write: Any, matrix: bool, tmp_path: Path) -> None:
    tables = read_log_tables(write(tmp_path / "log.mat", structure_with_time(matrix)))
    table = next(table for table in tables.values() if "time" in table.columns)
    columns = ["signals[0].values[1]", "signals[1].values[0]"] if matrix else ["signals[1].values", "signals[0].values"]
    np.testing.assert_array_equal(table.numbers("time"), T)
    if matrix and write is mat73:
        columns[1] += "[0]"
    np.testing.assert_array_equal([table.numbers(one) for one in columns], Q[::-1])


@pytest.mark.parametrize("write", [mat, mat73])
def test_a_recording_of_control_desk(write: Any, tmp_path: Path) -> None:
    table = read_log_tables(write(tmp_path / "log.mat", control_desk()))["rec1"]
    np.testing.assert_array_equal([table.numbers(f"Y[{number}].Data") for number in (0, 1)], Q)
    np.testing.assert_array_equal(table.numbers("X.Data"), T)


@pytest.mark.parametrize("write", [mat, mat73])
def test_a_timeseries_as_a_struct_and_cells(write: Any, tmp_path: Path) -> None:
    cells = np.empty((1, 2), object)
    cells[0, 0], cells[0, 1] = {"Time": T[:, None], "Data": Q[None, :1]}, {"Time": T[:, None], "Data": Q[None, 1:]}
    path = write(tmp_path / "log.mat", {"ts": {"Name": "q", "Time": T[:, None], "Data": Q[:, None]}, "logs": cells})
    tables = read_log_tables(path)
    column = next(name for name in tables["ts"].columns if name.startswith("Data[1]"))
    np.testing.assert_array_equal(tables["ts"].numbers(column), Q[1])
    np.testing.assert_array_equal(tables["logs[1]"].numbers("Data"), Q[1])


def transposed(path: Path, place: str, times: str) -> Path:
    with h5py.File(path, "w") as file:
        file[times] = T[None, :]
        file[place] = Q
        file["limits"] = [0.0, 1.0]
    return path


@pytest.mark.parametrize(("place", "times"), [("q", "time"), ("robot/q", "robot/time"), ("robot/q", "time")])
def test_arrays_that_matlab_wrote_to_hdf5(place: str, times: str, tmp_path: Path) -> None:
    tables = read_log_tables(transposed(tmp_path / "log.h5", place, times))
    (table,) = (table for table in tables.values() if "q[1]" in table.columns)
    np.testing.assert_array_equal([table.numbers("q[0]"), table.numbers("q[1]")], Q)


def tables_of(*arrays: tuple[str, Any]) -> dict[str, LogTable]:
    return tables_of_arrays("log", [("", name, values) for name, values in arrays], {})


def test_which_axis_is_that_of_the_rows() -> None:
    assert list(tables_of(("t", T), ("q", Q.T))[""].columns) == ["t", "q[0]", "q[1]"]
    assert list(tables_of(("q", Q), ("t", T))[""].columns) == ["q[0]", "q[1]", "t"]
    assert list(tables_of(("t", T[:3]), ("q", np.zeros((3, 7))), ("gains", np.zeros(7)))) == ["(3 rows)", "(7 rows)"]
    assert len(tables_of(("q", np.zeros((40, 60))))[""]) == 40
    assert "q[2]" in tables_of(("q", np.zeros((1000, 3))), ("gains", np.zeros(3)))["(1000 rows)"].columns
    with pytest.warns(StepGapWarning, match="log: q has 2 rows of 250 values, which are taken as columns"):
        assert list(tables_of(("q", Q))[""].columns) == ["q[0]", "q[1]"]


def test_numbers_in_rows_of_a_file_without_times(tmp_path: Path) -> None:
    """The warning comes from the other process."""
    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["q"] = Q
    with pytest.warns(StepGapWarning, match="q has 2 rows of 250 values"):
        assert len(read_log_tables(tmp_path / "log.h5")[""]) == ROWS


def test_variables_before_the_end_of_a_truncated_file(tmp_path: Path) -> None:
    stream = BytesIO()
    savemat(stream, {"t": T, "v": T, "w": T})
    (tmp_path / "log.mat").write_bytes(stream.getvalue()[:-100])
    with pytest.warns(StepGapWarning, match="truncated MAT file; the variables before its end are read"):
        table = read_log_tables(tmp_path / "log.mat")[""]
    assert list(table.columns) == ["t", "v"]


@pytest.mark.parametrize(
    ("kind", "advice"),
    [("timetable", "s.time = seconds\\(T.Time\\); s.v = T.v"), ("timeseries", "s.time = ts.Time; s.v = ts.Data")],
)
def test_objects_of_classes_say_what_to_save_instead(kind: str, advice: str, tmp_path: Path) -> None:
    stream = BytesIO()
    savemat(stream, {"t": T})
    parts = [struct.pack("<4I", 6, 8, 17, 0)]
    for text in (b"walk", b"MCOS", kind.encode()):
        parts.append(struct.pack("<2I", 16, len(text)) + text + bytes(-len(text) % 8))
    inner = BytesIO()
    savemat(inner, {"x": np.array([1, 2], np.uint32)})
    parts.append(inner.getvalue()[128:])
    content = b"".join(parts)
    (tmp_path / "log.mat").write_bytes(stream.getvalue() + struct.pack("<2I", 14, len(content)) + content)
    with pytest.warns(StepGapWarning, match=f"a {kind} of MATLAB, which only MATLAB can read; save {advice}"):
        read_log_tables(tmp_path / "log.mat")
