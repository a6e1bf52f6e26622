"""Plans of the exported C code for a robot with untracked states: weights, several steps, limited changes."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepgap.control.goal import StepGoals, Targets
from stepgap.control.settings import ControlSettings
from stepgap.export.controller.c_source import c_source
from stepgap.export.controller.model_reading import read_portable
from stepgap.export.controller.portable_controller import PortableController
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.robots.nominal_maps.surrogate_map import Samples, fit_surrogate
from stepgap.robots.nominal_maps.weighted_map import with_space
from stepgap.step import Array, StepMap, StepRecord, StepSpace, StepStatus
from tests.cli.command_line import Command
from tests.control.maps import PitchingHopper
from tests.export.controller.test_c_source import COMPILER, Compiled
from tests.export.controller.test_c_source import compile_in as compile_in  # fixture
from tests.quick_runs import leave_out_repeats, leave_out_report

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")


@pytest.fixture(scope="module")
def pitching() -> PortableController:
    """A controller of a robot with an untracked pitch, learned from many random steps, so that its map is certain."""
    nominal, rng = PitchingHopper(), np.random.default_rng(0)
    space, real = nominal.space, PitchingHopper(mass=1.9, lean=0.25)
    states = space.state_centre + space.state_scale * rng.uniform(-1, 1, (400, 4))
    commands = space.command_at(rng.uniform(-1, 1, (400, 2)))
    ends = real(states, commands) + 0.02 * space.state_scale * rng.normal(size=(400, 4))
    rows = zip(states, commands, ends, strict=True)
    records = [StepRecord(state, command, command, end, StepStatus.OK) for state, command, end in rows]
    logged = (LoggedStep(0, row, each.state, each.state, np.zeros(4), each) for row, each in enumerate(records))
    learner = Learner.start(nominal, Steps(space, logged), LearningSettings("linear", drift=False), 1)
    surrogate = fit_surrogate(nominal, rng, good_enough=1e-5)
    none = Samples(np.empty((0, 6)), np.empty((0, 4)), np.empty(0, np.int64))
    exact = replace(surrogate, samples=none)
    return PortableController(exact, learner.residual, None, np.empty((0, 6)), ControlSettings())


def with_weights(controller: PortableController, *weights: float) -> PortableController:
    """The controller with other weights of the state."""
    space = controller.space
    state = tuple(replace(each, weight=weight) for each, weight in zip(space.state, weights, strict=True))
    return replace(controller, nominal=with_space(controller.nominal, replace(space, state=state)))


@pytest.fixture
def own_errors_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python counts the errors of the planned steps alone, as C does, also where states are not tracked."""

    def targets_of(step_map: StepMap, targets: Array, untracked: object, standing: object) -> StepGoals:
        plain = tuple(Targets(step_map.space, target) for target in targets)
        return StepGoals(plain, plain)

    monkeypatch.setattr("stepgap.control.cautious_controller.goals_for", targets_of)


def random_targets(rng: np.random.Generator, space: StepSpace, steps: int) -> Array:
    """Targets all over the ranges of use, some of them missing; shape (steps, n)."""
    targets = space.state_centre + space.state_scale * rng.uniform(-1.2, 1.2, (steps, len(space.state)))
    targets[rng.uniform(size=targets.shape) < 0.15] = np.nan
    return targets


CASES = {
    "untracked states": ((1, 1, 0, 0), ControlSettings(horizon=1)),
    "weights": ((4, 0.5, 0.1, 0), ControlSettings(horizon=1)),
    "two steps": ((1, 1, 0, 0), ControlSettings(horizon=2)),
    "three steps of weighted states": ((4, 0.5, 0.1, 0), ControlSettings(horizon=3)),
    "a limited change": ((1, 1, 0, 0), ControlSettings(horizon=1, largest_change=0.1)),
    "a limited change, three steps": ((1, 2, 0, 0), ControlSettings(horizon=3, largest_change=0.1)),
    "as published": ((1, 1, 0, 0), ControlSettings(cautious=False, viability=False, avoid_failures=False, horizon=2)),
}


