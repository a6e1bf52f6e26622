"""The hopper's control in plain Python: the slow and independent reference for the compiled tick.

It is the code before the compiled tick: lists of samples, `np.polyfit`, and an object whose methods are called one by
one in every tick. Only the torque laws and the leg's geometry are those of the package.
"""

from math import inf, isfinite, isnan, nan, sin, sqrt, tau
from typing import NamedTuple

import numpy as np

from stepgap.rigs.rig import HEALTHY, Health, RigFault
from stepgap.robots.hopper.model.dynamics import leg_inertia, masses_of
from stepgap.robots.hopper.model.joint_control import flight_torque, joint_law, stance_torque
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.model.reduced import uprightness
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.tick.estimator import ACCELERATION, APEX_DROP, SPEED_DELAY
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.safety import BRAKE_GROWTH, BRAKED, JointMotion, Limited
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from stepgap.step import Array, StepStatus

STEP_TIMEOUT, LANDING_DAMPING = 4.0, 0.5

Torques = tuple[float, float]


class FlightFit:
    """Lines and parabolas fitted to the samples of one flight.

    The samples are positions of the hip, corrected for the leg's motion: x + S sin α₁ / m_x and
    y − S cos α₁ / m_y move as a free body does.
    """

    def __init__(self) -> None:
        self._times: list[float] = []
        self._xs: list[float] = []
        self._ys: list[float] = []
        self._sum_t = self._sum_x = self._sum_tt = self._sum_tx = 0.0
        self._highest = -np.inf

    def add(self, time: float, x: float, y: float) -> None:
        """Adds a sample: time since take-off [s], x relative to take-off [m], y [m]."""
        self._times.append(time)
        self._xs.append(x)
        self._ys.append(y)
        self._sum_t += time
        self._sum_x += x
        self._sum_tt += time * time
        self._sum_tx += time * x
        self._highest = max(self._highest, y)

    @property
    def apex_passed(self) -> bool:
        """Whether the hip has descended by APEX_DROP from its highest point."""
        return bool(self._ys) and self._ys[-1] < self._highest - APEX_DROP

    def speed(self) -> float:
        """Mean forward speed of the free body [m/s]; NaN before SPEED_DELAY or with fewer than three samples."""
        count = len(self._times)
        if count < 3 or self._times[-1] < SPEED_DELAY:
            return nan
        return (count * self._sum_tx - self._sum_t * self._sum_x) / (count * self._sum_tt - self._sum_t**2)

    def apex(self, count: float) -> tuple[float, float]:
        """Speed [m/s] and height [m] at the vertex of the parabola fitted to y; NaN if it has none.

        The speed is that of the parabola fitted to x, with a normal prior of the acceleration: one more equation.

        Args:
            count: One count of the yaw encoder [m].
        """
        if isnan(self.speed()):
            return nan, nan
        times = np.array(self._times) - np.mean(self._times)
        curvature, slope, level = np.polyfit(times, self._ys, 2)
        if curvature >= 0:
            return nan, nan
        apex = -slope / (2 * curvature)
        travelled = abs(np.polyfit(times, self._xs, 1)[0]) * self._times[-1]
        error = sqrt(len(times) / 12) * count / (1 + travelled / count)
        equations = np.vstack([np.vander(times, 3) / error, [2 / ACCELERATION, 0, 0]])
        parabola = np.linalg.lstsq(equations, np.array([*self._xs, 0]) / error, rcond=None)[0]
        return float(np.polyval(np.polyder(parabola), apex)), float(level - slope**2 / (4 * curvature))


class JointRates:
    """Rates of the leg angles from motor counts: differences over the last `span` readings.

    Without a new reading the rates stay as they are. For accelerations up to a, their error is at most a times the age
    of the oldest of these readings, plus the effect of rounding to counts.
    """

    def __init__(self, span: int = 2):
        self._past: list[tuple[float, float, float]] = []
        self._span, self._rates = span, (0.0, 0.0)

    def update(self, time: float, alpha_1: float, alpha_2: float) -> tuple[float, float]:
        """Adds a reading's time [s] and angles [rad]; returns (α̇₁, α̇₂) [rad/s], zero until there are enough."""
        past = self._past
        if past and time <= past[-1][0]:
            return self._rates
        past.append((time, alpha_1, alpha_2))
        if len(past) > self._span:
            before, old_1, old_2 = past.pop(0)
            took = round(time - before, 12)  # so that the last digits do not depend on the time since the start
            self._rates = (alpha_1 - old_1) / took, (alpha_2 - old_2) / took
        return self._rates


