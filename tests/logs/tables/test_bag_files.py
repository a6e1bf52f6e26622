"""Bags of several files, compressed, or of a recorder that was killed: all is read, or a line says what is not."""

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import zstandard

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.reading import read_log_tables
from stepgap.records.steps_csv import RecordError
from tests.logs.tables.test_formats import write_mcap_json
from tests.logs.tables.test_left_out import FLOAT, V, database, floats

COUNT = len(V)


def numbers(path: Path, *messages: str) -> list[float]:
    """The numbers of the topic /v, after warnings with these texts."""
    if messages:
        with pytest.warns(StepGapWarning) as caught:
            tables = read_log_tables(path)
        text = " | ".join(str(one.message) for one in caught)
        assert all(message in text for message in messages), text
    else:
        tables = read_log_tables(path)
    table: LogTable = tables["/v"]
    assert (np.diff(table.numbers("log_time")) >= 0).all()
    return table.numbers("data").tolist()


def bag(path: Path, first: int = 0, count: int = COUNT, change: Callable[[bytes], bytes] = bytes) -> Path:
    """A part of a bag with some of the messages."""
    database(path, {"/v": (FLOAT, [])})
    with closing(sqlite3.connect(path)) as content:
        rows = [(at, 0, at * 10**9, change(floats()[at])) for at in range(first, first + count)]
        content.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
        content.commit()
    return path


def killed_in_wal_mode(folder: Path, link: bool = False) -> Path:
    """A recorder that was killed, with the last two messages in the file beside the database only."""
    path = bag(folder / "recorded.db3", count=2)
    with closing(sqlite3.connect(path)) as content:
        content.execute("PRAGMA journal_mode = WAL")
        content.execute("PRAGMA wal_autocheckpoint = 0")
        for at in (2, 3):
            content.execute("INSERT INTO messages VALUES (?, 0, ?, ?)", (at, at * 10**9, floats()[at]))
            content.commit()
        (folder / "killed").mkdir()
        for end in ("", "-wal", "-shm"):
            shutil.copy(f"{path}{end}", folder / "killed" / f"hop.db3{end}")
    if not link:
        return folder / "killed" / "hop.db3"
    (folder / "link.db3").symlink_to(folder / "killed" / "hop.db3")
    return folder / "link.db3"


@pytest.mark.parametrize("link", [False, True])
def test_messages_in_the_write_ahead_log_are_read_and_nothing_is_written(link: bool, tmp_path: Path) -> None:
    path = killed_in_wal_mode(tmp_path, link)
    before = {file.name: file.read_bytes() for file in (tmp_path / "killed").iterdir()}
    assert numbers(path) == V.tolist()
    assert {file.name: file.read_bytes() for file in (tmp_path / "killed").iterdir()} == before
    Path(tmp_path / "killed" / "hop.db3-shm").unlink()
    assert numbers(path) == V.tolist()
    assert numbers(tmp_path / "killed") == V.tolist()


def test_a_damaged_write_ahead_log_is_named(tmp_path: Path) -> None:
    path = killed_in_wal_mode(tmp_path)
    log = path.with_name("hop.db3-wal")
    content = bytearray(log.read_bytes())
    content[-100] ^= 0xFF
    log.write_bytes(content)
    assert numbers(path, "hop.db3-wal: 1 of its ") == V.tolist()[:-1]


def test_changes_that_were_not_finished_are_undone(tmp_path: Path) -> None:
    """The journal of a recorder that was killed while it wrote has the former pages."""
    path = bag(tmp_path / "recorded.db3", count=2)
    with closing(sqlite3.connect(path, isolation_level=None)) as content:
        content.execute("PRAGMA cache_size = 1")
        content.execute("BEGIN")
        content.execute("UPDATE messages SET data = x'00'")
        content.executemany("INSERT INTO messages VALUES (?, 0, 9, ?)", [(at, bytes(3000)) for at in range(9, 99)])
        for end in ("", "-journal"):
            shutil.copy(f"{path}{end}", tmp_path / f"killed.db3{end}")
        content.execute("ROLLBACK")
    assert numbers(tmp_path / "killed.db3") == V.tolist()[:2]


