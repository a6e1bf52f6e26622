"""The verbs of `stepgap rig`: from an emulated ring to a real robot that is ready to hop."""

import shlex
import sys
from math import isfinite
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from stepgap.base.settings_file import InputError
from stepgap.cli.app import DEBUG_HELP, Overrides, Program, says_if_it_compiles

ETHERCAT = "ethercat"
"""Name of the rig that `rig.toml` describes."""

LONGEST = 86_400.0
"""Of what is measured or shown [s]."""

rig = App(name="rig", help="Bring up a robot, on EtherCAT or by the name of its rig, or try without one.")


@rig.command(help_epilogue=DEBUG_HELP)
def check(rig_file: Path | None = None, /, *, plant: str | None = None, seconds: float = 10.0) -> None:
    """Measure how late this machine is and how well the bus works, no torque given; exit code 1 if it is not fit.

    Args:
        rig_file: rig.toml of the robot, and the result is written beside it; without it only the machine is measured.
        plant: Name of its rig; without it ethercat.
        seconds: How long; without it 10.
    """
    from functools import partial

    from stepgap.plants.commissioning.check import describe, fingerprint, measure, write_check
    from stepgap.plants.commissioning.limp import limp_setup
    from stepgap.plants.realtime.process import RealtimeSetup
    from stepgap.rigs.entry_points import load_rig
    from stepgap.rigs.limp_rig import FrameCount
    from stepgap.robots.hopper.hop_control import HopperControl
    from stepgap.robots.hopper.limits import SafetyLimits
    from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
    from stepgap.robots.hopper.still import still_hopper

    _check_seconds(seconds)
    if plant and rig_file is None:
        raise InputError(f"--plant {plant}: goes with RIG_FILE, the file that describes the rig")
    frames, robot = FrameCount(), RobotParameters()
    control = HopperControl(robot, Gains(), CommandBounds())
    if rig_file is None:
        print("no rig.toml given: this is the machine alone, with sensor values that never change")
        result = measure(
            RealtimeSetup(partial(still_hopper, 1e-3), control),
            frames,
            1e-3,
            SafetyLimits.of(robot).late_ticks,
            seconds,
        )
        print(describe(result, bus=False))
    else:
        mark, make_rig = fingerprint(rig_file), partial(load_rig, plant or ETHERCAT, rig_file, robot)
        found, setup = make_rig(), limp_setup(make_rig, control, frames)
        late_ticks = (found.limits or SafetyLimits.of(robot)).late_ticks
        result = measure(setup, frames, found.sensor_model.tick, late_ticks, seconds)
        file = write_check(rig_file, mark, result)
        print(describe(result, bus=True))
        print(file)
    if result.failures():
        sys.exit(1)


