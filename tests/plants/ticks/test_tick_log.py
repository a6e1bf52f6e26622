"""The tick log against the mcap library's reader and Protobuf's decoder; damaged logs against the written ticks."""

import errno
import os
import resource
import shutil
import struct
import subprocess
import sys
import tracemalloc
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from mcap_protobuf.decoder import DecoderFactory

from stepgap.plants.ticks.tick_log import LARGEST_RECORD, TickLog, TickLogError, next_path, read_ticks, recover_ticks

UNITS = {"time": "s", "phi_1": "rad", "phi1": "rad", "torque_1": "N·m"}
"""Two of the names are one in Protobuf's JSON, where they need not differ."""


MEMORY = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
"""Folder for thousands of short-lived files."""


def ticks(count, fields=4, start=0.0):
    rows = np.random.default_rng(count).normal(size=(count, fields))
    rows[:, 0] = start + 1e-3 * np.arange(count)
    return rows


def write(path, batches, units=None):
    with TickLog(path, units or UNITS) as log:
        for rows in batches:
            log.append(rows)
            log.flush()


def same(one, other):
    """Equal to the last bit, also where numbers are not finite."""
    return one.shape == other.shape and one.tobytes() == other.tobytes()


def small_log(folder):
    """A log of a few chunks, its ticks, and the number of ticks before the end of each chunk."""
    path = folder / "small.mcap"
    rows = ticks(12)
    write(path, np.split(rows, [2, 7]))
    ends, found = [], 0
    with path.open("rb") as file:
        for record in StreamReader(file, emit_chunks=True).records:
            if isinstance(record, Chunk):
                found = len(ends)
                ends.append(file.tell())
    assert found == 2
    return path.read_bytes(), rows, list(zip(ends, [2, 7, 12], strict=True))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return small_log(tmp_path_factory.mktemp("small"))


def recovered(content, check=lambda outcome: None):
    """The ticks recovered from a file of that content; None if there are none."""
    with TemporaryDirectory(dir=MEMORY) as folder:
        broken, out = Path(folder, "broken.mcap"), Path(folder, "out.mcap")
        broken.write_bytes(content)
        try:
            outcome = recover_ticks(broken, out)
        except TickLogError as error:
            outcome = str(error)
        if isinstance(outcome, str):
            assert outcome.startswith(f"{broken}: ")
            assert not out.exists()
            return None
        check(outcome)
        units, rows = read_ticks(out)
        assert len(units) == rows.shape[1]
        assert outcome.ticks == len(rows)
        return rows


@given(
    hnp.arrays(float, st.tuples(st.integers(0, 20), st.just(3)), elements=st.floats(width=64)),
    st.floats(0, 1e6),
    st.lists(st.integers(0, 20)),
)
def test_numbers_are_read_as_they_were_written_to_the_last_bit(rows, start, cuts):
    rows[:, 0] = start + np.arange(len(rows)) * 1e-3
    units = {"time": "s", "x": "m", "_": ""}
    with TemporaryDirectory(dir=MEMORY) as folder:
        path = Path(folder, "log.mcap")
        write(path, np.split(rows, sorted(cuts)), units)
        read_units, read_rows = read_ticks(path)
        assert recover_ticks(path, path.with_name("out.mcap")) == (len(rows), ())
        assert read_ticks(path.with_name("out.mcap"))[0] == units
    assert list(read_units.items()) == list(units.items())
    assert same(read_rows, rows)


