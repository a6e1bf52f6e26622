"""Connects `stepgap run --plant process` to a walking robot on ROS 2 that is commanded velocities.

    stepgap run --robot velocity --plant process --out runs/ros2 -- python3 examples/process/ros2_robot.py
    stepgap run … -- python3 examples/process/ros2_robot.py --ros-args -r cmd_vel:=/go2/cmd_vel -p stamped:=true

A step begins with a new command on cmd_vel (geometry_msgs/Twist, or TwistStamped with the parameter stamped), which is
repeated until the step ends after the duration that StepGap says, `walk.seconds`. Its state is the mean velocity of the
step by odom (nav_msgs/Odometry, velocities in the frame of the robot). With --pose TOPIC, a geometry_msgs/PoseStamped
such as of motion capture, it is the displacement in the step, as seen by the robot. Topics can be remapped; parameters
are stamped, and limit_vx, limit_vy, limit_wz, the largest commands that the robot may get.

The robot gets the command zero when no odometry has come for SILENCE, when StepGap has no command for PATIENCE,
when the robot has tipped over, and when this program ends.
"""

import argparse
import json
import math
import queue
import signal
import sys
import threading
from itertools import pairwise

import rclpy
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from rclpy.clock import Clock, ClockType
from rclpy.qos import qos_profile_sensor_data
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

SILENCE, PATIENCE, REPEAT, REST = 0.2, 1.0, 0.05, 0.5  # s
TIPPED = 0.5  # cosine of the angle between the robot's vertical axis and the vertical
LIMITS = {"vx": 1.2, "vy": 0.5, "wz": 1.0}  # largest commands that this robot may get, if no parameter says another
UNITS = {
    "state": {"vx": "m/s", "vy": "m/s", "wz": "rad/s"},
    "command": {"command_vx": "m/s", "command_vy": "m/s", "command_wz": "rad/s"},
}
ZERO = [0.0, 0.0, 0.0]
STEADY = Clock(clock_type=ClockType.STEADY_TIME)


def now() -> float:
    """Time since any moment [s]; it does not jump."""
    return 1e-9 * STEADY.now().nanoseconds


class Robot:
    """The topics of the robot, and what its odometry says of the present step."""

    def __init__(self, node, pose_topic: str):
        self.node, self.command, self.published, self.heard = node, list[float](), -math.inf, -math.inf
        self.samples: list[tuple[float, ...]] = []  # of the present step: time of the robot [s], and velocities or pose
        self.upright, self.halted, self.by_pose = True, False, bool(pose_topic)
        self.seconds = math.nan  # duration of a step [s], which StepGap says
        self.limits = {
            f"command_{axis}": node.declare_parameter(f"limit_{axis}", most).value for axis, most in LIMITS.items()
        }
        self.is_stamped = node.declare_parameter("stamped", False).value
        self.commands = node.create_publisher(TwistStamped if self.is_stamped else Twist, "cmd_vel", 1)
        # Reliable and best-effort publishers both reach a subscription of sensor data.
        if pose_topic:
            node.create_subscription(PoseStamped, pose_topic, self.on_pose, qos_profile_sensor_data)
        else:
            node.create_subscription(Odometry, "odom", self.on_odometry, qos_profile_sensor_data)

    def on_odometry(self, message: Odometry) -> None:
        """A sample of velocity."""
        twist = message.twist.twist
        self.add(message.header.stamp, message.pose.pose, (twist.linear.x, twist.linear.y, twist.angular.z))

    def on_pose(self, message: PoseStamped) -> None:
        """A sample of position and yaw."""
        place, turn = message.pose.position, message.pose.orientation
        yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
        self.add(message.header.stamp, message.pose, (place.x, place.y, yaw))

    def add(self, stamp, pose, values: tuple[float, ...]) -> None:
        """Adds a sample, unless it is no number or not newer than the last one; such samples count as silence."""
        stamped = stamp.sec + 1e-9 * stamp.nanosec
        if all(map(math.isfinite, values)) and not (self.samples and stamped <= self.samples[-1][0]):
            self.samples.append((stamped, *values))
            self.heard = now()
            self.upright = 1 - 2 * (pose.orientation.x**2 + pose.orientation.y**2) > TIPPED

    def send(self, command: list[float]) -> None:
        """Gives the robot another command."""
        self.command, self.published = command, -math.inf
        self.spin()

    def spin(self) -> None:
        """Repeats the command if it is due, and receives what has come."""
        if self.command and now() - self.published >= REPEAT:  # before the start another program may move the robot
            message = TwistStamped() if self.is_stamped else Twist()
            if self.is_stamped:
                message.header.stamp = self.node.get_clock().now().to_msg()
            twist = message.twist if self.is_stamped else message
            twist.linear.x, twist.linear.y, twist.angular.z = self.command
            self.commands.publish(message)
            self.published = now()
        rclpy.spin_once(self.node, timeout_sec=0.01)

    def wait_for_odometry(self) -> None:
        """Returns when the robot is heard; StepGap ends this program if it takes longer than [process] start."""
        while now() - self.heard > SILENCE:
            self.spin()

    def step(self, command: list[float]) -> str:
        """Moves for a step by the clock of the robot; the status of the step."""
        self.samples = self.samples[-1:]
        if not self.halted:
            self.send(command)
        while not self.halted and self.samples[-1][0] - self.samples[0][0] < self.seconds:
            self.spin()
            self.watch()
        return "ok" if not self.halted else "stopped" if self.upright else "fell"

    def watch(self, late: bool = False) -> None:
        """Halts the robot, for good, if there is no odometry, if it has tipped over, or if StepGap is late."""
        if late or not self.upright or now() - self.heard > SILENCE:
            self.halted = True
            self.send(ZERO)

    def state(self) -> dict[str, float]:
        """Mean velocity of the step, forward, to the left and turning."""
        first, last = self.samples[0], self.samples[-1]
        if self.by_pose:
            total = displacement(self.samples)
        else:  # a sample is the velocity since the one before
            pairs = list(pairwise(self.samples))
            total = [sum(b[axis] * (b[0] - a[0]) for a, b in pairs) for axis in (1, 2, 3)]
        return {name: part / (last[0] - first[0]) for name, part in zip(UNITS["state"], total, strict=True)}


