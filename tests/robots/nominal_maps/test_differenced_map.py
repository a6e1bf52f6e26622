"""Maps without a formula for their derivatives: the step of their differences, and warnings of rough and slow maps."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pytest

from stepgap.base.random_streams import random_stream
from stepgap.experiment import nominal as module
from stepgap.experiment.nominal import load_nominal, slowness
from stepgap.experiment.settings import Experiment
from stepgap.robots.nominal_maps.differenced_map import DifferencedMap, has_no_formula, with_suitable_step
from stepgap.robots.robot import Robot
from stepgap.step import StepMap, StepSpace, difference_jacobian
from tests.control.maps import CountingMap, LossyHopper, NeverWorks, RoughMap

STATE, COMMAND = np.array([0.2, 0.58]), np.array([2.0, -3.0])


class Smooth(LossyHopper):
    jacobian = difference_jacobian  # pyright: ignore[reportAssignmentType]


class Rough(RoughMap):
    jacobian = difference_jacobian  # pyright: ignore[reportAssignmentType]


@dataclass(frozen=True)
class Grain:
    size: float = 0.0


@dataclass(frozen=True)
class Robotic(Robot):
    """A robot whose nominal map has jumps."""

    name = "robotic"

    grain: Grain = field(default_factory=Grain)

    @property
    def space(self) -> StepSpace:
        return LossyHopper().space

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        return {"equations": lambda: Rough(grain=self.grain.size) if self.grain.size else Smooth()}


def test_only_a_map_whose_class_says_so_has_no_formula() -> None:
    assert has_no_formula(Smooth())
    assert not has_no_formula(LossyHopper())


def test_a_smooth_map_stays_as_it_is() -> None:
    found = load_nominal(Experiment(Robotic()))
    assert isinstance(found.map, Smooth)
    assert found.warnings == ()


def test_a_rough_map_gets_a_larger_step_and_a_warning_whatever_the_seed() -> None:
    found, other = (load_nominal(Experiment(Robotic(Grain(3e-4)), seed=seed)) for seed in (0, 5))
    assert isinstance(found.map, DifferencedMap)
    assert isinstance(other.map, DifferencedMap)
    assert found.map.relative_step == other.map.relative_step > 3e-3
    exact = LossyHopper().jacobian(STATE, COMMAND)
    scale = np.concatenate([found.map.space.state_scale, found.map.space.command_scale])
    errors = [np.abs((one.jacobian(STATE, COMMAND) - exact) * scale).max() for one in (found.map, found.map.inner)]
    assert errors[0] < 0.02 < 0.1 < errors[1], "with 1e-4 half ranges the jumps dominate"
    (warning,) = found.warnings
    assert warning.startswith(
        "nominal map 'equations' is not smooth on a small scale: differences of 0.0001 and 0.1 half"
    )
    assert "nominal.surrogate = true" in warning


def test_a_map_for_which_no_step_is_suitable_is_said_to_be_so() -> None:
    coarse, why = with_suitable_step(Rough(grain=0.05), random_stream(0))
    assert isinstance(coarse, DifferencedMap)
    assert coarse.relative_step == 0.1
    assert why.startswith("is not smooth, or most of its steps fail")
    assert with_suitable_step(NeverWorks(), random_stream(0))[1] == why


@pytest.mark.parametrize("rough", [0.0, 3e-4, 0.05])
def test_the_choice_takes_at_most_400_evaluations(rough: float) -> None:
    counting = CountingMap(Rough(grain=rough) if rough else Smooth())
    with_suitable_step(counting, random_stream(0))
    assert counting.evaluations <= 400


def test_a_slow_map_is_warned_of_with_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def clock(step: float) -> Callable[[], float]:
        times = iter(np.arange(100) * step)
        return lambda: float(next(times))

    monkeypatch.setattr(module, "process_time", clock(0.003))
    assert slowness("equations", LossyHopper(), 500) == ""
    monkeypatch.setattr(module, "process_time", clock(0.25))
    found = slowness("equations", LossyHopper(), 500)
    assert found.startswith(
        "nominal map 'equations' takes 250 ms of CPU time for a step, and the choice of a command evaluates 15"
    )
    assert "so it takes 3.8 to 125 s; --nominal.surrogate true fits a fast surrogate to it" in found
