"""What `stepgap run` hops: the twin, the twin behind an emulated EtherCAT ring, or a rig by name."""

import os
import sys
from collections.abc import Callable
from functools import partial
from math import tau
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.loop import MeasureNoiseFloor, deployment_generator
from stepgap.experiment.noise_floor import measure_noise_floor
from stepgap.experiment.settings import EMULATED_RING, TWIN, Experiment
from stepgap.plants.commissioning.check import checked
from stepgap.plants.plant import Plant
from stepgap.plants.realtime.process import RealtimeSetup
from stepgap.plants.realtime.realtime_plant import RealtimePlant
from stepgap.plants.rig_plant import RigPlant
from stepgap.rigs.entry_points import load_rig, rig_names
from stepgap.rigs.ethercat.emulator.ring_settings import RingSettings
from stepgap.rigs.rig import Rig, RigFault
from stepgap.robots.hopper.direct_ring import DirectRing
from stepgap.robots.hopper.ethercat import RigSettings
from stepgap.robots.hopper.hop_control import HopperControl
from stepgap.robots.hopper.ring_rig import RingRig, emulated_settings
from stepgap.robots.hopper.tick import Tick
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin_machine import TwinMachine
from stepgap.step import Array, StepMap

SIMULATED = (TWIN, EMULATED_RING)
"""Plants of which a deployment can be made again."""

RING = RingSettings(inputs_after_tick=True)
"""How the ring of a run passes frames."""


class Plants(NamedTuple):
    """How a run gets its plants.

    Attributes:
        make: Makes the plant of one deployment from its random generator.
        replays: The same generator gives the same steps again.
        measure_noise_floor: Measures the noise floor, where that can be done.
    """

    make: Callable[[np.random.Generator], Plant]
    replays: bool
    measure_noise_floor: MeasureNoiseFloor | None = None


def choose_plants(
    settings: Experiment,
    reference: Reference,
    arm: bool,
    folder: Path,
    on_tick: Callable[[Tick], None] | None = None,
) -> Plants:
    """The plants of an experiment.

    Args:
        settings: Which plant, and all that describes it.
        reference: What will be tracked.
        arm: A person wants a rig to have torque.
        folder: Of the run; a rig's ticks go there.
        on_tick: Called with every tick of a simulation.

    Raises:
        InputError: They cannot be had with these settings.
    """
    simulated = settings.plant in SIMULATED
    if simulated and (arm or settings.rig):
        raise InputError(f"--arm, --rig: for rigs that can break things; plant '{settings.plant}' takes neither")
    if not simulated:
        return _of_rig(settings, arm, folder / "ticks")
    make_twin = partial(_twin, settings, _ground(settings))
    twin = make_twin(np.random.default_rng(0))

    def measure(step_map: StepMap, rng: np.random.Generator) -> Array:
        twin = make_twin(rng)
        return measure_noise_floor(plant_on(settings, twin), twin, step_map, reference, rng)

    if settings.plant == TWIN:
        return Plants(lambda rng: plant_on(settings, make_twin(rng), on_tick), True, measure)
    bus = _bus(settings, twin)

    def make_on_ring(rng: np.random.Generator) -> Plant:
        return plant_on(settings, RingRig(partial(_machine, settings, rng), RING, bus, settings.robot), on_tick)

    return Plants(make_on_ring, True, measure)


def remade_rig(settings: Experiment, iteration: int) -> tuple[Rig, Twin]:
    """What the plant of a recorded deployment hopped, as it was before the first hop, and the twin in it.

    It does what it did in the run, tick by tick; an emulated ring is left out, and none of its faults is known.

    Raises:
        InputError: It was no simulation, or the settings make no twin.
    """
    if settings.plant not in SIMULATED:
        raise InputError(f"plant '{settings.plant}': what a rig did cannot be made again; its own ticks are in ticks/")
    twin = _twin(settings, _ground(settings), deployment_generator(settings.seed, iteration))
    rig = twin if settings.plant == TWIN else DirectRing(twin, RING, _bus(settings, twin))
    return rig, twin


def _ground(settings: Experiment) -> GroundProfile:
    return GroundProfile(settings.gap, settings.robot.boom_length, random_stream(settings.seed))


def _twin(settings: Experiment, ground: GroundProfile, rng: np.random.Generator) -> Twin:
    floor_yaw = rng.uniform(0, tau)  # or every deployment would meet every target at the same yaw, and learn that
    try:
        return Twin(settings.robot, settings.gap, rng, ground=ground, floor_yaw=floor_yaw)
    except ValueError as error:
        raise InputError(f"the settings [robot] and [gap] make no twin: {error}") from None


def plant_on(settings: Experiment, rig: Rig, on_tick: Callable[[Tick], None] | None = None) -> RigPlant:
    """What hops a simulated rig."""
    return RigPlant(rig, HopperControl(settings.robot, settings.gains, settings.command), on_tick)


def _machine(settings: Experiment, rng: np.random.Generator) -> TwinMachine:
    """What an emulated ring's drives move; called in the ring's process."""
    return TwinMachine(_twin(settings, _ground(settings), rng))


def _bus(settings: Experiment, twin: Twin) -> RigSettings:
    """What the master of an emulated ring is told of it."""
    for name in ("motor_counts", "boom_counts_horizontal", "boom_counts_vertical"):
        if not np.isfinite(getattr(settings.gap, name)):
            raise InputError(f"gap.{name} must be finite: a ring carries whole counts, such as {name} = 16384")
    return emulated_settings(twin.sensor_model, settings.robot, RING, f"sg{os.getpid()}")  # runs may go on side by side


def _of_rig(settings: Experiment, arm: bool, logs: Path) -> Plants:
    if not settings.rig:
        plants = (*SIMULATED, *rig_names())
        if settings.plant not in plants:
            raise InputError(f"--plant {settings.plant}: unknown; it must be one of {', '.join(plants)}")
        raise InputError(f"--plant {settings.plant}: say which robot by --rig RIG.toml")
    make_rig = partial(load_rig, settings.plant, Path(settings.rig), settings.robot)
    make_rig()  # whatever is wrong with it is said before the first deployment
    if not arm:
        raise InputError(
            f"--plant {settings.plant}: gives torque only with --arm; `stepgap rig dry-run` does everything but torque"
        )
    setup = RealtimeSetup(make_rig, HopperControl(settings.robot, settings.gains, settings.command))

    def make(_: np.random.Generator) -> Plant:
        checked(Path(settings.rig))  # before each: every deployment reads the file anew
        return RealtimePlant(setup, logs, ask_to_hold)

    checked(Path(settings.rig))
    return Plants(make, replays=False)


def ask_to_hold() -> None:
    """Waits until a person holds the robot.

    Raises:
        RigFault: Nobody answers.
    """
    if sys.stdin.isatty():
        import termios  # a terminal's; Windows has none

        termios.tcflush(sys.stdin, termios.TCIFLUSH)  # what was typed before is no answer
    print(
        "Hold the robot up, its foot clear of the ground, and press Enter: it takes its landing posture within half a "
        "second. Then let it go. Ctrl-C lands it.",
        file=sys.stderr,
    )
    if not sys.stdin.readline():
        raise RigFault("nobody pressed Enter, so there was no torque")
