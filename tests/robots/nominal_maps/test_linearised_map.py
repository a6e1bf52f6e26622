"""The linearised map: it touches the map that it comes from, at the step that holds the target."""

import numpy as np
import pytest

from stepgap.robots.nominal_maps.linearised_map import linearised
from stepgap.step import StepFailed, difference_jacobian
from tests.control.maps import LossyHopper, NeverWorks, PitchingHopper


def test_it_touches_the_map_at_the_step_that_holds_the_target() -> None:
    nominal, target = LossyHopper(), np.array([0.3, 0.6])
    found = linearised(nominal, target)
    np.testing.assert_allclose(found.command, nominal.command_for(target, target), atol=1e-4)
    np.testing.assert_allclose(found(target, found.command), target, atol=1e-6)
    np.testing.assert_allclose(found.matrix, difference_jacobian(nominal, target, found.command), atol=1e-6)
    for step in 1e-2, 1e-3:  # the rest is of second order
        point = target + step, found.command + step
        assert np.abs(found(*point) - nominal(*point)).max() < step**2


def test_coordinates_without_a_target_are_those_of_a_state_that_is_repeated() -> None:
    nominal = PitchingHopper()
    found = linearised(nominal, np.array([0.3, 0.6, np.nan, np.nan]))
    np.testing.assert_allclose(found.state[:2], [0.3, 0.6])
    np.testing.assert_allclose(found(found.state, found.command), found.state, atol=1e-5)
    np.testing.assert_allclose(found.matrix, difference_jacobian(nominal, found.state, found.command), atol=1e-6)


def test_a_target_that_no_command_holds_gives_the_nearest_step_from_it() -> None:
    nominal, target = LossyHopper(), np.array([0.2, 0.9])
    found = linearised(nominal, target)
    assert found.command[1] == nominal.space.command_upper[1]
    np.testing.assert_allclose(found(target, found.command), nominal(target, found.command))


def test_where_no_command_makes_a_step_there_is_no_linear_map() -> None:
    with pytest.raises(StepFailed):
        linearised(NeverWorks(), np.array([0.2, 0.58]))
