"""A correction from a log alone: ten minutes of commands and odometry of the simulated trot, driven as if by hand.

    ./go python -m benchmarks.odometry_log FOLDER [SEED]

writes `FOLDER/odom.csv` and `FOLDER/cmd.csv`. Commands hold for 0.4 to 4 s and are sent at 10 Hz; they reach the robot
after 60 ms, and odometry comes at 50 Hz after 20 ± 5 ms, with noise of its velocities and of its pose.
docs/steps.md has the commands that follow, and what they gave.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import sys
from pathlib import Path

import mujoco
import numpy as np

from stepgap.robots.velocity.robot import TrottingRobot
from stepgap.robots.velocity.walking_robot import body_velocity
from stepgap.step import Array

DURATION, TO_ROBOT, FROM_ROBOT, JITTER = 600.0, 0.06, 0.02, 0.005  # s
VELOCITY_NOISE, POSE_NOISE = np.array([0.05, 0.05, 0.05]), np.array([0.003, 0.003, 0.003])  # m/s, rad/s; m, rad


def driven(rng: np.random.Generator, duration: float = DURATION) -> tuple[Array, Array]:
    """Times and commands as by hand: one, two or three velocities at once, and pauses; shapes (C,) and (C, 3)."""
    robot = TrottingRobot()
    space = robot.space
    changes = np.cumsum(rng.uniform(0.4, 4.0, int(duration)))
    lower, upper = 0.9 * space.command_lower, 0.9 * space.command_upper
    levels = np.round(
        rng.uniform(lower, upper, (len(changes) + 1, 3)) * (rng.uniform(size=(len(changes) + 1, 3)) < 0.7), 2
    )
    sent = np.unique(np.concatenate([np.arange(0.5, duration, 0.1), changes[changes < duration]]))
    return sent, levels[np.searchsorted(changes, sent, "right")]


def walked(sent: Array, command: Array, duration: float = DURATION) -> Array:
    """Time, velocity forward, left and of turning, x, y and yaw at 50 Hz; shape (R, 7)."""
    robot = TrottingRobot()
    model = robot.gap.of(robot.mjcf_model())
    data, control, rows = mujoco.MjData(model), robot.walking_control(), list[list[float]]()
    robot.stand(model, data)
    control.start(model, data)
    every, sums = round(control.period / model.opt.timestep), np.zeros(3)
    for tick in range(int(duration / model.opt.timestep)):
        if tick % every == 0:
            row = int(np.searchsorted(sent, data.time - TO_ROBOT, "right")) - 1
            data.ctrl[:] = control.control(model, data, command[row] if row >= 0 else np.zeros(3))
        mujoco.mj_step(model, data)
        sums += body_velocity(data)
        if (tick + 1) % (2 * every) == 0:
            w, x, y, z = data.qpos[3:7]
            yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            rows.append([data.time, *(sums / (2 * every)).tolist(), *data.qpos[:2].tolist(), float(yaw)])
            sums[:] = 0
        if robot.failed(model, data):
            raise SystemExit(f"the robot fell at {data.time:.1f} s")
    return np.array(rows)


def main(folder: Path, seed: int) -> None:
    """Writes the log."""
    rng = np.random.default_rng(seed)
    sent, command = driven(rng)
    odometry = walked(sent, command)
    odometry[:, 1:4] += VELOCITY_NOISE * rng.standard_normal((len(odometry), 3))
    odometry[:, 4:] += POSE_NOISE * rng.standard_normal((len(odometry), 3))
    odometry[:, 0] = np.maximum.accumulate(odometry[:, 0] + FROM_ROBOT + rng.normal(0, JITTER, len(odometry)))
    folder.mkdir(parents=True)
    for name, rows, header in (
        ("odom.csv", odometry, "time,vx,vy,wz,x,y,yaw"),
        ("cmd.csv", np.column_stack([sent, command]), "time,vx,vy,wz"),
    ):
        np.savetxt(folder / name, rows, delimiter=",", header=header, comments="", fmt="%.6f")
    print(f"{folder}: {len(odometry)} rows of odometry, {len(command)} commands")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)
