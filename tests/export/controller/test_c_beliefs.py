"""The exported C code believes what Python believes, step by step of a robot that changes and is measured wrongly."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from stepgap.control.cautious_controller import CautiousController
from stepgap.export.controller.c_source import c_source
from stepgap.export.controller.portable_controller import PortableController
from stepgap.learning.beliefs import Beliefs
from stepgap.step import StepRecord
from tests.export.controller.changing_robot import LIFE, ChangingRobot
from tests.export.controller.learned import SPACE, learned
from tests.export.controller.test_c_source import COMPILER, Compiled
from tests.export.controller.test_c_source import compile_in as compile_in  # fixture

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler")

HELD = 1e-6
"""Commands differ by less [half ranges], but for one in a hundred whose target is out of reach: near the least distance
from it the distance is so flat that the last digits decide between neighbours that are 1e-5 apart."""


def update(code: Compiled, record: StepRecord, phase: float) -> int:
    given = map(code.array, (record.state, record.requested, record.next_state))
    return code.call("filter_update", code.filter, *given, phase)


def controller_after(controller: PortableController, beliefs: Beliefs | None, phase: float) -> CautiousController:
    return replace(controller.controller, step_map=controller.map_by(beliefs, phase))


@pytest.mark.parametrize(("kind", "degree"), [("posterior", 2), ("gp", 1), ("quadratic", 2)])
def test_in_a_closed_loop_commands_and_alarms_are_those_of_python(
    kind: str, degree: int, compile_in: Callable[..., Compiled]
) -> None:
    """Over a whole deployment and the beginning of the next one, in which the beliefs go on."""
    controller = learned(kind, degree=degree)
    code, beliefs, found = compile_in(controller, optimised=degree == 2), controller.beliefs, list[str | None]()
    differences, moved = list[float](), False
    for deployment in range(2):
        robot, before = ChangingRobot(controller, life=(("as learned", 6),) if deployment else LIFE), None
        if deployment:
            assert beliefs
            beliefs = beliefs.redeployed()
            code.call("filter_restart", code.filter)
        while robot.is_on_its_way:
            given = robot.measured, robot.target(), before
            status, command, predicted, std = code.plan(*given, robot.phase)
            python = controller_after(controller, beliefs, robot.phase)
            assert status == 0
            differences.append(float(np.abs((command - python(*given).command) / SPACE.command_scale).max()))
            np.testing.assert_allclose(predicted, python.step_map(robot.measured, command), atol=1e-9)
            np.testing.assert_allclose(std, python.step_std(robot.measured, command), atol=1e-9)
            record, phase = robot.step(command)
            beliefs = controller.after(beliefs, record, phase)
            assert beliefs
            assert update(code, record, phase) == 0
            found.append(beliefs.alarm)
            moved = moved or beliefs.mixture(0.0).offset.any()
            assert code.alarm == beliefs.alarm
            before = command
    assert np.count_nonzero(np.array(differences) > HELD) <= len(differences) // 60, max(differences)
    assert max(differences) < 1e-5
    assert {"changed", "earlier"} <= set(found)
    assert moved, "a wrong measurement was suspected"


def test_it_follows_a_change_in_the_memory_that_the_header_states(compile_in: Callable[..., Compiled]) -> None:
    controller = learned("posterior")
    code, beliefs = compile_in(controller), controller.beliefs
    robot, alarms = ChangingRobot(controller, life=(("as learned", 18), ("loaded", 8))), set[str | None]()
    rng = np.random.default_rng(1)
    while robot.is_on_its_way:
        command = SPACE.command_at(rng.uniform(-1, 1, 2))
        record, phase = robot.step(command)
        beliefs = controller.after(beliefs, record, phase)
        assert update(code, record, phase) == 0
        alarms.add(code.alarm)
        status, planned, predicted, _ = code.plan(SPACE.state_centre, SPACE.state_centre, None, robot.phase)
        expected = controller.map_by(beliefs, robot.phase)(SPACE.state_centre, planned)
        assert status == 0
        assert np.abs((predicted - expected) / SPACE.state_scale).max() < 1e-9
    assert "changed" in alarms
    (stated,) = re.findall(r"about (\d+) kB: beliefs", c_source(controller, "controller").header)
    assert 1000 * int(stated) == pytest.approx(code.call("size"), abs=1000)
