"""Parameters of the robot and of its joint controller; they are defined only here.

The robot's parameters are those of the paper (Sec. 3). The paper prints no gains, so they are chosen
here, each with a reason.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import isfinite, tau
from types import MappingProxyType

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
        thrust_rest_length: What is added to the rest length from mid-stance to take-off [m].
        thrust_stiffness: What is added to the stiffness from mid-stance to take-off [N/m].
    """

    stiffness: float = 2500.0
    rest_length: float = 0.285
    landing_length: float = 0.26
    speed_gain: float = 0.2
    speed_setpoint: float = 0.1
    position_gain: float = 40.0
    damping_gain: float = 0.8
    thrust_rest_length: float = 0.0
    thrust_stiffness: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            require(isfinite(value), field.name, value, "be finite")
            if field.name not in ("speed_setpoint", "thrust_rest_length", "thrust_stiffness"):
                require(value > 0, field.name, value, "be positive")
        rule = f"exceed -stiffness = {-self.stiffness:g}"
        require(self.thrust_stiffness > -self.stiffness, "thrust_stiffness", self.thrust_stiffness, rule)

    def check(self, robot: RobotParameters) -> None:
        """Raises ValueError where a length lies outside the range of the robot's leg."""
        shortest, longest = robot.folded_length, robot.stretched_length
        lengths = {name: getattr(self, name) for name in ("rest_length", "landing_length")}
        lengths["rest_length + thrust_rest_length"] = self.rest_length + self.thrust_rest_length
        for name, value in lengths.items():
            rule = f"lie between {shortest:g} (leg folded) and {longest:g} (leg stretched)"
            require(shortest < value < longest, name, value, rule)


KNOB_UNITS: Mapping[str, str] = MappingProxyType(
    {
        "fx": "N",
        "fy": "N",
        "thrust_rest_length": "m",
        "thrust_stiffness": "N/m",
        "rest_length": "m",
        "stiffness": "N/m",
        "landing_length": "m",
        "speed_setpoint": "m/s",
        "speed_gain": "rad·s/m",
    }
)
"""What the step command can be: two forces, or a change of gains, with units. The first four act after mid-stance."""

FIRST_EARLY = 4
"""Number of the first one that acts before mid-stance."""

PAPER_PAIR = ("fx", "fy")
"""The step command of the paper (Sec. 4.2)."""


