"""What robots that hop on a virtual spring share: the phases of a step, and a control law that keeps its phase."""

from collections.abc import Callable
from typing import Any

from stepgap.base.compiled import compiled
from stepgap.mujoco_robots.mjcf.mjcf_robot import ControlLaw
from stepgap.step import Array

FLIGHT = 0
COMPRESSION = 1
THRUST = 2
"""Phases of a step."""


@compiled
def phase_after(phase, lands, rebounds, leaves):
    """Phase of this tick, from that of the tick before.

    Args:
        phase: Phase of the tick before.
        lands: Whether a foot touches the ground while the robot falls.
        rebounds: Whether the spring becomes longer.
        leaves: Whether the spring is at its rest length, or no foot touches the ground.
    """
    if phase == FLIGHT and lands:
        phase = COMPRESSION
    if phase == COMPRESSION and rebounds:
        phase = THRUST
    if phase == THRUST and leaves:
        phase = FLIGHT
    return phase


def phased(tick: Callable[..., int], law: Any) -> ControlLaw:
    """A control law that starts in flight.

    Args:
        tick: Compiled function of `law`, the phase before, whether a foot touches the ground, positions, velocities and
            the command; fills `data.ctrl`, its last argument, and returns the phase.
        law: Gains for compiled code.
    """
    phase = FLIGHT

    def control(_model: Any, data: Any, command: Array) -> None:
        nonlocal phase
        phase = tick(law, phase, data.ncon > 0, data.qpos, data.qvel, command, data.ctrl)

    return control
