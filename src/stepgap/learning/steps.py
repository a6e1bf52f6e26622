"""The append-only record of every executed step, in memory and by column."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from html import escape
from importlib import import_module
from typing import Any, Generic, Self, TypeVar, final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.base.errors import InputError
from stepgap.base.versions import INSTALL
from stepgap.step import Array, Codes, StepRecord, StepSpace, StepStatus

Labels = NDArray[np.intp]
"""Number of the deployment, fold or block that each step belongs to, from 0."""

_OF_STATE = ("state", "target", "next_state", "true_next_state", "predicted", "std")
_OF_COMMAND = ("command", "requested", "applied")
_NUMBERS = ("state", "target", *_OF_COMMAND, "next_state", "true_next_state", "predicted", "std", "context")
_MOST_COUNTS = 6  # Number of deployments above which a line on steps does not count those of each
_SHOWN_ROWS = 10  # Number of steps that notebooks show
AFTER = "_after"  # End of the names of the columns of the context
_LEAST_ROOM = 64  # Least number of steps for which memory is reserved
TAINTED = {StepStatus.DOUBTFUL: 30, StepStatus.FELL: 1, StepStatus.UNSTABLE: 1}
"""Number of steps before one with such a status whose states are doubtful, too: small faults are found late.

A sensor is the same in the next deployment of a run, so the steps before a doubt may be of earlier ones.
"""
_Values = TypeVar("_Values", Array, Labels, Codes)


@dataclass(frozen=True, eq=False)
class LoggedStep:
    """One executed step with its target and prediction: a row of `Steps` and of `steps.csv`.

    It is what a deployment yields, and what observers, writers and learners receive as soon as a step is executed.

    Attributes:
        iteration: Deployment it belongs to, from 0.
        step: Its number within the deployment, from 1; exploration steps, and before them the first step of a plant
            that knows it (`Plant.first_step`), come before, up to number 0.
        target: State wanted at its end; for an exploration step the predicted one, for the first step of a plant NaN;
            shape (n,).
        predicted: State that the controller's map predicted for the command; NaN where the controller found no
            command that makes a step; shape (n,).
        std: Standard deviation of that prediction, calibrated; zero for a map without one. Shape (n,).
        record: Record of the execution.
    """

    iteration: int
    step: int
    target: Array
    predicted: Array
    std: Array
    record: StepRecord

    @property
    def planned(self) -> bool:
        """Whether its command was planned: false for the first step of a plant (`Plant.first_step`)."""
        return self.step > 0 or not np.isnan(self.target).all()


class _Column(Generic[_Values]):
    """A column of `Steps`; its value is a new array."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, steps: "Steps", owner: type) -> _Values:
        column: Any = steps.rows[self._name].copy()
        return column


