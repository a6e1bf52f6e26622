"""What a rig's motors and joints may do; `robots/hopper/safety.py` holds every torque against it."""

from dataclasses import dataclass, fields
from math import inf, isnan, pi
from typing import Self

from stepgap.robots.hopper.parameters import RobotParameters, require


@dataclass(frozen=True)
class SafetyLimits:
    """Limits and budgets; what is infinite limits nothing, as on the twin, which nothing can break.

    Attributes:
        torque: Largest motor torque [N·m].
        torque_step: Largest change of a motor torque from one tick to the next [N·m]; only what goes, goes at once.
        joint_speed: Largest speed of a top link [rad/s]; a hop of the reference stays below 40.
        stretch_angle: α₂ below which the leg may not be stretched further [rad].
        lean_angle: Largest |α₁| [rad].
        fold_angle: Largest α₂ [rad].
        shortest_leg: Smallest leg length ℓ [m].
        longest_leg: Largest leg length ℓ [m].
        lowest_hip: Smallest height of the hip [m].
        highest_hip: Largest height of the hip [m].
        lost_frames: Frames in a row that may be lost.
        stale_ticks: Ticks in a row whose reading may be that of the tick before.
        late_ticks: Ticks in a row that may be missed.
        brake_damping: With which the motors brake when the robot leaves its bounds [N·m·s/rad].
        brake_ticks: How long they brake before torque goes off, in ticks.
    """

    torque: float
    torque_step: float = inf
    joint_speed: float = 120.0
    stretch_angle: float = 0.1
    lean_angle: float = inf
    fold_angle: float = inf
    shortest_leg: float = 0.0
    longest_leg: float = inf
    lowest_hip: float = -inf
    highest_hip: float = inf
    lost_frames: int = 2
    stale_ticks: int = 2
    late_ticks: int = 2
    brake_damping: float = 0.8
    brake_ticks: int = 300

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            require(not isnan(value), field.name, value, "be a number")
            if field.name in ("torque", "torque_step", "joint_speed", "lean_angle", "fold_angle", "longest_leg"):
                require(value > 0, field.name, value, "be positive")
        require(self.torque < inf, "torque", self.torque, "be finite")
        require(0 <= self.stretch_angle < pi, "stretch_angle", self.stretch_angle, "lie between 0 and π")
        require(
            self.stretch_angle < self.fold_angle,
            "fold_angle",
            self.fold_angle,
            f"exceed stretch_angle = {self.stretch_angle}",
        )
        for low, high in (("shortest_leg", "longest_leg"), ("lowest_hip", "highest_hip")):
            least = getattr(self, low)
            require(least < getattr(self, high), high, getattr(self, high), f"exceed {low} = {least}")
        for name, most in (("lost_frames", 5), ("stale_ticks", 5), ("late_ticks", 50), ("brake_ticks", 2000)):
            require(0 <= getattr(self, name) <= most, name, getattr(self, name), f"lie between 0 and {most}")
        require(0 <= self.brake_damping < inf, "brake_damping", self.brake_damping, "be finite and not negative")

    @classmethod
    def of(cls, robot: RobotParameters) -> Self:
        """The limits of a robot in simulation."""
        return cls(torque=robot.torque_limit)
