"""The time of each row of a log: its column, one clock for all topics, and counters that begin anew."""

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.log_table import LogTable
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

TIMES: Final = ("time", "log_time", "t", "timestamp", "__time")
"""Names of the column of the time, where none is given; the first one that a table has is used."""

LOGGED: Final = "log_time"
"""Column of messages: when they were recorded, by the clock of the computer."""

STAMPS: Final = ("header.stamp", "stamp", "timestamp")
"""Columns of messages that say when they were made, perhaps by the clock of a simulation."""

_SIMULATED: Final = ("/clock", "clock")  # Topic of the time of a simulation, and its column

_FEWEST: Final = 10  # Smallest number of stamps from which their rate is found
_INCREASING: Final = 0.9  # Smallest part of stamps that are later than the one before, if they are a clock
_RATES: Final = (1e-2, 1e2)  # Rates of clocks; stamps with others are in another unit
_SAME_RATE: Final = 2e-3  # Largest difference of the rates of two clocks that run alike
_APART: Final = 1.0  # Largest time between a stamp and the clock of the other stamps [s]
_COARSE: Final = 0.25  # Rounding of times that hides the motion within a step [s]
_COARSE_SINGLE: Final = 0.02  # The same, if it is that of single precision, which nobody wants [s]
_DAYS: Final = (20_000.0, 80_000.0)  # Dates of logs as Excel counts days
_SHORT_STEP: Final = 2e-6  # A time between two rows of less than 0.2 s, in days
_SLOWEST: Final = 0.4  # Time between two rows of a log [s] from which on it is in another unit, if that is not given
_DELAYED: Final = 0.5  # Largest time by which messages are late from time to time [s]


class _Pairs(NamedTuple):
    """When the messages of a topic were recorded, and their stamps [s]; shapes (P,), both increase."""

    topic: str
    column: str
    logged: Array
    stamped: Array

    @property
    def rate(self) -> float:
        """Seconds of the stamps in a second."""
        return float((self.stamped[-1] - self.stamped[0]) / (self.logged[-1] - self.logged[0]))

    @property
    def is_another(self) -> bool:
        """Whether the stamps run at another rate than the time of recording, or stop while it goes on."""
        span = self.logged[-1] - self.logged[0]
        late = self.logged - self.stamped
        line = np.polyfit(self.logged - self.logged[0], late, 1)
        scatter = late - np.polyval(line, self.logged - self.logged[0])
        noise = 1.4826 * float(np.median(np.abs(scatter - np.median(scatter))))
        drift = abs(line[0]) * span
        spread = float(np.ptp(np.percentile(late, [5, 95])))
        return drift > max(6 * noise, _SAME_RATE * span) or spread > max(_DELAYED, _SAME_RATE * span)

    def at(self, logged: Array) -> Array:
        """The stamps that messages recorded at some times would have; beyond the ends at the mean rate."""
        inside = np.interp(logged, self.logged, self.stamped)
        beyond = logged - np.clip(logged, self.logged[0], self.logged[-1])
        return inside + self.rate * beyond


@final
@dataclass(frozen=True, eq=False)
class Clock:
    """The clock of a log.

    Attributes:
        name: The column of the time; empty if each table has the first of `TIMES`.
        factors: Factors by which columns are multiplied.
        pairs: Times of recording and of this clock, by which messages without the column get their time; None if each
            table has its own times.
    """

    name: str
    factors: Mapping[str, float]
    pairs: _Pairs | None = None

    @property
    def described(self) -> str:
        """Text for the user; empty if the log has no messages."""
        return f"{self.name} of {self.pairs.topic}" if self.pairs else self.name

    def _column_of(self, table: LogTable) -> str | None:
        names = [self.name] if self.name else TIMES
        return next((one for one in names if not table.fault_of(one)), None)

    def check_unit(self, tables: Iterable[tuple[LogTable, Array]]) -> None:
        """Raises RecordError if the times of a log are in another unit than seconds, and their factor is not given.

        The rows of its fastest table are then too far apart for motion. Times of messages are always in seconds.
        """
        measured = [(table, time[np.isfinite(time)]) for table, time in tables if not _is_logged(table)]
        apart = [float(np.median(np.diff(time))) if len(time) > _FEWEST else 0.0 for _, time in measured]
        if min(apart, default=0.0) < _SLOWEST:
            return
        table = measured[int(np.argmin(apart))][0]
        column = self._column_of(table)
        if column is None or column in self.factors or table.columns[column].dtype.kind == "U":
            return
        factor = 1e-3 if min(apart) < 1e3 * _SLOWEST else 1e-6
        raise RecordError(
            f"{table.source}, column {column!r}: in seconds, its rows were {min(apart):.3g} s apart, too far to see "
            f"steps; give its factor in [factors] of --columns, such as {column} = {factor:g}, or 1 if it is in seconds"
        )

    def timed(self, table: LogTable) -> tuple[LogTable, Array] | None:
        """A table and the time of each row [s]; None if it has none.

        Raises:
            RecordError: The time goes back.
        """
        column = self._column_of(table)
        if self.pairs is None or not _is_logged(table):
            return (table, checked_times(table, column, self.factors)) if column else None
        placed = self.pairs.at(checked_times(table, LOGGED, self.factors))
        if column is None:
            return table, placed
        stamped = table.times(column, self.factors.get(column, 1.0))
        if -np.diff(stamped[np.isfinite(stamped)]).min(initial=0.0) > _DELAYED:
            return table, checked_times(table, column, self.factors)
        apart = np.abs(stamped - placed)[np.isfinite(stamped)]
        if len(apart) and np.median(apart) > max(_APART, _SAME_RATE * np.ptp(placed)):
            _warn(f"{table.source}: its {column} is not by the clock of {self.pairs.topic}, so its log_time counts")
            return table, placed
        order = np.argsort(stamped, kind="stable")  # messages may have been recorded in another order
        return rows_of(table, order), stamped[order]


