"""A correction from a log alone: ten minutes of commands and odometry of the simulated trot, driven as if by hand.

    ./go python -m benchmarks.odometry_log FOLDER SEED       # writes FOLDER/odom.csv and FOLDER/cmd.csv
    ./go python -m benchmarks.odometry_log serve SEED        # is the same robot, for `stepgap run --plant process`

Commands hold for 0.4 to 4 s and are sent at 10 Hz; they reach the robot after 60 ms, and odometry comes at 50 Hz after
20 ± 5 ms, with noise of its velocities and of its pose. docs/steps.md has the commands that use it, and what they gave.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import json
import sys
from pathlib import Path

import mujoco
import numpy as np

from stepgap.mujoco_robots.velocity.robot import TrottingRobot
from stepgap.mujoco_robots.velocity.walking_robot import WalkingRobot, body_velocity
from stepgap.step import Array, StepSpace

DURATION, TO_ROBOT, FROM_ROBOT, JITTER = 600.0, 0.06, 0.02, 0.005  # s
TICK = 0.02  # Time between two samples of the odometry [s]
STEP = 0.5
"""Time of a step in a deployment [s]."""
NOISE = np.array([0.05, 0.05, 0.05, 0.003, 0.003, 0.003])
"""Standard deviation of each number of the odometry [m/s, m/s, rad/s, m, m, rad]."""


class Walking:
    """A walking robot with the differences of `WalkingGap`, whose commands and odometry come late.

    Args:
        rng: Draws the noise of the odometry.
        robot: With its differences; by default the trot.
    """

    def __init__(self, rng: np.random.Generator, robot: WalkingRobot | None = None):
        robot = robot or TrottingRobot()
        self._robot, self._model, self._rng = robot, robot.gap.of(robot.mjcf_model()), rng
        self._data, self._control = mujoco.MjData(self._model), robot.walking_control()
        robot.stand(self._model, self._data)
        self._control.start(self._model, self._data)
        self._sent: list[tuple[float, Array]] = [(-1.0, np.zeros(3))]
        self._velocity = np.zeros(3)

    @property
    def time(self) -> float:
        """Time [s]."""
        return float(self._data.time)

    @property
    def fell(self) -> bool:
        """Whether it lies on the ground."""
        return self._robot.failed(self._model, self._data)

    def velocity(self) -> Array:
        """Mean of its true velocity over the latest 20 ms; shape (3,)."""
        return self._velocity

    def send(self, command: Array) -> None:
        """Gives it a command."""
        self._sent.append((self.time + TO_ROBOT, command))

    def odometry(self) -> Array:
        """Moves for 20 ms: time, velocity forward, to the left and of turning, x, y and yaw; shape (7,)."""
        ticks, velocity = round(self._control.period / self._model.opt.timestep), np.zeros(3)
        count = round(TICK / self._model.opt.timestep)
        for tick in range(count):
            if tick % ticks == 0:
                while len(self._sent) > 1 and self._sent[1][0] <= self.time + 1e-9:
                    del self._sent[0]
                self._data.ctrl[:] = self._control.control(self._model, self._data, self._sent[0][1])
            mujoco.mj_step(self._model, self._data)
            velocity += body_velocity(self._data) / count
        self._velocity = velocity
        w, x, y, z = self._data.qpos[3:7]
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        values = np.array([*velocity, *self._data.qpos[:2], yaw]) + NOISE * self._rng.standard_normal(6)
        return np.append(self.time + FROM_ROBOT + self._rng.normal(0, JITTER), values)


def driven(rng: np.random.Generator, space: StepSpace) -> tuple[Array, Array]:
    """Times and commands as by hand: one, two or three velocities at once, and pauses; shapes (C,) and (C, 3)."""
    changes = np.cumsum(rng.uniform(0.4, 4.0, int(DURATION)))
    levels = rng.uniform(0.9 * space.command_lower, 0.9 * space.command_upper, (len(changes) + 1, 3))
    levels = np.asarray(np.round(levels * (rng.uniform(size=levels.shape) < 0.7), 2), float)
    sent = np.unique(np.concatenate([np.arange(0.5, DURATION, 0.1), changes[changes < DURATION]]))
    return sent, levels[np.searchsorted(changes, sent, "right")]


def write_log(folder: Path, seed: int) -> None:
    """Writes the log."""
    rng = np.random.default_rng(seed)
    (sent, command), robot = driven(rng, TrottingRobot().space), Walking(rng)
    rows, due = list[Array](), 0
    while robot.time < DURATION and not robot.fell:
        while due < len(sent) and sent[due] <= robot.time + 1e-9:
            robot.send(command[due])
            due += 1
        rows.append(robot.odometry())
    odometry = np.array(rows)
    odometry[:, 0] = np.maximum.accumulate(odometry[:, 0])
    sent = TICK * np.ceil(sent / TICK - 1e-9)  # as they were sent here
    folder.mkdir(parents=True)
    for name, table, header in (
        ("odom.csv", odometry, "time,vx,vy,wz,x,y,yaw"),
        ("cmd.csv", np.column_stack([sent, command]), "time,cx,cy,cw"),
    ):
        np.savetxt(folder / name, table, delimiter=",", header=header, comments="", fmt="%.6f")
    print(f"{folder}: {len(odometry)} rows of odometry, {len(command)} commands{', then it fell' * robot.fell}")


def serve(seed: int) -> None:
    """Moves the same robot as the program of `stepgap run --plant process`, as fast as it is computed."""
    robot, space = Walking(np.random.default_rng(seed)), TrottingRobot().space

    def step(command: Array) -> dict[str, float]:
        robot.send(command)
        rows = np.array([robot.odometry() for _ in range(round(STEP / TICK))])
        return dict(zip(space.state_names, rows[:, 1:4].mean(axis=0).tolist(), strict=True))

    for line in sys.stdin:
        message = json.loads(line)
        if "stepgap" in message:
            quantities = {"state": space.state, "command": space.command}
            reply = {"ready": {kind: {each.name: each.unit for each in quantities[kind]} for kind in quantities}}
        elif "start" in message:
            reply = {"state": step(np.zeros(3))}
        elif "step" in message:
            state = step(np.array([message["command"][name] for name in space.command_names]))
            reply = {"step": message["step"]} | ({"status": "fell"} if robot.fell else {"next": state, "status": "ok"})
        else:
            break
        print(json.dumps(reply), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "serve":
        serve(int(sys.argv[2]))
    else:
        write_log(Path(sys.argv[1]), int(sys.argv[2]))
