"""The first torque of a robot, for `stepgap rig jog`: one motor at a time gets an alternating torque that grows slowly.

A torque τ sin ωt moves a link of inertia I by no more than τ / (I ω²), a degree for 1 N·m at 20 Hz, and its mean is
zero. So the motion is bounded without any sensor, whatever the signs and scales in rig.toml are. Gravity and slow
motions of a limp leg are not at this frequency and do not disturb the measurement of the answer.
"""

from collections import deque
from dataclasses import dataclass, replace
from math import isnan, nan, radians, sin, tau
from typing import Any, Self, TypeVar

import numpy as np

from stepgap.plants.tick_control import FinishedStep, Mode, Order, TickFlag
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.rig import HEALTHY, Health, Reading, Rig, Torques
from stepgap.robots.hopper.tick.hop_control import HopControl, HopperControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.sensors import HopperSensorModel, hopper_sensors
from stepgap.step import Array, StepStatus

LARGEST_TORQUE = 1.0  # Largest torque [N·m]
LARGEST_SPEED = 2.0  # Speed of a top link at which torque goes off for good [rad/s]
FREQUENCY = 20.0  # Frequency of the torque [Hz]
RISE = 1.0  # Rate at which its amplitude rises [N·m/s]
ENOUGH = radians(0.2)  # Amplitude of a link at which the torque rises no further [rad]
MEASURED_TIME = 0.3  # Time for which the amplitude is then kept, to measure the answer; a multiple of the period [s]

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


class JogControl(HopControl):
    """Control of a robot of which one motor is tried, with its sensors and safety function; a step is the whole trial.

    Args:
        motor: Number of the motor, 1 or 2.
        control: Arguments of `HopControl`, of which the limits are those of `jog_limits`.
    """

    def __init__(self, motor: int, sensor_model: HopperSensorModel, *control: Any):
        super().__init__(sensor_model, *control)
        self._motor = motor
        self._began = nan
        self._kept_from = nan
        self._ended = False
        self._angles = deque[tuple[float, float]](maxlen=1 + round(1 / (FREQUENCY * sensor_model.tick)))

    def tick(
        self, time: float, reading: Reading, order: Order, applied: Torques, health: Health = HEALTHY, age: float = 0.0
    ) -> tuple[Torques, int]:
        """Computes a tick; only an order to step gives torque."""
        tries = order.mode == Mode.STEP and not self._ended
        torque = self._torque(time) if tries else 0.0
        torques = (torque, 0.0) if self._motor == 1 else (0.0, torque)
        given, flags = super().tick(time, reading, Order(Mode.TORQUE, 1.0, torques), applied, health, age)
        return given, flags & _KEPT_FLAGS | (TickFlag.STEP_ENDED if tries and self._ended else 0)

    def _torque(self, time: float) -> float:
        if isnan(self._began):
            self._began = time
        motion = self.motion
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
        now = angles[-1]
        half = angles[len(angles) // 2]
        whole = angles[0]
        return max(abs(now[i] - 2 * half[i] + whole[i]) / 4 for i in (0, 1))

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


@dataclass(frozen=True, kw_only=True)
class HopperJog(HopperControl):
    """Control with which one motor of the hopper is tried.

    Attributes:
        motor: Number of the motor, 1 or 2.
    """

    motor: int

    @classmethod
    def of(cls, hopping: HopperControl, motor: int) -> Self:
        """The trial of a motor of a robot that will hop with this control."""
        return cls(**vars(hopping), motor=motor)

    @property
    def consent_request(self) -> str:
        """What a person is asked before the motor gets torque."""
        return (
            "The robot must hang with its foot off the ground, and nobody may be within its reach. Hold the space bar: "
            "the motor vibrates its link for a second or two. Torque goes off when you release the key."
        )

    def control(self, rig: Rig) -> JogControl:
        """Creates the control of a rig."""
        sensors = hopper_sensors(rig.sensor_model)
        return JogControl(self.motor, sensors, self.robot, self.gains, self.limits_of(rig), self.ground)

    def limits_of(self, rig: Rig) -> SafetyLimits:
        """Those with which it hops, within the limits of the jog."""
        return jog_limits(super().limits_of(rig))

    def step_ends(self, ticks: TickTable) -> np.ndarray:
        """There are no steps; shape (0,)."""
        del ticks
        return np.empty(0, int)
