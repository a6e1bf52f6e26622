"""Every sentence of a report follows from what happened in its run, for runs of several kinds."""

import re
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from stepgap.control.reach import whole_states
from stepgap.control.reference import Reference
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.learning.settings import LearningSettings
from stepgap.plants.model_plant import ModelPlant
from stepgap.report.analysis import Analysis
from stepgap.report.learned_residual import LearnedResidual
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array, Quantity, StepMap, StepRecord, StepSpace
from tests.control.maps import ClosedFormMap, LossyHopper, PitchingHopper
from tests.report.pages import Page
from tests.report.runs import REAL, TARGETS, report_of


@dataclass(frozen=True)
class Bouncer(ClosedFormMap):
    """A robot of one state coordinate, in rad, and one command."""

    gain: float = 0.02

    @property
    def space(self) -> StepSpace:
        return StepSpace((Quantity("tilt", "rad", -0.004, 0.004),), (Quantity("push", "N", -1, 1),))

    def next_state(self, state: Array, command: Array) -> Array:
        return 0.3 * state + self.gain * command + 0.001


LEVELS = Reference.from_segments(("tilt",), [(1, (0.0,)), (11, (0.002,)), (21, (-0.001,)), (31, (0.001,))], 40)


@dataclass(frozen=True)
class Kind:
    """A kind of run: what is learned, on which robot, with how much noise [half ranges]."""

    nominal: StepMap
    real: StepMap
    reference: Reference
    learning: LearningSettings
    noise: float = 0.02
    warm: bool = False


OFFLINE = LearningSettings("gp", 1, tolerance=0.0)
BELIEVED = replace(OFFLINE, residual="posterior")
KINDS = {
    "hopper": Kind(LossyHopper(), REAL, TARGETS, OFFLINE),
    "one state": Kind(Bouncer(), Bouncer(0.03), LEVELS, OFFLINE),
    "no learning": Kind(LossyHopper(), REAL, TARGETS, replace(OFFLINE, iterations=0)),
    "online": Kind(LossyHopper(), REAL, TARGETS, replace(OFFLINE, iterations=0, online=True)),
    "warm": Kind(LossyHopper(), REAL, TARGETS, replace(OFFLINE, iterations=0), warm=True),
    "believed": Kind(LossyHopper(), REAL, TARGETS, BELIEVED),
    "believed online": Kind(LossyHopper(), REAL, TARGETS, replace(BELIEVED, iterations=0, online=True)),
    "at its floor": Kind(REAL, REAL, TARGETS, OFFLINE),
    "without noise": Kind(Bouncer(), Bouncer(0.03), LEVELS, OFFLINE, noise=0.0),
    "pitching": Kind(PitchingHopper(), PitchingHopper(mass=1.8, loss=0.45, keep=0.6), TARGETS, OFFLINE),
}


@pytest.fixture(scope="module")
def text_of(tmp_path_factory: pytest.TempPathFactory):
    """Function that returns the text of the report of a kind of run."""

    @cache
    def report(name: str) -> str:
        kind = KINDS[name]
        folder = tmp_path_factory.mktemp("claims") / "run"
        folder.mkdir()
        (start,) = whole_states(kind.real, kind.reference.of(kind.real.space).targets[:1])
        plant = partial(ModelPlant, kind.real, start, kind.noise * kind.real.space.state_scale)
        known = None
        if kind.warm:
            first = folder.parent / "first"
            first.mkdir()
            run_experiment(Setup(kind.nominal, Plants(plant), kind.reference, kind.learning, seed=1), first)
            known = Run(first, space=kind.nominal.space).steps
        run_experiment(Setup(kind.nominal, Plants(plant), kind.reference, kind.learning, known=known), folder)
        return Page(report_of(folder, space=kind.nominal.space, nominal=kind.nominal, plant="test robot")).text

    return report


@pytest.mark.parametrize("name", KINDS)
def test_nothing_is_claimed_that_did_not_happen(name: str, text_of) -> None:
    """None of these robots is that of the paper, has a yaw that was measured, limits, or failed steps."""
    text, kind = text_of(name), KINDS[name]
    for claim in ("the paper", "yaw", "periodic", "Triangles", "cut by limits", " fell", "exploratory", "1.0 times"):
        assert claim not in text, claim
    assert not re.search(r"−0(\.0+)?(?![\d.])", text), "zero has no sign"
    assert ("with the learned correction" in text) == (kind.learning.iterations > 0)


