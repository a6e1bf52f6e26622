"""The page of a run in progress: it runs in another process, for which the run never waits."""

import subprocess
import sys
from pathlib import Path
from typing import Self

from stepgap.experiment.loop import Observer
from stepgap.experiment.tick_recorder import HopCount
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.ticks.tick_ring import TickRing
from stepgap.robots.hopper.tick import TICK_UNITS
from stepgap.view.motion import TICK_STRIDE

ROWS = 2**16
"""Number of ticks that the ring keeps for the page: nine minutes of hopping."""


class LiveView:
    """A page that shows a run from a separate process.

    The run writes some of its ticks into shared memory, without waiting; the page reads steps and models from the run
    folder. If the page fails, the run continues.

    Args:
        folder: Folder of the run, which contains the settings when the context is entered.
        host: Host name or address at which the page is served.
        port: Port of the page; None for the first free one.
    """

    def __init__(self, folder: Path, host: str, port: int | None):
        self._folder, self._host, self._port = folder, host, port
        self._hops, self._count = HopCount(), 0

    def on_ticks(self, rows: Rows) -> None:
        """Passes every `TICK_STRIDE`-th tick to the page."""
        hops = self._hops.on_ticks(rows)
        for i in range(-self._count % TICK_STRIDE, len(rows), TICK_STRIDE):
            self._ring.push((self._hops.iteration, hops[i], *rows[i]))
        self._count += len(rows)

    def observing(self, observer: Observer) -> Observer:
        """Observer that also counts steps and deployments for the ticks."""
        return self._hops.observing(observer)

    def stay(self) -> None:
        """Waits, at the end of the run, until the page is ended."""
        self._process.wait()

    def __enter__(self) -> Self:
        self._ring = TickRing.create(2 + len(TICK_UNITS), ROWS)
        program = "import sys; from stepgap.cli.app import main; main(sys.argv[1:])"
        options = ["--host", self._host, *(["--port", str(self._port)] if self._port else [])]
        self._process = subprocess.Popen(
            [sys.executable, "-c", program, "view", str(self._folder), "--ring", self._ring.name, *options],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C reaches only the run, which ends the page
        )
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._process.terminate()
        self._process.wait()
        self._ring.__exit__()