@rig.command
@says_if_it_compiles
def calibrate(
    rig_file: Path,
    /,
    *,
    alpha_1: float = 0.0,
    leg_length: float | None = None,
    height: float | None = None,
    out: Path | None = None,
    experiment: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Find the zeros of all sensors on EtherCAT: the limp robot in a known pose, boom at yaw zero, foot without load.

    Args:
        rig_file: rig.toml of the bus.
        alpha_1: Lean of the leg in the pose, forward positive [rad]; without it 0, straight down.
        leg_length: Of the leg in the pose, from the hip to the joint of the bottom links [m], as a jig sets it.
        height: Of the hip above the ground in the pose [m].
        out: File for the settings with the new zeros; without it RIG.calibrated.toml.
        experiment: TOML file of settings, whose [robot] it is.
    """
    from functools import partial

    from stepgap.experiment.settings import read_experiment
    from stepgap.plants.commissioning.limp import limp_setup, ticks_of
    from stepgap.rigs.limp_rig import FrameCount
    from stepgap.robots.hopper import calibrate as verb
    from stepgap.robots.hopper.ethercat import hopper_on_ethercat, read_rig_settings
    from stepgap.robots.hopper.hop_control import HopperControl

    if leg_length is None or height is None:
        raise InputError("--leg-length and --height: give both, as measured; nothing else would be right")
    pose, target = verb.Pose(alpha_1, leg_length, height), out or rig_file.with_suffix(".calibrated.toml")
    verb.check_pose(pose)
    given, settings = read_experiment(experiment, overrides or []), read_rig_settings(rig_file)
    expected = verb.expected_reading(settings, given.robot, pose)
    if target.exists():
        raise InputError(f"{target}: exists already; choose another --out")
    setup = limp_setup(
        partial(hopper_on_ethercat, settings, given.robot),
        HopperControl(given.robot, given.gains, given.command),
        FrameCount(),
    )
    ticks = ticks_of(setup, round(1 / settings.tick))
    zeros = verb.new_zeros(settings, verb.mean_reading(settings, ticks), expected)
    calibrated = verb.with_zeros(settings, zeros)
    verb.write_calibrated(rig_file, target, calibrated)
    print(verb.describe_zeros(settings, calibrated))
    print(target)


@rig.command(name="dry-run")
@says_if_it_compiles
def dry_run_(
    rig_file: Path,
    /,
    *,
    plant: str = ETHERCAT,
    seconds: float | None = None,
    experiment: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Do everything but give torque: show what the sensors say and what the control law would want.

    Args:
        rig_file: rig.toml of the robot.
        plant: Name of its rig; without it ethercat.
        seconds: How long; without it until Ctrl-C.
        experiment: TOML file of settings, whose [robot] and [gains] are taken.
    """
    from functools import partial

    from stepgap.experiment.settings import read_experiment
    from stepgap.plants.commissioning.dry_run import dry_run
    from stepgap.rigs.entry_points import load_rig
    from stepgap.robots.hopper.hop_control import HopperControl

    if seconds is not None:
        _check_seconds(seconds)
    settings = read_experiment(experiment, overrides or [])
    control = HopperControl(settings.robot, settings.gains, settings.command)
    dry_run(partial(load_rig, plant, rig_file, settings.robot), control, seconds)


@rig.command
def emulate(
    experiment: Path | None = None,
    /,
    *words: Annotated[str, Parameter(allow_leading_hyphen=True, show=False)],
    interface: str = "stepgap0",
    lock_step: bool = False,
    hold: float = 5.0,
    settings: Path = Path("emulated.toml"),
    program: Program = None,
    overrides: Overrides = None,
) -> None:
    """Emulate a bus with the twin as the robot on it, until Ctrl-C, or while a COMMAND given after -- runs.

    Args:
        experiment: TOML file of settings, whose [robot] and [gap] are the twin's.
        words: None; a command goes after --.
        interface: Name of the network interface that a master opens; without it stepgap0.
        lock_step: Let time go on with every frame; without it, by the clock.
        hold: How long the twin is held in the air when its drives have been enabled [s]; without it 5.
        settings: File for the rig.toml that fits it; without it emulated.toml.
    """
    if words:
        _refuse_words(experiment, words)
    from stepgap.cli.emulate import emulate as verb
    from stepgap.experiment.settings import read_experiment
    from stepgap.rigs.ethercat.emulator.ring_settings import RingSettings

    if not (isfinite(hold) and 0 <= hold <= LONGEST):
        raise InputError(f"--hold {hold:g}: it must lie between 0 and {LONGEST:g}")
    ring = RingSettings(lock_step=lock_step)
    code = verb(read_experiment(experiment, overrides or []), ring, interface, hold, settings, program or [])
    if code:
        sys.exit(code)


def _refuse_words(experiment: Path | None, words: tuple[str, ...]) -> None:
    """Says how a command is written, which is what words too many most likely are."""
    of_command = experiment and experiment.suffix != ".toml"
    before, command = ([], [str(experiment), *words]) if of_command else ([str(experiment)] * bool(experiment), words)
    if command[0].startswith("-"):
        raise InputError(f"{command[0]}: no option of rig emulate; what belongs to a command goes with it after --")
    typed = shlex.join(["stepgap", "rig", "emulate", *before, "--", *command])
    raise InputError(f"{command[0]}: a command goes after --; type `{typed}`, options of rig emulate before the --")


def _check_seconds(seconds: float) -> None:
    if not (isfinite(seconds) and 0.1 <= seconds <= LONGEST):
        raise InputError(f"--seconds {seconds:g}: it must lie between 0.1 and {LONGEST:g}")