def test_other_readers_read_the_same(tmp_path):
    rows, units = ticks(2000, 20), {"time": "s", **{f"signal_{i}": "1" for i in range(1, 20)}}
    rows[3, 5:8] = np.nan, np.inf, -0.0
    write(tmp_path / "log.mcap", [rows], units)
    with (tmp_path / "log.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = list(reader.iter_decoded_messages())
        summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert same(np.array([[getattr(message, name) for name in units] for *_, message in decoded]), rows)
    assert [message.log_time for _, _, message, _ in decoded] == [1_000_000 * i for i in range(2000)]
    assert [message.sequence for _, _, message, _ in decoded] == list(range(2000))
    (channel,) = summary.channels.values()
    assert (channel.topic, channel.message_encoding) == ("ticks", "protobuf")
    assert channel.metadata == {"names": ",".join(units), "units": ",".join(units.values())}
    assert summary.statistics.message_count == 2000
    sizes = [index.uncompressed_size for index in summary.chunk_indexes]
    assert len(sizes) == 7
    assert max(sizes) < 64 * 2**10 + 300


def test_a_full_chunk_is_in_the_file_at_once_and_every_tick_after_a_flush(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr(os, "fsync", synced.append)
    path, units, rows = tmp_path / "log.mcap", {"time": "s"} | {f"x{i}": "m" for i in range(39)}, ticks(3000, 40)
    with TickLog(path, units) as log:
        log.append(rows[:2500])
        assert path.stat().st_size == log._file.tell()
        faults = []
        found = recovered(path.read_bytes(), lambda outcome: faults.extend(outcome.faults))
        assert found is not None
        assert 2500 - 64 * 2**10 / 416 <= len(found) < 2500
        assert same(found, rows[: len(found)])
        assert faults == [f"it is truncated after {path.stat().st_size} bytes, before its index is complete"]
        log.append(rows[2500:])
        synced.clear()
        log.flush()
        assert len(synced) == 1
        assert same(recovered(path.read_bytes()), rows)
        with pytest.raises(TickLogError, match=r"log\.mcap: it is truncated .* `recover_ticks` recovers"):
            read_ticks(path)
    assert same(read_ticks(path)[1], rows)


def test_a_truncated_log_gives_all_complete_ticks(small):
    content, rows, chunks = small
    message = 9 + 22 + len(UNITS) * 9
    begins = chunks[0][0] - 2 * message
    previous = 0
    assert message % 2 == 1, "it is cut at every second byte of a message, and at the others of the next one"
    for cut in range(0, len(content), 2):
        found = recovered(content[:cut])
        if found is None:
            assert cut < begins
            continue
        assert len(found) >= max((count for end, count in chunks if end <= cut), default=0)
        assert previous <= len(found) <= 12
        assert same(found, rows[: len(found)])
        previous = len(found)
    partial = recovered(content[: chunks[1][0] - message - 1])
    assert partial is not None
    assert len(partial) == 7 - 2


@given(st.data())
@settings(max_examples=200)
def test_a_changed_byte_never_makes_a_tick_that_was_not_written(small, data):
    content, rows, _ = small
    position = data.draw(st.integers(0, len(content) - 1))
    changed = bytearray(content)
    changed[position] ^= data.draw(st.integers(1, 255))
    found = recovered(changed)
    written = [row.tobytes() for row in rows]
    positions = [written.index(row.tobytes()) for row in found] if found is not None else []
    assert positions == sorted(set(positions))
    assert len(positions) > 0 or position < 8 + 9 + 40, "two chunks of three, at least, are not touched by it"


@given(st.data())
@settings(max_examples=200)
def test_any_damage_is_survived_and_takes_no_memory(small, data):
    content = bytearray(small[0])
    for _ in range(data.draw(st.integers(1, 8))):
        position = data.draw(st.integers(8, len(content)))
        patch = data.draw(st.binary(max_size=20) | st.sampled_from([struct.pack("<Q", 2**k) for k in (0, 31, 62, 63)]))
        content[position : position + len(patch)] = patch
    tracemalloc.start()
    try:
        recovered(content[: data.draw(st.integers(8, len(content)))])
        assert tracemalloc.get_traced_memory()[1] < 4 * LARGEST_RECORD
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("length", [2**21, 2**31, 2**62, 2**64 - 1])
def test_an_impossible_length_loses_only_later_records(small, length):
    content, rows, chunks = small
    changed = bytearray(content)
    position = content.index(b"\x06", content.index(b"mcap-python")) + 1
    assert struct.unpack_from("<Q", content, position)[0] < chunks[0][0]
    struct.pack_into("<Q", changed, position, length)
    assert same(recovered(changed), rows[:2])


@pytest.mark.parametrize("wrong", [-1.0, 1.0, np.nan, np.inf, 1e300])
def test_in_a_truncated_chunk_the_times_must_agree(small, wrong):
    content, rows, chunks = small
    broken = bytearray(content[: chunks[1][0] - 1])
    position = content.index(struct.pack("<d", rows[3, 0]))
    struct.pack_into("<d", broken, position, wrong)
    assert same(recovered(broken), rows[:3])


def test_names_and_units_are_taken_from_the_index_where_the_first_chunk_is_damaged(small, tmp_path):
    content, rows, _ = small
    (tmp_path / "broken.mcap").write_bytes(content.replace(b"rad", b"deg", 1))
    recover_ticks(tmp_path / "broken.mcap", tmp_path / "out.mcap")
    units, found = read_ticks(tmp_path / "out.mcap")
    assert units == UNITS
    assert same(found, rows[2:])


def test_zeros_after_a_power_failure_are_no_records(small):
    content, rows, chunks = small
    faults = []
    cut = content.index(b"\x06", chunks[0][0])
    found = recovered(content[:cut] + bytes(1000), lambda outcome: faults.extend(outcome.faults))
    assert same(found, rows[:2])
    assert faults == [f"it is truncated or damaged in the record at byte {cut} of {cut + 1000}"]


def test_faults_are_named(small):
    content, rows, chunks = small
    changed = bytearray(content)
    changed[chunks[0][0] - 1] ^= 1
    faults = []
    found = recovered(changed, lambda outcome: faults.extend(outcome.faults))
    assert same(found, rows[2:])
    assert [fault.split(" at byte")[0] for fault in faults] == ["the chunk", "ticks are missing before the chunk"]


def test_no_file_is_overwritten(tmp_path, small):
    path = tmp_path / "ticks-0.mcap"
    path.write_bytes(small[0])
    for write_again in (lambda: TickLog(path, UNITS), lambda: recover_ticks(path, path)):
        with pytest.raises(TickLogError, match=r"ticks-0\.mcap: File exists"):
            write_again()
    assert path.read_bytes() == small[0]


def test_the_next_log_comes_after_the_last(tmp_path):
    assert next_path(tmp_path / "none").name == "ticks-0.mcap"
    for name in ("ticks-0.mcap", "ticks-10.mcap", "ticks-9.mcap", "ticks-x.mcap", "ticks-11.mcap.partial"):
        (tmp_path / name).touch()
    assert next_path(tmp_path) == tmp_path / "ticks-11.mcap"


@pytest.mark.parametrize(
    ("units", "message"),
    [
        ({}, "of 0 fields"),
        ({"time": "s", "a b": "m"}, "'a b': a name consists"),
        ({"time": "s", "α": "rad"}, "'α': a name consists"),
        ({"time": "s", "x": "m,s"}, "has a comma"),
        ({f"x{i}": "" for i in range(2001)}, "of 2001 fields"),
    ],
)
def test_names_and_units_are_checked(tmp_path, units, message):
    with pytest.raises(ValueError, match=message):
        TickLog(tmp_path / "log.mcap", units)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("rows", [np.zeros(4), np.zeros((2, 3)), [[np.nan, 0, 0, 0]], [[-1e-9, 0, 0, 0]], [[1e10] * 4]])
def test_rows_are_checked(tmp_path, rows):
    with TickLog(tmp_path / "log.mcap", UNITS) as log:
        log.append(ticks(2))
        with pytest.raises(ValueError, match=r"it must be|time must be"):
            log.append(rows)
    assert same(read_ticks(tmp_path / "log.mcap")[1], ticks(2))


def test_a_closed_log_is_reported(tmp_path):
    log = TickLog(tmp_path / "log.mcap", UNITS)
    log.close()
    log.close()
    with pytest.raises(TickLogError, match=r"log\.mcap: this log is closed"):
        log.append(ticks(1))


def fill(path):
    """Appends until the disk is full: returns the written ticks and the error."""
    with TickLog(path, UNITS) as log:
        for start in range(100):
            try:
                log.append(ticks(1000, start=start))
            except TickLogError as error:
                return np.concatenate([ticks(1000, start=k) for k in range(start + 1)]), error
    raise AssertionError("it was never full")


def check_full(path, rows, error, reason):
    assert str(error) == f"{path}: {os.strerror(reason)}"
    found = recovered(path.read_bytes())
    assert found is not None
    assert same(found, rows[: len(found)])
    size = 9 + 22 + 9 * len(UNITS)
    assert path.stat().st_size - 64 * 2**10 < len(found) * (size + 16), "but for indexes, the file is full of ticks"


def test_a_file_that_cannot_grow_keeps_its_content(tmp_path):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, before[1]))
    try:
        rows, error = fill(tmp_path / "log.mcap")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    check_full(tmp_path / "log.mcap", rows, error, errno.EFBIG)


