"""One part of a log that cannot be read is left out and named; only if it is asked for, it is an error."""

import json
import sqlite3
import struct
import warnings
from collections.abc import Callable
from contextlib import closing
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pytest
from mcap.writer import Writer
from pyarrow import parquet
from rosbags.rosbag1 import Writer as Bag1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat
from scipy.sparse import eye_array

from stepgap.base.errors import StepGapWarning
from stepgap.logs.columns import Columns
from stepgap.logs.foreign_log import read_foreign_logs
from stepgap.logs.tables import parquet_logs
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.reading import chosen_table, read_log_table, read_log_tables
from stepgap.records.steps_csv import RecordError

T, V = np.arange(4.0), np.array([0.5, 1.5, -2.5, 1e-9])
HUMBLE, JAZZY = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS2_JAZZY)
FLOAT, RANGE = "std_msgs/msg/Float64", "sensor_msgs/msg/Range"


def floats() -> list[bytes]:
    return [bytes(HUMBLE.serialize_cdr(HUMBLE.types[FLOAT](data=value), FLOAT)) for value in V.tolist()]


def ranges(store: Any) -> list[bytes]:
    """Messages whose definition differs between releases: `variance` came after Humble."""
    header = store.types["std_msgs/msg/Header"](store.types["builtin_interfaces/msg/Time"](3, 0), "tof")
    more = () if store is HUMBLE else (0.25,)
    messages = [store.types[RANGE](header, 1, 0.1, 0.0, 4.0, value, *more) for value in V.tolist()]
    return [bytes(store.serialize_cdr(message, RANGE)) for message in messages]


