"""The basic types of a step: its coordinates, the map that predicts it, and the record of an executed one.

A *step* runs from one section to the next: that of a hopper from apex to apex. All other modules describe steps by
`StepSpace` (names, units, ranges), `StepMap` (prediction) and `StepRecord` (what happened).
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from math import inf, isfinite, isinf, tau
from types import MappingProxyType
from typing import ClassVar, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.base.errors import StepGapError
from stepgap.base.names import NAME_RULE, UNIT_RULE, is_name, is_unit
from stepgap.base.ranges import require

Array = NDArray[np.float64]
"""Floating-point array, SI units."""

Codes = NDArray[np.int64]
"""Array of `StepStatus` values."""

_Number = TypeVar("_Number", float, Array)


class StepStatus(IntEnum):
    """Result of a step; its name in lower case is the `status` of a recorded step.

    A robot uses those that it can tell apart.

    Attributes:
        OK: It ended at its section.
        FELL: The robot fell, or cannot step on.
        NO_TAKE_OFF: Stance did not end: the robot did not leave the ground.
        FULL_STRETCH: A leg was stretched completely, where the model of its force ends.
        FOOT_SCUFFED: A foot touched the ground where it must be in the air.
        NO_APEX: It did not reach its section, such as the apex, within the time limit.
        INVALID: State or command are not finite numbers.
        STOPPED: A safety limit was exceeded, or the plant failed.
        DOUBTFUL: A sensor value was not plausible.
        UNSTABLE: The simulation became unstable, or is not that of the model for another reason. (The number 9 is that
            of a plan without a measurement in exported controllers.)
    """

    OK = 0
    FELL = 1
    NO_TAKE_OFF = 2
    FULL_STRETCH = 3
    FOOT_SCUFFED = 4
    NO_APEX = 5
    INVALID = 6
    STOPPED = 7
    DOUBTFUL = 8
    UNSTABLE = 10

    @property
    def label(self) -> str:
        """Lower-case word used in files and messages."""
        return self.name.lower()


ENDINGS = {
    StepStatus.OK: "made all its steps",
    StepStatus.FELL: "fell",
    StepStatus.STOPPED: "was stopped",
    StepStatus.DOUBTFUL: "was stopped because of a doubtful sensor",
    StepStatus.UNSTABLE: "ended because its simulation became unstable",
}
"""How a deployment ended, by the status of its last step; other steps that fail have no next state."""


def ending_of(status: StepStatus) -> str:
    """Phrase that follows "the deployment …", such as "fell", by the status of its last step."""
    return ENDINGS.get(status, f"ended without a next state ({status.label.replace('_', ' ')})")


ADVICE: Mapping[StepStatus, str] = {
    StepStatus.FELL: "the robot fell; "
    "choose a target nearer to the middle of the ranges of use, or a command nearer to the middle of its bounds",
    StepStatus.NO_TAKE_OFF: "the robot did not leave the ground; choose a command that pushes it off harder",
    StepStatus.FULL_STRETCH: "a leg reached full stretch, where its force is undefined; choose a weaker command",
    StepStatus.FOOT_SCUFFED: "a foot touched the ground where it must be in the air; choose a higher target",
    StepStatus.NO_APEX: "the step did not end within the time limit; check gains and command",
    StepStatus.INVALID: "state and command must be finite numbers",
    StepStatus.STOPPED: "a safety limit was exceeded, or the plant failed; check gains, command and limits",
    StepStatus.DOUBTFUL: "a sensor value was not plausible; check the sensors and their cables before going on",
    StepStatus.UNSTABLE: "the simulation became unstable; "
    "lower gains that are too high for a light joint, give it more armature, or make time step and tick shorter",
}
"""Advice for any robot on each `StepStatus` other than OK; a `StepSpace` may have that of its robot."""


@dataclass(frozen=True)
class Quantity:
    """One coordinate of a state or command.

    Attributes:
        name: Column name in files, for example `speed`; an identifier.
        unit: SI unit, for example `m/s`; empty if it is unknown.
        lower: Lower end of the range of use; for a command, a hard bound.
        upper: Upper end of the range of use; for a command, a hard bound.
        weight: How much the squared error of a state coordinate [half ranges] counts against those of the others. 0: it
            is predicted, but not tracked, so it has no target.
        above: Quantity of the context above which it is measured, such as the height of the ground at the touchdown of
            the step; empty if it is measured from a fixed zero.
        adds_up: Whether it is a distance from there, such as that from a foothold to the next one. Then targets add up:
            what a step falls short of is added to the target of the next one. It is 0 at the start of each step, and a
            map does not depend on it.

    Raises:
        ValueError: The name is no identifier, the unit has a character that no unit has, the range is empty, or the
            weight is not a finite number from 0 on.
    """

    name: str
    unit: str
    lower: float
    upper: float
    weight: float = 1.0
    above: str = ""
    adds_up: bool = False

    def __post_init__(self) -> None:
        _check_words(self.name, self.unit)
        require(isfinite(self.lower), "lower", self.lower, f"be finite ({self.name})")
        rule = f"be finite and exceed lower = {self.lower:g} ({self.name})"
        require(self.lower < self.upper < inf, "upper", self.upper, rule)
        require(0 <= self.weight < inf, "weight", self.weight, f"be a finite number from 0 on ({self.name})")
        require(bool(self.above) or not self.adds_up, "adds_up", self.adds_up, f"be false without above ({self.name})")


@dataclass(frozen=True)
class ContextQuantity:
    """A number measured around a step that is neither state nor command, such as where on its circle the robot is.

    Attributes:
        name: Name in `StepRecord.context`; its column in files is NAME_after.
        unit: SI unit, for example `rad`; empty if it is unknown.
        period: Change after which the robot is where it was, such as 2π of an angle about the vertical: the part of the
            error that returns with it is estimated and removed. Infinite if there is none.
        input_scale: Change that counts as one where a residual may depend on it, such as on the slope of the ground,
            because it is known, if only roughly, at the touchdown of the step, before the command acts. 0: no input.

    Raises:
        ValueError: The name is no identifier, the unit has a character that no unit has, the period is not positive, or
            the scale is negative.
    """

    name: str
    unit: str
    period: float = inf
    input_scale: float = 0.0

    def __post_init__(self) -> None:
        _check_words(self.name, self.unit)
        require(self.period > 0, "period", self.period, f"be positive ({self.name})")
        require(0 <= self.input_scale < inf, "input_scale", self.input_scale, f"be from 0 on ({self.name})")

    def phase(self, value: _Number) -> _Number:
        """A value, or an array of values, as an angle that is 2π at the period [rad]."""
        return value * (tau / self.period)


@dataclass(frozen=True)
class StepSpace:
    """Names, units and ranges of the state and the command of a step; its arrays are computed once and read-only.

    Attributes:
        state: The n coordinates of the state at the section.
        command: The m coordinates of the step command.
        context: What else is measured around a step; at most one of these quantities has a period.
        advice: What the robot advises after a step that failed, by its status, instead of `ADVICE`.
        is_lagged: Whether the command of the step before may still act in a step, as where a robot needs a good part of
            a step to reach a commanded velocity. Its effect is always learned; here plans of later steps count it, too.
        planar_seconds: Duration of a step [s] where the first three states are the mean velocities of a body that moves
            in a plane: forward, to the left and of turning to the left, in its own frame; 0 elsewhere. What the context
            has of `pose_names` is its place and its heading, from any zero.

    Raises:
        ValueError: Several quantities of the context have a period, no state coordinate is tracked, or one is measured
            above a quantity that is not in the context, or in another unit.
    """

    state: tuple[Quantity, ...]
    command: tuple[Quantity, ...]
    context: tuple[ContextQuantity, ...] = ()
    advice: Mapping[StepStatus, str] = field(default_factory=dict, compare=False, repr=False, kw_only=True)
    is_lagged: bool = field(default=False, kw_only=True)
    planar_seconds: float = field(default=0.0, compare=False, kw_only=True)

    pose_names: ClassVar[tuple[str, str, str]] = ("place_x", "place_y", "heading")

    def __post_init__(self) -> None:
        periodic = [quantity.name for quantity in self.context if isfinite(quantity.period)]
        require(len(periodic) <= 1, "context", periodic, "have at most one quantity with a period")
        units = {quantity.name: quantity.unit for quantity in self.context}
        for quantity in self.state:
            rule = f"be the name of a context quantity in {quantity.unit or 'the same unit'} ({quantity.name})"
            require(not quantity.above or units.get(quantity.above) == quantity.unit, "above", quantity.above, rule)
        for quantity in self.command:
            require(not quantity.above, "above", quantity.above, f"be empty, since it is a command ({quantity.name})")
        weights = [quantity.weight for quantity in self.state]
        require(any(weights) or not weights, "state", weights, "have a weight above 0 of at least one coordinate")

    @cached_property
    def periodic(self) -> ContextQuantity | None:
        """The quantity of the context that has a period; None if there is none."""
        return next((quantity for quantity in self.context if isfinite(quantity.period)), None)

    def advice_on(self, status: StepStatus) -> str:
        """Advice after a step that failed."""
        return self.advice.get(status) or ADVICE[status]

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Names of the state coordinates."""
        return tuple(quantity.name for quantity in self.state)

    @cached_property
    def command_names(self) -> tuple[str, ...]:
        """Names of the command coordinates."""
        return tuple(quantity.name for quantity in self.command)

    @cached_property
    def context_names(self) -> tuple[str, ...]:
        """Names of the quantities of the context."""
        return tuple(quantity.name for quantity in self.context)

    @property
    def in_a_line(self) -> str:
        """Names and units of state and command, for a line that describes an object."""
        state, command = (
            ", ".join(f"{quantity.name} [{quantity.unit}]" if quantity.unit else quantity.name for quantity in part)
            for part in (self.state, self.command)
        )
        return f"state {state}; command {command or 'none'}"

    def named_context(self, values: Sequence[float]) -> dict[str, float]:
        """Context of a step by name, from all its numbers in the order of `context`, or from none."""
        return dict(zip(self.context_names if values else (), values, strict=True))

    @cached_property
    def context_inputs(self) -> tuple[ContextQuantity, ...]:
        """Quantities of the context on which a residual may depend."""
        return tuple(quantity for quantity in self.context if quantity.input_scale)

    @cached_property
    def is_above_context(self) -> bool:
        """Whether a state coordinate is measured above a quantity of the context."""
        return any(quantity.above for quantity in self.state)

    @cached_property
    def adds_up(self) -> NDArray[np.bool_]:
        """Which state coordinates are distances whose targets add up; shape (n,)."""
        return np.array([quantity.adds_up for quantity in self.state], bool)

    def onward(self, state: Array) -> Array:
        """Ends of steps as starts of the next ones: distances that add up begin at zero; shape (…, n)."""
        return np.where(self.adds_up, 0.0, state) if self.adds_up.any() else state

    def start(self, measured: Array, context: Sequence[float]) -> Array:
        """The start of a step, as measured from fixed zeros before it, above its context; shape (n,)."""
        return self.onward(self.above(measured, context))

    def above(self, state: Array, context: Sequence[float]) -> Array:
        """A measured state with the coordinates of a step that are measured above its context; shape (n,).

        Args:
            state: State from fixed zeros; shape (n,).
            context: Context of the step in the order of `context`, or empty. What is unknown of it is not subtracted.
        """
        if not (context and self.is_above_context):
            return state
        zeros = dict(zip(self.context_names, context, strict=True)) | {"": 0.0}
        return state - np.nan_to_num([zeros[quantity.above] for quantity in self.state])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates of the state and then of the command."""
        return (*self.state_names, *self.command_names)

    def has_names_of(self, other: "StepSpace") -> bool:
        """Whether state and command have the names of another space, in the same order; ranges may differ."""
        return (self.state_names, self.command_names) == (other.state_names, other.command_names)

    @cached_property
    def state_centre(self) -> Array:
        """Middle of the range of use of each state coordinate; shape (n,)."""
        return _read_only((quantity.upper + quantity.lower) / 2 for quantity in self.state)

    @cached_property
    def state_scale(self) -> Array:
        """Half the range of use of each state coordinate; shape (n,)."""
        return _read_only((quantity.upper - quantity.lower) / 2 for quantity in self.state)

    @cached_property
    def error_scale(self) -> Array:
        """Error of each state coordinate that counts as one: half its range of use / √weight; shape (n,).

        Infinite where it is not tracked.
        """
        weights = np.sqrt([quantity.weight for quantity in self.state])
        return _read_only(np.divide(self.state_scale, weights, out=np.full(len(weights), inf), where=weights > 0))

    @cached_property
    def tracked(self) -> NDArray[np.bool_]:
        """Which state coordinates are tracked; shape (n,)."""
        return np.isfinite(self.error_scale)

    def has_target(self, target: Array) -> NDArray[np.bool_]:
        """In which tracked coordinates a target (…, n) wants something; it is NaN in the others; shape (…, n)."""
        return self.tracked & np.isfinite(target)

    @cached_property
    def state_lower(self) -> Array:
        """Lower ends of the ranges of use of the state coordinates; shape (n,)."""
        return _read_only(quantity.lower for quantity in self.state)

    @cached_property
    def state_upper(self) -> Array:
        """Upper ends of the ranges of use of the state coordinates; shape (n,)."""
        return _read_only(quantity.upper for quantity in self.state)

    @cached_property
    def command_scale(self) -> Array:
        """Half the range of each command coordinate; shape (m,)."""
        return _read_only((quantity.upper - quantity.lower) / 2 for quantity in self.command)

    @cached_property
    def command_lower(self) -> Array:
        """Lower command bounds; shape (m,)."""
        return _read_only(quantity.lower for quantity in self.command)

    @cached_property
    def command_upper(self) -> Array:
        """Upper command bounds; shape (m,)."""
        return _read_only(quantity.upper for quantity in self.command)

    @cached_property
    def command_centre(self) -> Array:
        """Middle of the command bounds; shape (m,)."""
        return _read_only((quantity.lower + quantity.upper) / 2 for quantity in self.command)

    def command_at(self, point: Array) -> Array:
        """Commands at scaled points, clipped to the command bounds, which are at −1 and 1; shape (…, m)."""
        command = self.command_centre + self.command_scale * point
        return np.minimum(np.maximum(command, self.command_lower), self.command_upper)

    def point_of(self, command: Array) -> Array:
        """Scaled points of commands; shape (…, m)."""
        return (command - self.command_centre) / self.command_scale

    def scaled_state(self, state: Array) -> Array:
        """States scaled so that the ranges of use end at −1 and 1; shape (…, n)."""
        return (state - self.state_centre) / self.state_scale

    def scaled_inputs(self, state: Array, command: Array) -> Array:
        """States and commands scaled so that their ranges end at −1 and 1, side by side; shape (…, n + m)."""
        return np.concatenate([self.scaled_state(state), self.point_of(command)], axis=-1)

    def scaled_jacobian(self, by_command: Array) -> Array:
        """∂(next state / `error_scale`)/∂point from ∂(next state)/∂command; shape (…, n, m)."""
        return by_command * self.command_scale / self.error_scale[:, None]


def _check_words(name: str, unit: str) -> None:
    """Raises ValueError unless name and unit can be written into any program, page or table."""
    require(is_name(name), "name", name, NAME_RULE)
    require(is_unit(unit), "unit", unit, UNIT_RULE)


def _read_only(numbers: Iterable[float]) -> Array:
    """Returns the numbers as a read-only array."""
    array = np.array(list(numbers), float)
    array.flags.writeable = False
    return array


class StepFailed(StepGapError):
    """A single step has no next state.

    Attributes:
        status: How the step ended.
        advice: What to try.
    """

    def __init__(self, status: StepStatus, space: StepSpace):
        self.status = status
        self.advice = space.advice_on(status)
        super().__init__(f"{status.label}: {self.advice}")


class Outcome(NamedTuple):
    """Prediction of a `StepMap` for one or many steps.

    Attributes:
        next_state: State after the step, NaN where it fails; shape (…, n).
        status: `StepStatus` value of each step; shape (…).
    """

    next_state: Array
    status: Codes


class CommandBefore(NamedTuple):
    """The effect of the command of the step before, which a `StepMap` counts as known.

    If that command had been another one, the next state would be higher by `effect` times the difference. The error of
    the step before may act, too: if the state had been another one by that error, the next state would be higher by
    `memory` times the difference.

    Attributes:
        effect: Shape (n, m) [units of the state per unit of the command].
        command: Of the step before the next one; shape (m,).
        memory: Shape (n, n).
    """

    effect: Array
    command: Array
    memory: Array


class StepMap(ABC):
    """Predicts the next state from the state and the command (Eq. 9).

    A subclass defines `space`, `evaluate` and `jacobian`; state (…, n) and command (…, m) broadcast
    over their leading axes.
    """

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.space.in_a_line}>"

    @property
    @abstractmethod
    def space(self) -> StepSpace:
        """Names, units and ranges."""

    @abstractmethod
    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; never raises for a step that fails."""

    @abstractmethod
    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails."""

    @property
    def command_before(self) -> CommandBefore | None:
        """The effect of the command of the step before; None if it has none, or is not known."""
        return None

    @property
    def noise_std(self) -> Array:
        """Standard deviation of a measured next state about its expected value; zero if unknown; shape (n,)."""
        return np.zeros(len(self.space.state))

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Standard deviation of the next state; zero for a map without uncertainty; shape (…, n) [state units].

        The standard deviation of a measured step is √(std² + `noise_std`²).
        """
        leading = np.broadcast_shapes(np.shape(state)[:-1], np.shape(command)[:-1])
        return np.zeros((*leading, len(self.space.state)))

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂std/∂(state, command); shape (…, n, n + m)."""
        leading = np.broadcast_shapes(np.shape(state)[:-1], np.shape(command)[:-1])
        return np.zeros((*leading, len(self.space.state), len(self.space.state) + len(self.space.command)))

    def __call__(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Next state; shape (…, n).

        Raises:
            StepFailed: The arguments are one step and it fails. In a batch such a step gives NaN.
        """
        next_state, status = self.evaluate(state, command)
        if next_state.ndim == 1 and int(status) != StepStatus.OK:
            raise StepFailed(StepStatus(int(status)), self.space)
        return next_state


