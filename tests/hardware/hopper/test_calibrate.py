"""With the calibrated zeros the reading of the pose is correct, for any signs, gears and earlier zeros."""

from dataclasses import replace
from math import asin, sin, tau
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.hardware.commissioning.limp import LimpTicks
from stepgap.hardware.hopper.calibrate import (
    SENSORS,
    Pose,
    expected_reading,
    mean_reading,
    new_zeros,
    replaced_zeros,
    with_zeros,
    write_calibrated,
)
from stepgap.hardware.hopper.ethercat import RigSettings, hopper_on_ethercat, read_rig_settings
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopControl
from stepgap.robots.hopper.tick.sensors import HopperReading, hopper_sensors
from tests.rig_ticks import LOG_UNITS

ROBOT = RobotParameters()
EXAMPLE = Path(__file__).parents[3] / "examples" / "rig.toml"
SETTINGS = read_rig_settings(EXAMPLE)
zeros = st.integers(-(2**30), 2**30)
signs = st.sampled_from([1, -1])
poses = st.builds(
    Pose, st.floats(-1, 1), st.floats(ROBOT.folded_length + 0.01, ROBOT.stretched_length - 0.01), st.floats(0.2, 0.8)
)


@st.composite
def rigs(draw: st.DrawFn) -> RigSettings:
    gear, scale = draw(st.sampled_from([1.0, 6.0, 9.5])), draw(st.floats(0.01, 1)) * draw(signs)
    motors = {
        name: replace(getattr(SETTINGS, name), sign=draw(signs), zero=draw(zeros), gear=gear)
        for name in ("motor_1", "motor_2")
    }
    booms = {
        name: replace(getattr(SETTINGS, name), sign=draw(signs), zero=draw(zeros))
        for name in ("boom_horizontal", "boom_vertical")
    }
    contact = replace(SETTINGS.contact, newton_per_count=scale, zero=draw(zeros))
    return replace(SETTINGS, contact=contact, **motors, **booms)


def reading_of(settings: RigSettings, counts: dict[str, float]) -> HopperReading:
    """Reading of a rig for the counts of its sensors."""

    def angle(name: str) -> float:
        table = getattr(settings, name)
        return table.sign * (counts[name] - table.zero)

    motor_1, motor_2, horizontal, vertical = map(angle, list(SENSORS)[:4])
    contact = settings.contact
    return HopperReading(
        motor_1, motor_2, horizontal, vertical, contact.newton_per_count * (counts["contact"] - contact.zero)
    )


@settings(deadline=None)
@given(rigs(), poses, st.data())
def test_the_reading_of_the_pose_is_correct_afterwards(before: RigSettings, pose: Pose, data: st.DataObject) -> None:
    counts = {table: float(data.draw(zeros)) for table in SENSORS}  # arbitrary counts at this pose
    reading = reading_of(before, counts)._asdict()
    found_zeros = new_zeros(before, reading, expected_reading(before, ROBOT, pose))
    if max(map(abs, found_zeros.values())) >= 2**31:
        with pytest.raises(InputError, match="zeros are out of range"):
            with_zeros(before, found_zeros)
        return
    after = with_zeros(before, found_zeros)
    sensors = hopper_sensors(hopper_on_ethercat(after, ROBOT).sensor_model)
    found = reading_of(after, counts)
    motion = HopControl(sensors, ROBOT, Gains(), after.limits).observe(found).motion
    count = tau / sensors.motor_counts
    assert motion.alpha_1 == pytest.approx(pose.alpha_1, abs=count)
    assert motion.leg_length == pytest.approx(pose.leg_length, abs=0.25 * count)
    pitch = asin((pose.hip_height - after.pivot_height) / ROBOT.boom_length)
    highest, lowest = (sin(pitch + part * tau / sensors.boom_counts_vertical) for part in (0.51, -0.51))
    assert lowest <= (motion.hip_height - after.pivot_height) / ROBOT.boom_length <= highest
    assert found.boom_horizontal == 0
    assert abs(found.contact_force) <= 0.51 * abs(after.contact.newton_per_count)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (Pose(0, 0.32, 0.5), "--leg-length 0.32: it must lie between 0.09 and 0.31"),
        (Pose(0, 0.09, 0.5), "--leg-length"),
        (Pose(0, 0.26, 3.0), "--height 3: the boom of 1.854 m does not reach there"),
    ],
)
def test_an_impossible_pose_is_refused(pose: Pose, message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}"):
        expected_reading(SETTINGS, ROBOT, pose)


