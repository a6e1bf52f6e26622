"""The scaled points of a step space: −1 and 1 are the bounds."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stepgap.control.box_points import box_grid
from stepgap.export.controller.step_filter import UNCORRECTED
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.step import ADVICE, ContextQuantity, Quantity, StepFailed, StepSpace, StepStatus, ending_of

SPACE = StepSpace(
    state=(Quantity("speed", "m/s", 0.0, 0.4),),
    command=(Quantity("fx", "N", -15.0, 15.0), Quantity("push", "N", 0.1, 0.7)),
)


def test_points_and_commands_are_inverse_to_each_other() -> None:
    commands = np.random.default_rng(0).uniform(SPACE.command_lower, SPACE.command_upper, (50, 2))
    points = SPACE.point_of(commands)
    assert (np.abs(points) <= 1).all()
    np.testing.assert_allclose(SPACE.command_at(points), commands, rtol=1e-12, atol=1e-12)


def test_commands_of_all_points_are_within_the_bounds() -> None:
    np.testing.assert_array_equal(SPACE.command_at(np.array([-3.0, 3.0])), [-15.0, 0.7])
    grid = SPACE.command_at(box_grid(7, 2))
    assert grid.shape == (7, 7, 2)
    assert ((grid >= SPACE.command_lower) & (grid <= SPACE.command_upper)).all()
    np.testing.assert_allclose(grid[0, -1], [-15.0, 0.7], rtol=1e-15)
    np.testing.assert_allclose(grid[3, 3], SPACE.command_centre, rtol=1e-15)
    np.testing.assert_allclose(np.diff(grid[0, :, 1]), 0.1, rtol=1e-12)


def test_scaled_states_are_one_at_the_ends_of_their_ranges() -> None:
    states = np.array([SPACE.state_lower, SPACE.state_centre, SPACE.state_upper])
    np.testing.assert_allclose(SPACE.scaled_state(states)[:, 0], [-1, 0, 1])


def test_a_scaled_jacobian_is_the_derivative_of_the_scaled_state_by_the_point() -> None:
    matrix = np.random.default_rng(1).normal(size=(len(SPACE.state), len(SPACE.command)))
    step = 0.1 * np.eye(len(SPACE.command))
    states = SPACE.scaled_state(SPACE.command_at(step) @ matrix.T) - SPACE.scaled_state(SPACE.command_centre @ matrix.T)
    np.testing.assert_allclose(SPACE.scaled_jacobian(matrix), states.T / 0.1)


def test_its_arrays_are_shared_and_read_only() -> None:
    assert SPACE.command_lower is SPACE.command_lower
    with pytest.raises(ValueError, match="read-only"):
        SPACE.state_scale[0] = 1.0


def test_spaces_have_the_same_names_only_if_state_and_command_are_divided_alike() -> None:
    wider = StepSpace((Quantity("speed", "", -9.0, 9.0),), (Quantity("fx", "", 0, 1), Quantity("push", "", 0, 1)))
    divided = StepSpace((*wider.state, wider.command[0]), wider.command[1:])
    assert SPACE.has_names_of(wider)
    assert wider.names == divided.names == ("speed", "fx", "push")
    assert not SPACE.has_names_of(divided)


def test_a_robot_words_its_own_advice_and_others_have_that_for_any_robot() -> None:
    worded = replace(SPACE, advice={StepStatus.FELL: "it rolled over; try it more slowly"})
    assert str(StepFailed(StepStatus.FELL, worded)) == "fell: it rolled over; try it more slowly"
    assert worded.advice_on(StepStatus.STOPPED) == SPACE.advice_on(StepStatus.STOPPED)
    assert worded == SPACE
    assert "rest length" in CommandBounds().space().advice_on(StepStatus.FULL_STRETCH)
    assert ADVICE.keys() == set(StepStatus) - {StepStatus.OK}
    for status, text in ADVICE.items():
        assert SPACE.advice_on(status) == text
        assert not re.search(r"\b(apex|hop|stiffness|spring|vertical|encoders?|the leg)\b", text), text


def test_only_a_fall_is_called_a_fall() -> None:
    assert {status.label: ending_of(status) for status in StepStatus if "fell" in ending_of(status)} == {"fell": "fell"}
    assert ending_of(StepStatus.STOPPED) == "was stopped"
    assert ending_of(StepStatus.NO_TAKE_OFF) == "ended without a next state (no take off)"


@pytest.mark.parametrize(("name", "unit"), [("a b", ""), ("", ""), ("x", "*/"), ("x", "m\n"), ("x", "<b>")])
def test_a_name_is_an_identifier_and_a_unit_has_few_characters(name: str, unit: str) -> None:
    for made in (lambda: Quantity(name, unit, 0.0, 1.0), lambda: ContextQuantity(name, unit)):
        with pytest.raises(ValueError, match="but it must"):
            made()


def test_the_statuses_of_files_and_exported_controllers_stay() -> None:
    labels = "ok fell no_take_off full_stretch foot_scuffed no_apex invalid stopped doubtful uncorrected unstable"
    numbers = labels.split()
    assert [status.label for status in StepStatus] == [name for name in numbers if name != "uncorrected"]
    assert all(numbers[status] == status.label for status in StepStatus)
    assert numbers[UNCORRECTED] == "uncorrected"
