"""Connects `stepgap run --plant process` to a robot on ROS 2; not tested, because no ROS 2 was available.

The controller of the robot subscribes to /step_command (fx, fy) and publishes the state at every apex, (speed, height),
on /apex:

    stepgap run --plant process --out runs/ros2 -- python3 examples/process/ros2_robot.py
"""

import json
import sys

import rclpy
from std_msgs.msg import Float64MultiArray

UNITS = {"state": {"speed": "m/s", "height": "m"}, "command": {"fx": "N", "fy": "N"}}

rclpy.init()
node, apexes = rclpy.create_node("stepgap"), []
commands = node.create_publisher(Float64MultiArray, "/step_command", 1)
node.create_subscription(Float64MultiArray, "/apex", lambda message: apexes.append(list(message.data)), 1)


def next_apex() -> dict[str, float]:
    """Waits for the robot's next apex; StepGap ends this program if it takes longer than [process] step."""
    apexes.clear()
    while not apexes:
        rclpy.spin_once(node)
    return dict(zip(UNITS["state"], apexes[-1], strict=True))


for line in sys.stdin:
    message = json.loads(line)
    if "stepgap" in message:
        answer = {"ready": UNITS}
    elif "start" in message:
        answer = {"state": next_apex()}
    elif "step" in message:
        commands.publish(Float64MultiArray(data=[message["command"][name] for name in UNITS["command"]]))
        answer = {"step": message["step"], "next": next_apex(), "status": "ok"}
    else:
        break
    print(json.dumps(answer), flush=True)
commands.publish(Float64MultiArray(data=[0.0, 0.0]))
