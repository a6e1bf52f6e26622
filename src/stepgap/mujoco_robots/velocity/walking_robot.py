"""A robot that walks at a commanded velocity, as a `Robot`: the state is its mean velocity over a time.

Its MuJoCo model, its start posture and its `WalkingControl` make a walking robot of it; all else is here.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from math import atan2, exp, isfinite, nan, radians
from typing import Any, Final, Self, final

import mujoco
import numpy as np

from stepgap.base.ranges import require
from stepgap.control.reference import Reference
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfRobot
from stepgap.mujoco_robots.mjcf.section import Section, every
from stepgap.mujoco_robots.velocity.gait import ConstantWalk, gait_of
from stepgap.robots.gap import NOT_NEGATIVE, Drawn, Rule, difference, within
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.robot import RobotFinding
from stepgap.step import Array, ContextQuantity, Quantity, StepMap, StepSpace

_WHOLE = Rule(lambda value: value >= 0 and value == int(value), "be a whole number from 0 on")


@dataclass(frozen=True)
class WalkingGap(MjcfGap):
    """Differences of the simulated walking robot from its model; SI units."""

    mass_scale: float = difference(1.0, exact=1.0, drawn=Drawn(0.95, 1.05))
    """Factor on all masses and inertias."""

    payload: float = difference(1.5, NOT_NEGATIVE, exact=0.0, drawn=Drawn(0.0, 3.0))
    """Mass of a load on the first body [kg]; its own moments of inertia are left out."""

    damping_scale: float = difference(1.0, exact=1.0, drawn=Drawn(0.7, 2.0), whole=1.5)
    """Factor on the damping of all joints with actuators."""

    slope: float = difference(0.03, within(0.5, "lie between -0.5 and 0.5"), exact=0.0, drawn=Drawn(-0.07, 0.07))
    """Slope of the ground in the direction of x, uphill positive [rad]."""

    delay: float = difference(0.004, NOT_NEGATIVE, exact=0.0, drawn=Drawn(0.0, 0.01))
    """Time by which control signals come later [s]; rounded to ticks."""

    state_noise: float = difference(0.02, NOT_NEGATIVE, exact=0.0)
    """Standard deviation of the noise of measured velocities, in half ranges of use."""

    force_noise: float = difference(0.0, NOT_NEGATIVE, exact=0.0)
    """Standard deviation of the noise of each control signal, relative to the signal."""

    payload_x: float = difference(0.05, exact=0.0, drawn=Drawn(-0.08, 0.08))
    """Place of the load, ahead of the middle of the first body [m]."""

    payload_y: float = difference(0.03, exact=0.0, drawn=Drawn(-0.05, 0.05))
    """Place of the load, to the left [m]."""

    payload_z: float = difference(0.05, exact=0.0, drawn=Drawn(0.0, 0.08))
    """Place of the load, upward [m]."""

    joint_offset: float = difference(radians(1.0), NOT_NEGATIVE, exact=0.0)
    """Standard deviation of the zeros of the joints that position servos move [rad]."""

    motor_spread: float = difference(0.1, within(0.9, "lie between -0.9 and 0.9"), exact=0.0)
    """Largest deviation of the strength of a single motor from that of the model, as a share."""

    individual: float = difference(1.0, _WHOLE, drawn=Drawn(1, 2**31))
    """Whole number of the individual, of which offsets and deviations of its motors are drawn."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """Differences drawn independently and uniformly, with another individual."""
        drawn = cls.draw(rng)
        return cls(**drawn | {"individual": float(int(drawn["individual"]))})

    def of(self, model: Any) -> Any:
        """A copy of a MuJoCo model with these differences; delay, lag and noise are not in it."""
        changed = super().of(model)
        place = np.array([self.payload_x, self.payload_y, self.payload_z])
        changed.body_ipos[1] += self.payload / changed.body_mass[1] * (place - changed.body_ipos[1])
        rng = np.random.default_rng(int(self.individual))
        strength = 1 + self.motor_spread * rng.uniform(-1, 1, (changed.nu, 1))
        offset = self.joint_offset * rng.standard_normal(changed.nu)
        for forces in (changed.actuator_gainprm, changed.actuator_biasprm, changed.actuator_forcerange):
            forces *= strength
        servos = changed.actuator_biastype != int(mujoco.mjtBias.mjBIAS_NONE)
        changed.actuator_biasprm[servos, 0] += (changed.actuator_gainprm[:, 0] * offset)[servos]
        mujoco.mj_setConst(changed, mujoco.MjData(changed))
        return changed


class WalkingControl(ABC):
    """Moves the joints of a walking robot at a commanded velocity.

    One object controls one robot; a copy of the robot is made by `deepcopy`, with the memory of its control.

    Attributes:
        period: Time between two calls of `control` [s], a multiple of the robot's tick.
    """

    period: float

    def start(self, model: Any, data: Any) -> None:  # noqa: B027  (a control without memory needs none)
        """Forgets the past; the robot stands in its start posture."""

    @abstractmethod
    def control(self, model: Any, data: Any, command: Array) -> Array:
        """Values of `data.ctrl` until the next call; shape (nu,).

        Args:
            data: Its data, which must not be changed.
            command: Velocity forward, to the left, and of turning to the left; shape (3,) [m/s, m/s, rad/s].
        """


_NAMES = (("vx", "m/s"), ("vy", "m/s"), ("wz", "rad/s"))
_USERDATA = 4
"""Numbers of `data.userdata` that a walking robot uses: sums of its velocity in a step, and the number of its ticks."""

_WALKS = np.array(
    [
        (0.3, 0.0, 0.0),
        (0.6, 0.0, 0.0),
        (0.6, 0.0, 0.5),
        (0.15, 0.0, 0.5),
        (0.0, 0.0, 0.0),
        (0.15, 0.0, 0.0),
        (0.15, 0.5, 0.0),
        (0.4, 0.5, -0.5),
        (0.8, 0.0, -0.2),
        (0.4, -0.5, 0.2),
        (0.1, -0.2, -0.2),
        (-0.5, 0.0, 0.0),
        (0.0, 0.0, 0.7),
        (0.0, 0.4, 0.0),
        (0.3, -0.3, -0.5),
        (0.6, 0.2, 0.3),
        (0.2, 0.0, 0.0),
    ]
)
"""Targets of `walks`, as shares for `_of_ranges`."""


@dataclass(frozen=True)
class VelocityRange:
    """Ranges of one velocity.

    Attributes:
        lower: Lower end of the range of use.
        upper: Its upper end.
        command_lower: Smallest commanded velocity. A command beyond the range of use makes a robot reach its ends that
            walks slower than it is told.
        command_upper: Largest commanded velocity.
    """

    lower: float
    upper: float
    command_lower: float
    command_upper: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require(isfinite(value), name, value, "be finite")
        for name in ("lower", "command_lower"):
            upper = getattr(self, name.replace("lower", "upper"))
            require(getattr(self, name) < upper, name, getattr(self, name), f"be less than the upper end, {upper:g}")


@dataclass(frozen=True)
class Walk:
    """How a step is made of walking.

    Attributes:
        seconds: Duration of a step, over which the velocity is averaged [s]: one or several periods of the gait.
        time_constant: Time constant with which the robot of the nominal map `lag` follows its command [s].
        fall_height: Height of the body's frame below which the robot has fallen [m].
        fall_tilt: Angle between the body's vertical axis and the vertical from which on it has fallen [rad].
        vx: Forward velocity [m/s].
        vy: Velocity to the left [m/s].
        wz: Velocity of turning to the left [rad/s].
        context: What else the robot measures that changes how it walks, such as the voltage of its battery, as an input
            of what is learned.
    """

    seconds: float = 0.5
    time_constant: float = 0.1
    fall_height: float = 0.15
    fall_tilt: float = 0.9
    vx: VelocityRange = VelocityRange(-0.2, 0.8, -0.5, 1.2)
    vy: VelocityRange = VelocityRange(-0.3, 0.3, -0.5, 0.5)
    wz: VelocityRange = VelocityRange(-0.6, 0.6, -1.0, 1.0)
    context: tuple[ContextQuantity, ...] = ()

    def __post_init__(self) -> None:
        require(0.05 <= self.seconds <= 2.0, "seconds", self.seconds, "lie from 0.05 to 2")
        require(0 <= self.time_constant <= 10, "time_constant", self.time_constant, "lie from 0 to 10")
        require(self.fall_height >= 0, "fall_height", self.fall_height, "not be negative")
        require(0 < self.fall_tilt <= 3, "fall_tilt", self.fall_tilt, "lie between 0 and 3")
        names = [*self.space.names, *self.space.context_names]
        require(len(set(names)) == len(names), "context", names, "have names that nothing else of a walking robot has")

    @property
    def space(self) -> StepSpace:
        """State vx, vy, wz: means over a step in the body's frame; command command_vx, …; its pose and `context`."""
        ranges = [(name, unit, getattr(self, name)) for name, unit in _NAMES]
        pose = zip(StepSpace.pose_names, ("m", "m", "rad"), strict=True)
        return StepSpace(
            tuple(Quantity(name, unit, ends.lower, ends.upper) for name, unit, ends in ranges),
            tuple(Quantity(f"command_{name}", u, ends.command_lower, ends.command_upper) for name, u, ends in ranges),
            (*(ContextQuantity(name, unit) for name, unit in pose), *self.context),
            is_lagged=True,
            planar_seconds=self.seconds,
        )


