"""The ring compared with a list, with a writer that overtakes the reader, and with a writer that is killed."""

import signal
import struct
import subprocess
import sys
from multiprocessing.shared_memory import SharedMemory
from time import sleep

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.plants.ticks.tick_ring import TickRing

WRITER = """
import sys
from itertools import count
from stepgap.plants.ticks.tick_ring import TickRing

ring = TickRing.attach(sys.argv[1])
for number in count():
    ring.push([number] * ring.fields)
"""
READER = """
import sys
from stepgap.plants.ticks.tick_ring import TickRing

with TickRing.attach(sys.argv[1]) as ring:
    print(len(ring.drain()), ring.lost)
"""


def numbered(first, last, fields=2):
    """Rows whose fields are all the number of the row."""
    return np.repeat(np.arange(first, last, dtype=float)[:, None], fields, axis=1)


def push(ring, first, last):
    for row in numbered(first, last, ring.fields).tolist():
        ring.push(row)


@given(rows=st.integers(1, 7), steps=st.lists(st.integers(0, 20)))
def test_rows_arrive_in_order_and_lost_ones_are_counted(rows, steps):
    with TickRing.create(2, rows) as writer, TickRing.attach(writer.name) as reader:
        pushed = lost = 0
        for step in steps:
            push(writer, pushed, pushed + step)
            pushed += step
            kept = min(step, rows)
            lost += step - kept
            np.testing.assert_array_equal(reader.drain(), numbered(pushed - kept, pushed))
            assert reader.lost == lost
        assert reader.drain().shape == (0, 2)


class Overtaking:
    """A writer that writes while the reader copies: the copy may have old and new parts."""

    def __init__(self, reader, writer, first, steps):
        self.reader, self.writer, self.first, self.steps = reader, writer, first, steps
        self.slots, reader._slots = reader._slots, self

    def stop(self):
        """Restores the reader's slots; returns the number of rows pushed so far."""
        self.reader._slots = self.__dict__.pop("slots")
        return self.first

    def __getitem__(self, index):
        copied = []
        for slot in index:
            step = next(self.steps, 0)
            push(self.writer, self.first, self.first + step)
            self.first += step
            copied.append(self.slots[slot].copy())
        return np.array(copied).reshape(-1, self.slots.shape[1])


@given(rows=st.integers(1, 7), before=st.integers(0, 12), steps=st.lists(st.integers(0, 4), max_size=7))
def test_rows_overwritten_while_they_are_copied_are_dropped_and_counted(rows, before, steps):
    with TickRing.create(2, rows) as writer, TickRing.attach(writer.name) as reader:
        push(writer, 0, before)
        overtaking = Overtaking(reader, writer, before, iter(steps))
        during = reader.drain()
        pushed = overtaking.stop()
        first = max(0, min(before, pushed - rows))
        np.testing.assert_array_equal(during, numbered(first, before))
        assert reader.lost == first
        after = reader.drain()
        np.testing.assert_array_equal(after, numbered(max(before, pushed - rows), pushed))
        assert reader.lost + len(during) + len(after) == pushed


def test_an_incomplete_row_of_a_dead_writer_is_never_read():
    with TickRing.create(3, 2) as writer, TickRing.attach(writer.name) as reader:
        push(writer, 0, 5)
        with pytest.raises(struct.error):
            writer.push([9.0, 9.0, None])  # type: ignore[list-item]
        np.testing.assert_array_equal(reader.drain(), numbered(3, 5, 3))
        with TickRing.attach(writer.name) as heir:
            push(heir, 5, 6)
        np.testing.assert_array_equal(reader.drain(), numbered(5, 6, 3))


@pytest.mark.parametrize("row", [[1.0], [1.0, 2.0, 3.0]])
def test_a_row_of_another_length_is_refused(row):
    with TickRing.create(2, 4) as ring:
        with pytest.raises(struct.error):
            ring.push(row)
        assert not len(ring.drain())


@pytest.mark.parametrize("ticks", [1, 500, 20_000])
def test_a_writer_killed_at_any_time_leaves_complete_rows_only(ticks):
    with TickRing.create(20, 1000) as ring:
        writer = subprocess.Popen([sys.executable, "-c", WRITER, ring.name])
        drained, count = [], 0
        while count < ticks and writer.poll() is None:
            drained.append(ring.drain())
            count += len(drained[-1])
            sleep(1e-4)
        writer.kill()
        assert writer.wait() == -signal.SIGKILL
        drained.append(ring.drain())
        rows = np.concatenate(drained)
        assert (rows == rows[:, :1]).all()
        assert (np.diff(rows[:, 0]) > 0).all()
        assert ring.lost + len(rows) == rows[-1, 0] + 1


def test_a_reader_that_ends_affects_neither_the_writer_nor_the_next_reader():
    with TickRing.create(2, 10) as ring:
        for pushed, answer in ((4, "4 0"), (14, "10 4")):
            push(ring, 4 if pushed > 4 else 0, pushed)
            reader = subprocess.run([sys.executable, "-c", READER, ring.name], capture_output=True, text=True)
            assert (reader.stdout.strip(), reader.stderr) == (answer, "")


def test_the_memory_is_freed_by_its_creator():
    with TickRing.create(2, 10) as ring:
        name = ring.name
    with pytest.raises(FileNotFoundError):
        TickRing.attach(name)


def test_only_a_ring_can_be_attached():
    memory = SharedMemory(create=True, size=4096)
    try:
        with pytest.raises(ValueError, match="is not a tick ring"):
            TickRing.attach(memory.name)
    finally:
        memory.close()
        memory.unlink()


@pytest.mark.parametrize(("fields", "rows"), [(0, 1), (1, 0), (-1, 5)])
def test_a_ring_has_rows_of_numbers(fields, rows):
    with pytest.raises(ValueError, match="must be 1 or more"):
        TickRing.create(fields, rows)
