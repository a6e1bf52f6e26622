"""The verbs of `stepgap rig`, for commissioning: from an emulated ring to a real robot that is ready to hop."""

import shlex
import sys
from functools import partial
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

from stepgap.base.errors import InputError
from stepgap.cli.options import Flag, Name, Overrides, Program, Seconds, add_verb
from stepgap.cli.terminal import announces_compilation, check_consent

if TYPE_CHECKING:  # slow imports are made where they are used
    from collections.abc import Mapping, Sequence

    from stepgap.rigs.rig import Finding

ETHERCAT = "ethercat"  # Name of the rig that `rig.toml` describes
LONGEST_DURATION = 86_400.0  # Longest duration of a measurement or display [s]


def check(rig_file: Path | None = None, /, *, plant: Name | None = None, seconds: Seconds = 10.0) -> None:
    """Measure the timing of this machine and of the bus, and the watchdogs, without torque; exit code 1 if not passed.

    Args:
        rig_file: rig.toml of the robot; the result is written next to it. [default: only the machine is measured]
        plant: Name of its rig. [default: ethercat]
        seconds: Duration [s].
    """
    from stepgap.hardware.commissioning.check import describe, measure, with_findings, with_watchdog, write_check
    from stepgap.hardware.commissioning.limp import limp_setup
    from stepgap.hardware.commissioning.proof import fingerprint
    from stepgap.hardware.hopper.still import still_hopper
    from stepgap.rigs.entry_points import load_rig
    from stepgap.robots.hopper.robot import Hopper
    from stepgap.robots.hopper.tick.limits import SafetyLimits

    _check_seconds(seconds)
    if plant and rig_file is None:
        raise InputError(f"--plant {plant}: valid only with RIG_FILE, the file that describes the rig")
    robot = Hopper()
    control = robot.control()
    limits = SafetyLimits.of(robot.parameters)
    if rig_file is None:
        print("no rig.toml given: timing of this machine alone, with constant sensor values")
        setup = limp_setup(partial(still_hopper, 1e-3), control)
        result = measure(setup, 1e-3, limits, seconds)
        print(describe(result, bus=False))
    else:
        mark = fingerprint(rig_file)
        make_rig = partial(load_rig, plant or ETHERCAT, rig_file, robot)
        own_rig = make_rig()
        setup = limp_setup(make_rig, control)
        findings = own_rig.findings()
        _refuse_contradictions(rig_file, mark, findings)
        tick = own_rig.sensor_model.tick
        result = measure(setup, tick, own_rig.limits or limits, seconds, own_rig.clock_limits)
        result = with_watchdog(with_findings(result, findings), make_rig)
        file = write_check(rig_file, mark, result)
        print(describe(result, bus=True))
        print(file)
    if result.failures():
        sys.exit(1)