def test_parts_that_are_compressed(tmp_path: Path) -> None:
    path = bag(tmp_path / "hop_0.db3")
    packed = path.with_name("hop_0.db3.zstd")
    packed.write_bytes(zstandard.compress(path.read_bytes()))
    assert numbers(tmp_path) == V.tolist(), "it has a copy that is not compressed"
    path.unlink()
    assert numbers(packed) == V.tolist()
    assert numbers(tmp_path) == V.tolist()
    write_mcap_json(tmp_path / "log.mcap")
    (tmp_path / "log").write_bytes(zstandard.compress((tmp_path / "log.mcap").read_bytes()))
    assert len(read_log_tables(tmp_path / "log")["/robot"]) == 7
    (tmp_path / "log.csv.zst").write_bytes(zstandard.compress(b"t,v\n0,1\n"))
    with pytest.raises(RecordError, match=r"log.csv.zst: compressed by zstd; unpack it by `unzstd` before"):
        read_log_tables(tmp_path / "log.csv.zst")


def test_messages_that_are_compressed(tmp_path: Path) -> None:
    assert numbers(bag(tmp_path / "hop.db3", change=zstandard.compress)) == V.tolist()


METADATA = (
    "rosbag2_bagfile_information:\n  relative_file_paths:\n    - hop_0.db3\n    - hop_1.db3\n  message_count: {}\n"
)


def test_logs_with_numbers_in_one_folder_are_no_parts(tmp_path: Path) -> None:
    bag(tmp_path / "hop_1.db3", 0, 2)
    bag(tmp_path / "hop_2.db3", 2, 2)
    assert numbers(tmp_path / "hop_1.db3") == V.tolist()[:2]


def test_a_bag_of_several_parts(tmp_path: Path) -> None:
    tmp_path = tmp_path / "hop"
    tmp_path.mkdir()
    bag(tmp_path / "hop_0.db3", 0, 2)
    bag(tmp_path / "hop_1.db3", 2, 2)
    assert numbers(tmp_path) == V.tolist()
    part = "left out hop_1.db3 (another part of this bag; give its folder to read all)"
    assert numbers(tmp_path / "hop_0.db3", part) == V.tolist()[:2]
    (tmp_path / "metadata.yaml").write_text(METADATA.format(COUNT))
    assert numbers(tmp_path) == V.tolist()
    assert numbers(tmp_path / "hop_0.db3", part) == V.tolist()[:2]
    (tmp_path / "hop_1.db3").unlink()
    lost = "left out hop_1.db3 (a part of the bag, by metadata.yaml, but missing)"
    assert numbers(tmp_path, lost, "2 messages, but metadata.yaml names 4") == V.tolist()[:2]


def test_metadata_of_any_size(tmp_path: Path) -> None:
    bag(tmp_path / "hop_0.db3")
    with (tmp_path / "metadata.yaml").open("wb") as file:
        file.truncate(3 * 10**9)
    assert numbers(tmp_path) == V.tolist()


@pytest.mark.parametrize("lost", [1, 14, 15, 30, 40, 44, 45, 90])
def test_an_mcap_file_that_was_cut_off(lost: int, tmp_path: Path) -> None:
    """Without chunks, so that each message counts; one that was cut is not read as a short one."""
    from mcap.writer import Writer

    with (tmp_path / "log.mcap").open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        channel = writer.register_channel("/v", "json", 0)
        for at in range(20):
            writer.add_message(channel, at, b'{"data": %d.5}' % at, at)
        writer.finish()
    content = (tmp_path / "log.mcap").read_bytes()
    record = 9 + 22 + 14  # head of a record, head of a message, and data
    end = content.index(b'{"data": 19.5}') + 14
    (tmp_path / "log.mcap").write_bytes(content[: end - lost])
    count = 20 - -(-lost // record)
    read = numbers(tmp_path / "log.mcap", f"log.mcap: cut off; the {count} messages before its end are read")
    assert read == [at + 0.5 for at in range(count)]
