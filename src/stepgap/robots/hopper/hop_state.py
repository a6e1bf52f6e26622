"""What a tick of hopping starts from and what it remembers: named tuples, for compiled code as for Python."""

from typing import NamedTuple

import numpy as np

from stepgap.plants.tick_control import Mode
from stepgap.robots.hopper.dynamics import Masses
from stepgap.robots.hopper.estimator import FlightFit, JointRates
from stepgap.robots.hopper.joint_control import JointLaw
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.phases import Phase
from stepgap.robots.hopper.safety import Motion, Watch
from stepgap.robots.hopper.sensors import HopperSensorModel

STEP_TIMEOUT = 4.0
"""Longest time from apex to apex [s]."""


class TickSettings(NamedTuple):
    """All that stays the same from tick to tick.

    Attributes:
        sensor_model: How to read the sensors.
        masses: Mass properties of the robot that the rig is taken to be.
        law: Torque laws.
        limits: What the safety function allows.
    """

    sensor_model: HopperSensorModel
    masses: Masses
    law: JointLaw
    limits: SafetyLimits


class TickInputs(NamedTuple):
    """What comes from outside at one tick.

    Attributes:
        time: When the tick began, since the start [s].
        age: By how much the reading is older than the tick [s].
        motor_1, motor_2, boom_horizontal, boom_vertical: Encoder counts.
        contact_force: Ground force on the foot [N].
        frame_lost, stale, late, emergency_stop: As in `Health`.
        mode: Number of the `Mode`.
        share: As in `Order`.
        force_x, force_y: Command force [N]; NaN while there is none.
        applied_1, applied_2: Torques that were applied since the tick before [N·m].
    """

    time: float
    age: float
    motor_1: float
    motor_2: float
    boom_horizontal: float
    boom_vertical: float
    contact_force: float
    frame_lost: int
    stale: int
    late: int
    emergency_stop: int
    mode: int
    share: float
    force_x: float
    force_y: float
    applied_1: float
    applied_2: float


class FlightState(NamedTuple):
    """Estimate of the present flight, or of the last one.

    Attributes:
        start: Time of take-off [s].
        x: Distance travelled at take-off [m].
        fit: Line and parabola through its samples.
        last_speed: Speed at the last apex [m/s], used while this flight is too short to be fitted.
    """

    start: float = 0.0
    x: float = 0.0
    fit: FlightFit = FlightFit()
    last_speed: float = 0.0


class HopProgress(NamedTuple):
    """The hop that the robot is in; it ends when the apex has just been passed.

    Attributes:
        deadline: Time at which it has failed [s].
        left_ground: The leg has pushed off the ground.
        force_x: Command force that acts after mid-stance [N]; NaN until it has come.
        force_y: Upward command force [N].
        thrust_ticks: Ticks in which the command acted.
        lost_x: Sum of the command force that limits took away [N].
        lost_y: Sum of the upward command force that limits took away [N].
        status: Number of a `StepStatus`: 0, or why there will be no apex.
    """

    deadline: float = STEP_TIMEOUT
    left_ground: int = 0
    force_x: float = np.nan
    force_y: float = np.nan
    thrust_ticks: int = 0
    lost_x: float = 0.0
    lost_y: float = 0.0
    status: int = 0


class Apex(NamedTuple):
    """The last hop that ended.

    Attributes:
        speed: At its apex [m/s].
        height: At its apex [m].
        yaw: Of the boom then [rad].
        lost_x: Command force that limits took away, on average [N].
        lost_y: Upward command force that limits took away [N].
        force_x: Command force that acted [N]; NaN where none came in time.
        force_y: Upward command force that acted [N].
    """

    speed: float = np.nan
    height: float = np.nan
    yaw: float = np.nan
    lost_x: float = 0.0
    lost_y: float = 0.0
    force_x: float = np.nan
    force_y: float = np.nan


class HopState(NamedTuple):
    """All that a tick hands to the next one.

    Attributes:
        mode: Number of the `Mode`.
        phase: Number of the `Phase`.
        sampled: Time of the latest reading [s].
        motion: What the sensors say of the robot.
        rates: Estimator of the leg's rates.
        flight: Estimator of the hip's flight.
        hop: The present hop.
        apex: The last hop that ended.
        watch: Memory of the safety function.
        asked_1: Torque that the law wanted of motor 1 [N·m].
        asked_2: Torque that the law wanted of motor 2 [N·m].
        limited: Why less was written; the number of a `Limited`.
    """

    mode: int = int(Mode.STEP)
    phase: int = Phase.DESCENT.value
    sampled: float = 0.0
    motion: Motion = Motion(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    rates: JointRates = JointRates()
    flight: FlightState = FlightState()
    hop: HopProgress = HopProgress()
    apex: Apex = Apex()
    watch: Watch = Watch()
    asked_1: float = 0.0
    asked_2: float = 0.0
    limited: int = 0