def next_phase(
    phase: Phase,
    *,
    apex_passed: bool,
    contact_force: float,
    touchdown_force: float,
    leg_length: float,
    takeoff_length: float,
    hip_rate: float,
) -> Phase:
    """Phase at this tick, from the phase at the previous one.

    If the hip descends while the foot is still on the ground, the robot has not taken off, and the phase is THRUST.

    Args:
        phase: Previous phase.
        apex_passed: Whether the apex of the present flight has been passed.
        contact_force: Ground force on the foot [N].
        touchdown_force: Force above which the foot is on the ground [N] (Sec. 3.3).
        leg_length: ℓ [m].
        takeoff_length: ℓ at which the leg leaves the ground [m] (Sec. 3.4).
        hip_rate: ẏ [m/s].
    """
    if phase == Phase.ASCENT and apex_passed:
        return Phase.THRUST if contact_force > touchdown_force else Phase.DESCENT
    if phase == Phase.ASCENT:
        return phase
    if phase == Phase.DESCENT:
        return Phase.COMPRESSION if contact_force > touchdown_force else phase
    if phase == Phase.COMPRESSION:
        return Phase.THRUST if hip_rate > 0 else phase
    airborne = leg_length >= takeoff_length or contact_force <= 0
    return Phase.ASCENT if airborne else phase


class Watch(NamedTuple):
    """State of the check; a new one starts with limp motors.

    Attributes:
        torque_1: Last torque of motor 1 [N·m].
        torque_2: Last torque of motor 2 [N·m].
        lost: Frames lost in a row.
        stale: Stale readings in a row.
        late: Ticks missed in a row.
        stopped: Reasons why the motors brake or stay off.
        braked: Number of ticks since the stop.
        slowest: Smallest joint speed since the stop [rad/s].
    """

    torque_1: float = 0.0
    torque_2: float = 0.0
    lost: int = 0
    stale: int = 0
    late: int = 0
    stopped: Limited = Limited.NOTHING
    braked: int = 0
    slowest: float = inf


class Checked(NamedTuple):
    """Torques that may be written [N·m], why they differ from the requested ones, and the watch for the next tick."""

    torque_1: float
    torque_2: float
    limited: Limited
    watch: Watch


def check_torque(
    limits: SafetyLimits, watch: Watch, motion: JointMotion, health: Health, torque_1: float, torque_2: float
) -> Checked:
    """Limits the torques; after a fault they brake for a while and then stay zero.

    Args:
        limits: Limits.
        watch: Watch of the previous tick.
        motion: JointMotion at this tick.
        health: Health at this tick.
        torque_1: Torque requested of motor 1 [N·m].
        torque_2: Torque requested of motor 2 [N·m].
    """
    lost = stale = late = 0
    stopped = watch.stopped
    if health is not HEALTHY:
        lost = watch.lost + 1 if health.frame_lost else 0
        stale = watch.stale + 1 if health.stale else 0
        late = watch.late + health.late if health.late else 0
        stopped |= _unhealthy(limits, health, lost, stale, late)
    if beyond := _out_of_range(limits, motion, torque_1 + torque_2):
        stopped |= beyond
    if stopped:
        speed = abs(motion.rate_1) + abs(motion.rate_2)
        if speed > min(watch.slowest, speed) + BRAKE_GROWTH:
            stopped |= Limited.SPEED_GREW
        after = Watch(0.0, 0.0, lost, stale, late, stopped, watch.braked + 1, min(watch.slowest, speed))
        torque_1, torque_2 = _brake(limits, watch, motion) if brakes(limits, after) else (0.0, 0.0)
        return Checked(torque_1, torque_2, stopped, after._replace(torque_1=torque_1, torque_2=torque_2))

    limited = Limited.NOTHING
    if motion.alpha_2 < limits.stretch_angle and torque_1 < torque_2:
        torque_1 = torque_2 = 0.5 * (torque_1 + torque_2)
        limited |= Limited.STRETCH
    most = limits.torque
    if abs(torque_1) > most or abs(torque_2) > most:
        torque_1, torque_2 = _within(most, torque_1), _within(most, torque_2)
        limited |= Limited.TORQUE
    step = limits.torque_step
    if abs(torque_1 - watch.torque_1) > step or abs(torque_2 - watch.torque_2) > step:
        torque_1, torque_2 = _within(step, torque_1, watch.torque_1), _within(step, torque_2, watch.torque_2)
        limited |= Limited.TORQUE_STEP
    return Checked(torque_1, torque_2, limited, Watch(torque_1, torque_2, lost, stale, late))


