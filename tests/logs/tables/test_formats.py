"""Every format, written by the library of its own ecosystem, is read back without a change."""

import gzip
import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pytest
from mcap.writer import CompressionType, Writer
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.writer import Writer as Ros2Writer
from pyarrow import parquet
from rosbags.rosbag1 import Writer as Bag1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat

from stepgap.logs.tables.reading import read_log_table, read_log_tables
from stepgap.records.steps_csv import RecordError

RNG = np.random.default_rng(1)
NUMBERS: dict[str, Any] = {name: RNG.normal(size=7) * 10.0 ** RNG.integers(-9, 9, 7) for name in ("t", "v", "y")}
NUMBERS["y"][3] = np.nan


def structured() -> np.ndarray:
    table = np.empty(7, [(name, float) for name in NUMBERS])
    for name, values in NUMBERS.items():
        table[name] = values
    return table


def write_npy(path: Path) -> None:
    with path.open("wb") as file:
        np.save(file, structured())


def write_npz(path: Path) -> None:
    with path.open("wb") as file:
        np.savez(file, rate=200.0, **NUMBERS)


def write_npz_compressed(path: Path) -> None:
    with path.open("wb") as file:
        np.savez_compressed(file, **NUMBERS)


def write_mat(path: Path) -> None:
    with path.open("wb") as file:
        savemat(file, NUMBERS, oned_as="column")


def write_mat_struct(path: Path) -> None:
    with path.open("wb") as file:
        savemat(file, {"log": NUMBERS, "g": 9.81, "name": "run"}, do_compression=True)


def write_mat_73(path: Path) -> None:
    """Conventions of MATLAB: a user block with its header, dimensions reversed, a struct as a group."""
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in NUMBERS.items():
            dataset = group.create_dataset(name, data=values[None, :])
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
        text = file.create_dataset("note", data=np.array([[72], [105]], np.uint16))
        text.attrs["MATLAB_class"] = np.bytes_("char")
        file.create_group("#refs#")
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    content = path.read_bytes()
    path.write_bytes(header + content[128:])


def write_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        for name, values in NUMBERS.items():
            file.create_dataset(f"robot/{name}", data=values, compression="gzip")
        file["other/t"] = np.arange(3.0)
        file["robot/phase"] = ["flight"] * 7


def write_parquet(path: Path) -> None:
    parquet.write_table(pa.table(NUMBERS | {"trial": ["a"] * 7}), path)


def write_json_lines(path: Path) -> None:
    rows = [dict(zip(NUMBERS, row, strict=True)) for row in zip(*NUMBERS.values(), strict=True)]
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))


def write_mcap_json(path: Path, compression: CompressionType = CompressionType.ZSTD) -> None:
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        schema = writer.register_schema("row", "jsonschema", b'{"type": "object"}')
        channel = writer.register_channel("/robot", "json", schema)
        for index, row in enumerate(zip(*NUMBERS.values(), strict=True)):
            data = json.dumps(dict(zip(NUMBERS, row, strict=True))).encode()
            writer.add_message(channel, 10**9 * index, data, 10**9 * index)
        writer.finish()


def write_csv_gz(path: Path) -> None:
    rows = "\n".join(",".join(map(repr, row)) for row in structured().tolist())
    path.write_bytes(gzip.compress(f"# a log\n\nt,v,y\n{rows}\n".encode()))


WRITERS = [value for name, value in list(globals().items()) if name.startswith("write_")]


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_numbers_are_read_back_bit_exactly(write: Callable[[Path], None], tmp_path: Path) -> None:
    path = tmp_path / "log"
    write(path)
    table = read_log_table(path, list(NUMBERS))
    assert len(table) == 7
    for name, values in NUMBERS.items():
        np.testing.assert_array_equal(table.numbers(name), values)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_every_compression_of_mcap(compression: CompressionType, tmp_path: Path) -> None:
    write_mcap_json(tmp_path / "log", compression)
    table = read_log_table(tmp_path / "log", ["/robot:v", "log_time"])
    np.testing.assert_array_equal(table.numbers("/robot:v"), NUMBERS["v"])
    np.testing.assert_allclose(table.numbers("log_time"), np.arange(7.0))


def test_protobuf_in_mcap(tmp_path: Path) -> None:
    from google.protobuf.struct_pb2 import ListValue
    from google.protobuf.timestamp_pb2 import Timestamp
    from google.protobuf.wrappers_pb2 import DoubleValue

    with (tmp_path / "log.mcap").open("wb") as file, ProtobufWriter(file) as writer:
        for index, value in enumerate(NUMBERS["v"]):
            writer.write_message("/v", DoubleValue(value=value), index)
            writer.write_message("/stamp", Timestamp(seconds=3, nanos=500_000_000), index)
            tree = ListValue()
            tree.extend([value, 2.0])
            writer.write_message("/list", tree, index)
    tables = read_log_tables(tmp_path / "log.mcap")
    np.testing.assert_array_equal(tables["/v"].numbers("value"), NUMBERS["v"])
    np.testing.assert_array_equal(tables["/list"].numbers("values[0].number_value"), NUMBERS["v"])
    np.testing.assert_array_equal(tables["/stamp"].numbers("stamp"), 3.5)


