"""Settings of a CAN bus and its devices: the part of `moteus.toml` that is the same for every robot."""

from dataclasses import dataclass
from math import isfinite, nan

from stepgap.base.ranges import require
from stepgap.hardware.bus_rig import BusTiming

TOLERATED = 0.06
"""Part of its largest torque by which a controller may report another torque than commanded, without another number."""


@dataclass(frozen=True, kw_only=True)
class Controller:
    """A controller and its motor; angle = 2π · sign · (turns − zero) / gear.

    Attributes:
        id: Identifier of the controller on the bus (its `id.id`).
        torque_limit: Largest torque at the top link [N·m].
        gear: Turns of the controller's output per turn of the top link; 1 if `rotor_to_output_ratio` includes it.
        sign: 1 if the output's turns increase forward, else −1.
        zero: The controller's position at angle zero [turns].
        torque_tolerance: Largest distance at the top link of the torque that it reports from the commands of the last
            5 ticks [N·m]; 0 for `TOLERATED` of the torque limit, infinite if it is not judged.
    """

    id: int
    torque_limit: float
    gear: float = 1.0
    sign: int = 1
    zero: float = 0.0
    torque_tolerance: float = 0.0

    def __post_init__(self) -> None:
        require(self.torque_tolerance >= 0, "torque_tolerance", self.torque_tolerance, "not be negative")
        require(1 <= self.id <= 126, "id", self.id, "lie between 1 and 126")
        for name in ("torque_limit", "gear"):
            value = getattr(self, name)
            require(isfinite(value) and value > 0, name, value, "be positive")
        require(self.sign in (1, -1), "sign", self.sign, "be 1 or -1")
        require(abs(self.zero) <= 128, "zero", self.zero, "lie within ±128 turns")

    @property
    def largest_deviation(self) -> float:
        """Largest distance of a reported torque from the commands at the top link [N·m]."""
        return self.torque_tolerance or TOLERATED * self.torque_limit

    def torque_command(self, torque: float) -> dict[str, float]:
        """Arguments of `moteus.Controller.make_position` for a torque at the top link [N·m], with gains zero."""
        return {
            "position": nan,
            "velocity": 0.0,
            "feedforward_torque": self.sign * torque / self.gear,
            "maximum_torque": self.torque_limit / self.gear,
            "kp_scale": 0.0,
            "kd_scale": 0.0,
            "ilimit_scale": 0.0,
        }

    def torque_at_link(self, torque: float) -> float:
        """Torque at the top link for the one that the controller reports at its output [N·m]."""
        return self.sign * self.gear * torque


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
