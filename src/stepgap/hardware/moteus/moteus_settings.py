"""Settings of a CAN bus and its devices: the part of `moteus.toml` that is the same for every robot."""

from dataclasses import dataclass
from math import inf, isfinite, nan, tau
from typing import NamedTuple

from stepgap.base.ranges import require
from stepgap.hardware.bus_rig import BusTiming


class JointCommand(NamedTuple):
    """Command of a joint, whose drive gives the torque kp (q − q_now) + kd (dq − dq_now) + tau.

    Attributes:
        q: Angle [rad].
        dq: Its rate [rad/s].
        kp: Stiffness [N·m/rad].
        kd: Damping [N·m·s/rad].
        tau: Feedforward torque [N·m].
    """

    q: float
    dq: float
    kp: float
    kd: float
    tau: float


class JointState(NamedTuple):
    """State of a joint, as measured by its drive.

    Attributes:
        q: Angle [rad].
        dq: Its rate [rad/s].
        tau: Torque [N·m].
    """

    q: float
    dq: float
    tau: float


@dataclass(frozen=True)
class Scale:
    """Units of a moteus controller: turns and N·m of its output, and gains as fractions of its configured ones.

    Attributes:
        gear: Turns of the controller's output per turn of the joint.
        sign: 1 if output and joint turn in the same direction, else −1.
        zero: Position of the output at angle zero [turns].
        servo_kp: The controller's `servo.pid_position.kp` [N·m/turn].
        servo_kd: The controller's `servo.pid_position.kd` [N·m·s/turn].
    """

    gear: float
    sign: int
    zero: float
    servo_kp: float
    servo_kd: float

    def position_command(self, command: JointCommand) -> dict[str, float]:
        """Converts a command to arguments of `moteus.Controller.make_position`; without stiffness the position is NaN.

        Raises:
            ValueError: A number is not finite, a gain is negative, or the damping is larger than moteus supports: it
                limits the scale of kd to that of kp.
        """
        if not all(map(isfinite, command)):
            raise ValueError(f"a joint command must be finite, not {command}")
        if command.kp < 0 or command.kd < 0:
            raise ValueError(f"gains must not be negative: {command}")
        per_turn = tau / self.gear**2
        kp_scale = command.kp * per_turn / self.servo_kp
        kd_scale = command.kd * per_turn / self.servo_kd
        if kd_scale > kp_scale:
            raise ValueError(f"kd = {command.kd} must be at most {self.servo_kd / self.servo_kp * command.kp:g} here")
        turns = self.sign * self.gear / tau
        return {
            "position": self.zero + turns * command.q if command.kp else nan,
            "velocity": turns * command.dq if command.kp else 0.0,
            "feedforward_torque": self.sign * command.tau / self.gear,
            "kp_scale": kp_scale,
            "kd_scale": kd_scale,
            "ilimit_scale": 0.0,
        }

    def joint_state(self, position: float, velocity: float, torque: float) -> JointState:
        """Converts the registers of the controller [turns, turns/s, N·m] to the state of the joint."""
        angle = self.sign * tau / self.gear
        return JointState(angle * (position - self.zero), angle * velocity, self.sign * self.gear * torque)


@dataclass(frozen=True, kw_only=True)
class Controller:
    """A controller and its motor; angle = 2π · sign · (turns − zero) / gear.

    Attributes:
        id: Identifier of the controller on the bus (its `id.id`).
        torque_limit: Largest torque at the top link [N·m].
        gear: Turns of the controller's output per turn of the top link; 1 if `rotor_to_output_ratio` includes it.
        sign: 1 if the output's turns increase forward, else −1.
        zero: The controller's position at angle zero [turns].
        servo_kp: Its `servo.pid_position.kp` [N·m/turn].
        servo_kd: Its `servo.pid_position.kd` [N·m·s/turn].
        torque_tolerance: Largest distance at the top link of the torque that it reports from the commands of the last
            5 ticks [N·m]; infinite if it is not judged.
    """

    id: int
    torque_limit: float
    gear: float = 1.0
    sign: int = 1
    zero: float = 0.0
    servo_kp: float = 4.0
    servo_kd: float = 0.05
    torque_tolerance: float = inf

    def __post_init__(self) -> None:
        require(self.torque_tolerance > 0, "torque_tolerance", self.torque_tolerance, "be positive")
        require(1 <= self.id <= 126, "id", self.id, "lie between 1 and 126")
        for name in ("torque_limit", "gear", "servo_kp", "servo_kd"):
            value = getattr(self, name)
            require(isfinite(value) and value > 0, name, value, "be positive")
        require(self.sign in (1, -1), "sign", self.sign, "be 1 or -1")
        require(abs(self.zero) <= 128, "zero", self.zero, "lie within ±128 turns")

    @property
    def scale(self) -> Scale:
        """Units of the controller."""
        return Scale(self.gear, self.sign, self.zero, self.servo_kp, self.servo_kd)