def difference_jacobian(step_map: StepMap, state: ArrayLike, command: ArrayLike, relative_step: float = 1e-4) -> Array:
    """Central differences of a `StepMap`; shape (…, n, n + m).

    Args:
        step_map: The map to differentiate.
        state: Shape (…, n).
        command: Shape (…, m).
        relative_step: Step as a fraction of each coordinate's half range.
    """
    state = np.asarray(state, float)
    command = np.asarray(command, float)
    n = state.shape[-1]
    m = command.shape[-1]
    leading = np.broadcast_shapes(state.shape[:-1], command.shape[:-1])
    point = np.concatenate([np.broadcast_to(state, (*leading, n)), np.broadcast_to(command, (*leading, m))], axis=-1)
    step = relative_step * np.concatenate([step_map.space.state_scale, step_map.space.command_scale])
    offset = np.diag(step)
    points = np.stack([point[..., None, :] + offset, point[..., None, :] - offset])
    ahead, behind = step_map.evaluate(points[..., :n], points[..., n:]).next_state
    return np.swapaxes((ahead - behind) / (2 * step[:, None]), -1, -2)


NOT_GIVEN = _read_only(())  # Default of an array of a record that its maker does not give
_NO_CONTEXT: Mapping[str, float] = MappingProxyType({})  # Default of the context of a record


