"""Safety limits of the hopper's motors and joints; `robots/hopper/tick/safety.py` applies them to every torque."""

from dataclasses import dataclass, fields
from math import inf, isinf, isnan, pi
from typing import Self

from stepgap.base.ranges import require
from stepgap.rigs.limits import MOST_LATE_TICKS, RigLimits
from stepgap.robots.hopper.parameters import RobotParameters

_POSITIVE = frozenset({
    "torque", "torque_step", "joint_speed", "lean_angle", "fold_angle", "longest_leg", "brake_torque",
    "continuous_torque", "overload_time", "mean_power", "posture_torque", "posture_speed", "jump_angle",
    "frozen_time", "ground_height", "motion_torque",
})  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class SafetyLimits(RigLimits):
    """Limits and budgets of the safety function; an infinite limit has no effect, as on the twin, which cannot break.

    Attributes:
        torque: Largest motor torque [N·m].
        torque_step: Largest change of a motor torque from one tick to the next [N·m]; torque goes off without steps.
        joint_speed: Largest speed of a top link [rad/s]; a hop of the reference stays below 40.
        stretch_angle: α₂ below which the leg may not be stretched further [rad].
        lean_angle: Largest |α₁| [rad].
        fold_angle: Largest α₂ [rad].
        shortest_leg: Smallest leg length ℓ [m].
        longest_leg: Largest leg length ℓ [m].
        lowest_hip: Smallest height of the hip [m].
        highest_hip: Largest height of the hip [m].
        continuous_torque: Torque that a motor withstands for any time [N·m].
        overload_time: Time for which it withstands the largest torque from cold [s].
        mean_power: Largest mean mechanical power of both motors, over some two seconds [W].
        posture_torque: Largest motor torque while the robot takes its posture, and at the end of its landing [N·m].
        posture_speed: Largest speed of a top link while the robot takes its posture [rad/s].
        first_share: Part of `torque` and `joint_speed` that is allowed in the first hop of a deployment.
        first_hops: Number of hops that must reach their apex until the full limits hold; they grow from hop to hop.
        brake_damping: Damping of the motors that brake after the robot has left its bounds [N·m·s/rad].
        brake_torque: Largest torque of a motor that brakes [N·m].
        brake_ticks: Number of ticks of braking before torque goes off.
        jump_angle: Smallest jump of a motor's encoder for which it is doubted [rad], 4 counts at least; what the other
            motor does in the opposite direction is subtracted. Encoders of the boom are doubted from 4 counts on, at a
            tick of 1 ms.
        sample_jitter: Largest error of the time of a reading, in ticks, by which a moving encoder seems to jump; 1
            where drives and sensors are not synchronised with the frames.
        frozen_time: Time for which a motor's encoder may stand still under torque, until it is doubted [s]; multiples
            of it hold for the pitch in flight and for a foot at the ground without contact force.
        ground_height: Largest height of the foot above or below the ground in stance, by leg and boom [m]: the sum of
            roughness, slope, penetration, bending of the boom and errors of the zeros.
        motion_torque: Torque by which the motion of the leg may deviate from the commands until a drive is doubted
            [N·m], in addition to 30 % of the command; more where the robot's own first hops show more.
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
    continuous_torque: float = inf
    overload_time: float = 1.0
    mean_power: float = inf
    posture_torque: float = inf
    posture_speed: float = inf
    first_share: float = 0.5
    first_hops: int = 0
    brake_damping: float = 0.8
    brake_torque: float = inf
    brake_ticks: int = 300
    jump_angle: float = inf
    sample_jitter: float = 1.0
    frozen_time: float = inf
    ground_height: float = inf
    motion_torque: float = inf

    def __post_init__(self) -> None:
        super().__post_init__()
        for field in fields(self):
            value = getattr(self, field.name)
            require(not isnan(value), field.name, value, "be a number")
            if field.name in _POSITIVE:
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
        require(0 < self.first_share <= 1, "first_share", self.first_share, "be positive and at most 1")
        require(0 <= self.first_hops <= 1000, "first_hops", self.first_hops, "lie between 0 and 1000")
        require(0 <= self.brake_ticks <= 2000, "brake_ticks", self.brake_ticks, "lie between 0 and 2000")
        require(0 <= self.sample_jitter <= 2, "sample_jitter", self.sample_jitter, "lie between 0 and 2")
        require(0 <= self.brake_damping < inf, "brake_damping", self.brake_damping, "be finite and not negative")

    @classmethod
    def of(cls, robot: RobotParameters) -> Self:
        """Limits of a robot in simulation."""
        return cls(torque=robot.torque_limit)

    def without_effect(self) -> tuple[str, ...]:
        """Names of the limits that are infinite or, for the shortest leg and the first hops, zero."""
        zero = {"shortest_leg", "first_hops"}
        return tuple(
            field.name
            for field in fields(self)
            if isinf(getattr(self, field.name)) or (field.name in zero and getattr(self, field.name) <= 0)
        )

    def ranges(self) -> dict[str, tuple[float, float]]:
        """Ranges of the logged motion beyond which the robot is stopped, by the name of the field of a tick."""
        return {
            "alpha_1": (-self.lean_angle, self.lean_angle),
            "alpha_2": (-inf, self.fold_angle),
            "joint_speed": (-inf, self.joint_speed),
            "leg_length": (self.shortest_leg, self.longest_leg),
            "height_above_ground": (self.lowest_hip, self.highest_hip),
        }

    def limp(self) -> Self:
        """Limits of a robot whose motors get no torque: faults of the bus stop it, but neither its pose nor its speed.

        A person may then move the leg, also before the encoders are calibrated. The budget of late ticks is the largest
        possible one.
        """
        return type(self)(
            torque=self.torque,
            joint_speed=inf,
            lost_frames=self.lost_frames,
            stale_ticks=self.lost_frames,
            late_ticks=MOST_LATE_TICKS,
            simulated=self.simulated,
            brake_damping=0.0,
            brake_ticks=0,
        )