def displacement(samples: list[tuple[float, ...]]) -> list[float]:
    """Sum of the displacements between successive poses, each in the frame of the robot."""
    total = [0.0, 0.0, 0.0]
    for (_, x0, y0, yaw0), (_, x1, y1, yaw1) in pairwise(samples):
        turn = math.remainder(yaw1 - yaw0, math.tau)
        yaw = yaw0 + turn / 2
        total[0] += math.cos(yaw) * (x1 - x0) + math.sin(yaw) * (y1 - y0)
        total[1] += math.cos(yaw) * (y1 - y0) - math.sin(yaw) * (x1 - x0)
        total[2] += turn
    return total


def checked(command: dict[str, float], limits: dict[str, float]) -> list[float]:
    """The command as a list; raises ValueError if it is not one that this robot may get."""
    for name, most in limits.items():
        if not abs(command[name]) <= most:  # also for NaN
            raise ValueError(f"{name} = {command[name]}, but this robot may get at most {most}")
    return [command[name] for name in UNITS["command"]]


def answer(robot: Robot, message: dict) -> dict:
    """The answer to a line of StepGap."""
    if "stepgap" in message:
        robot.seconds = message["seconds"]
        return {"ready": UNITS}
    if "start" in message:
        robot.wait_for_odometry()
        if (status := robot.step(ZERO)) != "ok":
            raise RuntimeError(f"the robot {status} before its first step")
        return {"state": robot.state()}
    status = robot.step(checked(message["command"], robot.limits))
    return {"step": message["step"], "status": status, **({"next": robot.state()} if status == "ok" else {})}


def serve(robot: Robot) -> None:
    """Answers lines until StepGap says stop or the input ends."""
    lines: queue.Queue[str] = queue.Queue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        lines.put("")

    threading.Thread(target=read, daemon=True).start()
    answered = now()
    while True:
        robot.spin()
        if robot.command and not robot.halted:
            robot.watch(late=now() - answered > PATIENCE)
        try:
            line = lines.get(timeout=0.005)
        except queue.Empty:
            continue
        if not line or "stop" in (message := json.loads(line)):
            return
        try:
            reply = answer(robot, message)
        except (ValueError, RuntimeError) as error:
            reply = {"error": str(error)}
        print(json.dumps(reply), flush=True)
        answered = now()


def main() -> None:
    """Connects, serves, and brings the robot to rest."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--pose", default="", metavar="TOPIC", help="PoseStamped to use instead of odom")
    pose_topic = parser.parse_args(remove_ros_args(sys.argv)[1:]).pose
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # runs what is below `finally`
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)  # its own handlers end all topics at once
    robot = Robot(rclpy.create_node("stepgap"), pose_topic)
    try:
        serve(robot)
    finally:
        ended = now()
        robot.send(ZERO)
        while now() - ended < REST:
            robot.spin()


if __name__ == "__main__":
    main()
