"""A robot that is a MuJoCo model with a controller: what its user writes, and its steps, tick by tick.

They are those of its nominal map, and those of a plant with a reality gap.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from copy import copy, deepcopy
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Self

import mujoco
import numpy as np

from stepgap.base.errors import InputError
from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.mujoco_robots.mjcf.mjcf_ground import GROUND_LENGTH, BoxGround, Footholds
from stepgap.mujoco_robots.mjcf.mjcf_kinematics import MjcfKinematics, tick_row
from stepgap.mujoco_robots.mjcf.section import Section
from stepgap.plants.plant import AtTouchdown, RepeatablePlant, StepCommands, Touchdown
from stepgap.plants.ticks.stream import OnTicks
from stepgap.rigs.rig import SensorModel
from stepgap.robots.ground import FLAT_GROUND, Treads
from stepgap.robots.mujoco_callbacks import set_mujoco_callbacks
from stepgap.robots.mujoco_faults import keep_divergence, mujoco_fault
from stepgap.robots.nominal_maps.simulator import SimulatorMap
from stepgap.robots.robot import Robot, Simulation
from stepgap.step import Array, StepMap, StepRecord, StepSpace, StepStatus

ControlLaw = Callable[[Any, Any, Array], None]
"""Called at every tick with model, data and the command of the step, shape (m,); writes `data.ctrl`."""


@dataclass(frozen=True)
class MjcfRobot(Robot):
    """A robot from a MuJoCo model. Its nominal map is the simulated model, its plant the model with a reality gap.

    Attributes:
        gap: Differences of the plant from the model.
        tick: Time between two calls of the controller [s]; a class attribute.
        longest_step: Time after which a step has failed [s]; a class attribute.
        ground: Its ground, where it is uneven; flat, unless a robot has a table `ground`.
        feet: Names of the geoms that stand on that ground; a class attribute.
    """

    gap: MjcfGap = field(default_factory=MjcfGap)

    tick = 0.002
    longest_step = 3.0
    ground = FLAT_GROUND
    feet: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def mjcf_model(self) -> Any:
        """The model, such as `mujoco.MjModel.from_xml_path("robot.xml")`; made again for every deployment."""

    def mjcf_spec(self) -> Any:
        """The model as a `mujoco.MjSpec`, whose geom `floor` is replaced; only for a robot with a table `ground`."""
        raise InputError(f"robot '{self.name}': a robot with a table [ground] also needs the method mjcf_spec")

    @abstractmethod
    def controller(self) -> ControlLaw:
        """A new controller for a tick, which writes `data.ctrl`; it may keep its memory in a closure or an object."""

    @abstractmethod
    def section(self) -> Section:
        """When a step ends: `apex`, `touchdown`, `next_foot`, `every`, or a `Section` with a function of your own."""

    @abstractmethod
    def state(self, model: Any, data: Any) -> Array:
        """The state at the section; shape (n,)."""

    @abstractmethod
    def place(self, model: Any, data: Any, state: Array) -> None:
        """Puts the model at the section, in this state; it was reset before."""

    def failed(self, model: Any, data: Any) -> bool:  # noqa: ARG002  (others use them)
        """Whether the robot has fallen."""
        return False

    def context(self, model: Any, data: Any) -> tuple[float, ...]:  # noqa: ARG002
        """What is measured at the end of a step beside the state, in the order of the robot's context."""
        return ()

    @property
    def start_state(self) -> Array:
        """State in which a deployment starts: the middle of the range of use; shape (n,)."""
        return self.space.state_centre

    @property
    def as_modelled(self) -> Self:
        """This robot with the default gap."""
        return replace(self, gap=type(self)().gap)

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        """The simulator."""
        return {"simulator": lambda: SimulatorMap(self.space, MjcfSimulator(self))}

    def simulations(self) -> Mapping[str, Callable[[np.random.Generator], Simulation]]:
        """The model with its gap."""
        return {"mujoco": lambda world: MjcfSimulation(self, world)}

    def placed(self, state: Array) -> Array:
        """The state that `state` reads after `place`."""
        stepper = MjcfStepper(self, MjcfGap.none(), np.random.default_rng(0))
        stepper.place(state)
        return stepper.state

    def kinematics(self, sensors: SensorModel | None = None) -> MjcfKinematics:  # noqa: ARG002
        """The geoms of the model."""
        return MjcfKinematics(self.mjcf_model(), self.space, self.place, self.tick)

    def randomised(self, rng: np.random.Generator) -> Self:
        """This robot with a random gap."""
        return replace(self, gap=type(self.gap).random(rng))


