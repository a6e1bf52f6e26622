"""The exported Python file beside the exported C code and a run: the same commands, also without measurements."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from stepgap.export.controller.python_source import PERMITTED, Place, one_file, python_source
from stepgap.export.controller.step_filter import UNCORRECTED
from stepgap.step import Array, StepStatus
from tests.export.controller.changing_robot import ChangingRobot
from tests.export.controller.learned import KINDS, SPACE, learned, steps
from tests.export.controller.test_c_source import COMPILER, Compiled
from tests.export.controller.test_c_source import compile_in as compile_in  # fixture

HELD = 1e-6
"""Commands differ by less [half ranges]."""


def exported(source: str, name: str, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The module that a file defines."""
    module = ModuleType(name)
    monkeypatch.setitem(sys.modules, name, module)
    exec(compile(source, name, "exec"), vars(module))  # noqa: S102  (our own file)
    return module


def apart(one: Array, other: Array) -> float:
    """Largest difference of two commands [half ranges]."""
    return float(np.abs((one - other) / SPACE.command_scale).max())


@pytest.mark.parametrize("kind", KINDS)
def test_its_map_is_that_of_the_controller(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    controller = learned(kind, failing=True)
    module = exported(python_source(controller), "exported_map", monkeypatch)
    nominal, residual = module.FormulaMap(module.MODEL), module.FormulaResidual(module.MODEL)
    states, commands = steps(200)
    points = np.hstack([states, commands])
    expected, found = controller.nominal.evaluate(states, commands), nominal.evaluate(states, commands)
    np.testing.assert_array_equal(found.status, expected.status)
    np.testing.assert_allclose(found.next_state, expected.next_state, atol=1e-11)
    pairs = [
        (nominal.jacobian(states, commands), controller.nominal.jacobian(states, commands)),
        (residual.mean(points), controller.residual.mean(points)),
        (residual.std(points), controller.residual.std(points)),
        (residual.mean_gradient(points), controller.residual.mean_gradient(points)),
        (residual.std_gradient(points), controller.residual.std_gradient(points)),
    ]
    for one, other in pairs:
        np.testing.assert_allclose(one, other, atol=1e-9)


@pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")
@pytest.mark.parametrize("change", [1.0, 0.2])
def test_in_a_closed_loop_c_and_python_agree_also_where_measurements_are_missing(
    change: float, compile_in: Callable[..., Compiled], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The robot changes on its way, and one in four states is missing, not a number or infinite."""
    controller = learned("gp_on_linear")
    controller = replace(controller, settings=replace(controller.settings, largest_change=change, horizon=1))
    module = exported(python_source(controller), "exported_filter", monkeypatch)
    filter_, code, rng = (
        module.StepFilter(module.MODEL),
        compile_in(controller, optimised=change == 1.0),
        np.random.default_rng(2),
    )
    state, before, found = SPACE.state_centre, None, list[int]()
    for number in range(40):
        target = SPACE.state_centre + SPACE.state_scale * rng.uniform(-1, 1, 2)
        target[rng.uniform(size=2) < 0.1] = np.nan
        phase, missing = float(rng.choice([np.nan, rng.uniform(-3, 3)])), rng.uniform() < 0.25
        measured = np.where(rng.uniform(size=2) < 0.5, rng.choice([np.nan, np.inf]), state) if missing else state
        absent = bool(missing and rng.uniform() < 0.5)
        plan = filter_.plan(None if absent else measured, target, before, phase)
        status, command, predicted, _ = planned(code, None if absent else measured, target, before, phase)
        assert status == plan.status
        assert apart(command, plan.command) < HELD
        assert (SPACE.command_lower <= plan.command).all()
        assert (plan.command <= SPACE.command_upper).all()
        if before is not None:
            assert np.abs((plan.command - before) / (2 * SPACE.command_scale)).max() <= change + 1e-12
        if status == StepStatus.OK:
            np.testing.assert_allclose(predicted, plan.predicted, atol=1e-7)
        found.append(status)
        noise = SPACE.state_scale * (0.01 * rng.normal(size=2) + (0.3 if number > 20 else 0.0))
        moved = controller.map(state, plan.command) + noise
        next_state = np.clip(moved, SPACE.state_centre - SPACE.state_scale, SPACE.state_centre + SPACE.state_scale)
        given = (None if absent else measured), plan.command, next_state
        assert filter_.update(*given, phase) == code.call("filter_update", code.filter, *arrays(code, given), phase)
        state, before = next_state, plan.command
    assert found.count(UNCORRECTED) > 3
    assert found[-1] == StepStatus.OK or found[-2] == StepStatus.OK, "it recovers"
    assert found.count(StepStatus.OK) > 20


def arrays(code: Compiled, given: tuple[Array | None, ...]) -> list[Any]:
    """Arguments for a function in C."""
    return [None if each is None else code.array(each) for each in given]


def planned(code: Compiled, state: Array | None, target: Array, before: Array | None, phase: float) -> Any:
    """A plan of C, also without a state."""
    found = code.array(code.m), code.array(code.n), code.array(code.n)
    status = code.call("plan", code.filter, *arrays(code, (state, target, before)), phase, *found)
    return status, *found


@pytest.mark.parametrize("kind", ["none", "gp"])
def test_without_a_measurement_the_command_is_that_of_the_nominal_map_at_the_target(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller = learned(kind, linear=True)
    module = exported(python_source(controller), "exported_fallback", monkeypatch)
    filter_, target = module.StepFilter(module.MODEL), SPACE.state_centre + 0.05 * SPACE.state_scale
    for state in (None, [np.nan, 0.58], [0.2, np.inf]):
        status, command, predicted, std = filter_.plan(state, target)
        assert status == UNCORRECTED
        reached = controller.nominal(target, command)
        within = (np.abs(command - SPACE.command_centre) < SPACE.command_scale - 1e-9).all()
        assert not within or np.abs((reached - target) / SPACE.state_scale).max() < 1e-6
        assert np.isnan([predicted, std]).all()
    assert filter_.plan(target, target).status == StepStatus.OK
    last = SPACE.command_at(np.array([0.3, -0.4]))
    assert filter_.plan(target, [np.inf, 0.5], last)[:2] == (StepStatus.INVALID, pytest.approx(last))


@pytest.mark.parametrize("kind", ["posterior", "gp"])
def test_its_commands_and_alarms_are_those_of_a_run(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a robot that changes and is measured wrongly, and at the beginning of the next deployment."""
    controller = learned(kind)
    module = exported(python_source(controller), "exported_beliefs", monkeypatch)
    filter_, beliefs, alarms = module.StepFilter(module.MODEL), controller.beliefs, set[str | None]()
    robot, before = ChangingRobot(controller, life=(("as learned", 18), ("loaded", 7))), None
    while robot.is_on_its_way:
        given = robot.measured, robot.target(), before
        plan = filter_.plan(*given, robot.phase)
        expected = replace(controller.controller, step_map=controller.map_by(beliefs, robot.phase))(*given)
        assert apart(plan.command, expected.command) < HELD
        before = plan.command
        record, phase = robot.step(before)
        beliefs = controller.after(beliefs, record, phase)
        assert filter_.update(record.state, record.requested, record.next_state, phase) == StepStatus.OK
        assert beliefs
        assert filter_.alarm == beliefs.alarm
        alarms.add(beliefs.alarm)
    assert "changed" in alarms
    assert beliefs
    filter_.restart()
    again = replace(controller.controller, step_map=controller.map_by(beliefs.redeployed()))
    given = SPACE.state_centre, SPACE.state_centre
    assert apart(filter_.plan(*given).command, again(*given).command) < HELD


def test_the_file_needs_numpy_alone(tmp_path: Path) -> None:
    (tmp_path / "controller.py").write_text(python_source(learned("gp")), "utf-8")
    script = """
import sys
from controller import MODEL, StepFilter
print(StepFilter(MODEL).plan([0.2, 0.58], [0.2, 0.58]).status)
print(*sorted({name.split(".")[0] for name in sys.modules if name.startswith(("stepgap", "scipy", "numba"))}))
"""
    result = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert result.stdout == "0\n\n"


def test_another_package_is_refused() -> None:
    assert "scipy" not in PERMITTED
    with pytest.raises(ValueError, match="NumPy alone"):
        one_file([Place("stepgap.control.gauss_newton", "minimise")], {})


@pytest.mark.parametrize("name", ['unit "7"', 'a"""\nimport os\n"""', "\\N{BULLET} \\"])
def test_a_name_is_no_code(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    passport = {"robot": "r", "name": name, "plant": "p", "date": "", "deployments": 1, "steps": 2, "errors": []}
    controller = replace(learned("none", linear=True), passport={**passport, "settings_sha256": ""})
    module = exported(python_source(controller), "exported_name", monkeypatch)
    assert module.MODEL["passport"]["name"] == name
    assert not hasattr(module, "os")
