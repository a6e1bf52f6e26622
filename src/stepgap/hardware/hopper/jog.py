"""The first torque of a robot, for `stepgap rig jog`: one motor at a time gets an alternating torque that grows slowly.

A torque τ sin ωt moves a link of inertia I by no more than τ / (I ω²), a degree for 1 N·m at 20 Hz, and its mean is
zero. So the motion is bounded without any sensor, whatever the signs and scales in rig.toml are. Gravity and slow
motions of a limp leg are not at this frequency and do not disturb the measurement of the answer.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isnan, nan, radians, sin, tau
from typing import TypeVar

import numpy as np

from stepgap.plants.tick_control import (
    FinishedStep,
    Mode,
    Order,
    RobotControl,
    TickControl,
    TickFlag,
)
from stepgap.plants.ticks.log_description import FieldMeaning
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import HEALTHY, Health, Reading, Rig, Torques
from stepgap.robots.hopper.tick.hop_control import HopControl, HopperControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.step import Array, StepSpace, StepStatus

LARGEST_TORQUE = 1.0
"""Largest torque [N·m]."""

LARGEST_SPEED = 2.0
"""Speed of a top link at which torque goes off for good [rad/s]."""

FREQUENCY = 20.0
"""Frequency of the torque [Hz]."""

RISE = 1.0
"""Rate at which its amplitude rises [N·m/s]."""

ENOUGH = radians(0.2)
"""Amplitude of a link at which the torque rises no further [rad]."""

MEASURED_TIME = 0.3
"""Time for which the amplitude is then kept, to measure the answer; a multiple of the period [s]."""

_KEPT_FLAGS = TickFlag.STOPPED | TickFlag.BRAKES | TickFlag.UNREADABLE


def jog_limits(limits: SafetyLimits) -> SafetyLimits:
    """Limits while a motor is tried: those of the robot, but a small torque, a small speed, and no brake."""
    return replace(
        limits,
        torque=min(LARGEST_TORQUE, limits.torque),
        joint_speed=min(LARGEST_SPEED, limits.joint_speed),
        first_hops=0,
        brake_ticks=0,
    )


Angle = TypeVar("Angle", float, Array)


def link_angles(alpha_1: Angle, alpha_2: Angle) -> tuple[Angle, Angle]:
    """Angles of the top links of motor 1 and 2 [rad]."""
    return alpha_1 + alpha_2, alpha_1 - alpha_2


class JogControl(TickControl):
    """Control of a robot of which one motor is tried; a step is its whole trial.

    Args:
        control: Control with `jog_limits`, whose sensors and safety function are used.
        motor: Number of the motor, 1 or 2.
        tick: Time between two ticks [s].
    """

    def __init__(self, control: HopControl, motor: int, tick: float):
        self._control, self._motor = control, motor
        self._began, self._kept_from, self._ended = nan, nan, False
        self._angles = deque[tuple[float, float]](maxlen=1 + round(1 / (FREQUENCY * tick)))

    @property
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log."""
        return self._control.units

    @property
    def motors(self) -> int:
        """Number of motors."""
        return self._control.motors

    def tick(
        self,
        time: float,
        reading: Reading,
        order: Order,
        applied: Torques,
        health: Health = HEALTHY,
        age: float = 0.0,
    ) -> tuple[Torques, int]:
        """Computes a tick; only an order to step gives torque."""
        tries = order.mode == Mode.STEP and not self._ended
        torque = self._torque(time) if tries else 0.0
        torques = (torque, 0.0) if self._motor == 1 else (0.0, torque)
        given, flags = self._control.tick(time, reading, Order(Mode.TORQUE, 1.0, torques), applied, health, age)
        return given, flags & _KEPT_FLAGS | (TickFlag.STEP_ENDED if tries and self._ended else 0)

    def _torque(self, time: float) -> float:
        """Torque of the motor at a time [N·m]."""
        if isnan(self._began):
            self._began = time
        motion = self._control.motion
        self._angles.append(link_angles(motion.alpha_1, motion.alpha_2))
        most = min(RISE * (time - self._began), LARGEST_TORQUE)
        if isnan(self._kept_from) and (most == LARGEST_TORQUE or self._oscillation() >= ENOUGH):
            self._kept_from = time
        if not isnan(self._kept_from):
            most = min(RISE * (self._kept_from - self._began), LARGEST_TORQUE)
        sine = sin(tau * FREQUENCY * (time - self._began))
        at_rest = abs(sine) > 0.95  # an inertia is at rest when the torque is largest
        self._ended = at_rest and time - self._kept_from >= MEASURED_TIME
        return most * sine

    def _oscillation(self) -> float:
        """Present deflection of the links at the frequency of the torque [rad]; constant speed does not count."""
        angles = self._angles
        if len(angles) < (angles.maxlen or 0):
            return 0.0
        now, half, whole = angles[-1], angles[len(angles) // 2], angles[0]
        return max(abs(now[i] - 2 * half[i] + whole[i]) / 4 for i in (0, 1))

    def row(self, applied: Torques) -> Sequence[float]:
        """The row of the last tick for the log."""
        return self._control.row(applied)

    def finished_step(self) -> FinishedStep:
        """The end of the trial, which has no apex."""
        return FinishedStep(np.full(2, np.nan), np.full(2, np.nan), np.zeros(2))

    def failed_step(self, applied: Torques | None) -> FinishedStep:
        """As `finished_step`."""
        del applied
        return self.finished_step()

    @property
    def status(self) -> StepStatus:
        """OK until the safety function stops the robot."""
        return StepStatus.STOPPED if self.stopped else StepStatus.OK

    @property
    def stopped(self) -> str:
        """Reasons for which the safety function stopped the robot."""
        return self._control.stopped


@dataclass(frozen=True)
class HopperJog(RobotControl):
    """Control with which one motor of the hopper is tried.

    Attributes:
        hopping: Control with which it will hop.
        motor: Number of the motor, 1 or 2.
    """

    hopping: HopperControl
    motor: int

    @property
    def space(self) -> StepSpace:
        """That of the hopping robot."""
        return self.hopping.space

    @property
    def units(self) -> Mapping[str, str]:
        """Fields of a row of the tick log."""
        return self.hopping.units

    @property
    def consent_request(self) -> str:
        """What a person is asked before the motor gets torque."""
        return (
            "The robot must hang with its foot off the ground, and nobody may be within its reach. Hold the space bar: "
            "the motor vibrates its link for a second or two. Torque goes off when you release the key."
        )

    def meaning(self, rig: Rig) -> FieldMeaning:
        """As while it hops, with the limits of the jog."""
        return self._limited(rig).meaning(rig)

    def control(self, rig: Rig) -> JogControl:
        """Creates the control of a rig."""
        return JogControl(self._limited(rig).control(rig), self.motor, rig.sensor_model.tick)

    def limp_limits(self, rig: Rig) -> RigLimits:
        """Limits of a rig whose motors get no torque."""
        return self.hopping.limp_limits(rig)

    def step_ends(self, ticks: TickTable) -> np.ndarray:
        """There are no steps; shape (0,)."""
        del ticks
        return np.empty(0, int)

    def describe(self, rig: Rig, tick: Mapping[str, float]) -> dict[str, str]:
        """Description of a logged tick."""
        return self.hopping.describe(rig, tick)

    def _limited(self, rig: Rig) -> HopperControl:
        return replace(self.hopping, limits=jog_limits(self.hopping.limits_of(rig)))
