"""Plants with a robot of three state coordinates, one command and three motors: nothing in them is the hopper's."""

# ruff: noqa: ARG002
# (The interfaces give more than this robot needs.)

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from math import inf, isnan, nan
from pathlib import Path

import numpy as np
import pytest

from stepgap.hardware.hopper.still import StillRig
from stepgap.hardware.realtime.board import Board, Request, StepEnd
from stepgap.hardware.realtime.loop import ControlLoop, LoopSettings
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.realtime_plant import KeptEvidence, RealtimePlant
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.tick_control import FinishedStep, Mode, Order, TickFlag
from stepgap.rigs.rig import HEALTHY, Health, Reading, Rig, SensorModel, Torques
from stepgap.step import ContextQuantity, Quantity, StepSpace, StepStatus
from tests.hardware.realtime.still_robot import StillControl, StillRobot

SPACE = StepSpace(
    (Quantity("x", "m", -1.0, 9.0), Quantity("y", "m", -1.0, 9.0), Quantity("roll", "rad", -1.0, 1.0)),
    (Quantity("push", "N", -2.0, 2.0),),
    (ContextQuantity("ground", "m"),),
)
TICKS_PER_STEP = 10


class MarchControl(StillControl):
    """Marches in place: a step takes ten ticks, and its three torques are the command and its multiples.

    Its evidence is the number of steps of all deployments.
    """

    def __init__(self) -> None:
        super().__init__()
        self._tick, self._command, self._before = 0, nan, 0.0

    @property
    def evidence(self) -> tuple[float, ...]:
        return (self._before + self._tick // TICKS_PER_STEP,)

    def resume(self, evidence: Sequence[float]) -> None:
        self._before = sum(evidence)

    @property
    def motors(self) -> int:
        return 3

    def tick(
        self,
        time: float,
        reading: Reading,
        order: Order,
        applied: Torques,
        health: Health = HEALTHY,
        age: float = 0.0,
    ) -> tuple[Torques, int]:
        (command,) = order.command
        assert len(applied) == 3
        self._row = (time, *reading)
        if order.mode != Mode.STEP:
            return (0.0, 0.0, 0.0), TickFlag.NOTHING
        if self._tick % TICKS_PER_STEP == 0:
            self._command = nan
        if isnan(self._command):
            self._command = command
        self._tick += 1
        ended = TickFlag.STEP_ENDED if self._tick % TICKS_PER_STEP == 0 else TickFlag.NOTHING
        push = 0.0 if isnan(self._command) else self._command
        return (push, 2 * push, 3 * push), ended | TickFlag.TAKES_COMMAND

    def finished_step(self) -> FinishedStep:
        number = self._tick // TICKS_PER_STEP
        return FinishedStep(np.array([number, 0.5, -0.25]), np.array([self._command]), np.array([0.125]), (1.5,))


class MarchRobot(StillRobot):
    """Makes a `MarchControl`."""

    @property
    def space(self) -> StepSpace:
        return SPACE

    def control(self, rig: Rig) -> MarchControl:
        return MarchControl()


class RecordedRig(StillRig):
    """A rig without hardware that keeps the last torques."""

    given: Torques = ()

    def write(self, torques: Torques) -> Torques:
        self.given = torques
        return torques


@pytest.fixture
def board() -> Iterator[Board]:
    board = Board.create(3, 1, 1)
    yield board
    board.close()
    board.unlink()


def a_rig() -> RecordedRig:
    return RecordedRig(SensorModel(tick=0.01), (0.5,))


def marching(board: Board) -> tuple[ControlLoop, RecordedRig]:
    """A loop whose robot is about to step, and its rig."""
    rig, settings = a_rig(), LoopSettings(calibrate_time=0, stand_time=0.02, release_time=inf)
    board.request = Request.START
    return ControlLoop(rig, MarchControl(), SPACE, board, lambda row: None, settings), rig


def next_end(loop: ControlLoop, board: Board, number: int) -> StepEnd:
    for _ in range(3 * TICKS_PER_STEP):
        assert loop.tick()
        if end := board.finished(number):
            return end
    pytest.fail("the step does not end")


def test_the_loop_steps_it_with_commands_within_their_bounds(board: Board):
    loop, rig = marching(board)
    first = next_end(loop, board, 0)
    np.testing.assert_array_equal(first.result.requested, [0.0])
    assert board.evidence == (1.0,)
    board.post_command(1, (1e9,))
    end = next_end(loop, board, 1)
    assert board.evidence == (2.0,)
    assert end.status == StepStatus.OK
    np.testing.assert_array_equal(end.result.state, [2.0, 0.5, -0.25])
    np.testing.assert_array_equal(end.result.requested, [2.0])
    np.testing.assert_array_equal(end.result.applied, [2.0 - 0.125])
    assert rig.given == (2.0, 4.0, 6.0)


def test_the_loop_refuses_a_command_that_is_not_finite(board: Board):
    loop, _ = marching(board)
    next_end(loop, board, 0)
    board.post_command(1, (nan,))
    assert not loop.tick()
    assert board.message == "the command must be finite, not nan"
    stopped = board.finished(1)
    assert stopped is not None
    assert stopped.status == StepStatus.STOPPED
    assert stopped.result.state.shape == (3,)
    np.testing.assert_array_equal(stopped.result.applied, [0.0])


def test_a_plant_in_the_same_process_steps_it():
    with RigPlant(a_rig(), MarchRobot()) as plant:
        plant.start()
        record = plant.take_step(np.array([0.5]))
        assert record.status == StepStatus.OK
        np.testing.assert_array_equal(record.next_state, [2.0, 0.5, -0.25])
        np.testing.assert_array_equal(record.applied, [0.5 - 0.125])
        plant.stop()
        plant.start()
        assert plant._control.evidence == (3.0,)


def test_the_plants_of_a_run_hand_evidence_on_from_process_to_process(tmp_path: Path):
    kept = KeptEvidence()
    settings = LoopSettings(calibrate_time=0, stand_time=0.02, release_time=inf)
    setup = RealtimeSetup(a_rig, MarchRobot(), settings)
    for steps in (1.0, 2.0):
        with RealtimePlant(setup, tmp_path, lambda _: nullcontext(), kept=kept) as plant:
            plant.start()
        assert kept.numbers[0] >= steps