def database(
    path: Path,
    topics: dict[str, tuple[str, list[bytes]]],
    release: str = "humble",
    definitions: tuple[tuple[str, str, str], ...] = (),
) -> None:
    """A .db3 file as rosbag2 writes it."""
    with closing(sqlite3.connect(path)) as bag:
        bag.execute("CREATE TABLE schema(schema_version INTEGER, ros_distro TEXT)")
        bag.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)")
        bag.execute("CREATE TABLE messages(id INTEGER, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        bag.execute("INSERT INTO schema VALUES (3, ?)", (release,))
        if definitions:
            columns = "topic_type TEXT, encoding TEXT, encoded_message_definition TEXT"
            bag.execute(f"CREATE TABLE message_definitions({columns})")
            bag.executemany("INSERT INTO message_definitions VALUES (?, ?, ?)", definitions)
        for number, (name, (kind, messages)) in enumerate(topics.items()):
            bag.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr')", (number, name, kind))
            rows = [(at, number, at * 10**9, data) for at, data in enumerate(messages)]
            bag.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        bag.commit()


def read(path: Path, *left_out: str) -> dict[str, LogTable]:
    """The tables of a log of which some parts are left out, with a warning that names them."""
    if not left_out:
        return dict(read_log_tables(path))
    with pytest.warns(StepGapWarning) as caught:
        tables = read_log_tables(path)
    assert len(caught) == 1
    for part in left_out:
        assert part in str(caught[0].message)
    return dict(tables)


@pytest.mark.parametrize("definitions", [(), (("control_msgs/msg/DynamicJointState", "unknown", ""),)])
def test_a_topic_without_a_definition(definitions: tuple[tuple[str, str, str], ...], tmp_path: Path) -> None:
    path, unknown = tmp_path / "bag.db3", ("control_msgs/msg/DynamicJointState", [b"\0\1\0\0" + bytes(20)])
    database(path, {"/v": (FLOAT, floats()), "/joints": unknown}, definitions=definitions)
    reason = "no definition of control_msgs/msg/DynamicJointState in the log"
    tables = read(path, f"/joints ({reason})")
    np.testing.assert_array_equal(chosen_table(path, tables, ["/v:data"]).numbers("data"), V)
    with pytest.raises(RecordError, match=f"/joints was left out: {reason}"):
        chosen_table(path, tables, ["/joints:values[0]"])
    with pytest.raises(RecordError, match="no column 'speed'"):
        chosen_table(path, tables, ["speed"])


@pytest.mark.parametrize(("release", "store"), [("humble", HUMBLE), ("jazzy", JAZZY), ("", HUMBLE), ("rolling", JAZZY)])
def test_older_bags_have_the_definitions_of_their_release_or_those_that_fit(
    release: str, store: Any, tmp_path: Path
) -> None:
    database(tmp_path / "bag.db3", {"/tof": (RANGE, ranges(store))}, release)
    table = read_log_table(tmp_path / "bag.db3", ["range"])
    np.testing.assert_array_equal(table.numbers("range"), V.astype(np.float32))
    assert ("variance" in table.columns) == (store is JAZZY)


def test_a_bag_folder_needs_no_metadata_but_uses_their_release(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    database(bag / "bag_0.db3", {"/tof": (RANGE, ranges(HUMBLE)), "/v": (FLOAT, floats())}, "")
    assert len(read_log_table(bag, ["range"])) == 4
    (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  ros_distro: jazzy\n")
    tables = read(bag, "/tof (a message that is shorter than its definition")
    assert list(tables) == ["/v"], "with a wrong release, nothing is read by a definition that does not fit"


@pytest.mark.parametrize(
    ("definition", "data", "reason"),
    [
        ("float64 x", "<u4 pad, <f8 x", ""),
        ("float32 x", "f8", "4 bytes more than the definition of a/msg/A has"),
        ("int16 x\nint16 y", "int16 and byte and int16", "2 bytes more"),
        ("int16 x", "padded", ""),
        ("int16 x", "encapsulated otherwise", "not in the plain CDR of ROS 2, but with the header 00070000"),
        ("wstring x", "f8", "no definition of a/msg/wstring in the log"),
        ("Missing x", "padded", "no definition of a/msg/Missing in the log"),
        ("float64", "f8", "the definition of a/msg/A cannot be read"),
    ],
)
def test_a_definition_that_does_not_fit_its_data_gives_no_numbers(
    definition: str, data: str, reason: str, tmp_path: Path
) -> None:
    content = {
        "<u4 pad, <f8 x": b"\0\1\0\0" + np.float64(2.5).tobytes(),
        "f8": b"\0\1\0\0" + np.float64(2.5).tobytes(),
        "int16 and byte and int16": b"\0\1\0\0\1\0\2\0\3\0",
        "padded": b"\0\1\0\0\5\0\0\0",
        "encapsulated otherwise": b"\0\7\0\0\5\0\0\0",
    }[data]
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        kind = writer.register_schema("a/msg/A", "ros2msg", definition.encode())
        channels = [writer.register_channel("/a", "cdr", kind), writer.register_channel("/b", "json", 0)]
        writer.add_message(channels[0], 0, content, 0)
        writer.add_message(channels[1], 0, b'{"y": 1.0}', 0)
        writer.finish()
    tables = read(
        tmp_path / "log.mcap", *([f"/a ({reason}", reason] if reason.startswith("no") else [reason] * bool(reason))
    )
    assert ("/a" in tables) == (not reason)
    assert tables["/b"].numbers("y").tolist() == [1.0]
    if not reason:
        assert tables["/a"].numbers("x").tolist() == [5.0 if data == "padded" else 2.5]


IDL = """================================================================================
IDL: a/msg/A
module a { module msg {
  struct A { double x; sequence<float> y; string name; };
}; };
"""


@pytest.mark.parametrize(
    ("encoding", "form", "definition"),
    [
        ("cdr", "ros2idl", IDL),
        ("cdr", "", ""),
        ("cdr", "ros2msg", ""),
        ("ros1", "ros1msg", "float64 x\nfloat32[] y\nstring name\n"),
    ],
)
def test_other_definitions_in_mcap(encoding: str, form: str, definition: str, tmp_path: Path) -> None:
    """IDL, the standard types of which rosbag2 found no definition, and messages of ROS 1."""
    name = "a/msg/A" if definition else FLOAT
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("float64 x\nfloat32[] y\nstring name", "a/msg/A"))
    serialize = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/a", encoding, writer.register_schema(name, form, definition.encode()))
        for value in V.tolist():
            fields = (value, np.array([3.5], np.float32), "left") if definition else (value,)
            writer.add_message(channel, 0, bytes(serialize(store.types[name](*fields), name)), 0)
        writer.finish()
    table = read_log_table(tmp_path / "log.mcap", ["x" if definition else "data"])
    np.testing.assert_array_equal(table.numbers("x" if definition else "data"), V)
    if definition:
        assert (table.numbers("y[0]")[0], str(table.columns["name"][0])) == (3.5, "left")


def test_a_type_without_fields_has_a_byte(tmp_path: Path) -> None:
    database(tmp_path / "bag.db3", {"/e": ("a/msg/E", [b"\0\1\0\0\0"])}, definitions=(("a/msg/E", "ros2msg", ""),))
    assert list(read_log_tables(tmp_path / "bag.db3")["/e"].columns) == ["log_time"]


def test_a_topic_with_a_wrong_definition_in_a_ros_1_bag(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("float32 x", "a/msg/Short"))
    with Bag1(tmp_path / "log.bag") as bag:
        good = bag.add_connection("/v", FLOAT, typestore=store)
        bad = bag.add_connection("/bad", "a/msg/Short", typestore=store)
        for at, value in enumerate(V.tolist()):
            data = bytes(store.serialize_ros1(store.types[FLOAT](data=value), FLOAT))
            bag.write(good, at, data)
            bag.write(bad, at, data)
    tables = read(tmp_path / "log.bag", "/bad (a message of 4 bytes more than the definition of a/msg/Short has)")
    np.testing.assert_array_equal(tables["/v"].numbers("data"), V)


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["robot/t"], file["robot/v"] = T, V
        file["robot/link"] = h5py.ExternalLink("other.h5", "/x")
        file["robot/phase"] = np.array([1 + 2j] * 4)
        filtered = file.create_dataset("robot/bad", data=np.arange(4.0), chunks=(4,), compression="gzip")
        at = filtered.id.get_chunk_info(0).byte_offset
    with path.open("r+b") as file:
        file.seek(at)
        file.write(b"\xff" * 4)


def mat(path: Path) -> None:
    with path.open("wb") as file:
        log = {"t": T, "v": V, "note": np.array([[1.0, "x"]], object)}
        savemat(file, {"robot": log, "sparse": eye_array(4).tocsc(), "cells": np.array(["a", 2.0], object)})


def test_structs_in_an_array_of_matlab_are_columns_with_their_numbers(tmp_path: Path) -> None:
    """As To Workspace of Simulink writes two signals."""
    signals = np.zeros((1, 2), [("values", object), ("label", object)])
    signals["values"][0, 0], signals["values"][0, 1] = T[:, None], V[:, None]
    signals["label"] = "y"
    savemat(tmp_path / "log.mat", {"simout": {"time": T, "signals": signals}})
    table = read(tmp_path / "log.mat")["simout"]
    assert list(table.columns) == ["time", "signals[0].values", "signals[1].values"]
    np.testing.assert_array_equal(table.numbers("signals[1].values"), V)


def npz(path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, t=T, v=V, settings=np.array([{"a": 1}], object), spectrum=V * 1j)


def table(path: Path) -> None:
    names = pa.array([["a"], None, ["b"], []], pa.list_(pa.string()))
    pictures = pa.array([b"\0", b"\1", b"\2", b"\3"])
    maps = pa.array([[("a", 1)]] * 4, pa.map_(pa.string(), pa.int64()))
    parquet.write_table(pa.table({"t": T, "v": V, "picture": pictures, "names": names, "map": maps}), path)


@pytest.mark.parametrize(
    ("write", "left_out", "asked"),
    [
        (hdf5, ("robot:link (a link to another file", "robot:phase (values of type complex128", "robot:bad ("), "bad"),
        (mat, ("robot:note (values of type object", "sparse (a csc_", "cells (values of type object"), "sparse"),
        (npz, ("settings (an array of Python objects", "spectrum (values of type complex128"), "spectrum"),
        (table, ("picture (values of type binary", "map (values of type map<"), "picture"),
    ],
)
def test_one_array_that_cannot_be_read(
    write: Callable[[Path], None], left_out: tuple[str, ...], asked: str, tmp_path: Path
) -> None:
    path = tmp_path / "log"
    write(path)
    tables = read(path, *left_out)
    for name, values in (("t", T), ("v", V)):
        np.testing.assert_array_equal(chosen_table(path, tables, ["t", "v"]).numbers(name), values)
    with pytest.raises(RecordError, match=f"{asked} was left out: "):
        chosen_table(path, tables, ["t", asked])


def test_lists_in_parquet_are_columns_as_in_mcap(tmp_path: Path) -> None:
    state = pa.array([[1.0, 2.0], None, [3.0, 4.0]], pa.list_(pa.float32(), 2))
    ragged, nested = pa.array([[1], [], [2, 3]]), pa.array([[[1.0, 2.0]]] * 3)
    steps = pa.array([[{"x": 1.5}]] * 3)
    columns = {"observation.state": state, "ragged": ragged, "nested": nested, "steps": steps}
    parquet.write_table(pa.table(columns | {"wide": pa.array([list(range(101))] * 3)}), tmp_path / "log.parquet")
    (found,) = read(tmp_path / "log.parquet", "wide (101 elements; at most 100 become columns)").values()
    numbers: dict[str, Any] = {name: found.numbers(name).tolist() for name in found.columns}
    assert str(numbers) == str({
        "observation.state[0]": [1.0, np.nan, 3.0],
        "observation.state[1]": [2.0, np.nan, 4.0],
        "ragged[0]": [1.0, np.nan, 2.0],
        "ragged[1]": [np.nan, np.nan, 3.0],
        "nested[0][0]": [1.0] * 3,
        "nested[0][1]": [2.0] * 3,
        "steps[0].x": [1.5] * 3,
    })  # fmt: skip


def test_a_filter_of_hdf5_that_is_not_installed(tmp_path: Path) -> None:
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file["t"], file["v"] = T, V
        file.create_dataset("packed", data=np.arange(4.0), chunks=(4,), compression="gzip")
    number, rest = struct.pack("<H", 1), struct.pack("<3H", 8, 1, 1) + b"deflate\0"
    content = path.read_bytes()
    assert content.count(number + rest) == 1
    path.write_bytes(content.replace(number + rest, struct.pack("<H", 32026) + rest))
    (table,) = read(path, "packed (compressed by deflate, which is not installed; write it with gzip)").values()
    np.testing.assert_array_equal(table.numbers("v"), V)


def matlab_object(path: Path) -> None:
    """Two arrays, and between them a variable of a class, as MATLAB's `save` writes a table."""
    texts = [(16, b"events"), (16, b"MCOS"), (16, b"table")]
    parts = [struct.pack("<4I", 6, 8, 17, 0)]
    parts += [struct.pack("<2I", kind, len(text)) + text + bytes(-len(text) % 8) for kind, text in texts]
    array = BytesIO()
    savemat(array, {"t": np.array([1, 2], np.uint32)})
    parts.append(array.getvalue()[128:])
    content = b"".join(parts)
    both = [BytesIO(), BytesIO()]
    savemat(both[0], {"t": T})
    savemat(both[1], {"v": V}, do_compression=True)
    first, last = (one.getvalue() for one in both)
    path.write_bytes(first + struct.pack("<2I", 14, len(content)) + content + last[128:])


def test_a_variable_of_a_class_does_not_hide_the_others(tmp_path: Path) -> None:
    matlab_object(tmp_path / "log.mat")
    tables = read(tmp_path / "log.mat", "left out variable 2 (a table of MATLAB, which only MATLAB can read")
    table = chosen_table(tmp_path / "log.mat", tables, ["t", "v"])
    np.testing.assert_array_equal([table.numbers("t"), table.numbers("v")], [T, V])


def test_an_object_of_matlab_in_version_7_3_is_no_column(tmp_path: Path) -> None:
    """It is stored as numbers that say where its parts are."""
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in (("t", T), ("v", V)):
            file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        where = file.create_dataset("events", data=np.array([[0xDD000000, 2, 1, 1]], np.uint32))
        where.attrs["MATLAB_class"] = np.bytes_("table")
        where.attrs["MATLAB_object_decode"] = np.int32(3)
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(header + path.read_bytes()[128:])
    (table,) = read(path, "left out events (a table of MATLAB, which only MATLAB can read").values()
    assert list(table.columns) == ["t", "v"]


def test_a_damaged_variable_does_not_hide_the_others(tmp_path: Path) -> None:
    file = BytesIO()
    savemat(file, {"t": T, "v": V}, do_compression=True)
    content = bytearray(file.getvalue())
    content[content.index(struct.pack("<I", 15)) + 20] ^= 0xFF
    (tmp_path / "log.mat").write_bytes(content)
    (table,) = read(tmp_path / "log.mat", "left out variable 1 (").values()
    np.testing.assert_array_equal(table.numbers("v"), V)


def test_a_page_of_parquet_whose_checksum_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    options: dict[str, Any] = {"write_page_checksum": True, "compression": "none", "use_dictionary": False}
    parquet.write_table(pa.table({"t": T, "v": V}), path, **options)
    content = path.read_bytes()
    path.write_bytes(content.replace(V.tobytes(), V[::-1].tobytes()))
    (table,) = read(path, "left out v (").values()
    np.testing.assert_array_equal(table.numbers("t"), T)


def test_a_column_of_parquet_that_is_small_only_in_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parquet_logs, "_LARGEST_COLUMN", 2**20)
    path, notes = tmp_path / "log.parquet", ["x" * 2**19 + end for end in "abc"]
    parquet.write_table(pa.table({"t": [0.0, 1.0, 2.0], "note": notes}), path, compression="zstd")
    unread = dict[str, str]()
    (table,) = parquet_logs.read_parquet(path, unread).values()
    assert list(table.columns) == ["t"]
    assert unread == {"note": "larger than 1048576 bytes when decompressed"}


@pytest.mark.parametrize("kind", ["json", "ros"])
def test_an_array_that_is_too_long_is_named_if_it_is_asked_for(kind: str, tmp_path: Path) -> None:
    path, name = tmp_path / "log", "std_msgs/msg/Float64MultiArray"
    if kind == "json":
        path.write_text(json.dumps({"t": 0.0, "data": [0.0] * 101}) + "\n")
    else:
        layout = HUMBLE.types["std_msgs/msg/MultiArrayLayout"]([], 0)
        message = HUMBLE.types[name](layout=layout, data=np.zeros(101))
        database(path, {"/state": (name, [bytes(HUMBLE.serialize_cdr(message, name))])})
    with pytest.raises(RecordError, match=r"data was left out: 101 elements; at most 100 become columns"):
        read_log_table(path, ["data[3]"])


def test_a_log_is_given_as_text_or_path(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t,v\n0,1\n")
    assert read_log_tables(str(tmp_path / "x.csv"))[""].numbers("v").tolist() == [1.0]


def test_fit_reads_the_rest(tmp_path: Path) -> None:
    rows = [json.dumps({"v": value, "c": 1.0}).encode() for value in V.tolist()]
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        good, bad = writer.register_channel("/robot", "json", 0), writer.register_channel("/camera", "cbor", 0)
        for at, row in enumerate(rows):
            writer.add_message(good, at, row, at)
        writer.add_message(bad, 0, b"", 0)
        writer.finish()
    with pytest.warns(StepGapWarning, match="left out /camera \\(messages in 'cbor', not read"):
        steps = read_foreign_logs([tmp_path / "log.mcap"], Columns(state=("v",), command=("c",))).steps
    np.testing.assert_array_equal(steps.next_state[:, 0], V[1:])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(RecordError, match=r"command '/camera:x': /camera was left out: messages in 'cbor'"):
            read_foreign_logs([tmp_path / "log.mcap"], Columns(state=("v",), command=("/camera:x",)))
