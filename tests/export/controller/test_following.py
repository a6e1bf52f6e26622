"""A robot that runs away and drifts: a run, the exported Python filter and the exported C code command the same."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from stepgap.control.following import MADE_UP
from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.control.shortfall import moved
from stepgap.experiment.deployment import deploy
from stepgap.export.controller.model_document import model_document, model_text
from stepgap.export.controller.model_reading import read_portable
from stepgap.export.controller.portable_controller import PortableController, portable_form
from stepgap.export.controller.python_source import python_source
from stepgap.export.controller.step_filter import StepFilter
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, ContextQuantity, Quantity, StepRecord, StepSpace, StepStatus
from tests.export.controller.test_c_source import COMPILER, Compiled
from tests.export.controller.test_c_source import compile_in as compile_in  # fixture
from tests.export.controller.test_python_source import exported

SECONDS = 0.5
STATE = tuple(Quantity(name, "", -1.0, 1.0) for name in ("vx", "vy", "wz"))
COMMAND = tuple(Quantity(name, "", -1.2, 1.2) for name in ("cx", "cy", "cw"))
POSE = tuple(ContextQuantity(name, "") for name in StepSpace.pose_names)
SPACE = StepSpace(STATE, COMMAND, POSE, is_lagged=True, planar_seconds=SECONDS)
TARGETS = np.array([[0.4, 0.0, 0.0], [0.7, 0.1, -0.1], [0.0, -0.1, 0.2], [0.3, 0.0, 0.0]]).repeat(6, axis=0)
CONTROL = ControlSettings(widening=0.1, surprise=0.4, make_up=4, horizon=2, largest_change=0.5)
ZERO = np.array([2.0, -1.0, 2.5])
"""Place and heading that are measured where the robot begins."""
CLOSE = 1e-8


def body(gain: float, space: StepSpace = SPACE) -> AffineMap:
    """A body that does a part of what it is told, and keeps a part of its velocity."""
    matrix = np.hstack([0.2 * np.eye(3), gain * np.eye(3)])
    return AffineMap(space, np.zeros(3), np.zeros(3), np.zeros(3), matrix)


class Drifting(ModelPlant):
    """It drifts, measures its pose as far as it is told, and runs away for some steps."""

    def __init__(self, measured: tuple[bool, bool, bool], away: range = range(0)):
        super().__init__(body(0.6), np.zeros(3))
        self._number, self._pose, self._measured, self._away = 0, ZERO, np.array(measured), away
        self._rng = np.random.default_rng(3)

    def take_step(self, command: Array) -> StepRecord:
        record = super().take_step(command)
        self._number += 1
        moves = record.next_state + [0.02, -0.05, 0.04] + 0.02 * self._rng.standard_normal(3)
        self._state = np.array([1.1, 0.6, -0.8]) if self._number in self._away else moves
        # What the odometry does not see is a slip to the left.
        self._pose = moved(self._pose, (self._state + np.array([0.0, 0.03, 0.0])) * SECONDS)
        context = np.where(self._measured, self._pose, np.nan)
        return replace(record, next_state=self._state, context=SPACE.named_context(context.tolist()))


class Deployment(NamedTuple):
    """A redeployment, and its controller as it is exported."""

    steps: tuple[LoggedStep, ...]
    controller: PortableController


def redeployment(
    measured: tuple[bool, bool, bool] = (True, True, True), away: range = range(9, 13), **changes: Any
) -> Deployment:
    control, reference = replace(CONTROL, **changes), Reference(SPACE.state_names, TARGETS)
    nominal = body(0.8, replace(SPACE, is_lagged=control.horizon == 1))  # C plans single steps of a lagged robot
    first = Learner.start(nominal, Steps(nominal.space), LearningSettings(), 0)
    known = Steps(nominal.space, deploy(first, Drifting(measured), reference, 0, 0, control))
    learner = Learner.start(nominal, known, LearningSettings(), 1)
    steps = tuple(deploy(learner, Drifting(measured, away), reference, 1, 0, control))
    return Deployment(steps, portable_form(learner, control, np.random.default_rng(0), {}, "a run"))


def pose_of(step: LoggedStep) -> Array:
    return np.array([step.record.context[name] for name in SPACE.pose_names])


def apart(one: Array, other: Array) -> float:
    """Largest difference of two commands [half ranges]."""
    return float(np.abs((one - other) / SPACE.command_scale).max())


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
@pytest.mark.parametrize("horizon", [1, 2])
@pytest.mark.parametrize("measured", [(True, True, True), (False, False, True), (False, False, False)])
def test_in_a_closed_loop_commands_are_those_of_a_run(
    measured: tuple[bool, bool, bool],
    horizon: int,
    compile_in: Callable[..., Compiled],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps, controller = redeployment(measured, horizon=horizon)
    assert controller.farthest is not None
    module = exported(python_source(controller), "exported_following", monkeypatch)
    code, filter_, before, told = compile_in(controller), module.StepFilter(module.MODEL), None, list[bool]()
    for number, step in enumerate(steps):
        record, ahead = step.record, TARGETS[number : number + horizon]
        plan = filter_.plan(record.state, ahead[0], before, ahead=ahead[1:])
        status, command, _, _ = code.plan(record.state, ahead, before, float("nan"))
        assert (plan.status, status) == (0, 0)
        assert apart(plan.command, record.requested) < CLOSE, number
        assert apart(command, record.requested) < CLOSE, number
        told.append(bool((np.abs(record.requested - record.state) > controller.farthest + 1e-6).any()))
        if told[-1]:
            assert (np.abs(record.requested - ahead[0]) <= MADE_UP + 1e-12).all()
        given = record.state, record.requested, record.next_state
        pose = pose_of(step)
        assert filter_.update(*given, pose=pose) == 0
        assert code.call("filter_update_at", code.filter, *map(code.array, given), float("nan"), code.array(pose)) == 0
        before = record.command
    assert len(steps) == len(TARGETS)
    assert 1 <= sum(told) <= 6, told


def test_each_setting_changes_commands() -> None:
    """So equal commands say that C and Python have it."""
    cases: list[dict[str, Any]] = [{}, {"make_up": 0}, {"surprise": np.inf}, {"widening": np.inf}]
    commands = [np.array([step.record.requested for step in redeployment(**case).steps]) for case in cases]
    assert all(np.abs(commands[0] - other).max() > 0.05 for other in commands[1:])


def test_before_the_first_redeployment_nothing_is_limited() -> None:
    learner = Learner.start(body(0.8), Steps(SPACE), LearningSettings(), 0)
    controller = portable_form(learner, CONTROL, np.random.default_rng(0), {}, "a run")
    assert (controller.farthest, controller.settings.surprise, controller.settings.make_up) == (None, np.inf, 4)
    control = model_document(controller)["control"]
    assert (control["farthest"], control["surprise"]) == (None, None)


def test_a_model_file_has_them(tmp_path: Path) -> None:
    controller = redeployment().controller
    (tmp_path / "model.json").write_text(model_text(controller), "utf-8")
    read = read_portable(tmp_path / "model.json")
    assert read.settings.surprise == CONTROL.surprise
    assert read.settings.make_up == CONTROL.make_up
    assert read.space.planar_seconds == SECONDS
    np.testing.assert_array_equal(read.farthest, controller.farthest)


BAD = (np.nan, np.inf, -np.inf, 1e300, -1e31, 1e29)
"""What a broken sensor, or a program that asks, may say."""


def perhaps_bad(rng: np.random.Generator) -> Array:
    return np.where(rng.uniform(size=3) < 0.1, rng.choice(BAD, 3), rng.uniform(-1.5, 1.5, 3))


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
@pytest.mark.parametrize("seed", range(3))
def test_whatever_the_numbers_are_a_command_is_within_its_bounds(
    seed: int, compile_in: Callable[..., Compiled]
) -> None:
    controller, rng = redeployment(horizon=1).controller, np.random.default_rng(seed)
    filter_, code = StepFilter(model_document(controller)), compile_in(controller)
    code.call("filter_init", code.filter)
    state, statuses, before = np.zeros(3), set[int](), [None, None]
    for _ in range(25):
        target, pose, next_state = (perhaps_bad(rng) for _ in range(3))
        with np.errstate(all="ignore"):
            plan = filter_.plan(state, target, before[0])
            filter_.update(state, plan.command, next_state, pose=pose)
        _, command, _, _ = code.plan(state, target, before[1], float("nan"))
        for each in (plan.command, command):
            assert (SPACE.command_lower <= each).all()
            assert (each <= SPACE.command_upper).all()
        given = map(code.array, (state, command, next_state))
        code.call("filter_update_at", code.filter, *given, float("nan"), code.array(pose))
        state, before = next_state, [plan.command, command]
        statuses.add(plan.status)
    assert StepStatus.OK in statuses
    assert len(statuses) > 1


def test_a_way_is_forgotten_and_so_is_a_surprise() -> None:
    controller = redeployment(horizon=1).controller
    fresh, used = (StepFilter(model_document(controller)) for _ in range(2))
    target = np.array([0.4, 0.0, 0.0])
    for _ in range(3):
        used.plan(np.zeros(3), target)
        used.update(np.zeros(3), target, np.array([-0.8, 0.5, 0.6]), learns=False)
    assert apart(used.plan(np.zeros(3), target).command, fresh.plan(np.zeros(3), target).command) > 0.1
    used.forget_way()
    assert apart(used.plan(np.zeros(3), target).command, fresh.plan(np.zeros(3), target).command) < CLOSE
