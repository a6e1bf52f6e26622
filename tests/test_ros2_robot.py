"""`examples/process/ros2_robot.py` moves a simulated robot, and halts it whenever something is wrong.

It runs as a process on a stand-in of rclpy (`ros2_stand_in`), with the published definitions of the messages.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from stepgap.mujoco_robots.velocity.walking_robot import Walk
from stepgap.plants.process import Child, ProcessPlant
from stepgap.step import Array, StepStatus

ROOT = Path(__file__).parent.parent
PROGRAM = [sys.executable, str(ROOT / "examples" / "process" / "ros2_robot.py")]
LAG, GAIN, SECONDS = 0.1, 0.8, 0.5
BEYOND = "the program reports: 'command_vx = 0.45, but this robot may get at most 0.4'"


@pytest.fixture
def commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file in which the robot notes its commands."""
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "tests" / "ros2_stand_in"))
    monkeypatch.setenv("STAND_IN_LOG", str(tmp_path / "commands"))
    return tmp_path / "commands"


def test_arguments_of_ros_remap_its_topics_and_set_its_parameters(
    commands: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STAND_IN_COMMAND", "/go2/base/cmd_vel")
    monkeypatch.setenv("STAND_IN_ODOM", "/go2/odom")
    ros = "--ros-args -r __ns:=/go2 -r cmd_vel:=base/cmd_vel -p stamped:=true -p limit_vx:=0.4"
    robot = plant(*ros.split())
    robot.start()
    assert robot.take_step(np.array([0.3, 0.0, 0.0])).status == StepStatus.OK
    beyond = robot.take_step(np.array([0.45, 0.0, 0.0]))
    assert (beyond.status, robot.fault) == (StepStatus.STOPPED, BEYOND)
    robot.stop()
    assert noted(commands)[:, 1].max() == 0.3


def noted(commands: Path) -> Array:
    """Times and commands that the robot got; shape (C, 4)."""
    return np.loadtxt(commands, ndmin=2)


def plant(*arguments: str) -> ProcessPlant:
    return ProcessPlant(partial(Child, [*PROGRAM, *arguments]), Walk().space, seconds=SECONDS)


@pytest.mark.parametrize("arguments", [(), ("--pose", "/mocap")], ids=["odometry", "pose"])
def test_states_are_the_mean_velocities_of_a_robot_that_lags(arguments: tuple[str, ...], commands: Path) -> None:
    robot, velocity = plant(*arguments), np.zeros(3)
    np.testing.assert_allclose(robot.start(), 0, atol=1e-6)
    wanted = np.array([[0.5, 0.0, 0.0], [0.5, 0.2, -0.6], [0.0, -0.3, 0.9]])
    for command in wanted:
        record = robot.take_step(command)
        assert record.status == StepStatus.OK
        kept = LAG / SECONDS * (1 - np.exp(-SECONDS / LAG))  # the mean of a lag; velocity is that at the begin
        np.testing.assert_allclose(record.next_state, GAIN * command + kept * (velocity - GAIN * command), atol=0.05)
        velocity = GAIN * command + np.exp(-SECONDS / LAG) * (velocity - GAIN * command)
    robot.stop()
    rows = noted(commands)
    assert np.diff(rows[:, 0]).max() <= 0.0601  # a robot halts by itself if its commands cease
    changes = rows[np.append(True, (np.diff(rows[:, 1:], axis=0) != 0).any(axis=1)), 1:]
    np.testing.assert_array_equal(changes, [[0, 0, 0], *wanted, [0, 0, 0]])
    assert rows[-1, 0] - rows[(rows[:, 1:] != 0).any(axis=1)][-1, 0] > 0.45


@pytest.mark.parametrize(
    ("fault", "status", "within"),
    [("silent", StepStatus.STOPPED, 0.27), ("nan", StepStatus.STOPPED, 0.27), ("fell", StepStatus.FELL, 0.05)],
)
def test_a_robot_that_is_silent_or_falls_is_halted(
    fault: str, status: StepStatus, within: float, commands: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin = 1.25
    monkeypatch.setenv("STAND_IN_FAULT", f"{fault},{begin}")
    robot = plant()
    robot.start()
    command = np.array([0.5, 0.0, 0.0])
    records = [robot.take_step(command) for _ in range(3)]
    assert [record.status for record in records] == [StepStatus.OK, status, status]
    rows = noted(commands)
    assert (rows[rows[:, 0] < begin][-1, 1:] == command).all()
    assert (rows[rows[:, 0] > begin + within][:, 1:] == 0).all()
    robot.stop()


@pytest.fixture
def walking(commands: Path) -> Iterator["subprocess.Popen[str]"]:
    """The program, after a step."""
    assert commands
    with subprocess.Popen(PROGRAM, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ) as program:
        assert program.stdin
        assert program.stdout
        forward = {"command_vx": 0.4, "command_vy": 0.0, "command_wz": 0.0}
        for message in ({"stepgap": 1, "seconds": SECONDS}, {"start": True}, {"step": 1, "command": forward}):
            program.stdin.write(json.dumps(message) + "\n")
            program.stdin.flush()
            line = program.stdout.readline()
        assert json.loads(line)["status"] == "ok"
        yield program
        program.kill()


@pytest.mark.parametrize("end", ["input ends", "terminated"])
def test_the_robot_comes_to_rest_when_the_program_ends(
    end: str, walking: "subprocess.Popen[str]", commands: Path
) -> None:
    assert noted(commands)[-1, 1] == 0.4
    assert walking.stdin
    if end == "input ends":
        walking.stdin.close()
    else:
        walking.send_signal(signal.SIGTERM)
    assert walking.wait(60) == 0
    rows = noted(commands)
    assert (rows[rows[:, 0] > rows[-1, 0] - 0.4][:, 1:] == 0).all()


def test_a_robot_that_gets_no_further_command_is_halted(walking: "subprocess.Popen[str]", commands: Path) -> None:
    """It then waits for the end: the next step is stopped."""
    while noted(commands)[-1, 1]:  # the program idles until its patience ends
        pass
    assert walking.stdin
    assert walking.stdout
    walking.stdin.write('{"step": 2, "command": {"command_vx": 0.4, "command_vy": 0.0, "command_wz": 0.0}}\n')
    walking.stdin.flush()
    assert json.loads(walking.stdout.readline()) == {"step": 2, "status": "stopped"}
    assert noted(commands)[-1, 1] == 0


@pytest.mark.parametrize("value", ["1.3", "NaN"])
def test_a_command_beyond_the_limits_does_not_reach_the_robot(
    value: str, walking: "subprocess.Popen[str]", commands: Path
) -> None:
    assert walking.stdin
    assert walking.stdout
    walking.stdin.write(f'{{"step": 2, "command": {{"command_vx": {value}, "command_vy": 0.0, "command_wz": 0.0}}}}\n')
    walking.stdin.flush()
    assert "command_vx = " in json.loads(walking.stdout.readline())["error"]
    assert set(noted(commands)[:, 1]) == {0.0, 0.4}
