"""`study_knobs` on a robot whose effects are known exactly, and on the hopper."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import radians

import numpy as np
import pytest
from numpy.typing import ArrayLike

from stepgap.base.errors import InputError
from stepgap.experiment.knobs import REGION, study_knobs
from stepgap.experiment.settings import Experiment, NominalSettings
from stepgap.report.knobs import describe_knobs, knobs_figure
from stepgap.robots.knobs import turned
from stepgap.robots.robot import Robot
from stepgap.step import Array, Outcome, Quantity, StepMap, StepSpace

SPACE = StepSpace(
    state=(Quantity("a", "m", -1.0, 1.0), Quantity("b", "m", -2.0, 2.0)),
    command=(Quantity("u", "N", -4.0, 4.0), Quantity("v", "N", -4.0, 4.0)),
)


@dataclass(frozen=True)
class Slopes:
    both: float = 1.0
    second: float = 2.0
    unused: float = 0.0

    def __post_init__(self) -> None:
        if 3.0 <= self.second < 4.0:
            raise ValueError("second must be less than 3")


@dataclass(frozen=True)
class Known(Robot):
    """Next state: half of the state, and u + both, v + 3 both² + second."""

    name = "known"
    gains: Slopes = field(default_factory=Slopes)

    @property
    def space(self) -> StepSpace:
        return SPACE

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        return {"sum": lambda: KnownMap(self.gains)}

    def loads(self, state: Array, command: Array) -> Mapping[str, float]:  # noqa: ARG002
        return {"push [N]": float(np.abs(command).max())}


@dataclass(frozen=True)
class KnownMap(StepMap):
    gains: Slopes

    @property
    def space(self) -> StepSpace:
        return SPACE

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        state, command = np.asarray(state, float), np.asarray(command, float)
        more = np.array([self.gains.both, 3 * self.gains.both**2 + self.gains.second]) - [1, 5]
        next_state = 0.5 * state + command + more
        return Outcome(next_state, np.zeros(next_state.shape[:-1], int))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:  # noqa: ARG002
        return np.broadcast_to(np.hstack([0.5 * np.eye(2), np.eye(2)]), (*np.shape(state)[:-1], 2, 4))


def settings(robot: Robot, kind: str = "sum") -> Experiment:
    return Experiment(robot, nominal=NominalSettings(kind=kind))


def test_effects_angles_and_loads_are_those_of_the_formula() -> None:
    calls: list[tuple[int, int]] = []
    study = study_knobs(settings(Known()), lambda done, total: calls.append((done, total)))
    assert [knob.key for knob in study.knobs] == ["u", "v", "gains.both", "gains.second"]
    assert [knob.reach for knob in study.knobs] == [4, 4, 0.1, 0.2]
    assert calls == [(number, 9) for number in range(9)]
    np.testing.assert_allclose(np.ptp(study.states, axis=0), 2 * REGION * SPACE.state_scale)
    effects = np.array([[4, 0, 0.1, 0.0], [0, 4, 0.6, 0.2]])  # 3 (1 + h)² has the slope 6
    np.testing.assert_allclose(study.effects, np.broadcast_to(effects, (9, 2, 4)), atol=1e-9)
    pairs = {(pair.first, pair.second): pair for pair in study.pairs}
    own = pairs[0, 1]
    assert own.angle == pytest.approx(radians(90))
    assert own.condition == pytest.approx(2)  # 4 of half a range of 1, and of 2
    assert own.missed == 0
    assert own.loads == {"push [N]": pytest.approx(REGION * 2 * 0.5 + 0.5 * 2)}
    assert pairs[2, 3].angle == pytest.approx(np.arctan2(0.1, 0.3))
    assert pairs[2, 3].missed > 0.5
    assert [pair.condition for pair in study.pairs] == sorted(pair.condition for pair in study.pairs)


def test_what_cannot_be_compared_is_said() -> None:
    with pytest.raises(InputError, match=r"nominal\.kind = log: robot 'known' does not make it"):
        study_knobs(settings(Known(), "log"))
    far = Known(gains=Slopes(both=50.0))
    with pytest.raises(InputError, match="no command holds any of 9 states"):
        study_knobs(settings(far))


def test_a_setting_that_is_not_valid_there_is_left_out_and_not_the_gait() -> None:
    study = study_knobs(settings(Known(gains=Slopes(second=2.99))))
    assert len(study.states) == 9
    assert [knob.key for knob in study.failed] == ["gains.second"]
    assert "left out" in describe_knobs(study)
    assert "gains.second" not in [knob.key for knob in study.knobs]


def test_weights_of_the_experiment_count() -> None:
    study = study_knobs(replace(settings(Known()), weights={"b": 4.0}))
    own = next(pair for pair in study.pairs if (pair.first, pair.second) == (0, 1))
    assert own.condition == pytest.approx(1.0)  # an error of b counts twice as much as before
    alone = study_knobs(replace(settings(Known()), weights={"b": 0.0}))
    assert "b m" not in describe_knobs(alone)


def test_tables_and_figure_name_every_setting() -> None:
    study = study_knobs(settings(Known()))
    text = describe_knobs(study)
    for knob in study.knobs:
        assert knob.key in text
    assert "largest push [N]" in text
    labels = knobs_figure(study).axes[0].get_legend_handles_labels()[1]
    assert labels == [knob.key for knob in study.knobs]


def test_a_robot_is_turned_by_key() -> None:
    assert turned(Known(), {"gains.both": 0.5, "gains.second": -1.0}) == replace(Known(), gains=Slopes(1.5, 1.0))
