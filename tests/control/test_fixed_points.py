"""Targets that are held instead of those that are not, against maps whose fixed points are known."""

import numpy as np
import pytest

from stepgap.control.limit_cycle import held_reference, nearest_fixed_point, reached_in_one_step
from stepgap.control.reach import whole_states
from stepgap.control.reference import Reference
from stepgap.robots.robot import stairs
from stepgap.step import StepMap
from tests.control.maps import LossyHopper, NeverWorks, PitchingHopper

NAN = np.nan


@pytest.mark.parametrize("step_map", [LossyHopper(), PitchingHopper()])
def test_a_reference_that_is_held_stays_the_same(step_map: StepMap) -> None:
    reference = stairs(step_map.space)
    assert held_reference(step_map, reference) is reference


def test_the_nearest_fixed_point_is_the_target_if_that_is_held_or_else_at_the_limit_of_the_commands() -> None:
    np.testing.assert_allclose(nearest_fixed_point(LossyHopper(), np.array([0.3, 0.6])), [0.3, 0.6], atol=1e-5)
    weak = LossyHopper(push=0.003)  # holds speeds up to (0.003 · 15 + 0.06) / (1 − 0.7) = 0.35 m/s
    found = nearest_fixed_point(weak, np.array([0.9, 0.6]))
    np.testing.assert_allclose(found, [0.35, 0.6], atol=0.002)
    coordinate = nearest_fixed_point(weak, np.array([NAN, 0.6]))
    assert coordinate[1] == pytest.approx(0.6, abs=1e-5)


@pytest.mark.parametrize("step_map", [LossyHopper(push=0.003), PitchingHopper(push=0.003)])
def test_targets_that_are_not_held_are_replaced_and_the_others_stay(step_map: StepMap) -> None:
    n = len(step_map.space.state)
    targets = np.full((5, n), NAN)
    targets[:, :2] = [[0.2, 0.58], [2.0, 0.6], [0.2, 3.0], [NAN, 0.6], [0.1, NAN]]
    reference = Reference(step_map.space.state_names, np.repeat(targets, 2, axis=0))
    held = held_reference(step_map, reference)
    assert held is not None
    assert reached_in_one_step(step_map, whole_states(step_map, held.targets), held.targets).all()
    same = np.array([0, 1, 6, 7, 8, 9])
    np.testing.assert_array_equal(held.targets[same], reference.targets[same])
    np.testing.assert_array_equal(np.isnan(held.targets), np.isnan(reference.targets))
    assert 0.3 < held.targets[2, 0] < 0.4


def test_a_map_that_holds_nothing_gives_no_reference() -> None:
    assert held_reference(NeverWorks(), stairs(NeverWorks().space)) is None