JOINTS = "std_msgs/Header header\nfloat64[] position\nstring name\nbool[2] contact\nduration age\nuint8[] picture"
HEADER = "=" * 80 + "\nMSG: std_msgs/Header\n{}time stamp\nstring frame_id\n"


def joints(types: dict[str, Any], ros1: bool, value: float) -> Any:
    time, header = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    stamp = time(sec=5, nanosec=250_000_000)
    head = header(stamp=stamp, frame_id="hip", **({"seq": 4} if ros1 else {}))
    age = types["builtin_interfaces/msg/Duration"](sec=-1, nanosec=500_000_000)
    contact, picture = np.array([True, False]), np.zeros(1000, np.uint8)
    return types["a/msg/Joints"](head, np.array([value, 2.0]), "flight", contact, age, picture)


def write_bag(path: Path, kind: str) -> None:
    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    definition = JOINTS if ros1 else JOINTS.replace("duration", "builtin_interfaces/Duration")
    store.register(get_types_from_msg(definition, "a/msg/Joints"))
    if ros1:
        writer: Any = Bag1(path)
        writer.set_compression(Bag1.CompressionFormat.LZ4)
    else:
        plugin = StoragePlugin.MCAP if kind == "ros2 mcap" else StoragePlugin.SQLITE3
        writer = Bag2(path, version=9, storage_plugin=plugin)
    with writer:
        connection = writer.add_connection("/joints", "a/msg/Joints", typestore=store)
        for index, value in enumerate(NUMBERS["v"]):
            message = joints(store.types, ros1, value)
            serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
            writer.write(connection, index * 10**9, bytes(serialize(message, "a/msg/Joints")))


@pytest.mark.parametrize("kind", ["ros1", "ros2 sqlite", "ros2 mcap"])
def test_bags_of_both_generations(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "log.bag"
    write_bag(path, kind)
    paths = [path, *path.glob("*.db3"), *path.glob("*.mcap")] if path.is_dir() else [path]
    for part in paths:
        table = read_log_table(part, ["/joints:position[0]", "header.stamp", "log_time", "age"])
        np.testing.assert_array_equal(table.numbers("position[0]"), NUMBERS["v"])
        np.testing.assert_array_equal(table.numbers("header.stamp"), 5.25)
        np.testing.assert_array_equal(table.numbers("age"), -0.5)
        np.testing.assert_array_equal(table.numbers("contact[0]"), 1.0)
        np.testing.assert_allclose(table.numbers("log_time"), np.arange(7.0))
        assert set(table.columns["name"]) == {"flight"}
        assert not [name for name in table.columns if "picture" in name], "it has more than 100 elements"


def test_ros_2_messages_in_mcap(tmp_path: Path) -> None:
    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Ros2Writer(file)
        schema = writer.register_msgdef(
            "a/msg/Point", "float64 x\nint8[] counts\nA[2] parts\n" + "=" * 80 + "\nMSG: a/A\nint32 n"
        )
        for value in NUMBERS["v"]:
            parts = [{"n": 1}, {"n": -2}]
            writer.write_message("/point", schema, {"x": value, "counts": [1, -3], "parts": parts})
        writer.finish()
    table = read_log_table(tmp_path / "log.mcap", ["x"])
    np.testing.assert_array_equal(table.numbers("x"), NUMBERS["v"])
    assert table.numbers("counts[1]").tolist() == [-3] * 7
    assert table.numbers("parts[1].n").tolist() == [-2] * 7


def test_groups_and_lengths_are_told_apart(tmp_path: Path) -> None:
    write_hdf5(tmp_path / "log.h5")
    with pytest.raises(RecordError, match="other, robot have these columns; say which, as in 'other:t'"):
        read_log_table(tmp_path / "log.h5", ["t"])
    assert len(read_log_table(tmp_path / "log.h5", ["other:t"])) == 3
    np.savez(tmp_path / "log.npz", a=np.zeros(3), b=np.zeros((3, 2)), c=np.zeros(4))
    tables = read_log_tables(tmp_path / "log.npz")
    assert {name: set(table.columns) for name, table in tables.items()} == {
        "(3 rows)": {"a", "b[0]", "b[1]"},
        "(4 rows)": {"c"},
    }


def test_an_older_bag_without_definitions_has_the_standard_types(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Bag2(tmp_path / "bag", version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/v", "std_msgs/msg/Float64", typestore=store)
        for value in NUMBERS["v"]:
            message = store.types["std_msgs/msg/Float64"](data=value)
            writer.write(connection, 0, bytes(store.serialize_cdr(message, "std_msgs/msg/Float64")))
    (database,) = (tmp_path / "bag").glob("*.db3")
    with closing(sqlite3.connect(database)) as content:
        content.execute("DELETE FROM message_definitions")
        content.commit()
    table = read_log_table(tmp_path / "bag", ["data"])
    np.testing.assert_array_equal(table.numbers("data"), NUMBERS["v"])
