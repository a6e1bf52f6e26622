"""The node of ROS 2 that `stepgap cure` writes moves a robot, on a stand-in of rclpy with the published messages."""

import json
import os
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stepgap.cure.cure_folder import cure_files
from stepgap.cure.drive import read_drive
from stepgap.cure.lesson import Lesson, lesson_of
from stepgap.cure.response import response_of
from stepgap.step import Array
from tests.cure.drives import DRIFT
from tests.logs.cli.test_cli_walks import write_bag
from tests.logs.sections.walking_logs import walking

ROOT = Path(__file__).parents[2]
END, BEGIN, FAULT = 9.0, 1.0, 6.0
"""When nobody asks any more, when the robot can be corrected, and when the odometry goes wrong [s]."""
ASKED = (0.4, 0.0, 0.0)


@pytest.fixture(scope="module")
def folder(minute: Lesson, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What is written for such a robot, as that of the stand-in."""
    return written(minute, tmp_path_factory.mktemp("cure"))


@pytest.fixture(scope="module")
def folder_of_poses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same of a bag of motion capture."""
    home = tmp_path_factory.mktemp("poses")
    write_bag(home / "bag", walking(60.0, 1), stamped=True, by_pose=True)
    drive = read_drive(str(home / "bag"))
    return written(lesson_of([drive], response_of(drive)), home)


def written(lesson: Lesson, home: Path) -> Path:
    for name, content in cure_files(lesson, [], [], "").items():
        (home / name).write_text(content)
    return home


def moved(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str, **names: str
) -> tuple[Array, list[Any]]:
    """Times, commands and true velocities (C, 4), and what the node said: (time, topic, text)."""
    asked = [[0.0, 0.0, 0.0, 0.0], [BEGIN, *ASKED], [END, 0.0, 0.0, 0.0]]
    values = {
        "PYTHONPATH": str(ROOT / "tests/ros2_stand_in"),
        "STAND_IN_LOG": str(tmp_path / "commands"),
        "STAND_IN_SAID": str(tmp_path / "said"),
        "STAND_IN_ASKED": json.dumps(asked),
        "STAND_IN_DRIFT": json.dumps(DRIFT.tolist()),
        **names,
    }
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    program = [sys.executable, str(folder / "cmd_vel_correction.py"), *arguments]
    subprocess.run(program, check=True, capture_output=True, env=os.environ)
    said = [json.loads(line) for line in (tmp_path / "said").read_text().splitlines()]
    return np.loadtxt(tmp_path / "commands", ndmin=2), said


def between(rows: Array, begin: float, end: float) -> Array:
    return rows[(rows[:, 0] > begin) & (rows[:, 0] < end), 1:]


def test_it_corrects_with_topics_and_parameters_of_the_command_line(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot does 0.8 of its command, and drifts to the left and turns; what it is told undoes that."""
    ros = "--ros-args -r __ns:=/go2 -r cmd_vel:=base/cmd_vel -r cmd_vel_raw:=/joy/cmd_vel -p stamped:=false"
    rows, said = moved(
        folder, tmp_path, monkeypatch, *ros.split(), STAND_IN_COMMAND="/go2/base/cmd_vel", STAND_IN_RAW="/joy/cmd_vel",
        STAND_IN_ODOM="/go2/odom", STAND_IN_STAMPED="0",
    )  # fmt: skip
    settled = between(rows, 4.0, END)
    np.testing.assert_allclose(settled.mean(axis=0) * 0.8 + DRIFT, ASKED, atol=0.04)
    assert np.ptp(settled, axis=0).max() < 0.15, "it does not ring"
    assert np.diff(rows[:, 0]).max() < 0.05
    assert [text for _, topic, text in said if topic == "/go2/cmd_vel_correction/status"][-1] == "corrected"


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("silent", "no odometry for 0.2 s"),
        ("nan", "the odometry is no number"),
        ("frozen", "the odometry repeats the same numbers for more than 0.3 s"),
        ("jumps", "the odometry jumps"),
    ],
)
def test_wrong_odometry_gives_the_plain_command_within_a_step_and_is_said(
    fault: str, reason: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    check_plain_after_fault(reason, *moved(folder, tmp_path, monkeypatch, STAND_IN_FAULT=f"{fault},{FAULT}"))


def check_plain_after_fault(reason: str, rows: Array, said: list[Any]) -> None:
    assert (np.abs(between(rows, 4.0, FAULT) - ASKED).max(axis=0) > 0.03).any(), "it corrects before"
    assert (between(rows, FAULT + 0.5, END) == ASKED).all()
    after = [(topic, text) for time, topic, text in said if time > FAULT]
    assert ("/cmd_vel_correction/status", f"not corrected: {reason}") in after
    assert ("log", f"not corrected: {reason}") in after


def test_a_heading_is_kept_with_the_pose_of_the_odometry(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is learned of the turning is wrong by some mrad/s, which add up; with `make_up` they do not."""
    turning = list[float]()
    for number, seconds in enumerate((0.0, 2.0)):
        home = tmp_path / str(number)
        home.mkdir()
        ros = f"--ros-args -p learns:=false -p make_up:={seconds}"
        rows, _ = moved(folder, home, monkeypatch, *ros.split())
        turning.append(abs(0.8 * rows[-1, 3] + DRIFT[2]))
    assert turning[0] > 0.004
    assert turning[1] < 0.001


@pytest.mark.parametrize(
    ("fault", "reason"),
    [("frozen", "the odometry repeats the same numbers for more than 0.3 s"), ("jumps", "the odometry jumps")],
)
def test_after_a_log_of_motion_capture_it_corrects_by_the_poses_until_they_are_wrong(
    fault: str, reason: str, folder_of_poses: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drift = [0.03, 0.03, 0.03]  # as in the log
    rows, said = moved(
        folder_of_poses, tmp_path, monkeypatch, "--ros-args", "-r", "odom:=/mocap", STAND_IN_FAULT=f"{fault},{FAULT}",
        STAND_IN_DRIFT=json.dumps(drift),
    )  # fmt: skip
    np.testing.assert_allclose(between(rows, 3.0, FAULT).mean(axis=0) * 0.8 + drift, ASKED, atol=0.04)
    check_plain_after_fault(reason, rows, said)


def test_a_parameter_turns_it_off_and_limits_hold(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ros = "--ros-args -p enabled:=false -p limit_vx:=0.25"
    rows, said = moved(folder, tmp_path, monkeypatch, *ros.split())
    assert (between(rows, BEGIN + 0.2, END) == [0.25, 0.0, 0.0]).all()
    assert [text for _, topic, text in said if topic == "log"][-1] == "not corrected: the correction is turned off"


def test_the_robot_gets_no_command_while_nobody_asks(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "commands").write_text("")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of NumPy, that the file is empty
        rows, said = moved(folder, tmp_path, monkeypatch, "--ros-args", "-r", "cmd_vel_raw:=/elsewhere")
    assert not rows.size
    assert said[0][2] == "nobody asks for a velocity"
