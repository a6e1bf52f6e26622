"""The hopper's control in plain Python: the slow and independent reference for the compiled tick.

It is the code before the compiled tick: lists of samples, `np.polyfit`, and an object whose methods are called one by
one in every tick. Torque laws, leg, phases, rates and safety function are those of the package, which have their own
tests.
"""

from math import inf, isfinite, isnan, nan, sin, sqrt, tau
from typing import NamedTuple

import numpy as np

from stepgap.base.compiled_record import as_record
from stepgap.rigs.rig import HEALTHY, Health, RigFault
from stepgap.robots.hopper.model.dynamics import leg_inertia, masses_of
from stepgap.robots.hopper.model.joint_control import flight_torque, joint_law, stance_torque
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.model.reduced import uprightness
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.tick.estimator import ACCELERATION, APEX_DROP, SPEED_DELAY, JointRates, with_reading
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.phases import Phase, next_phase
from stepgap.robots.hopper.tick.safety import Checked, JointMotion, Limited, Watch, brakes, check_torque
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.tick.stage import Stage
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
        self._sensors, self._stage = sensors, Stage(limits.torque, limits.joint_speed)
        self._law, self._masses = joint_law(robot, gains), masses_of(robot)
        self._time = self._due = self._sampled = 0.0
        self._phase, self._phase_start = Phase.DESCENT, 0.0
        self._speed, self._x_start, self._yaw = 0.0, 0.0, 0.0
        self._fit, self._rates = FlightFit(), JointRates()
        self._record = as_record(limits)[0]
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
        return brakes(self._record, self._watch.stopped, self._watch.braked)

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
        self._rates = with_reading(self._rates, self._sampled, alpha_1, alpha_2)
        rate_1, rate_2 = self._rates.rate_1, self._rates.rate_2
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
        checked = check_torque(self._record, self._stage, self._watch, self._motion, health, 0, asked[0], asked[1])
        self._watch = checked.watch
        return checked

    def close_tick(self, asked: Torques, applied: Torques, checked: Checked) -> None:
        """Processes the applied torques [N·m] and updates the status."""
        motion = self._motion
        if self._phase == Phase.THRUST:
            self._count_loss(asked[0] - applied[0], asked[1] - applied[1])
        if Limited(checked.limited).stops:
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
        phase = Phase(
            next_phase(
                int(self._phase), self._fit.apex_passed, contact_force, sensors.touchdown_force, leg.length,
                sensors.takeoff_length, leg.hip_rate,
            )
        )  # fmt: skip
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