@dataclass(frozen=True, kw_only=True)
class AuxEncoder:
    """An encoder at an auxiliary port of a controller; angle = 2π · sign · (counts − zero) / counts_per_turn.

    Attributes:
        id: Identifier of the controller, one of those of the motors.
        source: Its encoder source, 1 or 2 (`motor_position.sources.N`); 0 is the motor's own.
        counts_per_turn: Its `cpr`.
        sign: 1 if the counts increase forward or upward, else −1.
        zero: Counts at angle zero.
    """

    id: int
    source: int
    counts_per_turn: int
    sign: int = 1
    zero: int = 0

    def __post_init__(self) -> None:
        counts = self.counts_per_turn
        require(self.source in (1, 2), "source", self.source, "be 1 or 2")
        require(0 < counts <= 2**24, "counts_per_turn", counts, "lie between 1 and 2²⁴")
        require(self.sign in (1, -1), "sign", self.sign, "be 1 or -1")
        require(abs(self.zero) < counts, "zero", self.zero, f"lie within a turn of {counts} counts")


@dataclass(frozen=True, kw_only=True)
class AuxForce:
    """A force sensor with a voltage at an auxiliary port of a controller; newton_per_count · (counts − zero).

    Attributes:
        id: Identifier of the controller, one of those of the motors.
        port: Auxiliary port, 1 or 2.
        pin: Its pin, counted from 1, in analog mode.
        newton_per_count: Its scale [N]; 4096 counts are the full range; negative if the voltage falls under load.
        zero: Counts without load.
    """

    id: int
    port: int
    pin: int
    newton_per_count: float
    zero: int = 0

    def __post_init__(self) -> None:
        scale = self.newton_per_count
        require(self.port in (1, 2), "port", self.port, "be 1 or 2")
        require(1 <= self.pin <= 5, "pin", self.pin, "lie between 1 and 5")
        require(isfinite(scale) and scale != 0, "newton_per_count", scale, "be finite and not zero")
        require(0 <= self.zero <= 4096, "zero", self.zero, "lie between 0 and 4096")


CanDevice = Controller | AuxEncoder | AuxForce
"""A device of a table in `moteus.toml`: each gives one number of a reading, and a controller takes a torque."""


@dataclass(frozen=True, kw_only=True)
class CanSettings(BusTiming):
    """The CAN-FD bus of a robot; each robot adds the tables of its controllers, sensors and limits.

    Attributes:
        channel: Channel of the CAN-FD bus, such as 'can0'.
        interface: Interface of python-can.
        tick: Time between two commands [s].
        reply_timeout: Timeout of replies [s].
        watchdog: Time without a command after which a controller switches torque off [s].
    """

    channel: str
    interface: str = "socketcan"
    tick: float = 1e-3
    reply_timeout: float = 5e-4
    watchdog: float = 0.05

    @property
    def motors(self) -> tuple[Controller, ...]:
        """The controllers among the devices, in their order."""
        return tuple(device for device in self.devices.values() if isinstance(device, Controller))

    def __post_init__(self) -> None:
        for name, example in (("channel", "can0"), ("interface", "socketcan")):
            value = getattr(self, name)
            require(bool(value.strip()), name, value, f"be a name, such as '{example}'")
        self.check_times()
        self._check_ids()

    def _check_ids(self) -> None:
        """Refuses two controllers with the same id, and sensors at an unknown controller."""
        ids: dict[int, str] = {}
        for table, device in self.devices.items():
            if isinstance(device, Controller):
                differs = f"differ from {ids.get(device.id, '').replace('_', ' ')}'s"
                require(device.id not in ids, f"{table}.id", device.id, differs)
                ids[device.id] = table
        for table, device in self.devices.items():
            if not isinstance(device, Controller):
                require(device.id in ids, f"{table}.id", device.id, f"be {' or '.join(map(str, ids))}")
