"""Parameters of the robot and of its joint controller; they are defined only here.

The robot's parameters are those of the paper (Sec. 3). The paper prints no gains, so they are chosen
here, each with a reason.
"""

from dataclasses import dataclass, fields
from math import isfinite, tau

from stepgap.base.errors import InputError
from stepgap.base.ranges import require
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.robot import Robot
from stepgap.step import ContextQuantity, Quantity, StepSpace, StepStatus

ADVICE_ON_HOPS = {
    StepStatus.FELL: "the body came too low, or a leg tilted too far; "
    "choose a slower or higher target, or a command nearer to the middle of its bounds",
    StepStatus.NO_TAKE_OFF: "the leg did not push the body off the ground; "
    "raise the vertical force or the leg stiffness",
    StepStatus.FULL_STRETCH: "the leg reached full stretch, where the foot force is undefined; "
    "lower the vertical force or shorten the spring's rest length",
    StepStatus.FOOT_SCUFFED: "the foot touched the ground outside stance; "
    "choose a higher apex or land with a shorter leg",
    StepStatus.DOUBTFUL: "a sensor value was not plausible; check encoders, cables and force sensor before going on",
}
"""What to try after a hop that failed."""


@dataclass(frozen=True)
class RobotParameters:
    """Boom-mounted hopper with a four-bar leg (Sec. 3), SI units.

    Attributes:
        top_length: Length of a top link ℓ₁ [m].
        bottom_length: Length of a bottom link ℓ₂ [m].
        foot_length: Protrusion of the foot beyond the joint of the bottom links ℓ₃ [m].
        top_mass: Mass of a top link m₁ [kg].
        bottom_mass: Mass of a bottom link m₂ [kg].
        top_inertia: Inertia of a top link about its centre of mass I₁ [kg·m²].
        bottom_inertia: Inertia of a bottom link about its centre of mass I₂ [kg·m²].
        top_com: Distance of a top link's centre of mass from the hip c₁ [m].
        bottom_com: Distance of a bottom link's centre of mass from its knee c₂ [m].
        body_mass: Mass carried at the hip M, without the links [kg].
        boom_inertia_vertical: Boom inertia against vertical motion of the hip I_x [kg·m²].
        boom_inertia_horizontal: Boom inertia against horizontal motion of the hip I_z [kg·m²].
        boom_length: From the boom's pivot to the hip R [m].
        gravity: Downward acceleration g [m/s²].
        torque_limit: Largest torque of one motor [N·m]. Not in the paper: above the 12 to 14 N·m that the
            reference needs in the model, and the 17 N·m that the twin was asked for, so that it acts only in case of
            a fault.
    """

    top_length: float = 0.11
    bottom_length: float = 0.2
    foot_length: float = 0.045
    top_mass: float = 0.043
    bottom_mass: float = 0.047
    top_inertia: float = 0.0001
    bottom_inertia: float = 0.00025
    top_com: float = 0.0485
    bottom_com: float = 0.1054
    body_mass: float = 1.466
    boom_inertia_vertical: float = 5.0
    boom_inertia_horizontal: float = 5.0
    boom_length: float = 1.854
    gravity: float = 9.81
    torque_limit: float = 40.0

    def __post_init__(self) -> None:
        non_negative = {"foot_length", "boom_inertia_vertical", "boom_inertia_horizontal"}
        for field in fields(self):
            value = getattr(self, field.name)
            require(isfinite(value), field.name, value, "be finite")
            if field.name in non_negative:
                require(value >= 0, field.name, value, "not be negative")
            else:
                require(value > 0, field.name, value, "be positive")
        require(
            self.bottom_length > self.top_length,
            "bottom_length",
            self.bottom_length,
            f"exceed top_length = {self.top_length}: the four-bar closes at every angle only then",
        )

    @property
    def stretched_length(self) -> float:
        """Leg length ℓ at full stretch [m]; the leg is singular there."""
        return self.top_length + self.bottom_length

    @property
    def folded_length(self) -> float:
        """Leg length ℓ with the top links folded upward [m]; the shortest possible length."""
        return self.bottom_length - self.top_length


