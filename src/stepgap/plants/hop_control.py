"""What a tick of hopping computes: sensor values in, torques out; it knows neither rig nor clock.

A tick is `begin_tick`, `sense`, then one of the torques, then `check`, and after the torques were written `close_tick`.
"""

from math import inf, isfinite, isnan, sin, tau
from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import compiled
from stepgap.plants.estimator import FlightFit, JointRates
from stepgap.plants.phases import Phase, next_phase
from stepgap.plants.safety import Checked, Motion, Watch, brakes, check_torque
from stepgap.plants.tick import Tick
from stepgap.rigs.rig import HEALTHY, Health, Reading, RigFault, RigLayout
from stepgap.robots.hopper.dynamics import leg_inertia, masses_of
from stepgap.robots.hopper.joint_control import flight_torque, joint_law, stance_torque
from stepgap.robots.hopper.leg import foot, four_bar
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.reduced import uprightness
from stepgap.step import Array, StepStatus

STEP_TIMEOUT = 4.0
"""Longest time from apex to apex [s]."""

LANDING_DAMPING = 0.5
"""Damping of each motor with which a robot that is to stop lands [N·m·s/rad]: one bounce more, no harder than a hop."""

Torques = tuple[float, float]


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


class FinishedHop(NamedTuple):
    """What is known when an apex has just been passed.

    Attributes:
        state: At the apex; shape (2,).
        lost: Command force lost on the way there [N]; shape (2,).
        place: Yaw of the boom [rad].
    """

    state: Array
    lost: Array
    place: float


