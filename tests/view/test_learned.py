"""A curve is the residual at points that differ only in one input."""

import json
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.normal import INTERVAL_95
from stepgap.learning.residual_fit import residual_from_dict
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.view.learned import curve_along


@pytest.mark.parametrize("index", range(4))
def test_a_curve_is_the_residual_along_one_input(run_folder: Path, index: int) -> None:
    residual = residual_from_dict(json.loads((run_folder / "models" / "iteration_1.json").read_text()))
    point = np.array([0.2, 0.58, -31.0, 3.0])
    curve = curve_along(residual, CommandBounds().space(), point, index)
    assert (np.diff(curve.inputs) > 0).all()
    assert curve.inputs[curve.here] == point[index]
    for row in (0, curve.here, -1):
        other = point.copy()
        other[index] = curve.inputs[row]
        np.testing.assert_allclose(curve.mean[row], residual.mean(other), rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(curve.margin[row], INTERVAL_95 * residual.std(other, include_noise=True), rtol=1e-6)
