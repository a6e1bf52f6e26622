"""`stepgap steps` and `new` on logs of commands and odometry: bags of ROS 2 give what text gives, with units."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from stepgap.logs.columns import read_columns
from tests.cli.command_line import Command, refused
from tests.logs.sections.walking_logs import WalkingLog, walking, write_walk
from tests.ros2_stand_in.ros2_messages import STORE, as_bytes, message_type

NAMES = ("vx", "vy", "wz")
TWIST = [
    f"{name}=mean(twist.twist.{part})" for name, part in zip(NAMES, ("linear.x", "linear.y", "angular.z"), strict=True)
]
POSE = ["vx=mean(rate(forward))", "vy=mean(rate(left))", "wz=mean(rate(turn))"]
EVERY = ("--every", "0.5")


def write_bag(
    path: Path,
    log: WalkingLog,
    *,
    stamped: bool,
    by_pose: bool = False,
    topics: tuple[str, str] = ("/odom", "/cmd_vel"),
) -> None:
    """Odometry at 50 Hz, or poses on the same topic, and commands, in the order of their times."""
    measured, commanded = topics
    kinds = {
        measured: "geometry_msgs/msg/PoseStamped" if by_pose else "nav_msgs/msg/Odometry",
        commanded: f"geometry_msgs/msg/{'TwistStamped' if stamped else 'Twist'}",
    }
    messages: list[tuple[float, str, Any]] = []
    for time, velocity, pose in zip(log.time[::4], log.velocity[::4], log.pose[::4], strict=True):
        message = message_type(kinds[measured])()
        if not by_pose:
            write_twist(message.twist.twist, velocity)
        posed = message.pose if by_pose else message.pose.pose
        place, turn = posed.position, posed.orientation
        place.x, place.y = pose[:2].tolist()
        turn.z, turn.w = np.sin(pose[2] / 2), np.cos(pose[2] / 2)
        messages.append((time, measured, message))
    for time, command in zip(log.sent, log.command, strict=True):
        message = message_type(kinds[commanded])()
        write_twist(message.twist if stamped else message, command)
        messages.append((time, commanded, message))
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {topic: writer.add_connection(topic, kind, typestore=STORE) for topic, kind in kinds.items()}
        for time, topic, message in sorted(messages, key=lambda each: each[:2]):
            writer.write(connections[topic], round(1.7e18 + time * 1e9), as_bytes(message))


def write_twist(twist: Any, velocity: np.ndarray) -> None:
    twist.linear.x, twist.linear.y, twist.angular.z = velocity.tolist()


def numbers_of(file: str) -> np.ndarray:
    """States, commands and next states of the rows."""
    with Path(file).open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    columns = [*NAMES, *(f"c_{name}" for name in NAMES), *(f"next_{name}" for name in NAMES)]
    return np.array([[float(row[name]) for name in columns] for row in rows])


def test_a_bag_gives_the_steps_that_text_gives(tmp_path: Path, stepgap: Command) -> None:
    log = walking(40.0, 1)
    write_walk(log, tmp_path)
    own = ("--state", "mean(vx),mean(vy),mean(wz)", "--command", "c_vx=cx,c_vy=cy,c_wz=cw")
    assert stepgap("steps", "odom.csv+cmd.csv", *EVERY, *own, "--out", "text.csv").code == 0
    expected = numbers_of("text.csv")
    assert len(expected) > 40
    twist = ("--state", ",".join(TWIST))
    posed = ("--pose", "pose.pose", "--state", ",".join(POSE))
    for bag, stamp, state, name, error in (
        ("bag", "", twist, "twist", 2e-5),
        ("stamped", "twist.", posed, "pose", 0.01),  # between samples, means are of lines
    ):
        write_bag(tmp_path / bag, log, stamped=bool(stamp))
        parts = zip(NAMES, ("linear.x", "linear.y", "angular.z"), strict=True)
        command = ("--command", ",".join(f"c_{one}={stamp}{part}" for one, part in parts))
        found = stepgap("steps", bag, *EVERY, *state, *command, "--out", f"{name}.csv")
        assert found.code == 0, found
        assert "state mean over a step" in found.out
        assert "left out: " in found.out
        np.testing.assert_allclose(numbers_of(f"{name}.csv"), expected, atol=error)
        columns = read_columns(Path(f"{name}.toml"), {})
        assert columns is not None
        assert dict(columns.units) == {"vx": "m/s", "vy": "m/s", "wz": "rad/s"} | (
            {"c_vx": "m/s", "c_vy": "m/s", "c_wz": "rad/s"}
        )
    made = stepgap("new", "walker", "--from", "twist.csv", "--columns", "twist.toml")
    assert made.code == 0, made
    settings = Path("walker/experiment.toml").read_text()
    assert settings.count('unit = "m/s"') == 4
    assert settings.count('unit = "rad/s"') == 2


WRONG = [
    (("--every", "-1", "--state", "mean(vx)"), ("--every = -1", "it must be a positive number, or 0")),
    (("--every", "0.5", "--phase", "p", "--state", "mean(vx)"), ("it must not be given beside",)),
    (("--every", "0.5", "--at", "end", "--state", "mean(vx)"), ("--at = 'end'", "not be given beside every")),
    (("--hold", "2", "--height", "vx", "--state", "vx"), ("--hold = 2", "must be given together with every")),
    ((*EVERY, "--state", "vx=mean(rate(forward))"), ("no column 'forward'",)),
    ((*EVERY, "--pose", "x,y", "--state", "vx=mean(rate(forward))"), ("--pose = 'x,y'", "x,y,qx,qy,qz,qw")),
    ((*EVERY, "--pose", "pose", "--state", "mean(rate(left))"), ("odom.csv", "no column 'pose.position.x'")),
    ((*EVERY, "--pose", "x,y,cx", "--state", "mean(rate(left))"), ("column 'cx': its times are not those of 'x'",)),
    ((*EVERY, "--state", "mean(vx)", "--command", "mean(cx)"), ("only coordinates of the state may be",)),
    (("--every", "300", "--state", "mean(vx)", "--command", "cx"), ("no command holds for 300 s",)),
    (("--every", "1e-9", "--state", "mean(vx)", "--command", "cx"), ("makes more than 1,000,000 steps",)),
]


@pytest.mark.usefixtures("tmp_path")
def test_wrong_input_is_refused(tmp_path: Path, stepgap: Command) -> None:
    write_walk(walking(10.0, 0), tmp_path)
    for arguments, parts in WRONG:
        refused(stepgap("steps", "odom.csv+cmd.csv", *arguments, "--out", "steps.csv"), *parts)
    assert not Path("steps.csv").exists()