@final
class Steps:
    """Executed steps by column, in their order; a number that is not known is NaN. Immutable: `steps + more` is longer.

    Args:
        space: Names of their state, command and context; a quantity that it does not name is left out.

    Attributes:
        space: As above.
        rows: The steps as a structured array with one field for each column; not to be changed.
    """

    def __init__(self, space: StepSpace, steps: Iterable[LoggedStep] = ()):
        self.space = space
        self._memory = _Memory()
        self.rows = _rows_of(space, steps)

    @classmethod
    def of_columns(cls, space: StepSpace, **columns: ArrayLike) -> Self:
        """Steps of given columns, one of which is `state`; they have status OK unless `status` is given.

        Of the other columns, what is missing is unknown, but `requested` and `applied` are `command` by default,
        `iteration` is 0, and `number` counts from 1.
        """
        count = len(np.asarray(columns["state"]))
        values = dict[str, ArrayLike](columns)
        if "command" in columns:
            values = dict.fromkeys(("requested", "applied"), columns["command"]) | values
        labels = {"iteration": 0, "number": np.arange(1, count + 1), "status": StepStatus.OK}
        unknown = dict.fromkeys((*_OF_STATE, *_OF_COMMAND, "context"), np.nan)
        steps = cls(space)._of_rows(np.empty(count, _row_type(space)))
        return steps.with_columns(**(labels | unknown | values))

    def with_columns(self, **columns: ArrayLike) -> Self:
        """The same steps with other values in some columns."""
        rows = self.rows.copy()
        for name, values in columns.items():
            rows[name] = values
        return self._of_rows(rows)

    def in_space(self, space: StepSpace) -> Self:
        """The same numbers in a space of the same state and command, such as with other ranges; nothing is converted.

        Context that the new space does not name is dropped.
        """
        if space.context == self.space.context:
            return type(self)(space)._of_rows(self.rows)
        return type(self)(space, self)

    def selected(self, rows: NDArray[np.bool_] | Labels | slice) -> Self:
        """Some of the steps, given by a mask (N,), by their indices or by a slice."""
        return self._of_rows(self.rows[rows])

    @overload
    def __getitem__(self, rows: int) -> LoggedStep: ...

    @overload
    def __getitem__(self, rows: NDArray[np.bool_] | Labels | slice) -> Self: ...

    def __getitem__(self, rows: int | NDArray[np.bool_] | Labels | slice) -> LoggedStep | Self:
        """One step by its index, such as `steps[-1]`, or some of them, as `selected` takes them."""
        if isinstance(rows, int | np.integer):
            return _logged(self.space, self.rows[rows])
        return self.selected(rows)

    def __repr__(self) -> str:
        numbers, counts = np.unique(self.iteration, return_counts=True)
        of_each = ", ".join(f"{count} of deployment {one}" for count, one in zip(counts, numbers, strict=True))
        of_deployments = f" ({of_each})" if len(numbers) <= _MOST_COUNTS else f" of {len(numbers)} deployments"
        return f"<{len(self)} steps{of_deployments if len(numbers) else ''}: {self.space.in_a_line}>"

    def _repr_html_(self) -> str:
        """The first steps as a table, which notebooks show."""
        columns = self[:_SHOWN_ROWS].to_dict()
        heads = "".join(f"<th>{escape(name)}</th>" for name in columns)
        rows = [
            "".join(f"<td>{value if isinstance(value, str) else format(value, '.4g')}</td>" for value in row)
            for row in zip(*columns.values(), strict=True)
        ]
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        return f"<p>{escape(repr(self))}</p><table><tr>{heads}</tr>{body}</table>"

    def to_dict(self) -> dict[str, NDArray[Any]]:
        """The columns of `steps.csv` by their names, each with one value per step (N,); `status` is a word."""
        numbers = np.hstack([self.rows[name] for name in _NUMBERS]).T
        labels = np.array([StepStatus(code).label for code in self.status.tolist()], np.str_)
        return dict(zip(column_names(self.space), [self.iteration, self.number, *numbers, labels], strict=True))

    def to_pandas(self) -> Any:
        """The columns of `to_dict` as a `pandas.DataFrame`.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            pandas = import_module("pandas")  # most installations do not have it
        except ImportError:
            raise InputError(f"Steps.to_pandas needs pandas: {INSTALL} pandas; Steps.to_dict needs nothing") from None
        return pandas.DataFrame(self.to_dict())

    def _of_rows(self, rows: NDArray[np.void], memory: "_Memory | None" = None) -> Self:
        steps = type(self)(self.space)
        steps.rows = rows
        steps._memory = memory or _Memory()
        return steps

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[LoggedStep]:
        return (_logged(self.space, row) for row in self.rows)

    def __add__(self, steps: Iterable[LoggedStep]) -> Self:
        """Returns these steps followed by others; the time for one more does not depend on how many there are."""
        more = _rows_of(self.space, steps)
        return self._of_rows(*self._memory.joined(self.rows, more)) if len(more) else self

    iteration = _Column[Labels]()
    """Number of the deployment that each step belongs to; shape (N,)."""
    number = _Column[Labels]()
    """Number of each step in its deployment; shape (N,)."""
    status = _Column[Codes]()
    """`StepStatus` value of each step; shape (N,)."""
    state = _Column[Array]()
    """States at the start of each step; shape (N, n)."""
    target = _Column[Array]()
    """States wanted at the end; shape (N, n)."""
    command = _Column[Array]()
    """Commands of the controller; shape (N, m)."""
    requested = _Column[Array]()
    """Commands requested of the joints, which learning uses; shape (N, m)."""
    applied = _Column[Array]()
    """Commands applied; shape (N, m)."""
    next_state = _Column[Array]()
    """States at the end of each step, NaN where it failed; shape (N, n)."""
    true_next_state = _Column[Array]()
    """True states at the end of each step; shape (N, n)."""
    predicted = _Column[Array]()
    """Next states that the controller's map predicted; shape (N, n)."""
    std = _Column[Array]()
    """Standard deviations of these predictions; shape (N, n)."""
    context = _Column[Array]()
    """Context of each step, known at its end; shape (N, number of quantities in `space.context`)."""

    @property
    def last(self) -> LoggedStep | None:
        """The latest step; None if there is none."""
        return _logged(self.space, self.rows[-1]) if len(self) else None

    @property
    def iterations(self) -> list[int]:
        """Numbers of the deployments in it, in ascending order."""
        return np.unique(self.iteration).tolist()

    def of_iteration(self, iteration: int) -> Self:
        """The steps of one deployment."""
        return self.selected(self.iteration == iteration)

    def before(self, iteration: int) -> Self:
        """The steps of the deployments before one."""
        return self.selected(self.iteration < iteration)

    def tracking(self) -> Self:
        """The steps that tracked the reference; those up to number 0 had other targets, or none."""
        return self.selected(self.number > 0)

    @property
    def unplanned(self) -> NDArray[np.bool_]:
        """Whether each step is the first one of a plant (`Plant.first_step`), which had no target; shape (N,)."""
        return (self.number < 1) & np.isnan(self.target).all(axis=1)

    def planned(self) -> Self:
        """The steps whose command was planned: all but the `unplanned`."""
        unplanned = self.unplanned
        return self.selected(~unplanned) if unplanned.any() else self

    def completed(self) -> Self:
        """The steps that ended at their section: those with status OK."""
        return self.selected(self.status == StepStatus.OK)

    def tracking_errors(self) -> Array:
        """Next state − target of the completed steps that tracked the reference, NaN without a target; shape (k, n)."""
        tracked = self.tracking().completed()
        return tracked.next_state - tracked.target

    @property
    def tracked(self) -> list[int]:
        """Numbers of the state coordinates, from 0, that have a target in some of the steps."""
        return np.flatnonzero(np.isfinite(self.target).any(axis=0)).tolist()

    @property
    def failed_steps(self) -> int:
        """Number of steps that ended without a next state."""
        return int((self.status != StepStatus.OK).sum())

    @property
    def follows(self) -> NDArray[np.bool_]:
        """Whether each step directly followed the one before it among these steps; shape (N,)."""
        same, next_one = (np.diff(label, prepend=label[:1]) for label in (self.iteration, self.number))
        return (same == 0) & (next_one == 1)

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """Whether a sensor was doubtful in a step, or in one that soon followed it, by `TAINTED`; shape (N,).

        The fault may have begun before it was found, so that the states at the ends of the steps before are doubtful,
        too, also in earlier deployments of the same run. Before a fall, which may be due to a wrong state, only the
        step that it follows is.
        """
        follows = self.follows
        begins_again = np.diff(self.iteration, prepend=self.iteration[:1]) == 1
        doubtful = self.status == StepStatus.DOUBTFUL
        for status, count in TAINTED.items():
            reached = self.status == status
            goes_back = follows | begins_again if status == StepStatus.DOUBTFUL else follows
            for _ in range(count):
                reached = np.roll(reached & goes_back, -1)
                doubtful |= reached
        return doubtful

    @property
    def phase(self) -> Array:
        """Phase of the periodic context quantity when each step started [rad], NaN where it is unknown; shape (N,)."""
        periodic = self.space.periodic
        if periodic is None:
            return np.full(len(self), np.nan)
        after = self.context[:, self.space.context.index(periodic)]
        return np.where(self.follows, np.roll(periodic.phase(after), 1), np.nan)


