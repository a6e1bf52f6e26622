"""Everything of a deployment but torque: what the robot's sensors say and what the law would want, while it is limp."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from math import isfinite
from pathlib import Path
from time import sleep

from rich.console import Console
from rich.live import Live
from rich.table import Table

from stepgap.base.errors import InputError
from stepgap.base.signals import terminated_as_interrupted
from stepgap.plants.commissioning.limp import ended, limp_setup
from stepgap.plants.realtime.session import Session
from stepgap.plants.realtime.states import RigState
from stepgap.plants.tick_control import RobotControl
from stepgap.plants.ticks.tick_log import TickLog, TickLogError, next_path
from stepgap.rigs.limp_rig import FrameCount
from stepgap.rigs.rig import Rig, RigFault
from stepgap.step import Array

FOLDER = Path("dry-run")
"""Where ticks go."""

_LOOK_EVERY = 0.1
"""Time between two pictures [s]."""

Shown = dict[str, str]
"""What is shown: words by name."""


class WatchedLog:
    """A tick log that keeps the last tick in mind.

    Attributes:
        count: Ticks so far.
        last: Fields of the last one whose sensor values are known, by name; nothing before the first.
        worst: Largest delay of a tick's beginning [s].
    """

    def __init__(self, log: TickLog, names: Iterable[str]):
        self._log, self._names, self.count, self.worst = log, tuple(names), 0, 0.0
        self.last: dict[str, float] = {}

    def append(self, rows: Array) -> None:
        """Takes ticks."""
        self._log.append(rows)
        self.count += len(rows)
        for row in rows[::-1].tolist():
            if all(map(isfinite, row)):
                self.last = dict(zip(self._names, row, strict=True))
                break
        self.worst = max([self.worst, *rows[:, -1].tolist()])

    def flush(self) -> None:
        """As the log does."""
        self._log.flush()

    def close(self) -> None:
        """As the log does."""
        self._log.close()


def dry_run(make_rig: Callable[[], Rig], robot_control: RobotControl, seconds: float | None) -> Path:
    """Shows a limp robot's ticks for a while, or until Ctrl-C; the log of them.

    Args:
        make_rig: Makes its rig; it must be possible to pickle it.
        robot_control: Computes the torques that are shown.
        seconds: How long, in ticks.

    Raises:
        InputError: The log cannot be written.
        RigFault: The bus or a drive failed.
    """
    path, frames, rig = next_path(FOLDER), FrameCount(), make_rig()
    setup = limp_setup(make_rig, robot_control, frames)
    try:
        log = WatchedLog(TickLog(path, setup.units), setup.units)
    except TickLogError as error:
        raise InputError(str(error)) from None
    wanted, fault = float("inf") if seconds is None else seconds / rig.sensor_model.tick, ""
    describe = _describer(rig, robot_control, frames)
    session = Session(setup, log)
    try:
        with terminated_as_interrupted(), _shown(round(1 / rig.sensor_model.tick)) as show:
            while log.count < wanted and not session.over():
                sleep(_LOOK_EVERY)
                show(describe(log, session), log.count)
        fault = ended(session)
    except KeyboardInterrupt:
        pass  # this is how it ends
    finally:
        session.close()
    print(path)
    if fault:
        raise RigFault(fault)
    return path


def _describer(rig: Rig, robot_control: RobotControl, frames: FrameCount) -> Callable[[WatchedLog, Session], Shown]:
    """What is to be shown of the last tick."""

    def describe(log: WatchedLog, session: Session) -> Shown:
        tick = log.last
        if not tick:
            return {"state": session.board.state.name}
        return {
            "state": RigState(int(tick["state"])).name,
            **robot_control.describe(rig, tick),
            "late": f"{1e6 * tick['late']:.0f} µs, at most {1e6 * log.worst:.0f} µs",
            "lost": f"{frames.lost} frames",
        }

    return describe


@contextmanager
def _shown(every: int) -> Iterator[Callable[[Shown, int], None]]:
    """A table that changes in its place, on a terminal; elsewhere a plain line every so many ticks."""
    console = Console(stderr=True, highlight=False)
    if console.is_terminal:
        with Live(console=console, auto_refresh=False) as live:
            yield lambda shown, _: live.update(_table(shown), refresh=True)
        return
    due = 0

    def line(shown: Shown, count: int) -> None:
        nonlocal due
        if count >= due:
            console.print("; ".join(f"{name} {words}" for name, words in shown.items()), soft_wrap=True)
            due = (count // every + 1) * every

    yield line


def _table(shown: Shown) -> Table:
    table = Table(show_header=False, title="limp: no torque is given", box=None)
    for name, words in shown.items():
        table.add_row(name, words)
    return table
