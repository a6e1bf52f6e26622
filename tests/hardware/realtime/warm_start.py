"""Real-time processes that start within milliseconds, for tests whose subject is not how they start."""

import os
from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from typing import Any

import pytest

from stepgap.hardware.realtime import pace
from stepgap.hardware.realtime.process import RealtimeSetup, run_realtime


class WarmContext:
    """Makes real-time processes as copies of the fork server of tests, which has imported the package already."""

    def Process(self, target: Callable[..., None], args: tuple[Any, ...], daemon: bool) -> BaseProcess:
        assert target is run_realtime
        return get_context("forkserver").Process(target=_run_beside_server, args=args[:-1], daemon=daemon)


def _run_beside_server(setup: RealtimeSetup, board_name: str, ring_name: str) -> None:
    """Runs a real-time process whose parent is the fork server, and whose memory is not locked.

    Locked, a copy would copy all that it shares with the server.
    """
    pace._lock_memory = str
    run_realtime(setup, board_name, ring_name, os.getppid())


def start_realtime_from_warm_server(patch: pytest.MonkeyPatch) -> None:
    """Sessions start their real-time processes so, which would not notice the death of this process."""
    patch.setattr("stepgap.hardware.realtime.session.get_context", lambda _: WarmContext())
