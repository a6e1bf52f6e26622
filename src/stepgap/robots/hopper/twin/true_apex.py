"""The true motion of the twin's hip and its true apex, compiled; a controller never sees them."""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written


class TrueApex(NamedTuple):
    """The true apex of the present flight so far, or on the ground that of the flight before.

    Attributes:
        speed: Forward speed of the hip at its highest point [m/s]; NaN before the first take-off.
        height: Height of that point [m].
        grounded: Whether the foot is on the ground.
    """

    speed: float = np.nan
    height: float = np.nan
    grounded: bool = False


@as_written
def update_apex(apex, devices, views):
    """Updates the true apex at the end of a tick.

    Between two ticks of 1 ms the hip is at most 1 µm higher, so that nothing is interpolated.

    Args:
        apex: Record of `TrueApex`.
        devices: Record of `Devices`.
        views: `Views`.
    """
    so_far = apex[0]
    if views.touch[0] > 0.0:
        so_far.grounded = 1
        return
    (_, height), (speed, _) = true_hip(devices, views.qpos, views.qvel)
    if so_far.grounded or height > so_far.height:
        so_far.speed = speed
        so_far.height = height
        so_far.grounded = 0


@as_written
def true_hip(devices, qpos, qvel):
    """Position (distance travelled along the circle, height) [m] of the hip and its rate [m/s], deflection included.

    Args:
        devices: Record of `Devices`.
        qpos: MuJoCo's coordinates.
        qvel: Their rates.
    """
    rig = devices[0]
    x = 0.0
    z = 0.0
    x_rate = 0.0
    z_rate = 0.0
    if rig.boom_elastic:
        x = qpos[2]
        z = qpos[3]
        x_rate = qvel[2]
        z_rate = qvel[3]
    if not rig.boom_arc:
        return (qpos[0] + x, qpos[1] + z), (qvel[0] + x_rate, qvel[1] + z_rate)
    radius = rig.boom_length
    sine = np.sin(qpos[1])
    cosine = np.cos(qpos[1])
    return (
        (radius * qpos[0] + x, rig.pivot_height + radius * sine + z * cosine),
        (radius * qvel[0] + x_rate, (radius * cosine - z * sine) * qvel[1] + z_rate * cosine),
    )