ON_A_SMALL_DISK = """
import errno, sys
from pathlib import Path
from tests.plants.ticks.test_tick_log import check_full, fill
path = Path(sys.argv[1])
check_full(path, *fill(path), errno.ENOSPC)
"""


def test_on_a_full_disk_the_content_is_kept(tmp_path):
    isolated = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-ec"]
    mount = 'mount -t tmpfs -o size=300k none "$0"'
    if not shutil.which("unshare") or subprocess.run([*isolated, mount, tmp_path], capture_output=True).returncode:
        pytest.skip("no file system can be mounted here")
    check = [*isolated, f'{mount}; exec "$@"', tmp_path, sys.executable, "-c", ON_A_SMALL_DISK, tmp_path / "log.mcap"]
    outcome = subprocess.run(check, cwd=Path(__file__).parents[3], capture_output=True, text=True)
    assert outcome.returncode == 0, outcome.stderr


def foreign_log(path, units, data=b"{}"):
    """A log of another kind."""
    writer = Writer(str(path), compression=CompressionType.ZSTD)
    writer.start()
    schema = writer.register_schema("x", "jsonschema", b"{}")
    writer.add_message(writer.register_channel("ticks", "json", schema, units), 0, data, 0)
    writer.finish()


def test_other_files_than_tick_logs_are_refused(tmp_path):
    (tmp_path / "text").write_text("time,x\n0,1\n", encoding="utf-8")
    (tmp_path / "empty").touch()
    os.mkfifo(tmp_path / "pipe")
    foreign_log(tmp_path / "json", {})
    foreign_log(tmp_path / "pretender", {"names": "time,x", "units": "s,m"})
    refusals = {
        "text": "this is not an MCAP file",
        "empty": "this is not an MCAP file",
        "pipe": "this is not a file",
        ".": "this is not a file",
        "missing": "No such file or directory",
        "json": "it has no description of ticks",
        "pretender": "it has no description of ticks",
    }
    for name, refusal in refusals.items():
        for use in (read_ticks, lambda path: recover_ticks(path, tmp_path / "out")):
            with pytest.raises(TickLogError, match=refusal):
                use(tmp_path / name)
    assert not (tmp_path / "out").exists()