class _Memory:
    """Memory that rows and those that continue them share, each being a beginning of it."""

    def __init__(self) -> None:
        self._rows = np.empty(0, np.void)
        self._used = 0

    def joined(self, rows: NDArray[np.void], more: NDArray[np.void]) -> tuple[NDArray[np.void], "_Memory"]:
        """Rows followed by others. They are copied only where there is no room, or where others follow them already."""
        end = len(rows) + len(more)
        if self._used != len(rows) or end > len(self._rows):
            memory = _Memory()
            memory._rows = np.empty(max(_LEAST_ROOM, 2 * end), rows.dtype)
            memory._rows[: len(rows)] = rows
        else:
            memory = self
        memory._rows[len(rows) : end] = more
        memory._used = end
        return memory._rows[:end], memory


def _row_type(space: StepSpace) -> np.dtype[np.void]:
    """Fields of a row, which are the columns of `Steps`."""
    sizes = {name: len(space.state) for name in _OF_STATE} | {name: len(space.command) for name in _OF_COMMAND}
    numbers = [(name, np.float64, (size,)) for name, size in (sizes | {"context": len(space.context)}).items()]
    return np.dtype([("iteration", np.intp), ("number", np.intp), ("status", np.int64), *numbers])


def _rows_of(space: StepSpace, steps: Iterable[LoggedStep]) -> NDArray[np.void]:
    """The steps as rows, with the context of the space."""
    if isinstance(steps, Steps) and steps.space.context == space.context:
        return steps.rows
    rows = [
        (
            *(logged.iteration, logged.step, int(logged.record.status)),
            *(logged.record.state, logged.target, logged.record.next_state, logged.record.true_next_state),
            *(logged.predicted, logged.std, logged.record.command, logged.record.requested, logged.record.applied),
            [logged.record.context.get(quantity.name, np.nan) for quantity in space.context],
        )
        for logged in steps
    ]
    return np.array(rows, _row_type(space))


