"""The control of a hop, as threads of one process make it."""

import subprocess
import sys


def test_threads_may_make_their_first_control_at_once() -> None:
    program = """
import threading
import numpy as np
from stepgap.robots.hopper.hop_control import HopControl
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model

robot, made, together = RobotParameters(), [], threading.Barrier(4)

def make():
    together.wait()
    made.append(HopControl(twin_sensor_model(robot, RealityGap()), robot, Gains(), SafetyLimits.of(robot)))

threads = [threading.Thread(target=make) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(len(made))
"""
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (result.stdout, result.stderr) == ("4\n", "")