def clock_of(source: str, files: Sequence[Mapping[str, LogTable]], name: str, factors: Mapping[str, float]) -> Clock:
    """The clock of the tables of a log.

    Where a column is named that only some topics have, or the stamps run at another rate than the time of recording,
    all topics have the clock of the stamps; a `StepGapWarning` says it.

    Args:
        source: The log, for messages.
        files: Tables by topic, for each file.
        name: The column of the time, perhaps as TOPIC:COLUMN; empty if the user names none.
    """
    messages = [(topic, table) for file in files for topic, table in file.items() if _is_logged(table)]
    if not messages:
        return Clock(name, factors)
    return _named_clock(source, messages, name, factors) if name else _found_clock(source, messages, factors)


def _named_clock(
    source: str, messages: Sequence[tuple[str, LogTable]], name: str, factors: Mapping[str, float]
) -> Clock:
    chosen = [(topic, table) for topic, table in messages if name.startswith(f"{topic}:")]
    column = name.removeprefix(f"{chosen[0][0]}:") if chosen else name
    pairs = list(_pairs(chosen or messages, [column], factors))
    if column == LOGGED or not pairs:
        return Clock(column, factors)
    best = max(pairs, key=lambda one: len(one.logged))
    if lacking := [topic for topic, table in messages if table.fault_of(column)]:
        topics = f"{', '.join(lacking):.200}"
        _warn(f"{source}: {topics}: no {column}, so placed by log_time among the messages of {best.topic}")
    return Clock(column, factors, best)


def _found_clock(source: str, messages: Sequence[tuple[str, LogTable]], factors: Mapping[str, float]) -> Clock:
    common = next(one for one in TIMES if not any(table.fault_of(one) for _, table in messages))
    pairs = list(_pairs(messages, STAMPS, factors))
    others = [one for one in pairs if one.is_another]
    if common != LOGGED or not others:
        return Clock(common, factors)
    best = max(others, key=lambda one: (one.topic == _SIMULATED[0], len(one.logged)))
    speed = f"{best.rate:.3g} of the speed of log_time"
    if best.topic != _SIMULATED[0] and len(others) < len(pairs):
        topics = f"{', '.join(one.topic for one in others):.200}"
        _warn(f"{source}: the stamps of {topics} run at {speed}, but others do not, so all times are log_time")
        return Clock(LOGGED, factors)
    _warn(
        f"{source}: the stamps of {best.topic} run at {speed}, as in a simulation, so all times are by this clock; "
        "--time log_time is for those of recording"
    )
    return Clock(best.column, factors, best)


def _is_logged(table: LogTable) -> bool:
    return LOGGED in table.columns and table.columns[LOGGED].dtype.kind == "f"


