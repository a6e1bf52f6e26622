"""Time from touchdown to the new command in the real-time process, beside the window until mid-stance.

The twin hops on stairs of 56 mm behind the emulated ring, whose ticks take 1 ms of the wall clock each. It knows 227
hops on flat ground. A time begins with the tick of the touchdown, by its row in the log, and ends when the new command
is posted, so it contains the look for the touchdown and a plan of all rules. A plan was too late if the command that
was planned at the apex acted.

    ./go python -m benchmarks.touchdown_times [--hops 600]

It needs root, for the ring. If other programs use the cores, start it with `chrt -f 10`, below the real-time process.
"""

import argparse
import os
import sys
from contextlib import closing, nullcontext
from functools import partial
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import own_priors
from benchmarks.uneven_ground import GROUNDS, Blind, hops_of, random_reference
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.experiment.deployment import deploy
from stepgap.hardware.ethercat.emulator.emulator import emulated
from stepgap.hardware.hopper.ethercat import hopper_on_ethercat
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.hardware.hopper.ring_simulation import RING
from stepgap.hardware.hopper.twin_machine import TwinMachine
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.hardware.realtime.pace import WallClock
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.realtime_plant import RealtimePlant
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.plant import AtTouchdown, Plant, Touchdown
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import read_ticks
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model
from stepgap.step import Array, StepMap, StepRecord, StepStatus

SEED, HOLD = 1, 3.0
"""Seed of the ground, and time for which the twin is held [s]."""

SHARES = (0.5, 0.99, 0.999, 1.0)


class Timed(Blind):
    """A plant that writes down when the new command of each step was known, and counts those that did not act."""

    def __init__(self, plant: Plant):
        super().__init__(plant)
        self.posted: list[float] = []
        self.late = 0

    def take_replanned_step(self, command: Array, at_touchdown: AtTouchdown) -> StepRecord:
        """A step of the plant."""
        given = [command]

        def choose(found: Touchdown) -> Array:
            given.append(at_touchdown(found))
            self.posted.append(perf_counter())
            return given[-1]

        record = self._plant.take_replanned_step(command, choose)
        self.late += record.status == StepStatus.OK and not np.array_equal(record.command, given[-1])
        return record


def machine(robot: Hopper, number: int) -> TwinMachine:
    """The twin on its ground in a deployment; called in the ring's process."""
    ground = GroundProfile(robot.gap, robot.parameters.boom_length, random_stream(SEED, 9), robot.ground)
    place = {"hold": HOLD, "ground": ground, "floor_yaw": float(number)}
    return TwinMachine(Twin(robot.parameters, robot.gap, random_stream(SEED, number), **place))


def clock(start: Path) -> WallClock:
    """The clock of the real-time process, whose start it writes into a file [s]."""
    start.write_text(repr(perf_counter()))
    return WallClock()


def known_hops(nominal: StepMap) -> Steps:
    """Hops on flat ground."""
    flat, none = Hopper(ground=GROUNDS["flat"]), LearningSettings(residual="none")
    plant = flat.simulations()["twin"](random_stream(SEED, 9)).plant(random_stream(SEED, 0))
    return hops_of(Learner.start(nominal, Steps(nominal.space), none, 0), plant, paper_reference(), 0)[0]


def phase_starts(ticks: TickTable, phase: Phase) -> Array:
    """Times at which a phase of a hop begins [s]."""
    phases = np.where(ticks["state"] == RigState.STEP, ticks["phase"], np.nan)
    return ticks["time"][1:][(phases[1:] == phase) & (phases[:-1] != phase) & np.isfinite(phases[:-1])]


class Found(NamedTuple):
    """Times [s] of the new commands of a deployment, and why it ended.

    Attributes:
        after: From the touchdown to the new command; shape (N,).
        window: From the touchdown to mid-stance; shape (N,).
        late: Number of commands that came too late.
        fault: Why the deployment ended early; empty if it did not.
    """

    after: Array
    window: Array
    late: int
    fault: str


def measured(hops: int, learner: Learner, folder: Path, number: int) -> Found:
    """A deployment of some hops, on a place of its own of the ground."""
    robot, interface = Hopper(ground=GROUNDS["stairs_56"]), f"sgt{os.getpid()}"
    sensors = twin_sensor_model(robot.parameters, robot.gap)
    settings = emulated_settings(sensors, robot.parameters, RING, interface, robot.ground)
    rig = partial(hopper_on_ethercat, settings, robot.parameters)
    loop = LoopSettings(release_time=inf)  # nobody holds a key here
    setup = RealtimeSetup(rig, robot.control(), loop, partial(clock, folder / "start"))
    with emulated(interface, partial(machine, robot, number), RING):
        realtime = RealtimePlant(setup, folder, lambda board: nullcontext())
        plant = Timed(realtime)
        with closing(deploy(learner, plant, random_reference(number, hops).of(plant.space), 1)) as steps:
            for logged in steps:
                print(f"\r{logged.step} of {hops} hops", end="", file=sys.stderr, flush=True)
    ticks = TickTable(*read_ticks(folder / f"ticks-{number}.mcap"))
    posted = np.array(plant.posted) - float((folder / "start").read_text())
    landed, middle = phase_starts(ticks, Phase.COMPRESSION), phase_starts(ticks, Phase.THRUST)
    before = landed[np.searchsorted(landed, posted) - 1]
    after = np.append(middle, np.nan)[np.searchsorted(middle, before)]  # a robot that was stopped has none
    return Found(posted - before, after - before, plant.late, realtime.fault)


def main() -> None:
    """Prints quantiles of the times; a deployment that ends early is followed by another one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hops", type=int, default=600)
    options = parser.parse_args()
    robot, found = Hopper(ground=GROUNDS["stairs_56"]), list[Found]()
    nominal = robot.apex_map()
    with one_blas_thread(), TemporaryDirectory() as folder:
        learner = Learner.start(nominal, known_hops(nominal), LearningSettings(), 1, own_priors(robot))
        while (left := options.hops - sum(len(each.after) for each in found)) > 0:
            found.append(measured(left, learner, Path(folder), len(found)))
            print(f"\n{len(found[-1].after)} hops; {found[-1].fault or 'no fault'}", file=sys.stderr)
    times, windows = (np.concatenate([each[column] for each in found]) for column in range(2))
    shares = ", ".join(f"{1e3 * value:.1f}" for value in np.quantile(times, SHARES))
    late = sum(each.late for each in found)
    print(f"{len(times)} commands: p50, p99, p99.9, most: {shares} ms after touchdown; {late} came too late")
    print(f"mid-stance: {1e3 * np.nanmin(windows):.0f} to {1e3 * np.nanmax(windows):.0f} ms after touchdown")


if __name__ == "__main__":  # the real-time process imports this file
    main()
