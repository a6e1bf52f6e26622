"""Settings, inputs and state of a control tick: named tuples, for compiled code as for Python."""

from typing import NamedTuple

import numpy as np

from stepgap.plants.tick_control import Mode
from stepgap.robots.hopper.model.dynamics import Masses
from stepgap.robots.hopper.model.joint_control import JointLaw
from stepgap.robots.hopper.tick.drive_motion import DriveMotion
from stepgap.robots.hopper.tick.estimator import FlightFit, JointRates
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.load import Load
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.plausibility import SensorWatch
from stepgap.robots.hopper.tick.safety import JointMotion, Watch
from stepgap.robots.hopper.tick.sensors import HopperSensorModel
from stepgap.robots.hopper.tick.stage import Stage

STEP_TIMEOUT = 4.0  # Longest time from apex to apex [s]


class TickSettings(NamedTuple):
    """Constants of the control tick.

    Attributes:
        sensor_model: Sensor model of the rig.
        masses: Mass properties of the robot that the rig is assumed to be.
        law: Torque laws.
        limits: Limits of the safety function.
        uneven: Whether heights are judged above the ground that the foot found last, not above the boom's zero.
    """

    sensor_model: HopperSensorModel
    masses: Masses
    law: JointLaw
    limits: SafetyLimits
    uneven: int = 0


class TickInputs(NamedTuple):
    """Inputs of one tick.

    Attributes:
        time: Time at which the tick began, since the start [s].
        age: Age of the reading when the tick began [s].
        motor_1, motor_2, boom_horizontal, boom_vertical: Encoder counts.
        contact_force: Ground force on the foot [N].
        frame_lost, stale, late, emergency_stop: As in `Health`.
        mode: Number of the `Mode`.
        share: As in `Order`.
        force_x, force_y: Command force [N]; NaN while there is none.
        applied_1, applied_2: Torques that were applied since the previous tick [N·m].
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
    """Estimate of the present or last flight.

    Attributes:
        start: Time of take-off [s].
        x: Distance travelled at take-off [m].
        fit: Curves fitted to its samples.
        last_speed: Speed at the last apex [m/s], used while this flight is too short to be fitted.
    """

    start: float = 0.0
    x: float = 0.0
    fit: FlightFit = FlightFit()
    last_speed: float = 0.0


class HopProgress(NamedTuple):
    """Progress of the present hop, which ends just after the apex.

    Attributes:
        deadline: Time after which the hop counts as failed [s].
        left_ground: Whether the leg has taken off.
        force_x: Forward command force that acts after mid-stance [N]; NaN until it is given.
        force_y: Upward command force [N].
        thrust_ticks: Number of ticks in which the command acted.
        lost_x: Sum over ticks of the forward command force lost to limits [N].
        lost_y: Sum over ticks of the upward command force lost to limits [N].
        status: Number of a `StepStatus`: 0, or the reason why there will be no apex.
    """

    deadline: float = STEP_TIMEOUT
    left_ground: int = 0
    force_x: float = np.nan
    force_y: float = np.nan
    thrust_ticks: int = 0
    lost_x: float = 0.0
    lost_y: float = 0.0
    status: int = 0


class Landing(NamedTuple):
    """What leg and boom measured at the last touchdown.

    Attributes:
        ground: Height of the foot [m].
        foothold: Where it stood, as a distance travelled [m].
        slope: Rise over distance from the foothold before; that of earlier ones where the distance is short.
        yielding: By what ground and boom yielded in the stance before, per force [m/N].
        deepest: By what the foot has sunk in this stance [m].
        strongest: Largest contact force in this stance [N].
        farther: By how much footholds lie beyond where apexes let expect them, lately [m].
    """

    ground: float = 0.0
    foothold: float = 0.0
    slope: float = 0.0
    yielding: float = 0.0
    deepest: float = 0.0
    strongest: float = 0.0
    farther: float = 0.0


class Apex(NamedTuple):
    """Result of the last hop that ended at an apex.

    Attributes:
        speed: Speed at the apex [m/s].
        height: Height at the apex [m].
        yaw: Yaw of the boom at the apex [rad].
        lost_x: Mean forward command force lost to limits [N].
        lost_y: Mean upward command force lost to limits [N].
        force_x: Forward command force that acted [N]; NaN where none was given in time.
        force_y: Upward command force that acted [N].
        next_foothold: Where the foot will stand next on level ground, as a distance travelled [m].
    """

    speed: float = np.nan
    height: float = np.nan
    yaw: float = np.nan
    lost_x: float = 0.0
    lost_y: float = 0.0
    force_x: float = np.nan
    force_y: float = np.nan
    next_foothold: float = np.nan


class HopState(NamedTuple):
    """State that a tick passes to the next one.

    Attributes:
        mode: Number of the `Mode`.
        phase: Number of the `Phase`.
        sampled: Time of the latest reading [s].
        motion: Measured motion of leg and hip.
        rates: Estimator of the leg's rates.
        flight: Estimator of the hip's flight.
        hop: The present hop.
        landing: The last touchdown.
        apex: Result of the last hop.
        sensors: State of the plausibility checks.
        drives: Whether the leg moves as commanded.
        watch: State of the safety function.
        asked_1: Torque that the law requested of motor 1 [N·m].
        asked_2: Torque that the law requested of motor 2 [N·m].
        limited: Reason why the written torques differ; the number of a `Limited`.
        hops: Number of hops that have reached their apex.
        stage: Limits of torque and speed that held.
        load: Load of the motors so far.
    """

    mode: int = int(Mode.STEP)
    phase: int = Phase.DESCENT.value
    sampled: float = 0.0
    motion: JointMotion = JointMotion(alpha_1=0.0, alpha_2=0.0, rate_1=0.0, rate_2=0.0, leg_length=0.0, hip_height=0.0)
    rates: JointRates = JointRates()
    flight: FlightState = FlightState()
    hop: HopProgress = HopProgress()
    landing: Landing = Landing()
    apex: Apex = Apex()
    sensors: SensorWatch = SensorWatch()
    drives: DriveMotion = DriveMotion()
    watch: Watch = Watch()
    asked_1: float = 0.0
    asked_2: float = 0.0
    limited: int = 0
    hops: int = 0
    stage: Stage = Stage(0.0, 0.0)
    load: Load = Load()