@dataclass(frozen=True)
class CommandBounds:
    """What the step command is, and its bounds: in the paper, forces added after mid-stance (Sec. 4.2).

    With the default bounds the robot can hop at every apex of the reference (0–0.4 m/s, 0.52–0.64 m).

    Attributes:
        fx_lower: Smallest horizontal force [N].
        fx_upper: Largest horizontal force [N].
        fy_lower: Smallest vertical force [N].
        fy_upper: Largest vertical force [N].
        thrust_rest_length: Largest change of the rest length after mid-stance, up or down [m].
        thrust_stiffness: Largest change of the stiffness after mid-stance [N/m].
        rest_length: Largest change of the rest length in the whole stance [m].
        stiffness: Largest change of the stiffness in the whole stance [N/m].
        landing_length: Largest change of the leg length at touchdown [m].
        speed_setpoint: Largest change of the speed at which the leg lands vertically [m/s]; turns the landing leg by
            speed_gain times this.
        speed_gain: Largest change of the landing angle per speed error [rad·s/m].
        pair: Names of the two coordinates of the command: fx, fy, or that of a key above, which is then added to
            the gain of this name for one step. Those of the landing and of the whole stance act from the apex on, so
            they must be known before touchdown. `stepgap gait knobs` compares them.
    """

    fx_lower: float = -30.0
    fx_upper: float = 30.0
    fy_lower: float = -20.0
    fy_upper: float = 20.0
    thrust_rest_length: float = 0.01
    thrust_stiffness: float = 500.0
    rest_length: float = 0.015
    stiffness: float = 800.0
    landing_length: float = 0.02
    speed_setpoint: float = 0.5
    speed_gain: float = 0.1
    pair: tuple[str, ...] = PAPER_PAIR

    def __post_init__(self) -> None:
        two = len(self.pair) == 2 and len(set(self.pair)) == 2 and set(self.pair) <= KNOB_UNITS.keys()
        require(two, "pair", list(self.pair), f"have two different names of {', '.join(KNOB_UNITS)}")
        for field in fields(self):
            if field.name != "pair":
                require(isfinite(getattr(self, field.name)), field.name, getattr(self, field.name), "be finite")
            if field.name in KNOB_UNITS:
                require(getattr(self, field.name) > 0, field.name, getattr(self, field.name), "be positive")
        require(self.fx_lower < self.fx_upper, "fx_lower", self.fx_lower, f"lie below fx_upper = {self.fx_upper}")
        require(self.fy_lower < self.fy_upper, "fy_lower", self.fy_lower, f"lie below fy_upper = {self.fy_upper}")

    @property
    def knobs(self) -> tuple[int, int]:
        """Numbers of the two coordinates, in the order of `KNOB_UNITS`."""
        names = list(KNOB_UNITS)
        return names.index(self.pair[0]), names.index(self.pair[1])

    @property
    def is_early(self) -> bool:
        """Whether the command acts before mid-stance."""
        return max(self.knobs) >= FIRST_EARLY

    def check(self, gains: Gains, robot: RobotParameters) -> None:
        """Raises ValueError where a bound of the command takes a gain out of its range."""
        for name in set(self.pair) - set(PAPER_PAIR):
            for change in (-getattr(self, name), getattr(self, name)):
                try:
                    replace(gains, **{name: getattr(gains, name) + change}).check(robot)
                except ValueError as error:
                    largest = f"{name} = {getattr(self, name):g}"
                    raise ValueError(f"{largest}, but with this change gains.{error}") from None

    def _quantity(self, name: str) -> Quantity:
        if name in PAPER_PAIR:
            return Quantity(name, "N", getattr(self, f"{name}_lower"), getattr(self, f"{name}_upper"))
        return Quantity(name, KNOB_UNITS[name], -getattr(self, name), getattr(self, name))

    def space(self, ground: UnevenGround = FLAT_GROUND) -> StepSpace:
        """State [speed, height] and command [fx, fy] or others of the hopper (Eq. 10), and the boom's yaw at the apex.

        With footholds, the state also has the stride from the foothold of the hop to the next one, as it follows from
        the apex between them; it counts more than the height, since a miss is a fall, and the speed hardly: it follows.

        Args:
            ground: If it is measured, the height is that above the ground which the foot finds at touchdown, not that
                above the zero of the boom, and the context has its height and slope, where the foot stood, and how it
                yielded; at touchdown, how it yielded in the stance before.
        """
        above, slope, yielding = "ground" if ground.is_measured else "", 0.1 * ground.inputs, 1e-4 * ground.inputs
        found = (
            ContextQuantity("ground", "m"),
            ContextQuantity("foothold", "m"),
            ContextQuantity("slope", "", input_scale=slope),
            ContextQuantity("yielding", "m/N", input_scale=yielding),
        )
        speed = Quantity("speed", "m/s", 0.0, 0.4, weight=0.01 if ground.has_footholds else 1.0)
        stride = Quantity("stride", "m", 0.0, 0.5, weight=100.0, above="foothold", adds_up=True)
        return StepSpace(
            state=(speed, Quantity("height", "m", 0.52, 0.64, above=above), *((stride,) * ground.has_footholds)),
            command=tuple(map(self._quantity, self.pair)),
            context=(ContextQuantity("yaw", "rad", period=tau), *(found if above else ())),
            advice=ADVICE_ON_HOPS,
        )


PAPER_COMMAND = CommandBounds()
"""The command of the paper with its default bounds."""


def parameters_of(robot: Robot) -> RobotParameters:
    """The physical parameters of the robot that a rig is expected to be.

    Raises:
        InputError: The robot is not the hopper.
    """
    parameters = getattr(robot, "parameters", None)
    if not isinstance(parameters, RobotParameters):
        raise InputError(f"robot '{robot.name}': this rig is a hopper's; leave robot at 'hopper'")
    return parameters
