"""A deployment without torque: it displays sensor values and the torques that the control law would command."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from time import sleep

from rich.live import Live
from rich.table import Table

from stepgap.base.errors import InputError
from stepgap.base.signals import terminated_as_interrupted
from stepgap.cli.screen import screen
from stepgap.hardware.commissioning.limp import LastTick, describe_devices, ended, limp_setup
from stepgap.hardware.realtime.session import Session
from stepgap.plants.tick_control import RobotControl
from stepgap.plants.ticks.log_description import LogDescription
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import TickLog, TickLogError, next_path
from stepgap.rigs.rig import Rig, RigFault
from stepgap.step import Array

FOLDER = Path("dry-run")  # Folder of the tick logs
_UPDATE_EVERY = 0.1  # Time between two updates of the display [s]
DisplayedTick = dict[str, str]  # Displayed texts of a tick by their names


class WatchedLog(TickLog):
    """A tick log that also remembers the last tick.

    Attributes:
        last: The last tick with known sensor values.
        count: Number of ticks so far.
        worst: Largest delay of a tick [s].
    """

    def __init__(self, path: Path, units: Mapping[str, str], description: LogDescription):
        super().__init__(path, units, description)
        self.last = LastTick(units)
        self.count = 0
        self.worst = 0.0

    def append(self, rows: Array) -> None:
        """Adds ticks to the log."""
        super().append(rows)
        self.last.append(rows)
        self.count += len(rows)
        self.worst = max([self.worst, *rows[:, -1].tolist()])


class Travelled:
    """Distances that different sensors measured since a foot was put on the ground."""

    def __init__(self) -> None:
        self._start: dict[str, float] = {}

    def describe(self, travels: dict[str, float]) -> DisplayedTick:
        """Describes the change of each distance [m]; empty while there are none, after which they begin again."""
        self._start = (self._start or travels) if travels else {}
        return {name: f"{1e3 * (value - self._start[name]):+.1f} mm" for name, value in travels.items()}


def dry_run(make_rig: Callable[[], Rig], robot_control: RobotControl, seconds: float | None) -> Path:
    """Displays the ticks of a limp robot for a time, or until Ctrl-C; returns the path of their log.

    Args:
        make_rig: Creates its rig; it must be possible to pickle it.
        seconds: Duration, rounded to ticks [s]; None until Ctrl-C.

    Raises:
        InputError: The log cannot be written.
        RigFault: The bus or a drive failed.
    """
    path = next_path(FOLDER)
    rig = make_rig()
    setup = limp_setup(make_rig, robot_control)
    try:
        log = WatchedLog(path, setup.units, setup.described())
    except TickLogError as error:
        raise InputError(str(error)) from None
    wanted = float("inf") if seconds is None else seconds / rig.sensor_model.tick
    fault = ""
    with (
        Session(setup, log) as session,
        suppress(KeyboardInterrupt),  # the regular end
        terminated_as_interrupted(),
        _display(round(1 / rig.sensor_model.tick)) as display,
    ):
        described = partial(_described, rig, robot_control, Travelled(), log, session)
        while log.count < wanted and not session.over():
            sleep(_UPDATE_EVERY)
            display(described(), log.count)
        if fault := ended(session):
            sleep(_UPDATE_EVERY)  # until the last ticks are read
            display(described(), None)
    print(path)
    if fault:
        raise RigFault(fault)
    return path


def _described(
    rig: Rig, robot_control: RobotControl, travelled: Travelled, log: WatchedLog, session: Session
) -> DisplayedTick:
    tick = log.last.fields
    if not tick:
        return {"state": session.board.state.name}
    return {
        "state": RigState(int(tick["state"])).name,
        **robot_control.describe(rig, tick),
        **travelled.describe(robot_control.travels(rig, tick)),
        **describe_devices(rig, tick),
        "late": f"{1e6 * tick['late']:.0f} µs, at most {1e6 * log.worst:.0f} µs",
        "lost": f"{session.board.lost_frames} frames",
    }


@contextmanager
def _display(every: int) -> Iterator[Callable[[DisplayedTick, int | None], None]]:
    """Displays ticks as a table that is updated, on a terminal; otherwise as a plain line every `every` ticks.

    The last tick before a fault, which has no number, is always displayed.
    """
    console = screen(sys.stderr)
    if console.is_terminal:
        with Live(console=console, auto_refresh=False) as live:
            yield lambda tick, _: live.update(_table(tick), refresh=True)
        return
    due = 0

    def line(tick: DisplayedTick, count: int | None) -> None:
        nonlocal due
        if count is None or count >= due:
            console.print("; ".join(f"{name} {text}" for name, text in tick.items()), soft_wrap=True)
            due = ((count or 0) // every + 1) * every

    yield line


def _table(tick: DisplayedTick) -> Table:
    table = Table(show_header=False, title="limp: no torque is given", box=None)
    for name, text in tick.items():
        table.add_row(name, text)
    return table
