"""Torque after a signal to one of the two processes of a run, on the wall clock.

The emulated ring records when its drives give torque; their watchdog is 50 ms. Each signal is sent while the robot
hops. A stopped learning process is continued after some seconds, so that it can end.

    ./go python benchmarks/signals_to_a_run.py --times 3
"""

import argparse
import os
import select
import signal
import tempfile
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import partial
from math import inf
from multiprocessing import RawArray, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from statistics import median
from time import monotonic, sleep

import numpy as np

from stepgap.base.signals import terminated_as_interrupted
from stepgap.hardware.ethercat.emulator.emulator import run_emulator
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.ethercat.rig_settings import BusSettings
from stepgap.hardware.hopper.ethercat import hopper_on_ethercat
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.hardware.hopper.twin_machine import TwinMachine
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.realtime_plant import RealtimePlant
from stepgap.rigs.rig import RigFault, Torques
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.tick.sensors import HopperReading
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
LOOP = LoopSettings(release_time=inf)
"""Nobody holds a key in this benchmark."""
RING = RingSettings(lock_step=False)
COMMAND = np.array([-5.0, -8.0])
SIGNALS = signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGSTOP, signal.SIGKILL
ATTEMPTS = 5
SHARED = Path("/dev/shm")
CONTINUE_AFTER = 10.0
"""Time after which a stopped learning process is continued [s]."""


class ObservedTwin(TwinMachine):
    """The twin behind the ring; it reports every tick with torque."""

    def __init__(self, on_torque: Callable[[], None]):
        super().__init__(Twin(ROBOT, RealityGap(), np.random.default_rng(0), hold=3.0))
        self._on_torque = on_torque

    def tick(self, torques: Torques) -> HopperReading:
        if any(torques):
            self._on_torque()
        return super().tick(torques)


def serve(interface: str, last, pipe: Connection) -> None:
    def record_time() -> None:
        last[0] = monotonic()

    run_emulator(interface, ObservedTwin(record_time), RING, lambda _: pipe.send("ready"), pipe)


def hop(settings: BusSettings, folder: Path, pipe: Connection) -> None:
    """Hops until the run ends; sends the id of the real-time process when the robot hops."""
    setup = RealtimeSetup(partial(hopper_on_ethercat, settings, ROBOT), HopperControl(ROBOT, GAINS, BOUNDS), LOOP)
    with (
        suppress(KeyboardInterrupt, RigFault),
        terminated_as_interrupted(),
        RealtimePlant(setup, folder, lambda board: nullcontext()) as plant,
    ):
        plant.start()
        assert plant._session is not None
        plant.take_step(COMMAND)
        pipe.send(plant._session.process_id)
        while np.isfinite(plant.take_step(COMMAND).next_state).all():
            pass


def signalled(interface: str, number: signal.Signals, to_learning: bool) -> tuple[float, float, int]:
    """Times from the signal to the last torque and to the end of the run [s], and what is left in shared memory."""
    context, before = get_context("spawn"), set(SHARED.iterdir())
    here, there = context.Pipe()
    last = RawArray("d", 1)
    ring = context.Process(target=serve, args=(interface, last, there), daemon=True)
    ring.start()
    here.recv()
    sensors = Twin(ROBOT, RealityGap(), np.random.default_rng(0)).sensor_model
    settings = replace(emulated_settings(sensors, ROBOT, RING, interface), watchdog=0.05)
    ours, theirs = context.Pipe()
    with tempfile.TemporaryDirectory() as folder:
        learning = context.Process(target=hop, args=(settings, Path(folder), theirs))
        learning.start()
        theirs.close()
        realtime = ours.recv()
        process = os.pidfd_open(realtime)
        sleep(np.random.default_rng(number).uniform(0, 0.5))
        sent = monotonic()
        os.kill((learning.pid if to_learning else realtime) or 0, number)
        if to_learning and number == signal.SIGSTOP:
            sleep(CONTINUE_AFTER)
            os.kill(learning.pid or 0, signal.SIGCONT)
        learning.join()
        select.select([process], [], [])  # a killed learning process leaves the other one, which lands the robot
        ended = monotonic()
        os.close(process)
        sleep(0.5)
    here.close()
    ring.join()
    return last[0] - sent, ended - sent, len(set(SHARED.iterdir()) - before)


def when_it_hopped(interface: str, number: signal.Signals, to_learning: bool) -> tuple[float, float, int]:
    """`signalled`, again if the run ended before the signal, as by lost frames on a busy computer."""
    for _ in range(ATTEMPTS):
        with suppress(EOFError, ProcessLookupError):
            return signalled(interface, number, to_learning)
    raise SystemExit("no run lasts until the signal; this computer is too busy")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=3)
    times = parser.parse_args().times
    for to_learning in (True, False):
        for number in SIGNALS:
            found = [when_it_hopped(f"sgs{os.getpid()}", number, to_learning) for _ in range(times)]
            torque, end, left = zip(*found, strict=True)
            print(
                f"{number.name} to the {'learning' if to_learning else 'real-time'} process: torque for "
                f"{median(torque):.3f} s (longest {max(torque):.3f}), end after {max(end):.1f} s, "
                f"left in shared memory {max(left)}",
                flush=True,
            )


if __name__ == "__main__":
    main()
