"""The twin's physics, compiled: the steps of MuJoCo in a tick, long ones in flight and short ones in stance."""

# pyright: reportAttributeAccessIssue=false
# (Numba makes its types at run time.)

from ctypes import c_void_p, cast
from typing import NamedTuple

import mujoco
from llvmlite import binding
from numba import types

from stepgap.base.compiled import as_written
from stepgap.robots.hopper.twin.devices import in_flight, move_ground
from stepgap.robots.hopper.twin.drives import deliver
from stepgap.robots.mujoco_callbacks import c_library

# Compiled code finds MuJoCo's C function by its name; its address is that in the library which Python has loaded.
try:
    binding.add_symbol("mj_step", cast(c_library().mj_step, c_void_p).value)
except (OSError, AttributeError) as error:
    raise ImportError(f"MuJoCo {mujoco.__version__} has no C function mj_step for the twin; install 3.17") from error
_mj_step = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))


class Physics(NamedTuple):
    """What moves the twin: addresses of MuJoCo's models and data, which the twin keeps alive.

    Attributes:
        data: MuJoCo's data, of both models.
        stance: The model with the short steps of stance.
        flight: The model with the long steps of flight.
        stance_steps: Number of steps in a tick of stance.
        flight_steps: Number of steps in a tick of flight.
    """

    data: int
    stance: int
    flight: int
    stance_steps: int
    flight_steps: int


@as_written
def move(devices, views, physics):
    """Moves the twin by one tick.

    MuJoCo's step of length h computes v⁺ = v + h a(q, v), then q⁺ = q + h v⁺. With q taken half a step later than v, at
    which the tick begins and from which it ends half a step back, this is the leapfrog rule, whose error is of second
    order in h.

    Args:
        devices: Record of `Devices`.
        views: `Views`.
        physics: `Physics`.
    """
    rig = devices[0]
    uneven = len(views.uneven.treads) > 0
    model = physics.stance
    steps = physics.stance_steps
    if in_flight(devices, views):
        model = physics.flight
        steps = physics.flight_steps
    _drift(views, 0.5 * rig.tick / steps)
    for step in range(steps):
        deliver(rig, views.memory, views.ctrl, step / steps, (step + 1) / steps)
        if uneven:
            move_ground(devices, views)
        _mj_step(model, physics.data)
    _drift(views, -0.5 * rig.tick / steps)


@as_written
def _drift(views, time):
    """Moves all coordinates on at their present rates."""
    for i in range(len(views.qpos)):
        views.qpos[i] += time * views.qvel[i]