def _pairs(
    messages: Sequence[tuple[str, LogTable]], names: Sequence[str], factors: Mapping[str, float]
) -> Iterator[_Pairs]:
    """Yields the pairs of the topics whose stamps are those of a clock."""
    for topic, table in messages:
        columns = [_SIMULATED[1]] if topic == _SIMULATED[0] else names
        column = next((one for one in columns if not table.fault_of(one)), None)
        if column is None or table.columns[column].dtype.kind != "f":
            continue
        logged = np.asarray(table.columns[LOGGED], float) * factors.get(LOGGED, 1.0)
        stamped = np.asarray(table.columns[column], float) * factors.get(column, 1.0)
        has_both = np.isfinite(stamped) & np.isfinite(logged)
        # The longest part in which the clock was not set back, such as by a reset of the simulation.
        parts = np.split(np.flatnonzero(has_both), np.flatnonzero(np.diff(stamped[has_both]) < -_DELAYED) + 1)
        rows = max(parts, key=len)
        rising = np.diff(np.maximum.accumulate(stamped[rows]), prepend=-np.inf) > 0
        later = rows[rising & (np.diff(logged[rows], prepend=-np.inf) >= 0)]
        if len(later) < max(_FEWEST, _INCREASING * len(rows)) or logged[later[-1]] <= logged[later[0]]:
            continue
        pairs = _Pairs(topic, column, logged[later], stamped[later])
        if _RATES[0] < pairs.rate < _RATES[1]:
            yield pairs


def checked_times(table: LogTable, column: str, factors: Mapping[str, float]) -> Array:
    """The times in a column [s], of which those after midnight, or after the end of a counter, follow those before.

    Raises:
        RecordError: They go back, or cannot tell the rows apart.
    """
    factor = factors.get(column, 1.0)
    time = table.times(column, factor)
    rows = np.flatnonzero(np.isfinite(time))
    back = np.flatnonzero(np.diff(time[rows]) < 0)
    if len(back):
        before = rows[back[0]]
        after = rows[back[0] + 1]
        where = f"{table.row(int(after))}, column {column!r}"
        change = f"{where}: the time goes back from {time[before]:.6f} to {time[after]:.6f} s"
        period = _period(time[rows], factor)
        if not period:
            raise RecordError(f"{change}; split the log there, or name the column of its episodes by --deployment")
        kind = _PERIODS.get(period, "a counter that begins anew")
        _warn(f"{change}, as {kind}; {period:.10g} s are added from there on")
        time = time.copy()
        time[rows[1:]] += period * np.cumsum(np.diff(time[rows]) < 0)
    _check_rounding(table, column, time[rows])
    return time


_PERIODS: Final = {
    86_400.0: "the time of the day at midnight",
    43_200.0: "a clock of twelve hours",
    604_800.0: "the time of the week",
    3_600.0: "the minutes of an hour, or a clock that is set back in autumn",
}
"""Times after which clocks begin anew [s]."""

_COUNTERS: Final = (2.0**32, 2.0**16)  # Numbers after which counters do


def _period(time: Array, factor: float) -> float:
    """The period by which a clock goes back where it does, but for about a row; 0 if there is none."""
    steps = np.diff(time)
    usual = float(np.median(steps))
    for period in (*_PERIODS, *(count * factor for count in _COUNTERS)):
        forward = steps[steps < 0] + period
        if (forward >= 0).all() and (forward <= max(50 * usual, 1e-3 * period)).all():
            return period
    return 0.0


def _check_rounding(table: LogTable, column: str, time: Array) -> None:
    """Raises RecordError if times do not tell rows apart, because they were rounded, or are in days."""
    where = f"{table.source}, column {column!r}"
    steps = np.diff(time)
    later = steps[steps > 0]
    if len(time) < _FEWEST:
        return
    if not len(later):
        raise RecordError(
            f"{where}: all {len(time)} rows have the time {time[0]:.10g}; write more digits, in double precision, "
            "or name another column by --time"
        )
    if time[0] > _DAYS[0] and np.median(later) < _SHORT_STEP and time[-1] < _DAYS[1]:
        raise RecordError(f"{where}: days, as of Excel; its factor in [factors] of --columns is 86400")
    rounding = float(later.min())
    spacing = float(np.spacing(np.float32(np.abs(time).max())))
    is_single = bool((time.astype(np.float32) == time).all()) and spacing / 2 <= rounding <= 2 * spacing
    if 2 * len(later) > len(steps) or rounding < (_COARSE_SINGLE if is_single else _COARSE):
        return
    why = "in single precision" if is_single else "with too few digits"
    raise RecordError(
        f"{where}: {len(time)} rows have only {len(later) + 1} different times, written {why}; write them in double "
        "precision, or from the begin of the log"
    )


def rows_of(table: LogTable, rows: NDArray[np.intp]) -> LogTable:
    """The rows of a table with these indices, in this order."""
    columns = {name: values[rows] for name, values in table.columns.items()}
    return replace(table, columns=columns, lines=None if table.lines is None else table.lines[rows])


def _warn(message: str) -> None:
    warnings.warn(message, StepGapWarning, stacklevel=3)
