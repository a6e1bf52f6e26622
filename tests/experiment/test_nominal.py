"""The nominal map of an experiment, linearised."""

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import Experiment, NominalSettings
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.simulator import SimulatorMap
from stepgap.robots.robot import Robot
from stepgap.step import StepMap, StepSpace
from tests.control.maps import LossyHopper, NeverWorks


class Simulated(Robot):
    """A robot with a simulator, and with a map on which every step fails."""

    name = "simulated"

    @property
    def space(self) -> StepSpace:
        return LossyHopper().space

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        return {"simulator": lambda: SimulatorMap(self.space, LossyHopper().next_state), "falls": NeverWorks}


def test_a_surrogate_is_stored_as_it_was_fitted_and_linearised_where_it_is_read(tmp_path: Path) -> None:
    settings = Experiment(Simulated(), nominal=NominalSettings(linear=True))
    found, path = load_nominal(settings), tmp_path / "nominal_map.json"
    assert found.surrogate
    path.write_text(found.file)
    again = load_nominal(Experiment(Simulated(), nominal=NominalSettings(file=str(path), linear=True)))
    assert isinstance(found.map, AffineMap)
    assert isinstance(again.map, AffineMap)
    assert (again.map.matrix.tobytes(), again.file) == (found.map.matrix.tobytes(), "")
    exact = LossyHopper().jacobian(found.map.state, found.map.command)
    np.testing.assert_allclose(found.map.matrix, exact, atol=1e-4)
    surrogate = load_nominal(Experiment(Simulated(), nominal=NominalSettings(file=str(path)))).map
    assert not isinstance(surrogate, AffineMap)


class Equations(Simulated):
    """A robot with a map that is no simulator."""

    name = "equations"

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        return {"equations": LossyHopper}


def test_a_surrogate_is_fitted_to_any_map_if_it_is_wanted(tmp_path: Path) -> None:
    """It is the map to a part of the ranges, and read again from the file of a run."""
    settings = Experiment(Equations(), nominal=NominalSettings(surrogate=True))
    fitted = load_nominal(settings)
    exact = LossyHopper()
    space = exact.space
    states = space.state_centre + 0.5 * space.state_scale * np.random.default_rng(1).uniform(-1, 1, (50, 2))
    commands = space.command_at(np.random.default_rng(2).uniform(-0.5, 0.5, (50, 2)))
    error = (
        fitted.map.evaluate(states, commands).next_state - exact.evaluate(states, commands).next_state
    ) / space.state_scale
    assert np.abs(error).max() < 0.01
    assert fitted.file
    path = tmp_path / "nominal_map.json"
    path.write_text(fitted.file)
    again = load_nominal(Experiment(Equations(), nominal=NominalSettings(file=str(path), surrogate=True)))
    assert (
        again.map.evaluate(states, commands).next_state.tobytes()
        == fitted.map.evaluate(states, commands).next_state.tobytes()
    )
    assert not again.file
    with pytest.raises(InputError, match="needs no file"):
        load_nominal(Experiment(Equations(), nominal=NominalSettings(file=str(path))))


def test_a_template_needs_no_surrogate(tmp_path: Path) -> None:
    path = tmp_path / "template.toml"
    settings = Experiment(Equations(), nominal=NominalSettings("template", str(path), surrogate=True))
    with pytest.raises(InputError, match=r"nominal\.surrogate = true: a map of kind 'template' is fast; leave it out"):
        load_nominal(settings)


def test_a_map_that_makes_no_step_there_is_not_linearised() -> None:
    settings = Experiment(Simulated(), nominal=NominalSettings("falls", linear=True))
    with pytest.raises(InputError, match=r"nominal\.linear = true: nominal map 'falls' makes no step from the mean"):
        load_nominal(settings)
