"""Calibration of the sensors' zeros from their counts in a known pose."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import asin, isfinite, tau
from pathlib import Path
from types import MappingProxyType

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.files import create
from stepgap.base.settings_file import parse_toml
from stepgap.hardware.commissioning.limp import LimpTicks
from stepgap.hardware.hopper.ethercat import RigSettings, read_rig_settings
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.model.leg import knee_angle, leg_of
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperReading

MOST_COUNTS = 4  # Largest variation of the encoders of a robot at rest, in counts

SENSORS: Mapping[str, str] = MappingProxyType(
    {
        "motor_1": "motor_1",
        "motor_2": "motor_2",
        "boom_horizontal": "boom_horizontal",
        "boom_vertical": "boom_vertical",
        "contact": "contact_force",
    }
)
"""Tables of rig.toml that have a zero, and the fields of a reading that come from it."""


@dataclass(frozen=True)
class Pose:
    """Pose of the robot as measured by a person, with the boom at yaw zero and no load on the foot.

    Attributes:
        alpha_1: Leg angle α₁, forward positive [rad].
        leg_length: ℓ, from hip to the joint of the bottom links [m].
        hip_height: y above the ground [m].
    """

    alpha_1: float
    leg_length: float
    hip_height: float


def fold_angle(robot: RobotParameters, leg_length: float) -> float:
    """Angle α₂ [rad] that gives a leg length [m].

    Raises:
        InputError: The leg cannot have this length.
    """
    shortest = robot.folded_length
    longest = robot.stretched_length
    if not shortest < leg_length <= longest:
        raise InputError(f"--leg-length {leg_length:g}: it must lie between {shortest:g} and {longest:g}")
    return float(knee_angle(leg_of(robot), leg_length))


def expected_reading(settings: RigSettings, robot: RobotParameters, pose: Pose) -> dict[str, float]:
    """Reading of a calibrated rig in a pose, by field of `HopperReading`: counts from zero, contact force [N].

    Raises:
        InputError: The robot cannot take this pose.
    """
    alpha_2 = fold_angle(robot, pose.leg_length)
    rise = (pose.hip_height - settings.pivot_height) / robot.boom_length
    if not abs(rise) < 1:
        raise InputError(f"--height {pose.hip_height:g}: the boom of {robot.boom_length:g} m does not reach there")
    return {
        "motor_1": (pose.alpha_1 + alpha_2) / tau * settings.motor_1.link_counts,
        "motor_2": (pose.alpha_1 - alpha_2) / tau * settings.motor_2.link_counts,
        "boom_horizontal": 0.0,
        "boom_vertical": asin(rise) / tau * settings.boom_vertical.counts_per_turn,
        "contact_force": 0.0,
    }


def new_zeros(settings: RigSettings, reading: Mapping[str, float], expected: Mapping[str, float]) -> dict[str, int]:
    """Zeros, by table, with which the rig gives the expected reading.

    With counts c of a sensor and its zero z, the rig reads r = s (c − z), where s is the sign or the force of a count;
    it should read e = s (c − z'), so z' = z + (r − e) / s.

    Args:
        settings: Settings with the present zeros.
        reading: Reading of the rig with these zeros, by field of `HopperReading`.
        expected: Reading that it should give.
    """
    zeros = {}
    for table, name in SENSORS.items():
        scale = settings.contact.newton_per_count if table == "contact" else getattr(settings, table).sign
        zeros[table] = round(getattr(settings, table).zero + (reading[name] - expected[name]) / scale)
    return zeros


def with_zeros(settings: RigSettings, zeros: Mapping[str, int]) -> RigSettings:
    """Settings with new zeros, given by table.

    Raises:
        InputError: A zero is out of range.
    """
    try:
        tables = {table: replace(getattr(settings, table), zero=zero) for table, zero in zeros.items()}
    except ValueError as error:
        raise InputError(f"the new zeros are out of range: {error}") from None
    return replace(settings, **tables)


def mean_reading(settings: RigSettings, ticks: LimpTicks) -> dict[str, float]:
    """Mean of the readings, by field of `HopperReading`.

    Raises:
        InputError: The robot was not at rest.
        RigFault: The rig failed while it was read.
    """
    if ticks.fault:
        raise RigFault(ticks.fault)
    table = ticks.table
    contact = settings.contact
    most = dict.fromkeys(HopperReading._fields, float(MOST_COUNTS))
    most["contact_force"] = max(contact.touchdown_force, MOST_COUNTS * abs(contact.newton_per_count))
    for name in HopperReading._fields:
        span = float(np.ptp(table[name]))
        unit = "N" if name == "contact_force" else "counts"
        if span > most[name]:
            raise InputError(
                f"{name} varied by {span:g} {unit}, more than the {most[name]:g} of a robot at rest; "
                "hold the robot still and try again"
            )
    return {name: float(table[name].mean()) for name in HopperReading._fields}


def replaced_zeros(text: str, zeros: Mapping[str, int]) -> str:
    """Text of a rig.toml with the lines `zero = …` of some tables replaced or inserted; nothing else changes."""
    lines = []
    table = ""
    missing = dict(zeros)
    for line in text.splitlines(keepends=True):
        if header := re.match(r"\s*\[+\s*([^\[\]#]*?)\s*\]", line):
            table = header[1]
            lines.append(line if line.endswith("\n") else f"{line}\n")
            if table in missing and "zero" not in parse_toml(text).get(table, {}):
                lines.append(f"zero = {missing.pop(table)}\n")
        elif table in missing and (entry := re.fullmatch(r"(\s*zero\s*=\s*)([^#\s]+)(.*)", line, re.DOTALL)):
            lines.append(f"{entry[1]}{missing.pop(table)}{entry[3]}")
        else:
            lines.append(line)
    return "".join(lines)


def write_calibrated(rig_file: Path, out: Path, settings: RigSettings) -> None:
    """Writes a copy of a rig.toml, with its comments, that differs only in the zeros, which are those of `settings`.

    Raises:
        InputError: The file exists or cannot be written, or the zeros cannot be inserted.
    """
    zeros = {table: getattr(settings, table).zero for table in SENSORS}
    try:
        text = replaced_zeros(rig_file.read_bytes().decode("utf-8-sig"), zeros)
        create(out, text)
    except OSError as error:
        raise InputError(f"{out}: cannot be written: {error.strerror}; choose another --out") from None
    try:
        right = read_rig_settings(out) == settings
    except InputError:
        right = False
    if not right:
        out.unlink()
        names = ", ".join(f"[{table}]" for table in SENSORS)
        raise InputError(
            f"{rig_file}: the zeros cannot be inserted; write {names} as separate tables with one key per line"
        )


def describe_zeros(before: RigSettings, after: RigSettings) -> str:
    """Table of the old and the new zeros, as text."""
    rows = [("", "old zero", "new zero")]
    rows += [(table, str(getattr(before, table).zero), str(getattr(after, table).zero)) for table in SENSORS]
    return "\n".join(f"{name:16} {old:>12} {new:>12}" for name, old, new in rows)


def check_pose(pose: Pose) -> None:
    """Raises InputError where a number of a pose is not finite or out of range."""
    for option, value in (
        ("--alpha-1", pose.alpha_1),
        ("--leg-length", pose.leg_length),
        ("--height", pose.hip_height),
    ):
        if not isfinite(value):
            raise InputError(f"{option} {value:g}: it must be finite")
    if abs(pose.alpha_1) > tau / 4:
        raise InputError(f"--alpha-1 {pose.alpha_1:g}: in radians, it must lie within ±π/2")
