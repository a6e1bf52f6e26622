"""What stands on the CAN bus and what its numbers mean: `moteus.toml`, read strictly."""

from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path

from stepgap.base.ranges import require
from stepgap.base.settings_file import build, read_toml, with_table
from stepgap.rigs.moteus.joint import Scale
from stepgap.robots.hopper.limits import SafetyLimits


def _require_id(value: int) -> None:
    require(1 <= value <= 126, "id", value, "lie between 1 and 126")


@dataclass(frozen=True, kw_only=True)
class Motor:
    """A controller and its motor; angle = 2π · sign · (turns − zero) / gear.

    Attributes:
        id: Of the controller on the bus (its `id.id`).
        torque_limit: Largest torque at the top link [N·m].
        gear: Turns of the controller's output per turn of the top link; 1 where `rotor_to_output_ratio` says it all.
        sign: 1 where the output's turns grow forward, else −1.
        zero: The controller's position at angle zero [turns].
        servo_kp: Its `servo.pid_position.kp` [N·m/turn].
        servo_kd: Its `servo.pid_position.kd` [N·m·s/turn].
    """

    id: int
    torque_limit: float
    gear: float = 1.0
    sign: int = 1
    zero: float = 0.0
    servo_kp: float = 4.0
    servo_kd: float = 0.05

    def __post_init__(self) -> None:
        _require_id(self.id)
        for name in ("torque_limit", "gear", "servo_kp", "servo_kd"):
            value = getattr(self, name)
            require(isfinite(value) and value > 0, name, value, "be positive")
        require(self.sign in (1, -1), "sign", self.sign, "be 1 or -1")
        require(abs(self.zero) <= 128, "zero", self.zero, "lie within ±128 turns")

    @property
    def scale(self) -> Scale:
        """How the controller counts."""
        return Scale(self.gear, self.sign, self.zero, self.servo_kp, self.servo_kd)


@dataclass(frozen=True, kw_only=True)
class BoomEncoder:
    """An encoder at an auxiliary port of a controller; angle = 2π · sign · (counts − zero) / counts_per_turn.

    Attributes:
        id: Of the controller, one of the motors'.
        source: Which of its encoder sources, 1 or 2 (`motor_position.sources.N`); 0 is the motor's own.
        counts_per_turn: Its `cpr`.
        sign: 1 where the counts grow forward or upward, else −1.
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
class Contact:
    """A voltage at an auxiliary port of a controller tells the ground force, newton_per_count · (counts − zero).

    Attributes:
        id: Of the controller, one of the motors'.
        port: Auxiliary port, 1 or 2.
        pin: Its pin, counted from 1, in analog mode.
        newton_per_count: Its scale [N], 4096 counts being the whole range; negative where pressing lowers the voltage.
        touchdown_force: Force above which the foot is on the ground [N] (Sec. 3.3).
        zero: Counts without force.
        takeoff_length: Leg length at which the leg leaves the ground [m] (Sec. 3.4).
    """

    id: int
    port: int
    pin: int
    newton_per_count: float
    touchdown_force: float
    zero: int = 0
    takeoff_length: float = inf

    def __post_init__(self) -> None:
        scale, force = self.newton_per_count, self.touchdown_force
        require(self.port in (1, 2), "port", self.port, "be 1 or 2")
        require(1 <= self.pin <= 5, "pin", self.pin, "lie between 1 and 5")
        require(isfinite(scale) and scale != 0, "newton_per_count", scale, "be finite and not zero")
        require(0 <= force <= 1e6, "touchdown_force", force, "lie between 0 and 1e6")
        require(0 <= self.zero <= 4096, "zero", self.zero, "lie between 0 and 4096")
        require(self.takeoff_length > 0, "takeoff_length", self.takeoff_length, "be positive")


@dataclass(frozen=True, kw_only=True)
class MoteusSettings:
    """A robot with two moteus controllers.

    Attributes:
        channel: Of the CAN-FD bus, such as 'can0'.
        pivot_height: Height of the boom's pivot above the ground [m].
        motor_1: Turns the top link at α₁ + α₂.
        motor_2: Turns the top link at α₁ − α₂.
        boom_horizontal: Yaw of the boom.
        boom_vertical: Pitch of the boom.
        contact: Ground force.
        limits: What the safety function allows.
        interface: How python-can reaches the bus.
        tick: Time between two commands [s].
        reply_timeout: How long replies are waited for [s].
        watchdog: Time without a command after which a controller gives up the torque [s].
    """

    channel: str
    pivot_height: float
    motor_1: Motor
    motor_2: Motor
    boom_horizontal: BoomEncoder
    boom_vertical: BoomEncoder
    contact: Contact
    limits: SafetyLimits
    interface: str = "socketcan"
    tick: float = 1e-3
    reply_timeout: float = 5e-4
    watchdog: float = 0.05

    def __post_init__(self) -> None:
        for name, example in (("channel", "can0"), ("interface", "socketcan")):
            value = getattr(self, name)
            require(bool(value.strip()), name, value, f"be a name, such as '{example}'")
        require(isfinite(self.pivot_height), "pivot_height", self.pivot_height, "be finite")
        require(1e-4 <= self.tick <= 0.01, "tick", self.tick, "lie between 0.0001 and 0.01")
        require(2 * self.tick <= self.watchdog <= 0.5, "watchdog", self.watchdog, "be at least two ticks, at most 0.5")
        require(
            0 < self.reply_timeout < self.watchdog,
            "reply_timeout",
            self.reply_timeout,
            f"be positive and less than watchdog = {self.watchdog}",
        )
        ids = (self.motor_1.id, self.motor_2.id)
        require(ids[0] != ids[1], "motor_2.id", ids[1], "differ from motor 1's")
        gears = (self.motor_1.gear, self.motor_2.gear)
        require(gears[1] == gears[0], "motor_2.gear", gears[1], f"be that of motor 1, {gears[0]:g}")
        for name in ("boom_horizontal", "boom_vertical", "contact"):
            require(getattr(self, name).id in ids, f"{name}.id", getattr(self, name).id, f"be {ids[0]} or {ids[1]}")
        yaw, pitch = self.boom_horizontal, self.boom_vertical
        differs = (pitch.id, pitch.source) != (yaw.id, yaw.source)
        require(differs, "boom_vertical.source", pitch.source, "differ from the horizontal angle's")


def read_moteus_settings(path: Path) -> MoteusSettings:
    """The rig that a TOML file describes.

    Raises:
        InputError: Naming file, key and what would be right.
    """
    return build(MoteusSettings, read_toml(path, "a rig"), lambda name: f"{path}: {with_table(name)}")
