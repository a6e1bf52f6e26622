"""A plant in real time: the loop runs in a separate process, and this one gives it a command for every hop."""

from contextlib import ExitStack
from pathlib import Path
from time import sleep

import numpy as np

from stepgap.plants.plant import Plant
from stepgap.plants.realtime.board import FinishedHop, Request
from stepgap.plants.realtime.consent import Consent
from stepgap.plants.realtime.process import RealtimeSetup
from stepgap.plants.realtime.session import Session
from stepgap.plants.ticks.tick_log import TickLog, TickLogError, next_path
from stepgap.rigs.rig import RigFault
from stepgap.step import ADVICE, Array, StepRecord, StepSpace, StepStatus

_CHECK_EVERY = 1e-3
"""Time between two checks whether a hop has ended [s]."""


class RealtimePlant(Plant):
    """Executes hops on a rig that does not wait for commands.

    A step ends when the apex has just been passed. The command acts from the next mid-stance on, some 0.3 s later; this
    is the time in which the caller must give it. A hop whose command comes later is made without one, and the requested
    command in its record is zero. If that happens twice in a row, the robot lands (`LoopSettings.missed_commands`).

    Args:
        setup: The rig and its control.
        logs: Folder for the ticks of every deployment, `ticks-*.mcap`.
        consent: Asks a person for consent, when the rig is connected and limp, before torque is given.
        settings: Text of the file that describes the rig, for the logs.
    """

    def __init__(self, setup: RealtimeSetup, logs: Path, consent: Consent, settings: str = ""):
        self._setup, self._logs, self._consent, self._settings = setup, logs, consent, settings
        self._consented = ExitStack()
        self._space, self._session = setup.robot_control.space, None
        self._state, self._hop, self._fault = np.full(2, np.nan), 0, ""

    @property
    def space(self) -> StepSpace:
        """State [speed, height] in [m/s, m], command [fx, fy] in [N]."""
        return self._space

    @property
    def fault(self) -> str:
        """Why the last deployment was aborted, or what failed during the landing; empty if there was no fault."""
        return self._fault

    def start(self) -> Array:
        """Makes the first hop, without command, which begins when the robot, held in the air until then, is let go.

        Before, the rig is connected without torque, a person consents, and the robot takes its landing posture.

        Returns:
            The state at the first apex, [speed, height] in [m/s, m]; shape (2,).

        Raises:
            RigFault: The rig cannot be connected, or the first hop failed.
        """
        self.stop()
        self._hop, self._fault = 0, ""
        try:
            log = TickLog(next_path(self._logs), self._setup.units, self._setup.described(self._settings))
        except TickLogError as error:
            raise RigFault(str(error)) from None
        self._session = session = Session(self._setup, log)
        session.await_ready()
        self._consented.enter_context(self._consent(session.board))
        session.board.request = Request.HOP
        hop = self._await_hop(session)
        if hop.status != StepStatus.OK:
            detail = f" ({self._fault})" if self._fault else ""
            raise RigFault(f"the first hop failed: {hop.status.label}{detail}: {ADVICE[hop.status]}")
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        """Hops once; after a fall, a fault or a safety stop the record has no next state, and the robot lands.

        Args:
            command: [fx, fy] in [N], which is limited to the bounds; shape (2,).

        Raises:
            RigFault: The log of ticks cannot be written.
        """
        session, state, command = self._session, self._state, np.asarray(command, float)
        if session is None:
            raise RigFault("the rig is not started")
        within = np.clip(command, self._space.command_lower, self._space.command_upper)
        if np.isnan(within).any():
            self.stop()
            return StepRecord(state, command, within, np.full(2, np.nan), StepStatus.INVALID)
        self._hop += 1
        session.board.post_command(self._hop, *within.tolist())
        hop = self._await_hop(session)
        requested = np.array([hop.requested_fx, hop.requested_fy])
        applied = np.array([hop.applied_fx, hop.applied_fy])
        return StepRecord(state, command, applied, self._state, hop.status, hop.yaw, requested=requested)

    def stop(self) -> None:
        """Lands the robot and switches torque off."""
        if self._session:
            self._session, session = None, self._session
            try:
                session.close()
            finally:
                self._consented.close()
            self._fault = self._fault or session.message()

    def _await_hop(self, session: Session) -> FinishedHop:
        """Waits for the end of the present hop."""
        while (hop := session.board.hop(self._hop)) is None:
            if session.over():  # the loop may have finished the hop since the last look
                hop = session.board.hop(self._hop) or FinishedHop.stopped(self._hop)
                break
            session.check_sink()
            sleep(_CHECK_EVERY)
        if hop.status != StepStatus.OK:
            self._fault = session.message()
        self._state = np.array([hop.speed, hop.height])
        return hop
