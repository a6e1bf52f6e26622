"""A log of commands and odometry of a robot whose motion is known."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from stepgap.step import Array

DELAY, LAG = 0.08, 0.15  # s


@dataclass(frozen=True)
class WalkingLog:
    """Odometry at R times and C commands.

    Attributes:
        time: Times of the odometry [s]; shape (R,).
        velocity: Forward, to the left [m/s] and turning [rad/s], without noise; shape (R, 3).
        pose: x, y [m] and yaw [rad], not unwrapped; shape (R, 3).
        sent: Times of the commands [s]; shape (C,).
        command: Commands; shape (C, 3).
    """

    time: Array
    velocity: Array
    pose: Array
    sent: Array
    command: Array

    def mean(self, begin: float, end: float) -> Array:
        """Mean velocity between two times, by the finest sum there is."""
        inside = (self.time >= begin) & (self.time <= end)
        return self.velocity[inside].mean(axis=0)


@cache
def walking(duration: float, seed: int, tick: float = 0.005) -> WalkingLog:
    """A robot that is driven by hand: commands hold for 0.3 to 4 s, and are sent ten times a second."""
    rng = np.random.default_rng(seed)
    changes = np.cumsum(rng.uniform(0.3, 4.0, int(duration)))
    levels = np.round(rng.uniform([-0.2, -0.3, -0.8], [0.8, 0.3, 0.8], (len(changes) + 1, 3)), 2)
    sent = np.unique(np.concatenate([np.arange(0, duration, 0.1), changes[changes < duration]]))
    command = levels[np.searchsorted(changes, sent, "right")]
    time = np.arange(0, duration, tick)
    felt = levels[np.searchsorted(changes, time - DELAY, "right")]
    # It follows with a lag of first order, and moves along its middle direction in each tick.
    followed = tick / LAG * (0.8 * felt + 0.03)
    followed[0] = 0.0
    velocity = np.asarray(lfilter([1.0], [1.0, tick / LAG - 1.0], followed, axis=0), float)
    forward, left, turn = velocity.T
    yaw = np.cumsum(tick * turn)
    middle = yaw - tick * turn / 2
    moved = [forward * np.cos(middle) - left * np.sin(middle), forward * np.sin(middle) + left * np.cos(middle)]
    pose = np.stack([*np.cumsum(tick * np.array(moved), axis=1), (yaw + np.pi) % (2 * np.pi) - np.pi], axis=-1)
    return WalkingLog(time, velocity, pose, sent, command)


def write_walk(log: WalkingLog, folder: Path, noise: float = 0.0, seed: int = 0, every: int = 4) -> None:
    """Writes odom.csv, with every fourth time, and cmd.csv; all velocities and positions have noise [m/s, m, rad]."""
    rng = np.random.default_rng(seed)
    kept = slice(None, None, every)
    values = np.hstack([log.velocity, log.pose])[kept]
    rows = np.column_stack([log.time[kept], values + rng.normal(0, noise, values.shape)])
    np.savetxt(folder / "odom.csv", rows, delimiter=",", header="time,vx,vy,wz,x,y,yaw", comments="", fmt="%.9g")
    rows = np.column_stack([log.sent, log.command])
    np.savetxt(folder / "cmd.csv", rows, delimiter=",", header="time,cx,cy,cw", comments="", fmt="%.9g")
