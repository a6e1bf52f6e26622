"""A plant in real time: the loop runs in a separate process, and this one gives it a command for every step."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from time import sleep

import numpy as np

from stepgap.hardware.realtime.board import Request, StepEnd
from stepgap.hardware.realtime.consent import Consent
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.session import Session
from stepgap.plants.plant import AtTouchdown, Plant, StepCommands, Touchdown
from stepgap.plants.tick_control import FinishedStep
from stepgap.plants.ticks.tick_log import TickLog, TickLogError, next_path
from stepgap.rigs.rig import RigFault
from stepgap.step import Array, StepRecord, StepSpace, StepStatus

_CHECK_EVERY = 1e-3  # Time between two checks whether a step has ended [s]


class KeptEvidence:
    """Evidence against the sensors that the deployments of a run hand on: `TickControl.evidence`.

    Attributes:
        numbers: That after the last deployment; empty if there is none.
    """

    numbers: tuple[float, ...] = ()


class RealtimePlant(Plant):
    """Executes steps on a rig that does not wait for commands.

    The robot's control determines when a step ends and until when the next command may come; for a hopper, from the
    apex to the following mid-stance, some 0.3 s. A step whose command comes later is made without one, and the
    requested command in its record is zero. If that happens twice in a row, the robot lands
    (`LoopSettings.missed_commands`).

    Args:
        setup: The rig and its control.
        logs: Folder for the ticks of every deployment, `ticks-*.mcap`.
        consent: Asks a person for consent, when the rig is connected and limp, before torque is given.
        settings: Text of the file that describes the rig, for the logs.
        kept: Evidence that the plants of a run hand on; None for this plant alone.
    """

    def __init__(
        self, setup: RealtimeSetup, logs: Path, consent: Consent, settings: str = "", kept: KeptEvidence | None = None
    ):
        self._setup = setup
        self._logs = logs
        self._consent = consent
        self._settings = settings
        self._kept = kept or KeptEvidence()
        self._consented = ExitStack()
        self._space = setup.robot_control.space
        self._session = None
        self._measured = np.full(len(self._space.state), np.nan)
        self._step = 0
        self._fault = ""
        self._context: tuple[float, ...] = ()

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of its robot."""
        return self._space

    @property
    def fault(self) -> str:
        """Why the last deployment was aborted, or what failed during the landing; empty if there was no fault."""
        return self._fault

    def start(self) -> Array:
        """Takes the first step, without a command, which begins when the robot, held until then, is released.

        Before, the rig is connected without torque, a person consents, and the robot takes its posture for the release.

        Returns:
            The state at the end of that step; shape (n,).

        Raises:
            RigFault: The rig cannot be connected, or the first step failed.
        """
        self.stop()
        self._step = 0
        self._fault = ""
        try:
            log = TickLog(next_path(self._logs), self._setup.units, self._setup.described(self._settings))
        except TickLogError as error:
            raise RigFault(str(error)) from None
        self._session = session = Session(self._setup, log, self._kept.numbers)
        session.await_ready()
        self._consented.enter_context(self._consent(session.board))
        session.board.request = Request.START
        first, status = self._await_step(session)
        if status != StepStatus.OK:
            detail = f" ({self._fault})" if self._fault else ""
            raise RigFault(f"the first step failed: {status.label}{detail}: {self.space.advice_on(status)}")
        return self._space.above(first.state, self._context)

    def take_step(self, command: Array) -> StepRecord:
        """Takes a step, as `take_replanned_step` does, with the command alone."""
        return self._next(command, None)

    def take_replanned_step(self, command: Array, at_touchdown: AtTouchdown) -> StepRecord:
        """Takes a step whose command is chosen anew at its touchdown; if that is too late, the first one acts."""
        return self._next(command, at_touchdown)

    def _next(self, command: Array, at_touchdown: AtTouchdown | None) -> StepRecord:
        """Takes a step; after a fall, a fault or a safety stop the record has no next state, and the robot lands.

        Raises:
            RigFault: The log of ticks cannot be written.
        """
        session = self._session
        before = self._measured
        space = self._space
        if session is None:
            raise RigFault("the rig is not started")
        commands = StepCommands(space, command)
        if np.isnan(commands.within).any():
            self.stop()
            state = space.start(before, self._context)
            nowhere = np.full(len(before), np.nan)
            return StepRecord(state, commands.first, commands.within, nowhere, StepStatus.INVALID)
        self._step += 1
        session.board.post_command(self._step, commands.within.tolist())
        asked = False

        def look() -> None:
            nonlocal asked
            quantities = None if asked or at_touchdown is None else session.board.touchdown(self._step)
            if at_touchdown and quantities is not None:
                asked = True
                self._context = quantities
                touchdown = Touchdown(space.start(before, quantities), space.named_context(quantities))
                session.board.post_command(self._step, commands.replace(at_touchdown, touchdown).tolist())

        step, status = self._await_step(session, look)
        state = space.start(before, self._context)
        next_state = space.above(step.state, self._context)
        context = space.named_context(step.context)
        command = commands.acted(step.command)
        return StepRecord(state, command, step.applied, next_state, status, context, step.requested)

    def stop(self) -> None:
        """Lands the robot and switches torque off."""
        if self._session:
            session = self._session
            self._session = None
            try:
                session.close()
            finally:
                self._consented.close()
                self._kept.numbers = session.evidence
            self._fault = self._fault or session.message()

    def _await_step(self, session: Session, look: Callable[[], None] = lambda: None) -> StepEnd:
        """Waits for the end of the present step; looks meanwhile for other things, too."""
        while (end := session.board.finished(self._step)) is None:
            if session.over():  # the loop may have finished the step since the last look
                stopped = StepEnd(FinishedStep.stopped(self._space), StepStatus.STOPPED)
                end = session.board.finished(self._step) or stopped
                break
            session.check_sink()
            look()
            sleep(_CHECK_EVERY)
        if end.status != StepStatus.OK:
            self._fault = session.message()
        self._measured = end.result.state
        if np.isfinite(end.result.context).any():  # else that of the touchdown or of the step before holds
            self._context = end.result.context
        return end