class MjcfStepper:
    """A MuJoCo model that is stepped from section to section.

    Args:
        gap: Differences of the model that is stepped.
        rng: Draws the noise of the control signals, and where on uneven ground the robot is put.
        treads: Uneven ground; None where it is flat.
    """

    def __init__(self, robot: MjcfRobot, gap: MjcfGap, rng: np.random.Generator, treads: Treads | None = None):
        self._robot = robot
        self._gap = gap
        self._rng = rng
        set_mujoco_callbacks()
        self._ground = BoxGround(robot.mjcf_spec(), robot.feet, treads) if treads else None
        self._begin = 0.0
        self._model = gap.of(self._ground.model if self._ground else robot.mjcf_model())
        keep_divergence(self._model)
        self._footholds = Footholds(self._model, robot.feet) if robot.ground.is_measured else None
        self._data = mujoco.MjData(self._model)
        self._section = robot.section()
        self._substeps = max(1, round(robot.tick / self._model.opt.timestep))
        self._guard_functions = (self._section.guard, *self._section.others)
        self._most_ticks = round(robot.longest_step / robot.tick)
        self.place(robot.start_state)

    def place(self, state: Array) -> None:
        """Puts the robot into a state at the section, with a controller without memory."""
        mujoco.mj_resetData(self._model, self._data)
        self._robot.place(self._model, self._data, state)
        if self._ground:
            self._begin = self._rng.uniform(0, GROUND_LENGTH)
            self._ground.put(self._data, self._begin)
        self._fault = self._fault_of(mujoco.mj_forward)
        self._control = self._robot.controller()
        self._late = deque([self._data.ctrl.copy()] * round(self._gap.delay / self._robot.tick))
        self._lagged = self._data.ctrl.copy()
        self._armed = [False] * len(self._guard_functions)
        self._guards = [0.0] * len(self._guard_functions)
        self._last = -1
        if self._section.others:
            values = self._guard_values()
            self._last = values.index(min(values))

    @property
    def state(self) -> Array:
        """True state; shape (n,)."""
        return np.asarray(self._robot.state(self._model, self._data), float)

    @property
    def fault(self) -> str:
        """Why the simulation is not that of the model, since it was placed; empty if it is."""
        return self._fault

    @property
    def tick_row(self) -> Sequence[float]:
        """Row of the last tick; the columns are those of `tick_units`."""
        return tick_row(self._data)

    @property
    def context(self) -> tuple[float, ...]:
        """What is measured of the last step; after the robot's own what its feet have found, if that is measured."""
        of_feet = self._footholds.context if self._footholds else ()
        return *self._robot.context(self._model, self._data), *of_feet

    def step(
        self,
        command: Array,
        on_tick: Callable[[], None] = lambda: None,
        at_touchdown: Callable[[Array], Array] = lambda command: command,
    ) -> StepStatus:
        """Moves to the next section; returns how the step ended.

        Args:
            command: Command of the step; shape (m,).
            on_tick: Called at the end of every tick.
            at_touchdown: Called with the command when the feet have found the ground, if it is measured; returns that
                of the rest of the step.
        """
        if self._fault:
            return StepStatus.UNSTABLE
        if self._footholds:
            self._footholds.begin_step()
        for _ in range(self._most_ticks):
            self._tick(command)
            if self._fault:
                return StepStatus.UNSTABLE
            on_tick()
            if self._footholds and self._footholds.have_landed(self._data):
                command = at_touchdown(command)
            if self._robot.failed(self._model, self._data):
                return StepStatus.FELL
            if self._crosses():
                return StepStatus.OK if np.isfinite(self.state).all() else StepStatus.FELL
        return StepStatus.NO_APEX

    def copy(self, rng: np.random.Generator) -> "MjcfStepper":
        """A stepper in the same state that draws other noise."""
        copied = deepcopy(self, {id(self._robot): self._robot, id(self._model): self._model})
        copied._rng = rng
        return copied

    def _tick(self, command: Array) -> None:
        data = self._data
        self._control(self._model, data, command)
        if self._gap.force_noise:
            data.ctrl *= 1 + self._gap.force_noise * self._rng.standard_normal(len(data.ctrl))
        if self._late:
            self._late.append(data.ctrl.copy())
            data.ctrl[:] = self._late.popleft()
        if self._gap.motor_lag:
            self._lagged += (data.ctrl - self._lagged) * self._robot.tick / (self._gap.motor_lag + self._robot.tick)
            data.ctrl[:] = self._lagged
        self._fault = self._fault_of(mujoco.mj_step, self._substeps)
        if self._ground:
            self._ground.put(data, self._begin)

    def _fault_of(self, computes: Callable[..., None], *numbers: int) -> str:
        """What MuJoCo finds wrong while it computes a motion; empty if nothing."""
        try:
            computes(self._model, self._data, *numbers)
        except mujoco.FatalError as error:
            return f"MuJoCo cannot compute the motion: {' '.join(str(error).split()):.300}"
        return mujoco_fault(self._model, self._data)

    def _crosses(self) -> bool:
        """Whether a guard of the section, of several another one than the last, has just fallen through zero."""
        before = self._guards
        self._guards = self._guard_values()
        ended = False
        for number, (was, now) in enumerate(zip(before, self._guards, strict=True)):
            armed = self._armed[number] or now > self._section.threshold
            crossed = armed and was > 0 >= now
            self._armed[number] = armed and not crossed
            if crossed and number != self._last and not ended:
                ended = True
                self._last = number if self._section.others else -1
        return ended

    def _guard_values(self) -> list[float]:
        return [guard(self._model, self._data) for guard in self._guard_functions]