def brakes(limits: SafetyLimits, watch: Watch) -> bool:
    """Whether the motors of a stopped robot still brake."""
    return bool(watch.stopped) and not watch.stopped & ~BRAKED and watch.braked <= limits.brake_ticks


def _brake(limits: SafetyLimits, watch: Watch, motion: JointMotion) -> tuple[float, float]:
    """Torques against the rotation, within limits [N·m]; driving torque stops immediately; braking torque grows."""
    speed_1, speed_2 = motion.rate_1 + motion.rate_2, motion.rate_1 - motion.rate_2
    return _brake_motor(limits, watch.torque_1, speed_1), _brake_motor(limits, watch.torque_2, speed_2)


def _brake_motor(limits: SafetyLimits, before: float, speed: float) -> float:
    brake = _within(min(limits.torque, limits.brake_torque), -limits.brake_damping * speed)
    return _within(abs(brake), _within(limits.torque_step, brake, before if before * brake > 0 else 0.0))


def _within(most: float, value: float, centre: float = 0.0) -> float:
    """The value, limited to a distance of `most` from the centre."""
    return min(centre + most, max(centre - most, value))


def _out_of_range(limits: SafetyLimits, motion: JointMotion, torques: float) -> Limited:
    """Reasons why the motion or the torques, given as their sum, are not allowed."""
    alpha_1, alpha_2, rate_1, rate_2, leg_length, hip_height = motion
    if not isfinite(torques + alpha_1 + alpha_2 + rate_1 + rate_2 + leg_length + hip_height):
        return Limited.NOT_FINITE
    reason = Limited.NOTHING
    if abs(rate_1) + abs(rate_2) > limits.joint_speed:
        reason |= Limited.JOINT_SPEED
    if abs(alpha_1) > limits.lean_angle or alpha_2 > limits.fold_angle:
        reason |= Limited.JOINT_ANGLE
    if not limits.shortest_leg <= leg_length <= limits.longest_leg:
        reason |= Limited.LEG_LENGTH
    if not limits.lowest_hip <= hip_height <= limits.highest_hip:
        reason |= Limited.HIP_HEIGHT
    return reason


def _unhealthy(limits: SafetyLimits, health: Health, lost: int, stale: int, late: int) -> Limited:
    """Reasons why the health, with its numbers of bad ticks in a row, is not allowed."""
    reason = Limited.NOTHING
    if lost > limits.lost_frames:
        reason |= Limited.LOST_FRAMES
    if stale > limits.stale_ticks:
        reason |= Limited.STALE
    if late > limits.late_ticks:
        reason |= Limited.LATE
    if health.emergency_stop:
        reason |= Limited.EMERGENCY_STOP
    return reason


class LegState(NamedTuple):
    """Measured state of the leg and, if the foot is at rest, of the hip.

    Attributes:
        length: ℓ [m].
        hip_rate: ẏ of the hip if the foot is at rest [m/s].
        shift_x: Forward offset of the free body from the hip, S sin α₁ / m_x [m].
        shift_y: Upward offset, −S cos α₁ / m_y [m].
    """

    length: float
    hip_rate: float
    shift_x: float
    shift_y: float


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


def _stance_torque(law, alpha_1, alpha_2, force_x, force_y):
    bar = four_bar(law.leg, alpha_2)
    toe = foot(law.leg, bar, alpha_1)
    return stance_torque(law, bar, toe, np.sin(alpha_1), np.cos(alpha_1), force_x, force_y)


def _lost_force(law, alpha_1, alpha_2, lost_1, lost_2):
    """Force on the body that torques (lost_1, lost_2) cause in stance: the inverse of τ = −Jᵀ force."""
    toe = foot(law.leg, four_bar(law.leg, alpha_2), alpha_1)
    q_1, q_2 = lost_1 + lost_2, lost_1 - lost_2
    determinant = toe.x_1 * toe.y_2 - toe.x_2 * toe.y_1
    return (toe.y_1 * q_2 - toe.y_2 * q_1) / determinant, (toe.x_2 * q_1 - toe.x_1 * q_2) / determinant