@pytest.mark.usefixtures("own_errors_only")
@pytest.mark.parametrize("case", CASES)
def test_plans_are_those_of_python(
    case: str, pitching: PortableController, compile_in: Callable[..., Compiled]
) -> None:
    weights, settings = CASES[case]
    controller = replace(with_weights(pitching, *weights), settings=settings)
    code, rng, space, together, same = compile_in(controller), np.random.default_rng(3), controller.space, 0, 0
    for number in range(25):
        state = space.state_centre + space.state_scale * rng.uniform(-0.7, 0.7, 4)
        targets = random_targets(rng, space, settings.horizon)
        previous = space.command_at(rng.uniform(-1, 1, 2)) if number % 5 else None
        python = replace(controller.controller, previous=previous)
        plan = python(state, targets[0], previous, targets[1:])
        status, command, predicted, std = code.plan(state, targets, previous, 0.0)
        assert status == 0
        same += bool(np.abs((command - plan.command) / space.command_scale).max() < 1e-6)
        np.testing.assert_allclose(predicted, controller.map(state, command), atol=1e-9)
        np.testing.assert_allclose(std, python.step_std(state, command), atol=1e-9)
        if settings.horizon > 1:
            together += bool(np.abs(plan.command - python(state, targets[0], previous).command).max() > 1e-3)
        if previous is not None:
            share = np.abs(command - previous) / (2 * space.command_scale)
            assert share.max() <= settings.largest_change + 1e-12
    assert same >= 24, "another way by rounding is rare"
    assert (together > 3) == (settings.horizon > 1), "the other targets have no effect"


@pytest.mark.parametrize("horizon", [1, 3])
def test_where_all_states_are_tracked_plans_are_those_of_a_run(
    horizon: int, pitching: PortableController, compile_in: Callable[..., Compiled]
) -> None:
    controller = replace(with_weights(pitching, 4, 1, 0.2, 0.1), settings=ControlSettings(horizon=horizon))
    code, rng, space, same = compile_in(controller), np.random.default_rng(4), controller.space, 0
    for _ in range(25):
        state = space.state_centre + space.state_scale * rng.uniform(-0.7, 0.7, 4)
        targets = random_targets(rng, space, horizon)
        plan = controller.controller(state, targets[0], None, targets[1:])
        status, command, _, _ = code.plan(state, targets, None, 0.0)
        assert status == 0
        same += bool(np.abs((command - plan.command) / space.command_scale).max() < 1e-6)
    assert same >= 24


def test_more_steps_than_the_horizon_are_not_used_and_none_is_invalid(
    pitching: PortableController, compile_in: Callable[..., Compiled]
) -> None:
    controller = replace(pitching, settings=ControlSettings(horizon=2))
    code, space = compile_in(controller), controller.space
    targets = random_targets(np.random.default_rng(0), space, 40)
    of_two, of_all, alone = (
        code.plan(space.state_centre, each, None, 0.0) for each in (targets[:2], targets, targets[0])
    )
    assert of_two[1].tolist() == of_all[1].tolist()
    assert alone[1].tolist() == code.plan(space.state_centre, targets[:1], None, 0.0)[1].tolist()
    status, command, _, _ = code.plan(space.state_centre, targets[:0], None, 0.0)
    assert (status, command.tolist()) == (6, space.command_centre.tolist())


def test_a_run_with_weights_is_exported(package: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    leave_out_repeats(monkeypatch)
    leave_out_report(monkeypatch)
    options = ["--iterations", "0", "--weights.height", "0.25", "--control.horizon", "3", "--out", "out", "--quiet"]
    assert stepgap("run", "--robot", "pitching", *options).code == 0
    for kind, file in (("c", "controller.c"), ("model", "model.json")):
        result = stepgap("export", "out", "--to", kind, "--out", file)
        assert result.code == 0, result.err
    header = Path("controller.h").read_text()
    assert "height [m], range of use 0.52 to 0.64, weight 0.25\n" in header
    assert "those of the first\n   3 steps are used" in header
    assert "pitch, pitch_rate: the errors of the planned steps count alone" in header
    read = read_portable(Path("model.json"))
    assert (read.settings.horizon, [each.weight for each in read.space.state]) == (3, [1, 0.25, 0, 0])


def test_the_header_says_what_is_tracked_and_limited(pitching: PortableController) -> None:
    header = c_source(replace(pitching, settings=ControlSettings(largest_change=0.1)), "controller").header
    assert "pitch [rad], range of use -0.4 to 0.4, not tracked" in header
    assert "height [m], range of use 0.52 to 0.64\n" in header
    assert "weight 0.25" in c_source(with_weights(pitching, 1, 0.25, 0, 0), "controller").header
    assert "by at most 0.1 of their range" in header