def _logged(space: StepSpace, row: np.void) -> LoggedStep:
    context = {quantity.name: float(value) for quantity, value in zip(space.context, row["context"], strict=True)}
    record = StepRecord(
        state=row["state"],
        command=row["command"],
        applied=row["applied"],
        next_state=row["next_state"],
        status=StepStatus(int(row["status"])),
        context=context,
        requested=row["requested"],
        true_next_state=row["true_next_state"],
    )
    return LoggedStep(int(row["iteration"]), int(row["number"]), row["target"], row["predicted"], row["std"], record)


def joined(parts: Sequence[Steps]) -> Steps:
    """Concatenates the steps of one or more records; a number of a deployment is left out between two of them.

    The space is that of the first one, with the context of all.
    """
    context = {quantity.name: quantity for steps in reversed(parts) for quantity in reversed(steps.space.context)}
    merged = Steps(replace(parts[0].space, context=tuple(reversed(context.values()))))
    for steps in parts:
        first = max(merged.iterations, default=-2) + 2
        merged += steps.with_columns(iteration=steps.iteration + first)
    return merged


def runs_before(known: Steps) -> list[list[int]]:
    """Numbers of the deployments of each earlier run; they are negative, and one is missing between two runs."""
    runs = list[list[int]]()
    for number in (iteration for iteration in known.iterations if iteration < 0):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return runs


def as_past(known: Steps) -> Steps:
    """Steps renumbered as deployments before number 0."""
    return known.with_columns(iteration=known.iteration - max(known.iterations, default=-1) - 1)


def column_names(space: StepSpace) -> list[str]:
    """Columns of `Steps.to_dict` and of `steps.csv`."""
    state = space.state_names
    command = space.command_names
    return [
        "iteration",
        "step",
        *state,
        *(f"target_{name}" for name in state),
        *command,
        *(f"{kind}_{name}" for kind in ("requested", "applied") for name in command),
        *(f"{kind}_{name}" for kind in ("next", "true_next", "predicted", "std") for name in state),
        *(f"{name}{AFTER}" for name in space.context_names),
        "status",
    ]
