"""Time for which torque lasts after the real-time process was killed with SIGKILL, on the wall clock.

The emulated ring records when its drives give torque; its watchdog is 50 ms. Several kills, each while the robot hops.

    ./go python benchmarks/killed_process.py --kills 5
"""

import argparse
import os
import signal
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from multiprocessing import RawArray, get_context
from pathlib import Path
from time import monotonic, sleep

import numpy as np

from stepgap.plants.realtime.process import RealtimeSetup
from stepgap.plants.realtime.realtime_plant import RealtimePlant
from stepgap.rigs.ethercat.emulator.emulator import run_emulator
from stepgap.rigs.ethercat.emulator.ring_settings import RingSettings
from stepgap.rigs.rig import Torques
from stepgap.robots.hopper.ethercat import hopper_on_ethercat
from stepgap.robots.hopper.hop_control import HopperControl
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.ring_rig import emulated_settings
from stepgap.robots.hopper.sensors import HopperReading
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin_machine import TwinMachine

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
RING = RingSettings(lock_step=False)
COMMAND = np.array([-5.0, -8.0])


class ObservedTwin(TwinMachine):
    """The twin behind the ring; it reports every tick with torque."""

    def __init__(self, on_torque: Callable[[], None]):
        super().__init__(Twin(ROBOT, RealityGap(), np.random.default_rng(0), hold=3.0))
        self._on_torque = on_torque

    def tick(self, torques: Torques) -> HopperReading:
        if any(torques):
            self._on_torque()
        return super().tick(torques)


def serve(interface: str, last, pipe) -> None:
    def record_time() -> None:
        last[0] = monotonic()

    run_emulator(interface, ObservedTwin(record_time), RING, lambda _: pipe.send("ready"), pipe)


def kill_once(interface: str, folder: Path) -> float:
    """Time from the kill to the last torque [s]."""
    context = get_context("spawn")
    here, there = context.Pipe()
    last = RawArray("d", 1)
    ring = context.Process(target=serve, args=(interface, last, there), daemon=True)
    ring.start()
    here.recv()
    sensors = Twin(ROBOT, RealityGap(), np.random.default_rng(0)).sensor_model
    settings = replace(emulated_settings(sensors, ROBOT, RING, interface), watchdog=0.05)
    with RealtimePlant(
        RealtimeSetup(partial(hopper_on_ethercat, settings, ROBOT), HopperControl(ROBOT, GAINS, BOUNDS)), folder
    ) as plant:
        plant.start()
        plant.take_step(COMMAND)
        assert plant._session is not None
        killed = monotonic()
        os.kill(plant._session.process_id, signal.SIGKILL)
        sleep(0.5)
        lasted = last[0] - killed
    here.close()
    ring.join()
    return lasted


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=5)
    with tempfile.TemporaryDirectory() as folder:
        for number in range(parser.parse_args().kills):
            print(f"kill {number + 1}: torque for {1000 * kill_once(f'sgk{os.getpid()}', Path(folder)):.1f} ms more")


if __name__ == "__main__":
    main()
