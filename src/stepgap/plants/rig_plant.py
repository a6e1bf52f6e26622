"""The 1 kHz loop on a rig: read → estimate → phase → torque → limit → write."""

from collections.abc import Callable
from math import isnan, sin, tau
from typing import NamedTuple

import numpy as np

from stepgap.hopper.dynamics import leg_inertia, masses_of
from stepgap.hopper.joint_control import flight_torque, joint_law, stance_torque
from stepgap.hopper.leg import foot, four_bar
from stepgap.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.hopper.reduced import uprightness
from stepgap.hybrid.compiled import compiled
from stepgap.plants.estimator import FlightFit, JointRates
from stepgap.plants.phases import Phase, next_phase
from stepgap.plants.plant import Plant
from stepgap.plants.safety import HEALTHY, Limited, Motion, Watch, check_torque
from stepgap.rigs.limits import SafetyLimits
from stepgap.rigs.rig import Reading, Rig, RigFault
from stepgap.step import ADVICE, Array, Reason, StepRecord, StepSpace

STEP_TIMEOUT = 4.0
"""Longest time from apex to apex [s]."""


class Tick(NamedTuple):
    """All that happened in one tick; angles [rad], torques [N·m]."""

    time: float
    reading: Reading
    phase: Phase
    alpha_1: float
    alpha_2: float
    asked: tuple[float, float]
    applied: tuple[float, float]
    limited: Limited


class LegState(NamedTuple):
    """What the joint encoders say of the leg and, if the foot stands still, of the hip.

    Attributes:
        length: ℓ [m].
        hip_rate: ẏ of the hip over a standing foot [m/s].
        shift_x: Forward offset of the free body from the hip, S sin α₁ / m_x [m].
        shift_y: Upward offset, −S cos α₁ / m_y [m].
    """

    length: float
    hip_rate: float
    shift_x: float
    shift_y: float


@compiled
def _leg_state(masses, alpha_1, alpha_2, rate_1, rate_2):
    bar = four_bar(masses.leg, alpha_2)
    toe = foot(masses.leg, bar, alpha_1)
    moment = leg_inertia(masses, bar, alpha_2).s
    return (
        bar.length,
        -(toe.y_1 * rate_1 + toe.y_2 * rate_2),
        moment * np.sin(alpha_1) / masses.x,
        -moment * np.cos(alpha_1) / masses.y,
    )


@compiled
def _stance_torque(law, alpha_1, alpha_2, force_x, force_y):
    bar = four_bar(law.leg, alpha_2)
    toe = foot(law.leg, bar, alpha_1)
    return stance_torque(law, bar, toe, np.sin(alpha_1), np.cos(alpha_1), force_x, force_y)


@compiled
def _lost_force(law, alpha_1, alpha_2, lost_1, lost_2):
    """Force on the body that torques (lost_1, lost_2) make in stance: the inverse of τ = −Jᵀ force."""
    toe = foot(law.leg, four_bar(law.leg, alpha_2), alpha_1)
    q_1, q_2 = lost_1 + lost_2, lost_1 - lost_2
    determinant = toe.x_1 * toe.y_2 - toe.x_2 * toe.y_1
    return (toe.y_1 * q_2 - toe.y_2 * q_1) / determinant, (toe.x_2 * q_1 - toe.x_1 * q_2) / determinant


