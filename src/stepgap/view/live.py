"""The page of a run in progress: it runs in another process, for which the run never waits."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Self

from stepgap.experiment.displays import LivePage
from stepgap.experiment.loop import Observer
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.ticks.stream import thinned
from stepgap.plants.ticks.tick_ring import TickRing
from stepgap.records.summary import Deployment
from stepgap.robots.scene import Kinematics
from stepgap.view.address import HERE, free_port

VIEW_INTERVAL = 0.008  # Time between two drawn ticks [s]
ROWS = 2**16  # Number of ticks that the ring keeps for the page: nine minutes of motion
_LONGEST_END = 10.0  # Time after which a page that does not end by itself is killed [s]


class LiveView(LivePage):
    """A page that shows a run from a separate process.

    The run writes some of its ticks into shared memory, without waiting; the page reads steps and models from the run
    folder. If the page fails, the run continues.

    Args:
        folder: Folder of the run, which contains the settings when the context is entered.
        host: Host name or address at which the page is served; None for this machine alone.
        port: Port of the page; None for the first free one.
        kinematics: Kinematics of the robot, whose ticks are shown; None if it has no ticks.

    Raises:
        InputError: The page cannot be served there.
    """

    def __init__(self, folder: Path, host: str | None, port: int | None, kinematics: Kinematics | None):
        self._folder = folder
        self._host = host or HERE
        self._port = port
        free_port(self._host, port)
        self._fields = len(kinematics.units) if kinematics else 0
        self._iteration = 0
        self._push_some = thinned(self._push, kinematics.every(VIEW_INTERVAL) if kinematics else 1)

    def on_ticks(self, rows: Rows, step: int) -> None:
        """Passes some of the ticks to the page."""
        self._push_some(rows, step)

    def observing(self, observer: Observer) -> Observer:
        """Observer that also counts deployments for the ticks."""

        def on_deployment(deployment: Deployment) -> None:
            observer.on_deployment(deployment)
            self._iteration = deployment.iteration + 1

        return replace(observer, on_deployment=on_deployment)

    def stay(self) -> None:
        """Waits, at the end of the run, until the page is ended."""
        self._process.wait()

    def __enter__(self) -> Self:
        self._ring = TickRing.create(2 + self._fields, ROWS)
        program = "import sys; from stepgap.cli.app import main; main(sys.argv[1:])"
        options = ["--host", self._host, *(["--port", str(self._port)] if self._port else [])]
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", program, "view", str(self._folder), "--ring", self._ring.name, *options],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C reaches only the run, which ends the page
        )
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._process.terminate()
        try:
            self._process.wait(_LONGEST_END)
        except subprocess.TimeoutExpired:  # the signal came during a callback, which swallowed it
            self._process.kill()
            self._process.wait()
        self._ring.__exit__()

    def _push(self, rows: Rows, step: int) -> None:
        for row in rows:
            self._ring.push((self._iteration, step, *row))