@announces_compilation
def calibrate(
    rig_file: Path,
    /,
    *,
    alpha_1: Annotated[float, Parameter(metavar="RADIANS")] = 0.0,
    leg_length: Annotated[float | None, Parameter(metavar="METRES")] = None,
    height: Annotated[float | None, Parameter(metavar="METRES")] = None,
    out: Path | None = None,
    experiment: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Find the zeros of all sensors on EtherCAT: with the limp robot in a known pose, yaw zero, foot unloaded.

    Args:
        rig_file: rig.toml of the bus.
        alpha_1: Leg angle in the pose, forward positive, 0 straight down [rad].
        leg_length: Length of the leg in the pose, from the hip to the joint of the bottom links [m], as a jig sets it.
        height: Height of the hip above the ground in the pose [m].
        out: New file for the settings with the new zeros. [default: RIG.calibrated.toml]
        experiment: TOML file of settings, of which [parameters] is used.
    """
    from stepgap.experiment.settings import read_experiment
    from stepgap.hardware.commissioning.limp import limp_setup, ticks_of
    from stepgap.hardware.hopper import calibrate as verb
    from stepgap.hardware.hopper.ethercat import hopper_on_ethercat, read_rig_settings
    from stepgap.robots.hopper.robot import as_hopper

    if leg_length is None or height is None:
        raise InputError("--leg-length and --height: give both, as measured; they have no default")
    pose = verb.Pose(alpha_1, leg_length, height)
    target = out or rig_file.with_suffix(".calibrated.toml")
    verb.check_pose(pose)
    robot = read_experiment(experiment, overrides or []).robot
    hopper = as_hopper(robot, "a rig is calibrated")
    settings = read_rig_settings(rig_file)
    expected = verb.expected_reading(settings, hopper.parameters, pose)
    if target.exists():
        raise InputError(f"{target}: exists already; choose another --out")
    setup = limp_setup(partial(hopper_on_ethercat, settings, hopper.parameters), hopper.control())
    ticks = ticks_of(setup, round(1 / settings.tick))
    zeros = verb.new_zeros(settings, verb.mean_reading(settings, ticks), expected)
    calibrated = verb.with_zeros(settings, zeros)
    verb.write_calibrated(rig_file, target, calibrated)
    print(verb.describe_zeros(settings, calibrated))
    print(target)


@announces_compilation
def jog(
    rig_file: Path,
    /,
    *,
    plant: Name = ETHERCAT,
    experiment: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Try each motor alone with at most 1 N·m: whether the right link moves, in the right direction; run needs it.

    Nobody holds the robot: it hangs with its foot off the ground. A person turns each link by hand, then holds the
    space bar while one motor vibrates its link by a fraction of a degree.

    Args:
        rig_file: rig.toml of the robot, which must have passed `rig check`; the result is written next to it.
        plant: Name of its rig.
        experiment: TOML file of settings, of which [parameters] and [gains] are used.
    """
    from stepgap.experiment.settings import read_experiment
    from stepgap.hardware.commissioning.check import checked
    from stepgap.hardware.commissioning.proof import JOG, fingerprint, write_proof
    from stepgap.hardware.hopper.jog_trial import try_motors
    from stepgap.hardware.rig_plants import require_limits
    from stepgap.rigs.entry_points import load_rig
    from stepgap.robots.hopper.robot import as_hopper

    check_consent("rig jog")
    robot = as_hopper(read_experiment(experiment, overrides or []).robot, "motors are tried")
    make_rig = partial(load_rig, plant, rig_file, robot)
    limits = require_limits(str(rig_file), make_rig().limits)
    checked(rig_file)
    mark = fingerprint(rig_file)
    settings = rig_file.read_text("utf-8")
    content = try_motors(make_rig, robot.control(), limits.simulated, settings)
    file = write_proof(rig_file, JOG, mark, content)
    print("result  passed" if content["passed"] else "result  not passed")
    print(file)
    if not content["passed"]:
        sys.exit(1)


@announces_compilation
def dry_run_(
    rig_file: Path,
    /,
    *,
    plant: Name = ETHERCAT,
    seconds: Seconds | None = None,
    experiment: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Do everything except apply torque: show the sensors and the torques that the control law would command.

    Args:
        rig_file: rig.toml of the robot.
        plant: Name of its rig.
        seconds: Duration [s]. [default: until Ctrl-C]
        experiment: TOML file of settings, of which [parameters] and [gains] are used.
    """
    from stepgap.experiment.settings import read_experiment
    from stepgap.hardware.commissioning.dry_run import dry_run
    from stepgap.rigs.entry_points import load_rig

    if seconds is not None:
        _check_seconds(seconds)
    robot = read_experiment(experiment, overrides or []).robot
    control = robot.control()
    if control is None:
        raise InputError(f"robot '{robot.name}' has no control for a rig")
    dry_run(partial(load_rig, plant, rig_file, robot), control, seconds)


def incident(log: Path, /, *, seconds: Seconds = 1.0, out: Path | None = None) -> None:
    """Explain why a robot was stopped: the last second of a tick log in words, and as a figure.

    Args:
        log: Log of a deployment, such as run/ticks/ticks-0.mcap; also a truncated one.
        seconds: Time before the fault that is shown [s].
        out: New figure, .png, .svg or .pdf. [default: beside the log]
    """
    from stepgap.base.output_files import check_new, format_by_name, free_name, write_new
    from stepgap.hardware.incident import describe_incident, read_incident
    from stepgap.plants.ticks.tick_log import TickLogError
    from stepgap.report.own_style import own_style

    _check_seconds(seconds)
    picture = out or free_name(log.with_name(f"{log.stem}_incident.png"))
    form = format_by_name(picture)
    check_new(picture, "--out")
    try:
        event = read_incident(log, seconds)
    except TickLogError as error:
        raise InputError(str(error)) from None
    print(describe_incident(event))
    with own_style():
        from stepgap.hardware.incident_figure import incident_picture

        write_new(picture, "--out", incident_picture(event, form))


def esi(file: Path, /, *, product: Name | None = None) -> None:
    """Print what a rig.toml needs for the devices of an ESI file: identity, PDOs, clocks and start-up objects.

    Args:
        file: ESI file (EtherCAT Slave Information, ETG.2000) of a vendor.
        product: Product code of the device, such as 0x00030924. [default: all devices]
    """
    from stepgap.hardware.ethercat.esi.proposal import propose
    from stepgap.hardware.ethercat.esi.reader import read_esi

    print(propose(read_esi(file), product))


def emulate(
    experiment: Path | None = None,
    /,
    *extra: Annotated[str, Parameter(allow_leading_hyphen=True, show=False)],
    interface: Name = "stepgap0",
    lock_step: Flag = False,
    dc: Flag = False,
    hold: Seconds = 5.0,
    settings: Path = Path("emulated.toml"),
    program: Program = None,
    overrides: Overrides = None,
) -> None:
    """Emulate a bus with the twin as its robot, until Ctrl-C, or while the COMMAND given after -- is running.

    Args:
        experiment: TOML file of settings, whose [parameters], [gap] and [ground] are the twin's.
        extra: Not allowed; a command is written after --.
        interface: Name of the network interface that a master opens.
        lock_step: Advance time by one tick with every frame. [default: time follows the clock]
        dc: Let the drives need distributed clocks, whose rates differ; not with --lock-step.
        hold: Time for which the twin is held in the air after its drives have been enabled [s].
        settings: File for the rig.toml of this bus.
    """
    if extra:
        _refuse_extra_arguments(experiment, extra)
    from stepgap.experiment.settings import read_experiment
    from stepgap.hardware.cli.emulate import emulate_ring
    from stepgap.hardware.ethercat.emulator.ring_settings import DRIFTING_CLOCKS, RingClocks, RingSettings
    from stepgap.robots.hopper.robot import as_hopper

    if not (isfinite(hold) and 0 <= hold <= LONGEST_DURATION):
        raise InputError(f"--hold {hold:g}: it must lie between 0 and {LONGEST_DURATION:g}")
    if dc and lock_step:
        raise InputError("--dc: not with --lock-step, where frames pass at no time that a master could steer")
    ring = RingSettings(lock_step=lock_step, clocks=DRIFTING_CLOCKS if dc else RingClocks())
    given = read_experiment(experiment, overrides or [])
    hopper = as_hopper(given.robot, "a bus is emulated")
    code = emulate_ring(hopper, given.seed, ring, interface, hold, settings, program or [])
    if code:
        sys.exit(code)


def _refuse_extra_arguments(experiment: Path | None, extra: tuple[str, ...]) -> None:
    """Raises InputError that explains how to give a command, since extra arguments are probably a command."""
    of_command = experiment and experiment.suffix != ".toml"
    given = [str(experiment)] if experiment else []
    before, command = ([], [*given, *extra]) if of_command else (given, extra)
    if command[0].startswith("-"):
        raise InputError(f"{command[0]}: not an option of rig emulate; options of a command follow it after --")
    typed = shlex.join(["stepgap", "rig", "emulate", *before, "--", *command])
    raise InputError(f"{command[0]}: a command goes after --; type `{typed}`, options of rig emulate before the --")


def _refuse_contradictions(rig_file: Path, mark: "Mapping[str, str]", findings: "Sequence[Finding]") -> None:
    """Prints what contradicts the settings, before anything is connected, and ends with exit code 1; else returns."""
    from stepgap.hardware.commissioning.check import write_refusal

    contradictions = [finding.text for finding in findings if finding.is_error]
    if contradictions:
        for finding in sorted(findings, key=lambda finding: not finding.is_error):
            print(f"{'error   ' if finding.is_error else 'remark  '}{finding.text}")
        print(f"result  not passed: {rig_file.name} contradicts ESI files of the devices; nothing was measured")
        print(write_refusal(rig_file, mark, contradictions))
        sys.exit(1)


def _check_seconds(seconds: float) -> None:
    if not (isfinite(seconds) and 0.1 <= seconds <= LONGEST_DURATION):
        raise InputError(f"--seconds {seconds:g}: it must lie between 0.1 and {LONGEST_DURATION:g}")


rig = App(name="rig", help="Commission a robot, on EtherCAT or by the name of its rig, or practise on an emulated one.")
add_verb(rig, "esi", esi)
add_verb(rig, "check", check)
add_verb(rig, "calibrate", calibrate)
add_verb(rig, "dry-run", dry_run_)
add_verb(rig, "jog", jog)
add_verb(rig, "emulate", emulate)
add_verb(rig, "incident", incident)
