"""Everything of a deployment but torque: what the robot's sensors say and what the law would want, while it is limp."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import degrees, isfinite
from pathlib import Path
from time import sleep

from rich.console import Console
from rich.live import Live
from rich.table import Table

from stepgap.base.settings_file import InputError
from stepgap.base.signals import terminated_as_interrupted
from stepgap.plants.commissioning.limp import ended, limp_setup
from stepgap.plants.realtime.session import Session
from stepgap.plants.realtime.states import RigState
from stepgap.plants.ticks.tick_log import TickLog, TickLogError, next_path
from stepgap.rigs.limp_rig import FrameCount
from stepgap.rigs.rig import Reading, Rig, RigFault
from stepgap.robots.hopper.hop_control import HopControl
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.phases import Phase
from stepgap.robots.hopper.safety import Limited
from stepgap.robots.hopper.tick import LOG_UNITS
from stepgap.step import Array

FOLDER = Path("dry-run")
"""Where ticks go."""

LOOK_EVERY = 0.1
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

    def __init__(self, log: TickLog):
        self._log, self.count, self.worst = log, 0, 0.0
        self.last: dict[str, float] = {}

    def append(self, rows: Array) -> None:
        """Takes ticks."""
        self._log.append(rows)
        self.count += len(rows)
        for row in rows[::-1].tolist():
            if all(map(isfinite, row)):
                self.last = dict(zip(LOG_UNITS, row, strict=True))
                break
        self.worst = max([self.worst, *rows[:, -1].tolist()])

    def flush(self) -> None:
        """As the log does."""
        self._log.flush()

    def close(self) -> None:
        """As the log does."""
        self._log.close()


def dry_run(make_rig: Callable[[], Rig], robot: RobotParameters, gains: Gains, seconds: float | None) -> Path:
    """Shows a limp robot's ticks for a while, or until Ctrl-C; the log of them.

    Args:
        make_rig: Makes its rig; it must be possible to pickle it.
        robot: On it.
        gains: Of the law whose torques are shown.
        seconds: How long, in ticks.

    Raises:
        InputError: The log cannot be written.
        RigFault: The bus or a drive failed.
    """
    path, frames, rig = next_path(FOLDER), FrameCount(), make_rig()
    try:
        log = WatchedLog(TickLog(path, LOG_UNITS))
    except TickLogError as error:
        raise InputError(str(error)) from None
    wanted, fault = float("inf") if seconds is None else seconds / rig.layout.tick, ""
    describe = _describer(rig, robot, gains, frames)
    session = Session(limp_setup(make_rig, robot, gains, frames), log)
    try:
        with terminated_as_interrupted(), _shown(round(1 / rig.layout.tick)) as show:
            while log.count < wanted and not session.over():
                sleep(LOOK_EVERY)
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


def _describer(
    rig: Rig, robot: RobotParameters, gains: Gains, frames: FrameCount
) -> Callable[[WatchedLog, Session], Shown]:
    """What is to be shown of the last tick."""
    layout, limits = rig.layout, rig.limits or SafetyLimits.of(robot)

    def describe(log: WatchedLog, session: Session) -> Shown:
        tick = log.last
        if not tick:
            return {"state": session.board.state.name}
        reading = Reading(*(tick[name] for name in Reading._fields))
        seen = HopControl(layout, robot, gains, limits).look(reading)
        motion, beyond = seen.motion, Limited(seen.watch.stopped)
        return {
            "state": RigState(int(tick["state"])).name,
            "phase": Phase(int(tick["phase"])).name,
            "alpha_1": f"{degrees(motion.alpha_1):+.2f}°",
            "alpha_2": f"{degrees(motion.alpha_2):+.2f}°",
            "leg": f"{motion.leg_length:.4f} m",
            "hip": f"{motion.hip_height:.4f} m",
            "contact": f"{reading.contact_force:+.1f} N",
            "wanted": f"{tick['asked_1']:+.2f}, {tick['asked_2']:+.2f} N·m",
            "late": f"{1e6 * tick['late']:.0f} µs, at most {1e6 * log.worst:.0f} µs",
            "lost": f"{frames.lost} frames",
            "beyond": (beyond.name or "nothing").lower().replace("_", " ").replace("|", ", ") if beyond else "nothing",
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