class FinishedHop(NamedTuple):
    """Result of a hop whose apex has just been passed.

    Attributes:
        state: State at the apex; shape (2,).
        lost: Command force lost to limits [N]; shape (2,).
        yaw: Yaw of the boom [rad].
    """

    state: Array
    lost: Array
    yaw: float


class ReferenceControl:
    """The joint control of Sec. 4.1 from sensor values, hop by hop.

    A hop ends when the apex has just been passed; a command acts from mid-stance to take-off.

    Args:
        sensors: Sensor model of the rig.
        robot: Robot that the rig is assumed to be.
        gains: Gains of the joint controller.
        limits: Limits of the safety function.
    """

    def __init__(self, sensors: HopperSensorModel, robot: RobotParameters, gains: Gains, limits: SafetyLimits):
        self._sensors, self._limits = sensors, limits
        self._law, self._masses = joint_law(robot, gains), masses_of(robot)
        self._time = self._due = self._sampled = 0.0
        self._phase, self._phase_start = Phase.DESCENT, 0.0
        self._speed, self._x_start, self._yaw = 0.0, 0.0, 0.0
        self._fit, self._rates = FlightFit(), JointRates()
        self._watch, self._reason = Watch(), StepStatus.OK
        self._begin_hop()

    def _begin_hop(self) -> None:
        self._lost_x = self._lost_y = 0.0
        self._push_ticks, self._left_ground = 0, False
        self._deadline = self._time + STEP_TIMEOUT

    @property
    def time(self) -> float:
        """Start of this tick, since the start of the deployment [s]."""
        return self._time

    @property
    def due(self) -> float:
        """Start of the next tick, since the start of the deployment [s]."""
        return self._due

    @property
    def phase(self) -> Phase:
        """Phase at the present tick."""
        return self._phase

    @property
    def takes_command(self) -> bool:
        """Whether this hop's command can still act in full, because mid-stance is ahead."""
        return self._phase in (Phase.DESCENT, Phase.COMPRESSION) and not self._left_ground

    @property
    def brakes(self) -> bool:
        """Whether the safety function has stopped the robot and its motors still brake."""
        return brakes(self._limits, self._watch)

    @property
    def reason(self) -> StepStatus:
        """OK while the robot hops, otherwise the reason why it does not."""
        return self._reason

    def await_release(self) -> None:
        """Begins a first hop: the robot is held in the air, for any length of time."""
        self._phase = Phase.DESCENT
        self._begin_hop()
        self._deadline = inf

    def begin_tick(self, late: float = 0.0) -> None:
        """Advances the time to a tick; if it begins more than a tick late [s], all later ticks are shifted."""
        tick, self._time = self._sensors.tick, self._due + late
        self._due = (self._time if late > tick else self._due) + tick

    def sense(self, reading: HopperReading, *, stale: bool = False, age: float = 0.0) -> JointMotion:
        """Processes the sensor values of this tick and updates the phase.

        Args:
            reading: The sensor values.
            stale: Whether they are those of the previous tick.
            age: Age of a new reading at this tick [s].

        Raises:
            RigFault: A value is not a number.
        """
        sensors = self._sensors
        if not isfinite(sum(reading)):
            raise RigFault(f"a sensor value is not a number: {reading}")
        self._sampled = self._sampled if stale else self._time - age
        phi_1 = reading.motor_1 * tau / sensors.motor_counts
        phi_2 = reading.motor_2 * tau / sensors.motor_counts
        alpha_1, alpha_2 = 0.5 * (phi_1 + phi_2), 0.5 * (phi_1 - phi_2)
        rate_1, rate_2 = self._rates.update(self._sampled, alpha_1, alpha_2)
        self._yaw = reading.boom_horizontal * tau / sensors.boom_counts_horizontal
        x = sensors.boom_length * self._yaw
        y = sensors.pivot_height + sensors.boom_length * sin(reading.boom_vertical * tau / sensors.boom_counts_vertical)
        self._leg = leg = LegState(*_leg_state(self._masses, alpha_1, alpha_2, rate_1, rate_2))
        self._reading, before = reading, self._phase
        if self._phase in (Phase.ASCENT, Phase.DESCENT) and not stale:
            self._fit.add(self._sampled - self._phase_start, x - self._x_start + leg.shift_x, y + leg.shift_y)
        self._update_phase(reading.contact_force, x)
        self._left_ground = self._left_ground or before == Phase.THRUST != self._phase
        self._motion = JointMotion(alpha_1, alpha_2, rate_1, rate_2, leg.length, y)
        return self._motion

    def hop_torque(self, command: tuple[float, float]) -> Torques:
        """Torques [N·m] of the hop with a command force (fx, fy) [N], which acts after mid-stance."""
        if self._phase not in (Phase.COMPRESSION, Phase.THRUST):
            return self.posture_torque()
        force_x, force_y = command if self._phase == Phase.THRUST else (0.0, 0.0)
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
            share: Elapsed fraction of the landing time; at 1 only damping remains.
        """
        if self._phase not in (Phase.COMPRESSION, Phase.THRUST):
            return self.posture_torque()
        motion, spring = self._motion, max(0.0, 1.0 - share)
        torque_1, torque_2 = _stance_torque(self._law, motion.alpha_1, motion.alpha_2, 0.0, 0.0)
        return (
            spring * torque_1 - LANDING_DAMPING * (motion.rate_1 + motion.rate_2),
            spring * torque_2 - LANDING_DAMPING * (motion.rate_1 - motion.rate_2),
        )

    def check(self, asked: Torques, health: Health = HEALTHY) -> Checked:
        """Limits the torques to those that may be written [N·m]."""
        checked = check_torque(self._limits, self._watch, self._motion, health, asked[0], asked[1])
        self._watch = checked.watch
        return checked

    def close_tick(self, asked: Torques, applied: Torques, checked: Checked) -> None:
        """Processes the applied torques [N·m] and updates the status."""
        motion = self._motion
        if self._phase == Phase.THRUST:
            self._count_loss(asked[0] - applied[0], asked[1] - applied[1])
        if checked.limited and checked.limited.stops:
            self._reason = StepStatus.STOPPED
        elif uprightness(self._law.leg, motion.hip_height, motion.alpha_1, motion.alpha_2) < 0:
            self._reason = StepStatus.FELL

    def finished_hop(self) -> FinishedHop | None:
        """The hop that has just ended at an apex, or None.

        A flight that is too short to be measured does not end the hop: the robot has bounced and continues.
        """
        if self._reason == StepStatus.OK and self._left_ground and self._phase == Phase.DESCENT:
            state = self._apex()
            if np.isfinite(state).all():
                finished = FinishedHop(state, self.lost_command(), self._yaw)
                self._begin_hop()
                return finished
        if self._time > self._deadline:
            self._reason = StepStatus.NO_APEX if self._left_ground else StepStatus.NO_TAKE_OFF
        return None

    def lost_command(self) -> Array:
        """Mean command force lost to limits while this hop's command acted [N]; shape (2,)."""
        return np.array([self._lost_x, self._lost_y]) / max(1, self._push_ticks)

    def _apex(self) -> Array:
        """State at the apex just passed; NaN for a flight that is too short to be measured."""
        sensors = self._sensors
        speed, top = self._fit.apex(sensors.boom_length * tau / sensors.boom_counts_horizontal)
        if not isnan(speed):
            self._speed = speed
        return np.array([speed, top - self._leg.shift_y])

    def _update_phase(self, contact_force: float, x: float) -> None:
        """Updates the phase."""
        leg, sensors = self._leg, self._sensors
        phase = next_phase(
            self._phase,
            apex_passed=self._fit.apex_passed,
            contact_force=contact_force,
            touchdown_force=sensors.touchdown_force,
            leg_length=leg.length,
            takeoff_length=sensors.takeoff_length,
            hip_rate=leg.hip_rate,
        )
        if phase == Phase.COMPRESSION != self._phase:
            self._deadline = min(self._deadline, self._time + STEP_TIMEOUT)
        if phase == Phase.ASCENT != self._phase:
            self._fit, self._phase_start, self._x_start = FlightFit(), self._sampled, x
        self._phase = phase

    def _flight_speed(self) -> float:
        """Speed for the landing angle: that of this flight, or of the last apex while it is too short."""
        speed = self._fit.speed()
        return self._speed if isnan(speed) else speed

    def _count_loss(self, lost_1: float, lost_2: float) -> None:
        """Adds the command force lost to limits while the command acted."""
        self._push_ticks += 1
        if lost_1 or lost_2:
            lost_x, lost_y = _lost_force(self._law, self._motion.alpha_1, self._motion.alpha_2, lost_1, lost_2)
            self._lost_x += lost_x
            self._lost_y += lost_y