def walks(space: StepSpace, steps: int = 6) -> Reference:
    """Walking at changing velocities, some of them slow, sideways, turning, and standing still.

    Args:
        space: State vx, vy, wz.
        steps: Number of steps at each target.
    """
    targets = _of_ranges(_WALKS, space)
    segments = [(1 + steps * number, target.tolist()) for number, target in enumerate(targets)]
    return Reference.from_segments(space.state_names, segments, steps=steps * len(targets))


def _of_ranges(shares: Array, space: StepSpace) -> Array:
    """Velocities by shares of the upper end of each range of use, or of the lower one if they are negative."""
    return np.where(shares >= 0, shares * space.state_upper, -shares * space.state_lower)


@dataclass(frozen=True)
class WalkingRobot(MjcfRobot):
    """A robot that walks at a commanded velocity. A subclass has its model, its start posture and its control.

    Attributes:
        walk: How a step is made of walking.
    """

    gap: MjcfGap = field(default_factory=WalkingGap)
    walk: Walk = field(default_factory=Walk)

    @abstractmethod
    def mjcf_spec(self) -> Any:
        """The model, a new `mujoco.MjSpec`; its first body has a free joint, its ground is a plane at height 0."""

    @abstractmethod
    def stand(self, model: Any, data: Any) -> None:
        """Writes the start posture into `data.qpos`, and values that hold it into `data.ctrl`."""

    @abstractmethod
    def walking_control(self) -> WalkingControl:
        """A new control."""

    @property
    def space(self) -> StepSpace:
        """Velocities, and commanded velocities."""
        return self.walk.space

    @property
    def step_seconds(self) -> float:
        """That of the walk."""
        return self.walk.seconds

    @property
    def start_state(self) -> Array:
        """Standing still."""
        return np.zeros(len(_NAMES))

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        """The velocity follows its command with a lag, and the simulated model without differences."""
        return {"lag": self._lag, **super().nominal_maps()}

    def _lag(self) -> AffineMap:
        """Mean velocity over a step at whose begin a first-order lag has the velocity of the step before.

        With time constant τ and duration T: next = a·velocity + (1 − a)·command, a = τ/T·(1 − exp(−T/τ)).
        """
        share = self.walk.time_constant / self.walk.seconds
        kept = share * (1 - exp(-1 / share)) if share else 0.0
        unit = np.eye(len(_NAMES))
        zero = np.zeros(len(_NAMES))
        return AffineMap(self.space, zero, zero, zero, np.hstack([kept * unit, (1 - kept) * unit]))

    def findings(self) -> Sequence[RobotFinding]:
        """Period, response and scatter of its gait, and whether a step has whole periods."""
        return [gait_finding(self)]

    def references(self) -> Mapping[str, Callable[[], Reference]]:
        """Walks with slow velocities and pauses, and stairs."""
        return {"walks": lambda: walks(self.space), **super().references()}

    @final
    def mjcf_model(self) -> Any:
        """The model of `mjcf_spec`."""
        spec = self.mjcf_spec()
        spec.nuserdata = _USERDATA
        spec.worldbody.first_body().simple = 0  # a load may move its centre of mass
        return spec.compile()

    def controller(self) -> "_Walking":
        """The control at its period, and the means of the velocity."""
        return _Walking(self.walking_control(), self.walk.seconds)

    def section(self) -> Section:
        """The end of a duration."""
        return every(self.walk.seconds)

    def state(self, model: Any, data: Any) -> Array:  # noqa: ARG002
        """Mean velocity since the begin of the step; shape (3,)."""
        return data.userdata[:3] / data.userdata[3]

    def context(self, model: Any, data: Any) -> tuple[float, ...]:  # noqa: ARG002
        """Place in the world and heading of the first body, without errors; what else is measured is not simulated."""
        w, x, y, z = data.qpos[3:7]
        heading = atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return float(data.qpos[0]), float(data.qpos[1]), heading, *(nan for _ in self.walk.context)

    def place(self, model: Any, data: Any, state: Array) -> None:
        """In the start posture, moving with the velocity of the state, as if it had done so in the step before."""
        self.stand(model, data)
        turn = np.empty(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        data.qvel[:3] = turn.reshape(3, 3) @ [state[0], state[1], 0.0]
        data.qvel[5] = state[2]
        data.userdata[:] = [*state, 1.0]

    def failed(self, model: Any, data: Any) -> bool:  # noqa: ARG002
        """Whether the body is too low or too much tilted."""
        _, x, y, _ = data.qpos[3:7]
        return bool(data.qpos[2] < self.walk.fall_height or 1 - 2 * (x * x + y * y) < np.cos(self.walk.fall_tilt))


class _Walking:
    """A control law for a tick, made of a `WalkingControl`; sums up the velocity in `data.userdata`."""

    def __init__(self, control: WalkingControl, seconds: float):
        self._control = control
        self._seconds = seconds
        self._step = -1
        self._due = 0.0
        self._held = np.empty(0)

    def __call__(self, model: Any, data: Any, command: Array) -> None:
        now = data.time + 0.5 * model.opt.timestep  # the time is a sum, and not exact
        if self._step < 0:
            self._control.start(model, data)
        if now > self._due:
            self._held = np.array(self._control.control(model, data, command), float)
            self._due += self._control.period
        data.ctrl[:] = self._held
        if now // self._seconds != self._step:
            self._step = now // self._seconds
            data.userdata[:] = 0.0
        data.userdata[:] += [*body_velocity(data), 1.0]


def body_velocity(data: Any) -> Array:
    """Velocity forward and to the left, and of turning to the left, in the frame of a free first body; shape (3,)."""
    back = np.empty(4)
    velocity = np.empty(3)
    mujoco.mju_negQuat(back, data.qpos[3:7])
    mujoco.mju_rotVecQuat(velocity, data.qvel[:3], back)
    return np.array([velocity[0], velocity[1], data.qvel[5]])


_INTERVAL: Final = 0.02  # About the time between two samples of a walk [s]
_HELD: Final = 4.0  # Time for which a walk to measure a gait has the same command [s]

_COMMANDS: Final = np.array(
    [
        (0.5, 0.0, 0.0),
        (0.8, 0.0, 0.0),
        (0.4, 0.0, 0.0),
        (0.6, 0.5, 0.0),
        (0.6, -0.5, 0.0),
        (0.6, 0.0, 0.5),
        (0.6, 0.0, -0.5),
        (0.9, 0.0, 0.0),
        (0.4, 0.4, 0.4),
        (0.4, -0.4, -0.4),
    ]
)
"""Commands of that walk, as shares for `_of_ranges`."""


def measured_walk(robot: WalkingRobot) -> ConstantWalk | None:
    """Walks the model without differences at constant commands; None if it falls.

    Args:
        robot: The robot; its commands are shares of its ranges of use.
    """
    commands = _of_ranges(_COMMANDS, robot.space)
    model = robot.mjcf_model()
    data = mujoco.MjData(model)
    robot.place(model, data, np.zeros(3))
    mujoco.mj_forward(model, data)
    control = robot.controller()
    substeps = max(1, round(robot.tick / model.opt.timestep))
    ticks = max(1, round(_INTERVAL / robot.tick))
    interval = ticks * substeps * model.opt.timestep
    velocities = np.empty((len(commands), round(_HELD / interval), 3))
    for number, command in enumerate(commands):
        for sample in range(velocities.shape[1]):
            for _ in range(ticks):
                control(model, data, command)
                mujoco.mj_step(model, data, substeps)
            if robot.failed(model, data) or not np.isfinite(data.qvel).all():
                return None
            velocities[number, sample] = body_velocity(data)
    return ConstantWalk(commands, velocities, interval)


def gait_finding(robot: WalkingRobot) -> RobotFinding:
    """What a walk of the model shows of its gait, and whether its step has whole periods."""
    walk = measured_walk(robot)
    if walk is None:
        advice = "Compare the policy with its training, or choose narrower ranges of use."
        fault = "The model falls at constant commands within its ranges of use."
        return RobotFinding("gait", right=False, sentence=f"{fault} {advice}")
    seconds = robot.walk.seconds
    gait = gait_of(walk, seconds)
    words = gait.in_words(robot.space)
    if gait.fits(seconds):
        return RobotFinding("gait", right=True, sentence=words)
    part = f"A step of {seconds:g} s is {seconds / gait.period:.2f} periods"
    why = "so its mean velocity depends on where in the gait it begins"
    advice = f"Set walk.seconds = {gait.whole_steps(seconds):.4g}."
    return RobotFinding("gait", right=False, sentence=f"{words} {part}, {why}. {advice}")
