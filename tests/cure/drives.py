"""Logs of a robot that was driven by hand: it follows its commands with delay, lag and gains, and drifts."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from stepgap.step import Array

TICK, LAG, SWAY = 0.02, 0.1, 0.4
"""Time between two rows and time constant [s]; period of the gait [s]."""
GAINS = np.array([0.8, 0.8, 0.8])
DRIFT = np.array([0.02, 0.06, -0.1])

Change = Callable[[Array], Array]
"""What is changed in the odometry: rows of time, vx, vy, wz, x, y and yaw."""


def drive(seconds: float = 100.0, seed: int = 0, delay: float = 0.06) -> tuple[Array, Array]:
    """Rows of odometry (time, vx, vy, wz, x, y, yaw) and of commands (time, vx, vy, wz)."""
    rng = np.random.default_rng(seed)
    changes = np.cumsum(rng.uniform(0.6, 4.5, 200)).round(1)  # commands are sent every 0.1 s
    levels = rng.uniform([-0.2, -0.3, -0.6], [0.8, 0.3, 0.6], (201, 3)).round(2) * (rng.uniform(size=(201, 3)) < 0.7)
    time = np.arange(0, seconds, TICK)
    velocity, pose, rows = np.zeros(3), np.zeros(3), list[Array]()
    for now in time:
        wanted = GAINS * levels[np.searchsorted(changes, now - delay + 1e-9, "right")] + DRIFT
        velocity = velocity + TICK / LAG * (wanted - velocity)
        pose = pose + TICK * np.append(turned(velocity[:2], pose[2]), velocity[2])
        sway = np.array([0.02, 0.05, 0.05]) * np.sin(2 * np.pi * now / SWAY + np.arange(3))
        rows.append(np.concatenate([[now], velocity + sway + rng.normal(0, 0.02, 3), pose]))
    sent = np.arange(0, seconds, 0.1)
    return np.array(rows), np.column_stack([sent, levels[np.searchsorted(changes, sent + 1e-9, "right")]])


def turned(vector: Array, angle: float) -> Array:
    """A vector turned by an angle."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([cosine * vector[0] - sine * vector[1], sine * vector[0] + cosine * vector[1]])


def written(folder: Path, odometry: Array, commands: Array) -> str:
    """Writes two tables; the text with which they are read."""
    for name, table, header in (
        ("odom.csv", odometry, "time,vx,vy,wz,x,y,yaw"),
        ("cmd.csv", commands, "time,command_vx,command_vy,command_wz"),
    ):
        np.savetxt(folder / name, table, delimiter=",", header=header, comments="", fmt="%.6f")
    return f"{folder / 'odom.csv'}+{folder / 'cmd.csv'}"