@dataclass(frozen=True, eq=False)
class StepRecord:
    """Record of one executed step.

    Attributes:
        state: State from which it started, as measured; shape (n,).
        command: Command given by the controller; shape (m,).
        applied: The part of the command that the joints received, after all limits; of a failed step, NaN where it is
            not known; shape (m,).
        next_state: State in which it ended, as measured; NaN if it failed; shape (n,).
        status: How it ended.
        context: What was measured around the step and is known when it ends, by the names in `StepSpace.context`, such
            as {"yaw": 0.3}; it is neither state nor command, and what is missing or NaN is unknown.
        requested: Command that was requested of the joints, within its bounds; by default `command`. It is another one
            where `command` came too late to act. Learning uses this one: then the effect of limits on a command
            is part of the learned map, and the controller plans with it. Shape (m,).
        true_next_state: State in which it ended as it truly was, known only for simulated plants, NaN elsewhere. It is
            for reports; nothing that controls or learns may read it. Shape (n,).

    Raises:
        ValueError: A number of the context is infinite, or the status is not a `StepStatus`.
    """

    state: Array
    command: Array
    applied: Array
    next_state: Array
    status: StepStatus
    context: Mapping[str, float] = field(default_factory=lambda: _NO_CONTEXT)
    requested: Array = field(default_factory=lambda: NOT_GIVEN)
    true_next_state: Array = field(default_factory=lambda: NOT_GIVEN)

    def __post_init__(self) -> None:
        for name, value in self.context.items():
            require(not isinf(value), f"context.{name}", value, "be a finite number, or NaN where it is not known")
        object.__setattr__(self, "status", StepStatus(self.status))
        if self.requested is NOT_GIVEN:
            object.__setattr__(self, "requested", self.command)
        if self.true_next_state is NOT_GIVEN:
            object.__setattr__(self, "true_next_state", np.full(np.shape(self.next_state), np.nan))
