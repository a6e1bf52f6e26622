"""`examples/process/unitree_bridge.py` on the stand-in of rclpy, with the published messages of Unitree."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parent.parent
PROGRAM = ROOT / "examples" / "process" / "unitree_bridge.py"
ASKED, SILENT, END = [0.3, 0.1, -0.2], 2.0, 3.0


def test_commands_become_requests_and_states_become_odometry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = {
        "PYTHONPATH": str(ROOT / "tests/ros2_stand_in"),
        "STAND_IN_LOG": str(tmp_path / "commands"),
        "STAND_IN_SAID": str(tmp_path / "said"),
        "STAND_IN_ASKED": json.dumps([[0.0, *ASKED], [END, 0.0, 0.0, 0.0]]),
        "STAND_IN_RAW": "/go2/cmd_vel",
        "STAND_IN_STAMPED": "0",
        "STAND_IN_COMMAND": "/api/sport/request",
        "STAND_IN_FAULT": f"nobody,{SILENT}",
    }
    for name, value in values.items():
        monkeypatch.setenv(name, value)
    ros = ["--ros-args", "-r", "cmd_vel:=/go2/cmd_vel", "-r", "odom:=/go2/odom"]
    subprocess.run([sys.executable, PROGRAM, *ros], check=True, capture_output=True, env=os.environ)
    rows = np.loadtxt(tmp_path / "commands")
    assert (rows[:-1, 1:] == ASKED).all()
    assert (rows[-1, 1:] == 0).all(), "the robot is stopped"
    assert SILENT + 0.3 < rows[-1, 0] < SILENT + 0.7
    said = [json.loads(line) for line in (tmp_path / "said").read_text().splitlines()]
    assert {topic for _, topic, *_ in said} == {"/go2/odom"}
    np.testing.assert_allclose([numbers for *_, numbers, _ in said], [truth for *_, truth in said], atol=1e-6)
