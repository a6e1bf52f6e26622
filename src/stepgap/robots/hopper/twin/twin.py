"""The twin as a rig: the sensors and motors of the MuJoCo hopper."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from copy import copy
from math import acos, asin, ceil, exp, inf, isfinite, pi, sin, sqrt
from typing import Self

import mujoco
import numpy as np
from numpy.typing import NDArray

from stepgap.base.compiled_record import as_record
from stepgap.base.ranges import require
from stepgap.plants.compiled_rig import CompiledRig, TickRun
from stepgap.plants.tick_control import Order, TickControl
from stepgap.rigs.rig import RigFault, Torques
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopControl
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.robots.hopper.twin.devices import (
    OUT_OF_REACH,
    READ,
    TOO_FAST,
    Devices,
    Views,
    drive,
    move_ground,
    read_counts,
)
from stepgap.robots.hopper.twin.model import GroundProfile, build_model, contact_of, export_xml, gravity, with_timestep
from stepgap.robots.hopper.twin.physics import Physics, move
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.run_ticks import NO_NUMBER, NO_TORQUE, run_ticks
from stepgap.robots.hopper.twin.treads import UnevenViews, put_on_tread
from stepgap.robots.hopper.twin.true_apex import TrueApex, update_apex
from stepgap.robots.hopper.twin.true_state import TrueState, true_state
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model
from stepgap.robots.mujoco_callbacks import set_mujoco_callbacks
from stepgap.robots.mujoco_faults import mujoco_fault
from stepgap.robots.scene import GroundPieces
from stepgap.step import Array

STANCE_STEP = 2.5e-4
FLIGHT_STEP = 1e-3
"""Longest physics steps near the ground, where contact and friction decide, and in flight [s]. They are part of what
the twin is, like its stiffness; `benchmarks/twin_steps.py` measures what others would change."""

FEWEST_STEPS = 4  # Smallest number of physics steps in a tick near the ground

FASTEST_FOOT = 8.0
"""Speed to which a foot is trusted [m/s], some six times that of a touchdown: a tick is one of flight as long as the
foot could not come to the ground at this speed before its end."""

START_LENGTH = Gains().landing_length  # Leg length of the held twin [m]

OVERSPEED = 400.0
"""Motor speed at which the drives trip [rad/s], ten times that of a hop; at little more, MuJoCo would diverge."""

NO_NOISE = np.zeros((512, 2))
"""Torque noise of a twin without any: as many ticks as are drawn at once, and motors."""

MESSAGES = {
    OUT_OF_REACH: "the motion is no longer within the boom's reach",
    TOO_FAST: f"a motor turned faster than {OVERSPEED:g} rad/s",
    NO_TORQUE: "torques must be finite",
}
"""Faults by the outcome of a tick."""


class Twin(CompiledRig):
    """The MuJoCo hopper: a robot that differs from its physics model by a `RealityGap`.

    It starts with the leg straight down at landing length. The hip is held in the air for a while, so that the
    controller can stabilise the leg, and is then released. Connecting again restarts the motion, but continues the
    sequence of random noise.

    Args:
        robot: Robot of the physics model.
        gap: Differences of the twin from it.
        rng: Draws torque noise, in blocks, and before that the ground's profile if none is given.
        tick: Time from one read to the next [s].
        start_height: Height of the held hip [m].
        start_speed: Horizontal speed of the hip when released [m/s].
        hold: Time for which the hip is held [s].
        ground: Profile of the ground, for several twins on the same ground.
        floor_yaw: Yaw of the floor at boom yaw zero [rad], which is where on the floor the robot starts.

    Raises:
        ValueError: An argument is out of range, or the foot would start in the ground.
    """

    def __init__(
        self,
        robot: RobotParameters,
        gap: RealityGap,
        rng: np.random.Generator,
        tick: float = 1e-3,
        start_height: float = 0.55,
        start_speed: float = 0.0,
        hold: float = 0.3,
        ground: GroundProfile | None = None,
        floor_yaw: float = 0.0,
    ):
        require(isfinite(tick) and tick > 0, "tick", tick, "be positive")
        require(isfinite(start_height), "start_height", start_height, "be finite")
        require(isfinite(start_speed), "start_speed", start_speed, "be finite")
        require(isfinite(floor_yaw), "floor_yaw", floor_yaw, "be finite")
        require(isfinite(hold) and hold >= 0, "hold", hold, "not be negative")
        self._robot = robot
        self._gap = gap
        self._rng = rng
        self._start_height = start_height
        self._start_speed = start_speed
        self._hold_ticks = round(hold / tick)
        self._stance_steps = max(FEWEST_STEPS, ceil(tick / STANCE_STEP - 1e-9))
        self._flight_steps = ceil(tick / FLIGHT_STEP - 1e-9)
        self._ground = ground or GroundProfile(gap, robot.boom_length, rng)
        self._under = np.zeros(1)
        self._sensor_model = twin_sensor_model(robot, gap, tick)
        set_mujoco_callbacks()
        self._model = build_model(robot, gap, tick / self._stance_steps, self._ground.has_risers, tick)
        self._flight_model = with_timestep(self._model, tick / self._flight_steps)
        self._data = mujoco.MjData(self._model)
        self._bind()
        self._noise = NO_NOISE
        self._noise_used = len(NO_NOISE)
        self._connected = False
        self._fault = ""
        self._hold_remaining = 0
        self._apex = as_record(TrueApex())
        self._set_floor_yaw(floor_yaw)
        waves = self._ground.height(floor_yaw) - self._ground.tread_height(floor_yaw)
        lowest = START_LENGTH + robot.foot_length + max(waves, 0.0)
        rule = f"exceed {lowest:.4g}, or the foot is in the ground"
        require(start_height > lowest, "start_height", start_height, rule)
        self._vertical_coordinate(self._held_height)

    def _bind(self) -> None:
        """Takes views of MuJoCo's memory."""
        model = self._model
        data = self._data
        self._scratch = mujoco.MjData(model)
        self._views = Views(
            qpos=data.qpos,
            qvel=data.qvel,
            touch=data.sensordata,
            ctrl=data.ctrl,
            memory=data.userdata,
            force=data.qfrc_applied,
            foot=data.geom("foot").xpos,
            ground=data.mocap_pos[0],
            waves=self._ground.waves,
            uneven=self._uneven_views(),
        )
        self._physics = Physics(
            data=data._address,
            stance=model._address,
            flight=self._flight_model._address,
            stance_steps=self._stance_steps,
            flight_steps=self._flight_steps,
        )
        self._motors = [int(model.joint(f"motor_{motor}").qposadr[0]) for motor in (1, 2)]

    def _uneven_views(self) -> UnevenViews:
        """Treads with their contacts, and what MuJoCo moves with them."""
        model = self._model
        data = self._data
        treads = self._ground.treads
        robot = self._robot
        gap = self._gap
        table = np.zeros((0, 8))
        if treads is not None:
            shares = list(zip(treads.stiffness.tolist(), treads.friction.tolist(), strict=True))
            contacts = {share: contact_of(model, robot, gap, *share) for share in set(shares)}
            places = np.column_stack([treads.start, treads.height, treads.slope])
            table = np.hstack([places, [contacts[share] for share in shares]])
        pair = model.pair("foot_ground").id
        risers = self._ground.has_risers
        return UnevenViews(
            treads=table,
            length=2 * pi * robot.boom_length,
            under=self._under,
            turn=data.mocap_quat[0],
            riser=data.mocap_pos[1] if risers else np.zeros(0),
            riser_turn=data.mocap_quat[1] if risers else np.zeros(4),
            impedance=model.pair_solimp[pair],
            spring=model.pair_solref[pair],
            slip=model.pair_solreffriction[pair],
            friction=model.pair_friction[pair],
        )

    def ground_pieces(self) -> GroundPieces | None:
        """The treads around the robot, as they are drawn; None without treads."""
        return self._ground.pieces(self._floor_yaw)

    @property
    def _held_height(self) -> float:
        """Height of the held hip: it is held above the tread under it [m]."""
        return self._start_height + self._ground.tread_height(self._floor_yaw)

    def _devices_at(self, floor_yaw: float) -> Devices:
        """Sensors and motors, with the floor turned under the robot by an angle [rad]."""
        gap = self._gap
        sensors = self._sensor_model
        kept = exp(-sensors.tick / gap.torque_noise_time) if gap.torque_noise_time > 0 else 0.0
        return Devices(
            motor_1=self._motors[0],
            motor_2=self._motors[1],
            offset_1=gap.motor_offset_1,
            offset_2=gap.motor_offset_2,
            motor_scale=sensors.motor_counts / (2 * pi),
            yaw_scale=sensors.boom_counts_horizontal / (2 * pi),
            pitch_scale=sensors.boom_counts_vertical / (2 * pi),
            motors_round=gap.motor_counts < inf,
            yaw_rounds=gap.boom_counts_horizontal < inf,
            pitch_rounds=gap.boom_counts_vertical < inf,
            overspeed=OVERSPEED,
            boom_arc=gap.boom_arc,
            boom_elastic=gap.boom_stiffness < inf,
            boom_length=sensors.boom_length,
            pivot_height=sensors.pivot_height,
            floor_yaw=floor_yaw,
            torque_limit=min(self._robot.torque_limit, gap.torque_limit),
            torque_saturation=gap.torque_saturation,
            noise_kept=kept,
            noise_fresh=gap.torque_noise * sqrt(1 - kept**2),
            delay=gap.delay / sensors.tick,
            lag=gap.torque_lag / sensors.tick,
            tick=sensors.tick,
            reach=FASTEST_FOOT * sensors.tick * (1 + 0.5 / self._flight_steps),  # the foot is known half a step late
            steepness=self._ground.steepness,
        )

    @property
    def sensor_model(self) -> HopperSensorModel:
        """Sensor model of the twin; all zeros are at angle 0."""
        return self._sensor_model

    @property
    def truth(self) -> tuple[float, ...]:
        """Forward speed [m/s] and height [m] of the hip at the true apex, its highest point since the last take-off.

        The deflection of the boom, which its encoders do not see, is included. Empty before the first take-off.
        """
        speed = float(self._apex["speed"][0])
        height = float(self._apex["height"][0])
        return (speed, height) if isfinite(height) else ()

    @property
    def released(self) -> tuple[float, ...]:
        """Forward speed [m/s] and height [m] of the held hip, which its sensors show as they show an apex."""
        return self._start_speed, self._held_height

    def connect(self) -> None:
        """Puts the robot into its starting pose, held and with limp motors, and sets the time to zero."""
        model = self._model
        data = self._data
        move(self._devices, self._views, self._physics)  # compiles it, for which a ring would not wait later
        mujoco.mj_resetData(model, data)
        data.qpos[:] = self._start_pose()
        for either in (model, self._flight_model):
            either.eq("hold_boom_vertical").data[0] = data.qpos[1]
        self._views.ground[2] = self._ground.height(self._floor_yaw)
        if self._ground.treads is not None:
            put_on_tread(self._views.uneven, self._ground.tread_at(self._floor_yaw))
        data.eq_active[:] = 1
        mujoco.mj_forward(model, data)
        if self._ground.treads is not None:
            move_ground(self._devices, self._views)
        self._connected = True
        self._fault = ""
        self._apex = as_record(TrueApex())
        self._hold_remaining = self._hold_ticks
        if self._hold_remaining == 0:
            self._release()

    def read(self) -> HopperReading:
        """Reads the sensor values of the present tick.

        Raises:
            RigFault: The twin is not connected, its motion cannot be measured, or a motor is too fast.
        """
        if not self._connected:
            raise RigFault("the twin is not connected")
        counts, outcome = read_counts(self._devices, self._views)
        if outcome != READ:
            raise self._trip(self._fault_of(outcome))
        return HopperReading(*counts)

    def write(self, torques: Torques) -> tuple[float, float]:
        """Commands the motor torques for one tick [N·m] and returns the limited torques.

        Delay, lag, scale and noise come after that and stay unknown to the caller, as with real drives.

        Raises:
            RigFault: A torque is not finite, or the rig is stopped.
        """
        if self._fault or not self._connected:
            raise RigFault(self._fault or "the twin is not connected")
        torque_1, torque_2 = torques
        applied = drive(self._devices, torque_1, torque_2, self._next_noise(1)[0], self._views)
        if applied[0] != applied[0]:
            raise self._trip(f"torques must be finite, not {torque_1}, {torque_2}")
        move(self._devices, self._views, self._physics)
        update_apex(self._apex, self._devices, self._views)
        self._count_ticks(1)
        return applied

    def run(self, control: TickControl, time: float, order: Order, applied: Torques, most: int) -> TickRun:
        """Runs ticks of a `HopControl` in compiled code, at most until the hip is released or a block of noise ends.

        The first call of all may compile; the time of the twin stands still meanwhile.
        """
        if not isinstance(control, HopControl):
            raise TypeError(f"a hopper's twin needs a HopControl, not {type(control).__name__}")
        if self._fault or not self._connected:
            return TickRun(rows=(), time=time, applied=None, flags=0, fault=self._fault or "the twin is not connected")
        noise = self._next_noise(min(most, self._hold_remaining or most))
        rows = np.empty((len(noise), len(TICK_UNITS)))
        done, outcome, flags, time, applied_1, applied_2 = run_ticks(
            control.memory,
            self._devices,
            self._views,
            self._physics,
            self._apex,
            noise,
            rows,
            time,
            self._sensor_model.tick,
            int(order.mode),
            order.share,
            *order.command,
            *applied,
        )
        self._noise_used -= len(noise) - done - (outcome == NO_TORQUE)
        self._count_ticks(done)
        if outcome == NO_NUMBER:
            fault = f"a sensor value is not finite: {self.read()}"
            return TickRun(rows=rows[:done], time=time, applied=None, flags=0, fault=fault)
        if fault := self._fault_of(outcome):
            return TickRun(rows=rows[:done], time=time, applied=None, flags=0, fault=str(self._trip(fault)))
        return TickRun(rows=rows[:done], time=time, applied=(applied_1, applied_2), flags=flags, fault="")

    def fork(self, rng: np.random.Generator, floor_yaw: float = 0.0) -> Self:
        """Returns a copy in exactly the same motion, including the state of the drives; this twin is unchanged.

        Args:
            rng: Draws the copy's torque noise, including its present value.
            floor_yaw: Angle by which the floor, and with it the tilted gravity, is turned under the copy [rad], as if
                the robot did the same at another yaw.
        """
        twin = copy(self)
        twin._model = copy(self._model)
        twin._flight_model = copy(self._flight_model)
        twin._data = copy(self._data)
        twin._rng = rng
        twin._apex = self._apex.copy()
        twin._under = self._under.copy()
        twin._bind()
        twin._set_floor_yaw(self._floor_yaw + floor_yaw)
        twin._noise = NO_NOISE
        twin._noise_used = len(NO_NOISE)
        if self._gap.torque_noise > 0:
            twin._views.force[self._motors] = self._gap.torque_noise * twin._next_noise(1)[0]
        return twin

    def become(self, gap: RealityGap) -> None:
        """Changes the differences from the physics model in the midst of the motion, as when a load is picked up.

        The motion and the state of the drives continue. The ground keeps its profile.

        Raises:
            ValueError: The sensors, the delay or the joints would be other ones.
        """
        sensors = twin_sensor_model(self._robot, gap, self._sensor_model.tick)
        model = build_model(self._robot, gap, self._model.opt.timestep, self._ground.has_risers, sensors.tick)
        sizes = ("nq", "nu", "neq", "nuserdata")
        if sensors != self._sensor_model or any(getattr(model, n) != getattr(self._model, n) for n in sizes):
            raise ValueError("a robot that moves keeps its sensors, delays and joints; only other numbers may change")
        data = mujoco.MjData(model)
        mujoco.mj_copyData(data, model, self._data)
        self._gap = gap
        self._model = model
        self._flight_model = with_timestep(model, self._flight_model.opt.timestep)
        self._data = data
        self._bind()
        self._set_floor_yaw(self._floor_yaw)
        if self._ground.treads is not None:
            put_on_tread(self._views.uneven, int(self._under[0]))

    def push(self, speed: float) -> None:
        """Changes the horizontal speed of the hip at once [m/s], as a short push does."""
        self._data.qvel[0] += speed / (self._sensor_model.boom_length if self._gap.boom_arc else 1.0)

    def close(self) -> None:
        """Switches torque off; the twin can be connected again."""
        self._torque_off()
        self._connected = False

    def true_state(self) -> TrueState:
        """True state, for tests and viewers, never for a controller; it does not change the motion."""
        time = self._data.time
        held = self._hold_remaining > 0
        return true_state(self._model, self._scratch, self._devices, self._views, time, held)

    def model_xml(self) -> str:
        """The twin as MJCF with visible shapes and its hip free, for any MuJoCo viewer (keyframe `start`)."""
        return export_xml(self._robot, self._gap, self._model.opt.timestep, self._start_pose())

    def _start_pose(self) -> NDArray[np.float64]:
        """MuJoCo's coordinates of the held robot: leg straight down at landing length."""
        model = self._model
        qpos = np.zeros(model.nq)
        qpos[1] = self._vertical_coordinate(self._held_height)
        alpha, beta = _leg_triangle(self._robot, START_LENGTH)
        for motor, side in ((1, 1), (2, -1)):
            qpos[model.joint(f"motor_{motor}").qposadr[0]] = side * alpha
            qpos[model.joint(f"knee_{motor}").qposadr[0]] = -side * (alpha + beta)
        return qpos

    def _release(self) -> None:
        self._data.eq_active[1:] = 0
        self._data.qvel[0] = self._start_speed / (self._sensor_model.boom_length if self._gap.boom_arc else 1.0)

    def _fault_of(self, outcome: int) -> str:
        """What MuJoCo finds wrong in the motion, or the sensors in its last tick; empty if nothing."""
        return mujoco_fault(self._model, self._data) or MESSAGES.get(outcome, "")

    def _trip(self, message: str) -> RigFault:
        """Switches torque off until the twin is connected again; returns the fault to raise."""
        self._fault = message
        self._torque_off()
        return RigFault(message)

    def _torque_off(self) -> None:
        data = self._data
        data.ctrl[:] = 0
        data.userdata[:] = 0
        data.qfrc_applied[:] = 0

    def _vertical_coordinate(self, height: float) -> float:
        """MuJoCo's vertical coordinate for a height of the hip [m]: the height, or the pitch [rad] on the arc."""
        if not self._gap.boom_arc:
            return height
        rise = height - self._gap.boom_pivot_height
        require(abs(rise) < self._robot.boom_length, "start_height", height, "be within the boom's reach")
        return asin(rise / self._robot.boom_length)

    def _set_floor_yaw(self, floor_yaw: float) -> None:
        """Turns the floor, and with it the tilt of the boom's axis, by an angle under the robot [rad]."""
        self._floor_yaw = floor_yaw
        for model in (self._model, self._flight_model):
            model.opt.gravity[:] = gravity(self._robot, self._gap, floor_yaw)
        self._devices = as_record(self._devices_at(floor_yaw))

    def _next_noise(self, most: int) -> Array:
        """Standard normal numbers for the next ticks and each motor; zeros without noise; shape (k, 2), k ≤ most."""
        if self._noise_used == len(self._noise):
            if self._gap.torque_noise > 0:
                self._noise = self._rng.standard_normal(NO_NOISE.shape)  # a single draw would take a microsecond
            self._noise_used = 0
        noise = self._noise[self._noise_used : self._noise_used + most]
        self._noise_used += len(noise)
        return noise

    def _count_ticks(self, count: int) -> None:
        """Releases the hip when its last tick of being held is over."""
        if self._hold_remaining > 0:
            self._hold_remaining -= count
            if self._hold_remaining == 0:
                self._release()


def _leg_triangle(robot: RobotParameters, length: float) -> tuple[float, float]:
    """Angles between a leg of this length and its links at hip and lower joint: α₂ and β [rad]."""
    top = robot.top_length
    bottom = robot.bottom_length
    alpha = acos((top**2 + length**2 - bottom**2) / (2 * top * length))
    return alpha, asin(top * sin(alpha) / bottom)
