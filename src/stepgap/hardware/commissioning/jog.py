"""Sessions of `stepgap rig jog`: a limp robot that a person moves by hand, and a step with the consent of a person."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from time import sleep

from stepgap.base.signals import terminated_as_interrupted
from stepgap.hardware.commissioning.limp import LastTick, ended
from stepgap.hardware.realtime.board import Request
from stepgap.hardware.realtime.consent import Consent
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.session import Session
from stepgap.plants.ticks.tick_log import TickLog, next_path, read_intact_ticks
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.rig import RigFault

JOG = "jog"  # Verb of `stepgap rig`, and folder of its logs
_LOOK_EVERY = 0.02  # Time between two looks at the state of the session [s]


@contextmanager
def limp_robot(setup: RealtimeSetup) -> Iterator[Callable[[], Mapping[str, float]]]:
    """Runs a limp robot within the block; yields a function that returns its last tick.

    Args:
        setup: Setup from `limp_setup`.

    Raises:
        RigFault: The rig failed.
    """
    last = LastTick(setup.units)
    session = Session(setup, last)

    def look() -> Mapping[str, float]:
        session.check()
        return last.fields

    try:
        with terminated_as_interrupted():
            while not look():
                sleep(_LOOK_EVERY)
            yield look
    finally:
        session.close()


def ticks_of_step(setup: RealtimeSetup, consent: Consent, settings: str) -> tuple[Path, TickTable]:
    """Runs a robot until the end of its first step, with the consent of a person; returns the log and its ticks.

    Args:
        setup: Setup of the rig.
        consent: Asks a person when the robot is connected and limp.
        settings: Text of the file that describes the rig, for the log.

    Raises:
        RigFault: The rig failed, a safety function stopped it, or there is no consent.
        TickLogError: The log cannot be written.
    """
    path = next_path(Path(JOG))
    session = Session(setup, TickLog(path, setup.units, setup.described(settings)))
    try:
        with terminated_as_interrupted():
            session.await_ready()
            with consent(session.board):
                session.board.request = Request.START
                while session.board.finished(0) is None and not ended(session):
                    session.check_sink()
                    sleep(_LOOK_EVERY)
    finally:
        session.close()
    if fault := session.message():
        raise RigFault(f"{fault} ({path})")
    units, rows, _ = read_intact_ticks(path)
    return path, TickTable(units, rows)
