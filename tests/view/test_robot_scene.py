"""Directions of the drawn links."""

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from stepgap.view.robot_scene import turned_to


@settings(deadline=None)
@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3))
@example((0.0, 1.2e-07, -0.09375))
@example((5e-324, 5e-324, -1.0))
@example((0.0, -0.0, -1.0))
def test_a_turn_takes_z_to_the_direction(direction: tuple[float, float, float]) -> None:
    w, *xyz = turned_to(np.array(direction))
    axis, z = np.array(xyz), np.array([0.0, 0.0, 1.0])
    turned = z + 2 * np.cross(axis, np.cross(axis, z) + w * z)
    np.testing.assert_allclose(turned, np.array(direction) / np.linalg.norm(direction), atol=1e-12)