def test_learning_between_deployments_is_judged_by_the_first_one(text_of) -> None:
    for name in ("hopper", "one state", "believed"):
        text = text_of(name)
        assert "It tracked: the last deployment made all its 40 steps without a fall" in text
        assert "before: RMSE of deployment 0" in text
        assert "every tracking error is smaller than in deployment 0." in text
        assert "times smaller" in text


def test_a_single_deployment_that_learned_nothing_is_not_compared(text_of) -> None:
    text = text_of("no learning")
    assert "with the nominal map: nothing was learned yet." in text
    assert not any(word in text for word in ("before: RMSE", "times smaller", "larger than", "corrected by"))
    assert "RMSE of deployment 0 (95 % interval)" in text
    assert "because nothing had been learned yet" in text


@pytest.mark.parametrize("name", ["online", "believed online", "warm"])
def test_learning_from_the_start_is_judged_by_the_nominal_predictions_and_by_the_band(name: str, text_of) -> None:
    text = text_of(name)
    assert "he last deployment made all its 40 steps without a fall" in text
    assert "smaller than that of the nominal map's predictions" in text
    assert "before: RMSE of the nominal map's predictions" in text
    assert "executed steps they stayed within 3 noise floors." in text
    assert "nothing had been learned" not in text


def test_at_the_floor_nothing_is_called_smaller_or_larger(text_of) -> None:
    text = text_of("at its floor")
    assert "no tracking error is clearly smaller or larger than in deployment 0" in text
    assert "near the noise floor from the beginning" in text
    assert text.count("no clear change") == 2
    assert not any(word in text for word in ("times smaller", "times larger"))


def test_what_is_not_tracked_is_shown_and_not_judged(text_of) -> None:
    text = text_of("pitching")
    assert "It tracked: the last deployment made all its 40 steps without a fall" in text
    assert "every tracking error is smaller than in deployment 0." in text
    assert text.count("times smaller") == 2
    assert "Error of pitch" not in text
    assert "Map of pitch." in text
    assert "nan" not in text


def test_a_plant_without_noise_has_no_floor_to_be_compared_with(text_of) -> None:
    text = text_of("without noise")
    assert "the plant has no noise, and so no noise floor." in text
    assert not any(word in text for word in ("noise floors", "It tracked", "did not track"))


def test_beliefs_say_what_figures_do_not_show(tmp_path: Path) -> None:
    """A hopper on a boom: its error has a part that returns with the yaw, which beliefs know, and one that does not."""
    nominal, texts = LossyHopper(), []
    reference = Reference(TARGETS.names, np.tile(TARGETS.targets, (3, 1)))
    for learning in (BELIEVED, OFFLINE):
        folder = tmp_path / learning.residual
        folder.mkdir()
        plant = partial(_Turning, REAL, TARGETS.targets[0], np.array([0.004, 0.001]))
        run_experiment(Setup(nominal, Plants(plant), reference, learning), folder)
        settings = Experiment(Hopper(), learning=learning)
        run = Run(folder, space=nominal.space, nominal=nominal, settings=settings)
        learned = Analysis(run).learned
        assert isinstance(learned, LearnedResidual)
        for each in learned.standardised_errors:
            assert 0.8 < np.sqrt(np.mean(each**2)) < 1.25
        texts.append(Page(report_of(folder, space=nominal.space, nominal=nominal, settings=settings)).text)
    without = "Figures and tables are without what returns with the yaw, and what follows from the step before."
    assert [without in text for text in texts] == [True, False]
    assert ["It jumps where what is believed" in text for text in texts] == [True, True]
    assert ["steady errors between these two numbers" in text for text in texts] == [False] * 2


class _Turning(ModelPlant):
    """A plant that turns by a quarter of a radian in each step, and whose speed depends on where it is."""

    tilt = 0.05
    turned = 0.0

    def take_step(self, command: Array) -> StepRecord:
        record = super().take_step(command)
        shift = np.array([self.tilt * np.sin(self.turned), 0.0])
        self.turned += 0.25
        self._state = record.next_state + shift
        return replace(record, next_state=record.next_state + shift, context={"yaw": self.turned})
