"""A pace for a real-time process in lock-step with its ring; it imports little, since such a process imports it."""

import os
from multiprocessing import parent_process
from time import monotonic, sleep

LONGEST_PAUSE = 1.0
"""Longest time that the pace waits for the learning process [s], which a test may have stopped or killed."""


def patient():
    """A pace that waits while the learning process wants to run: on a busy machine the robot would hop without it.

    Without commands it falls after some hops.
    """
    learning, now = parent_process(), 0.0  # also that of a copy of a fork server
    assert learning is not None
    status = os.open(f"/proc/{learning.pid}/stat", os.O_RDONLY)

    def pace(due):
        nonlocal now
        now = max(now, due)
        sleep(1e-4)
        begin = monotonic()
        while is_runnable(status) and monotonic() - begin < LONGEST_PAUSE:
            sleep(1e-4)
        return now

    return pace


def is_runnable(status):
    """Whether a process runs or waits for a processor; not if it sleeps, or has ended."""
    try:
        return os.pread(status, 1000, 0).rpartition(b")")[2].split()[0] == b"R"
    except OSError:
        return False