class RigPlant(Plant):
    """Hops a rig with the joint control of Sec. 4.1.

    A step ends, and the next command is due, when the apex has just been passed; the command acts
    after the following mid-stance. The applied command is the one within bounds, less what the
    drives and the safety limits took from the torques while it acted.

    Args:
        rig: What moves.
        robot: The robot the rig is taken to be.
        gains: Joint controller.
        bounds: Range of the command.
        on_tick: Called with every `Tick`, for logs.
        limits: What the safety function allows; without, what it allows this robot in simulation.
    """

    def __init__(
        self,
        rig: Rig,
        robot: RobotParameters,
        gains: Gains,
        bounds: CommandBounds,
        on_tick: Callable[[Tick], None] | None = None,
        limits: SafetyLimits | None = None,
    ):
        self._rig, self._space, self._on_tick = rig, bounds.space(), on_tick
        self._law, self._masses, self._limits = (
            joint_law(robot, gains),
            masses_of(robot),
            limits or SafetyLimits.of(robot),
        )
        self._state = np.full(2, np.nan)
        self._reset()

    def _reset(self) -> None:
        self._time, self._phase, self._phase_start = 0.0, Phase.FALLING, 0.0
        self._speed, self._x_start = 0.0, 0.0
        self._fit, self._rates = FlightFit(), JointRates(self._rig.layout.tick)
        self._lost_x = self._lost_y = 0.0
        self._push_ticks = 0
        self._watch, self._reason = Watch(), Reason.OK

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fy]."""
        return self._space

    def start(self) -> Array:
        """Connects, holds the landing posture until the robot is let go, and hops once without command.

        Raises:
            RigFault: The rig cannot be had, or the first hop failed.
        """
        self._rig.connect()
        self._reset()
        self._state = self._hop((0.0, 0.0))
        if self._reason != Reason.OK:
            raise RigFault(
                f"the first hop failed: {self._reason.status}: {ADVICE[self._reason]}; "
                "on the twin, see whether the differences in [gap] leave a robot that can hop"
            )
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        """Hops once; a fall, a fault or a safety stop is a record without a next state, and torque is off."""
        asked = np.asarray(command, float)
        within = np.clip(asked, self._space.command_lower, self._space.command_upper)
        state = self._state
        if np.isnan(within).any():
            self._reason = Reason.INVALID
        self._state = self._hop((float(within[0]), float(within[1])))
        lost = np.array([self._lost_x, self._lost_y]) / max(1, self._push_ticks)
        return StepRecord(state, asked, within - lost, self._state, self._reason)

    def stop(self) -> None:
        """Torque off."""
        self._rig.close()

    def _hop(self, command: tuple[float, float]) -> Array:
        """Ticks from just after an apex to just after the next; NaN and a reason if there is none."""
        self._lost_x = self._lost_y = 0.0
        self._push_ticks = 0
        deadline = self._time + STEP_TIMEOUT
        left_ground = False
        while self._reason == Reason.OK:
            before = self._phase
            try:
                self._tick(command)
            except RigFault:
                self._reason = Reason.STOPPED
            left_ground = left_ground or before == Phase.PUSHING != self._phase
            if self._reason == Reason.OK and left_ground and self._phase == Phase.FALLING:
                state = self._apex()
                if np.isfinite(state).all():
                    return state
            if self._time > deadline:
                self._reason = Reason.NO_APEX if left_ground else Reason.NO_TAKE_OFF
        self._rig.close()
        return np.full(2, np.nan)

    def _apex(self) -> Array:
        """State at the apex just passed; NaN of a flight that is too short to tell: the robot bounced, and hops on."""
        speed = self._fit.speed()
        if isnan(speed):
            return np.full(2, np.nan)
        self._speed = speed
        return np.array([speed, self._fit.apex_height() - self._leg.shift_y])

    def _tick(self, command: tuple[float, float]) -> None:
        rig, layout = self._rig, self._rig.layout
        reading = rig.read()
        phi_1 = reading.motor_1 * tau / layout.motor_counts
        phi_2 = reading.motor_2 * tau / layout.motor_counts
        alpha_1, alpha_2 = 0.5 * (phi_1 + phi_2), 0.5 * (phi_1 - phi_2)
        rate_1, rate_2 = self._rates.update(alpha_1, alpha_2)
        x = layout.boom_length * reading.boom_horizontal * tau / layout.boom_counts_horizontal
        y = layout.pivot_height + layout.boom_length * sin(reading.boom_vertical * tau / layout.boom_counts_vertical)
        self._leg = LegState(*_leg_state(self._masses, alpha_1, alpha_2, rate_1, rate_2))
        self._update_phase(reading.contact_force, x, y)

        if self._phase in (Phase.LOADING, Phase.PUSHING):
            force_x, force_y = command if self._phase == Phase.PUSHING else (0.0, 0.0)
            torque = _stance_torque(self._law, alpha_1, alpha_2, force_x, force_y)
        else:
            torque = flight_torque(self._law, alpha_1, alpha_2, rate_1, rate_2, self._flight_speed())
        motion = Motion(alpha_1, alpha_2, rate_1, rate_2, self._leg.length, y)
        checked = check_torque(self._limits, self._watch, motion, HEALTHY, torque[0], torque[1])
        self._watch = checked.watch
        applied = rig.write(checked.torque_1, checked.torque_2)
        if self._phase == Phase.PUSHING:
            self._count_loss(alpha_1, alpha_2, torque[0] - applied[0], torque[1] - applied[1])
        if checked.limited and checked.limited.stops:
            self._reason = Reason.STOPPED
        elif uprightness(self._law.leg, y, alpha_1, alpha_2) < 0:
            self._reason = Reason.FELL
        if self._on_tick:
            self._on_tick(Tick(self._time, reading, self._phase, alpha_1, alpha_2, torque, applied, checked.limited))
        self._time += layout.tick

    def _update_phase(self, contact_force: float, x: float, y: float) -> None:
        """Takes the flight's sample and moves on to the next phase."""
        leg, layout = self._leg, self._rig.layout
        if self._phase in (Phase.RISING, Phase.FALLING):
            self._fit.add(self._time - self._phase_start, x - self._x_start + leg.shift_x, y + leg.shift_y)
        phase = next_phase(
            self._phase,
            apex_passed=self._fit.apex_passed,
            contact_force=contact_force,
            touchdown_force=layout.touchdown_force,
            leg_length=leg.length,
            takeoff_length=layout.takeoff_length,
            hip_rate=leg.hip_rate,
        )
        if phase == Phase.RISING != self._phase:
            self._fit, self._phase_start, self._x_start = FlightFit(), self._time, x
        self._phase = phase

    def _flight_speed(self) -> float:
        """Speed for the landing angle: that of this flight, or of the last apex while it is too short."""
        speed = self._fit.speed()
        return self._speed if isnan(speed) else speed

    def _count_loss(self, alpha_1: float, alpha_2: float, lost_1: float, lost_2: float) -> None:
        """Adds up the command force that limits took away while the command acted."""
        self._push_ticks += 1
        if lost_1 or lost_2:
            lost_x, lost_y = _lost_force(self._law, alpha_1, alpha_2, lost_1, lost_2)
            self._lost_x += lost_x
            self._lost_y += lost_y