def ticks_with(**columns: list[float]) -> LimpTicks:
    rows = np.zeros((4, len(LOG_UNITS)))
    for name, values in columns.items():
        rows[:, list(LOG_UNITS).index(name)] = values
    return LimpTicks(TickTable(LOG_UNITS, rows), 0, "", "")


def test_a_robot_that_moves_is_refused_and_one_at_rest_is_averaged() -> None:
    at_rest = ticks_with(motor_1=[7, 8, 8, 9], contact_force=[0.1, -0.1, 0.2, 0.0])
    found = mean_reading(SETTINGS, at_rest)
    assert (found["motor_1"], found["contact_force"]) == (8.0, pytest.approx(0.05))
    with pytest.raises(InputError, match=r"^boom_vertical varied by 5 counts, more than the 4"):
        mean_reading(SETTINGS, ticks_with(boom_vertical=[0, 0, 0, -5]))
    with pytest.raises(InputError, match=r"^contact_force varied by 6 N, more than the 5"):
        mean_reading(SETTINGS, ticks_with(contact_force=[0, 6, 0, 0]))
    with pytest.raises(RigFault, match="unplugged"):
        mean_reading(SETTINGS, replace(at_rest, fault="unplugged"))


@settings(deadline=None)
@given(st.fixed_dictionaries(dict.fromkeys(SENSORS, zeros)))
def test_only_the_zeros_of_a_file_change(new: dict[str, int]) -> None:
    before, after = EXAMPLE.read_text("utf-8"), replaced_zeros(EXAMPLE.read_text("utf-8"), new)
    old_lines, new_lines = before.splitlines(), after.splitlines()
    assert [line for line in new_lines if not line.startswith("zero =")] == [
        line for line in old_lines if not line.startswith("zero =")
    ]
    assert sum(line.startswith("zero =") for line in new_lines) == len(SENSORS)
    assert replaced_zeros(after, new) == after


TRICKY = """
[ motor_1 ]  # the left one
zero=0x10 # was measured
sign = 1
[motor_2]
[contact]# zero = 7
  zero = -1_000"""


def test_comments_and_odd_layouts_are_kept() -> None:
    assert replaced_zeros(TRICKY, {"motor_1": 5, "motor_2": 6, "contact": 7}) == (
        "\n[ motor_1 ]  # the left one\nzero=5 # was measured\nsign = 1\n"
        "[motor_2]\nzero = 6\n[contact]# zero = 7\n  zero = 7"
    )


def test_a_byte_order_mark_does_no_harm(tmp_path: Path) -> None:
    rig_file, out = tmp_path / "rig.toml", tmp_path / "new.toml"
    rig_file.write_text(EXAMPLE.read_text("utf-8"), encoding="utf-8-sig")
    write_calibrated(rig_file, out, with_zeros(SETTINGS, dict.fromkeys(SENSORS, 3)))
    assert read_rig_settings(out) == with_zeros(SETTINGS, dict.fromkeys(SENSORS, 3))


def test_a_file_that_cannot_be_changed_is_refused_and_no_file_remains(tmp_path: Path) -> None:
    rig_file, out = tmp_path / "rig.toml", tmp_path / "new.toml"
    inline = 'boom_vertical = { slave = "pitch encoder", counts_per_turn = 16384 }\n'
    text = EXAMPLE.read_text("utf-8").replace('[boom_vertical]\nslave = "pitch encoder"\ncounts_per_turn = 16384\n', "")
    rig_file.write_text(inline + text, encoding="utf-8")
    settings = read_rig_settings(rig_file)
    with pytest.raises(InputError, match="the zeros cannot be inserted"):
        write_calibrated(rig_file, out, with_zeros(settings, dict.fromkeys(SENSORS, 3)))
    assert not out.exists()
    write_calibrated(EXAMPLE, out, with_zeros(SETTINGS, dict.fromkeys(SENSORS, 3)))
    assert read_rig_settings(out) == with_zeros(SETTINGS, dict.fromkeys(SENSORS, 3))
    with pytest.raises(InputError, match="cannot be written"):
        write_calibrated(EXAMPLE, out, SETTINGS)