class MjcfSimulator:
    """A step of the model without a gap, for a `SimulatorMap`."""

    def __init__(self, robot: MjcfRobot):
        self._stepper = MjcfStepper(robot, MjcfGap.none(), np.random.default_rng(0))

    def __call__(self, state: Array, command: Array) -> Array | StepStatus:
        """Next state after a step from a state, or how it failed."""
        self._stepper.place(state)
        status = self._stepper.step(command)
        return self._stepper.state if status == StepStatus.OK else status


class MjcfPlant(RepeatablePlant):
    """The model with its reality gap, sensor noise included.

    Args:
        on_ticks: Called with the ticks of every step at its end, and with the first posture as step 0.
        treads: Uneven ground; None where it is flat.
    """

    def __init__(
        self, robot: MjcfRobot, rng: np.random.Generator, on_ticks: OnTicks | None = None, treads: Treads | None = None
    ):
        self._robot = robot
        self._rng = rng
        self._on_ticks = on_ticks
        self._number = 0
        self._stepper = MjcfStepper(robot, robot.gap, rng, treads)
        self._state = np.full(len(robot.space.state), np.nan)

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the robot."""
        return self._robot.space

    @property
    def fault(self) -> str:
        """Time, joint and usual causes of a simulation that became unstable; empty if it did not."""
        return self._stepper.fault

    def start(self) -> Array:
        """Puts the robot into its first state, and measures."""
        self._stepper.place(self._robot.start_state)
        self._state = self._measured(self._rng)
        self._number = 0
        if self._on_ticks:
            self._on_ticks([self._stepper.tick_row], 0)
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        """Steps to the next section."""
        return self._taken(StepCommands(self.space, command), None)

    def take_replanned_step(self, command: Array, at_touchdown: AtTouchdown) -> StepRecord:
        """Steps to the next section, with another command from the touchdown of the last foot on."""
        return self._taken(StepCommands(self.space, command), at_touchdown)

    def repeated(self, command: Array, rng: np.random.Generator, turned: float = 0.0) -> Array:  # noqa: ARG002
        """Next state of a copy with new noise; there is nothing to turn."""
        copied = copy(self)
        copied._rng = rng
        copied._stepper = self._stepper.copy(rng)
        copied._on_ticks = None
        return copied.take_step(command).next_state

    def stop(self) -> None:
        """Does nothing: a simulation stands still."""

    def _taken(self, commands: StepCommands, at_touchdown: AtTouchdown | None) -> StepRecord:
        space = self.space
        before = self._state
        unknown = np.full(len(self._state), np.nan)

        def chosen(command: Array) -> Array:
            context = self._stepper.context
            touchdown = Touchdown(space.above(before, context), space.named_context(context))
            return commands.replace(at_touchdown, touchdown) if at_touchdown else command

        status = self._step(commands.within, chosen) if np.isfinite(commands.first).all() else StepStatus.INVALID
        true_state = self._stepper.state if status == StepStatus.OK else unknown
        self._state = self._measured(self._rng) if status == StepStatus.OK else unknown
        context = self._stepper.context if status != StepStatus.INVALID else ()
        applied = commands.within
        state, next_state, true_state = (space.above(values, context) for values in (before, self._state, true_state))
        named = space.named_context(context)
        return StepRecord(state, commands.acted(applied), applied, next_state, status, named, applied, true_state)

    def _step(self, command: Array, chosen: Callable[[Array], Array]) -> StepStatus:
        self._number += 1
        if self._on_ticks is None:
            return self._stepper.step(command, at_touchdown=chosen)
        rows = list[Sequence[float]]()
        status = self._stepper.step(command, lambda: rows.append(self._stepper.tick_row), chosen)
        self._on_ticks(rows, self._number)
        return status

    def _measured(self, rng: np.random.Generator) -> Array:
        noise = self._robot.gap.state_noise * self.space.state_scale
        return self._stepper.state + noise * rng.standard_normal(len(noise))


class MjcfSimulation(Simulation):
    """The model with its reality gap; the same in all deployments.

    Args:
        world: Draws its ground, if that is uneven.
    """

    def __init__(self, robot: MjcfRobot, world: np.random.Generator):
        self._robot = robot
        self._treads = None if robot.ground.is_flat else robot.ground.treads(GROUND_LENGTH, world)

    def plant(self, rng: np.random.Generator, on_ticks: OnTicks | None = None) -> MjcfPlant:
        """Plant of one deployment."""
        return MjcfPlant(self._robot, rng, on_ticks, self._treads)

    def repeatable_plant(self, rng: np.random.Generator) -> MjcfPlant:
        """The same."""
        return self.plant(rng)