@dataclass(frozen=True)
class Gains:
    """Set-points and gains of the joint controller (Sec. 4.1), SI units.

    Attributes:
        stiffness: Virtual leg spring K₂ [N/m]. Compresses the leg by about 8 cm from a 0.6 m apex.
        rest_length: Rest length of the virtual spring ℓ₀ [m]; below the stretched 0.31 m with room
            for the command forces.
        landing_length: Leg length in flight ℓ_des [m]. Shorter than ℓ₀: the spring lands preloaded,
            which more than replaces the energy lost in the model's impact; the command then holds an
            apex with fy ≈ −10 N, which leaves most of its upward range for the losses of a real robot.
        speed_gain: Landing angle per speed error K₁ [rad·s/m]; about half a stance's sweep of the
            leg per speed, so that a hop neither speeds up nor brakes.
        speed_setpoint: Speed at which the leg lands vertically ẋ_des [m/s]. Constant, because
            otherwise the map would have a fifth input. With this value the command holds the speeds
            of the reference with fx between −8 and 0 N, and the largest stair down of the reference
            can just be reached in one step.
        position_gain: Gain on the leg angles in flight K_p [N·m/rad], on α₁ and on α₂.
        damping_gain: Gain on the leg angle rates in flight K_d [N·m·s/rad].
    """

    stiffness: float = 2500.0
    rest_length: float = 0.285
    landing_length: float = 0.26
    speed_gain: float = 0.2
    speed_setpoint: float = 0.1
    position_gain: float = 40.0
    damping_gain: float = 0.8

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            require(isfinite(value), field.name, value, "be finite")
            if field.name != "speed_setpoint":
                require(value > 0, field.name, value, "be positive")

    def check(self, robot: RobotParameters) -> None:
        """Raises ValueError where a length lies outside the range of the robot's leg."""
        for name in ("rest_length", "landing_length"):
            value = getattr(self, name)
            require(
                robot.folded_length < value < robot.stretched_length,
                name,
                value,
                f"lie between {robot.folded_length:g} (leg folded) and {robot.stretched_length:g} (leg stretched)",
            )


@dataclass(frozen=True)
class CommandBounds:
    """Bounds of the step command: forces added after mid-stance (Sec. 4.2), [N].

    With these bounds the robot can hop at every apex of the reference (0–0.4 m/s, 0.52–0.64 m).

    Attributes:
        fx_lower: Smallest horizontal force [N].
        fx_upper: Largest horizontal force [N].
        fy_lower: Smallest vertical force [N].
        fy_upper: Largest vertical force [N].
    """

    fx_lower: float = -30.0
    fx_upper: float = 30.0
    fy_lower: float = -20.0
    fy_upper: float = 20.0

    def __post_init__(self) -> None:
        for field in fields(self):
            require(isfinite(getattr(self, field.name)), field.name, getattr(self, field.name), "be finite")
        require(self.fx_lower < self.fx_upper, "fx_lower", self.fx_lower, f"lie below fx_upper = {self.fx_upper}")
        require(self.fy_lower < self.fy_upper, "fy_lower", self.fy_lower, f"lie below fy_upper = {self.fy_upper}")

    def space(self, ground: UnevenGround = FLAT_GROUND) -> StepSpace:
        """State [speed, height] and command [fx, fy] of the hopper (Eq. 10), and the yaw of its boom at the apex.

        With footholds, the state also has the stride from the foothold of the hop to the next one, as it follows from
        the apex between them; it counts more than the height, since a miss is a fall, and the speed hardly: it follows.

        Args:
            ground: If it is measured, the height is that above the ground which the foot finds at touchdown, not that
                above the zero of the boom, and the context has its height and slope, where the foot stood, and how it
                yielded; at touchdown, how it yielded in the stance before.
        """
        above = "ground" if ground.is_measured else ""
        slope = 0.1 * ground.inputs
        yielding = 1e-4 * ground.inputs
        of_ground = (
            ContextQuantity("ground", "m"),
            ContextQuantity("foothold", "m"),
            ContextQuantity("slope", "", input_scale=slope),
            ContextQuantity("yielding", "m/N", input_scale=yielding),
        )
        speed = Quantity("speed", "m/s", 0.0, 0.4, weight=0.01 if ground.has_footholds else 1.0)
        stride = Quantity("stride", "m", 0.0, 0.5, weight=100.0, above="foothold", adds_up=True)
        return StepSpace(
            state=(speed, Quantity("height", "m", 0.52, 0.64, above=above), *((stride,) * ground.has_footholds)),
            command=(
                Quantity("fx", "N", self.fx_lower, self.fx_upper),
                Quantity("fy", "N", self.fy_lower, self.fy_upper),
            ),
            context=(ContextQuantity("yaw", "rad", period=tau), *(of_ground if above else ())),
            advice=ADVICE_ON_HOPS,
        )


def parameters_of(robot: Robot) -> RobotParameters:
    """The physical parameters of the robot that a rig is expected to be.

    Raises:
        InputError: The robot is not the hopper.
    """
    parameters = getattr(robot, "parameters", None)
    if not isinstance(parameters, RobotParameters):
        raise InputError(f"robot '{robot.name}': this rig is a hopper's; leave robot at 'hopper'")
    return parameters