class HopControl:
    """The joint control of Sec. 4.1 from sensor values, hop by hop.

    A hop ends when the apex has just been passed; a command acts from mid-stance to take-off.

    Args:
        layout: How to read the sensors.
        robot: The robot the rig is taken to be.
        gains: Joint controller.
        limits: What the safety function allows.
    """

    def __init__(self, layout: RigLayout, robot: RobotParameters, gains: Gains, limits: SafetyLimits):
        self._layout, self._limits = layout, limits
        self._law, self._masses = joint_law(robot, gains), masses_of(robot)
        self._time = self._due = self._sampled = 0.0
        self._phase, self._phase_start = Phase.FALLING, 0.0
        self._speed, self._x_start, self._yaw = 0.0, 0.0, 0.0
        self._fit, self._rates = FlightFit(), JointRates()
        self._watch, self._status = Watch(), StepStatus.OK
        self._begin_hop()

    def _begin_hop(self) -> None:
        self._lost_x = self._lost_y = 0.0
        self._push_ticks, self._left_ground = 0, False
        self._deadline = self._time + STEP_TIMEOUT

    @property
    def time(self) -> float:
        """When this tick began, since the start [s]."""
        return self._time

    @property
    def due(self) -> float:
        """When the next tick is to begin, since the start [s]."""
        return self._due

    @property
    def phase(self) -> Phase:
        """Of the present tick."""
        return self._phase

    @property
    def takes_command(self) -> bool:
        """Whether this hop's command can still act in full: mid-stance is ahead."""
        return self._phase in (Phase.FALLING, Phase.LOADING) and not self._left_ground

    @property
    def brakes(self) -> bool:
        """Whether the safety function has stopped the robot and its motors brake still."""
        return brakes(self._limits, self._watch)

    @property
    def status(self) -> StepStatus:
        """OK while the robot hops; why not, else."""
        return self._status

    def await_release(self) -> None:
        """Begins a first hop: the robot is held in the air, and may be for as long as it takes."""
        self._phase = Phase.FALLING
        self._begin_hop()
        self._deadline = inf

    def begin_tick(self, late: float = 0.0) -> None:
        """Moves time on to a tick; one that begins more than a tick late [s] moves all later ones."""
        tick, self._time = self._layout.tick, self._due + late
        self._due = (self._time if late > tick else self._due) + tick

    def sense(self, reading: Reading, *, stale: bool = False, age: float = 0.0) -> Motion:
        """Takes the sensor values of this tick and moves on to the next phase where it is due.

        Args:
            reading: The sensor values.
            stale: They are those of the tick before once more.
            age: By how much a reading that is not is older than this tick [s].

        Raises:
            RigFault: One is no number.
        """
        layout = self._layout
        if not isfinite(sum(reading)):
            raise RigFault(f"the sensors tell what is no number: {reading}")
        self._sampled = self._sampled if stale else self._time - age
        phi_1 = reading.motor_1 * tau / layout.motor_counts
        phi_2 = reading.motor_2 * tau / layout.motor_counts
        alpha_1, alpha_2 = 0.5 * (phi_1 + phi_2), 0.5 * (phi_1 - phi_2)
        rate_1, rate_2 = self._rates.update(self._sampled, alpha_1, alpha_2)
        self._yaw = reading.boom_horizontal * tau / layout.boom_counts_horizontal
        x = layout.boom_length * self._yaw
        y = layout.pivot_height + layout.boom_length * sin(reading.boom_vertical * tau / layout.boom_counts_vertical)
        self._leg = leg = LegState(*_leg_state(self._masses, alpha_1, alpha_2, rate_1, rate_2))
        self._reading, before = reading, self._phase
        if self._phase in (Phase.RISING, Phase.FALLING) and not stale:
            self._fit.add(self._sampled - self._phase_start, x - self._x_start + leg.shift_x, y + leg.shift_y)
        self._update_phase(reading.contact_force, x)
        self._left_ground = self._left_ground or before == Phase.PUSHING != self._phase
        self._motion = Motion(alpha_1, alpha_2, rate_1, rate_2, leg.length, y)
        return self._motion

    def hop_torque(self, command: tuple[float, float]) -> Torques:
        """Torques [N·m] of the hop with a command force (fx, fy) [N], which acts after mid-stance."""
        if self._phase not in (Phase.LOADING, Phase.PUSHING):
            return self.posture_torque()
        force_x, force_y = command if self._phase == Phase.PUSHING else (0.0, 0.0)
        return _stance_torque(self._law, self._motion.alpha_1, self._motion.alpha_2, force_x, force_y)

    def posture_torque(self) -> Torques:
        """Torques [N·m] that hold the landing posture."""
        motion = self._motion
        return flight_torque(
            self._law, motion.alpha_1, motion.alpha_2, motion.rate_1, motion.rate_2, self._flight_speed()
        )

    def landing_torque(self, share: float) -> Torques:
        """Torques [N·m] that end the hopping: posture in the air; on the ground a damped spring that fades away.

        Args:
            share: Of the time that landing may take, how much is over; at 1 only damping is left.
        """
        if self._phase not in (Phase.LOADING, Phase.PUSHING):
            return self.posture_torque()
        motion, spring = self._motion, max(0.0, 1.0 - share)
        torque_1, torque_2 = _stance_torque(self._law, motion.alpha_1, motion.alpha_2, 0.0, 0.0)
        return (
            spring * torque_1 - LANDING_DAMPING * (motion.rate_1 + motion.rate_2),
            spring * torque_2 - LANDING_DAMPING * (motion.rate_1 - motion.rate_2),
        )

    def check(self, asked: Torques, health: Health = HEALTHY) -> Checked:
        """What of the torques may be written [N·m]."""
        checked = check_torque(self._limits, self._watch, self._motion, health, asked[0], asked[1])
        self._watch = checked.watch
        return checked

    def close_tick(self, asked: Torques, applied: Torques, checked: Checked) -> Tick:
        """Takes what was really applied [N·m] and judges the tick."""
        motion = self._motion
        if self._phase == Phase.PUSHING:
            self._count_loss(asked[0] - applied[0], asked[1] - applied[1])
        if checked.limited and checked.limited.stops:
            self._status = StepStatus.STOPPED
        elif uprightness(self._law.leg, motion.hip_height, motion.alpha_1, motion.alpha_2) < 0:
            self._status = StepStatus.FELL
        return Tick(
            self._time, self._reading, self._phase, motion.alpha_1, motion.alpha_2, asked, applied, checked.limited
        )

    def finished_hop(self) -> FinishedHop | None:
        """The hop that has just ended at an apex, or None.

        A flight that is too short to be measured ends no hop: the robot bounced, and hops on.
        """
        if self._status == StepStatus.OK and self._left_ground and self._phase == Phase.FALLING:
            state = self._apex()
            if np.isfinite(state).all():
                finished = FinishedHop(state, self.lost_command(), self._yaw)
                self._begin_hop()
                return finished
        if self._time > self._deadline:
            self._status = StepStatus.NO_APEX if self._left_ground else StepStatus.NO_TAKE_OFF
        return None

    def lost_command(self) -> Array:
        """Mean command force that limits took away while this hop's command acted [N]; shape (2,)."""
        return np.array([self._lost_x, self._lost_y]) / max(1, self._push_ticks)

    def _apex(self) -> Array:
        """State at the apex just passed; NaN of a flight that is too short to tell."""
        speed = self._fit.speed()
        if isnan(speed):
            return np.full(2, np.nan)
        self._speed = speed
        return np.array([speed, self._fit.apex_height() - self._leg.shift_y])

    def _update_phase(self, contact_force: float, x: float) -> None:
        """Moves on to the next phase where it is due."""
        leg, layout = self._leg, self._layout
        phase = next_phase(
            self._phase,
            apex_passed=self._fit.apex_passed,
            contact_force=contact_force,
            touchdown_force=layout.touchdown_force,
            leg_length=leg.length,
            takeoff_length=layout.takeoff_length,
            hip_rate=leg.hip_rate,
        )
        if phase == Phase.LOADING != self._phase:
            self._deadline = min(self._deadline, self._time + STEP_TIMEOUT)
        if phase == Phase.RISING != self._phase:
            self._fit, self._phase_start, self._x_start = FlightFit(), self._sampled, x
        self._phase = phase

    def _flight_speed(self) -> float:
        """Speed for the landing angle: that of this flight, or of the last apex while it is too short."""
        speed = self._fit.speed()
        return self._speed if isnan(speed) else speed

    def _count_loss(self, lost_1: float, lost_2: float) -> None:
        """Adds up the command force that limits took away while the command acted."""
        self._push_ticks += 1
        if lost_1 or lost_2:
            lost_x, lost_y = _lost_force(self._law, self._motion.alpha_1, self._motion.alpha_2, lost_1, lost_2)
            self._lost_x += lost_x
            self._lost_y += lost_y
