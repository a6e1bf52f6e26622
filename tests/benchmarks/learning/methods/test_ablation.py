"""Methods without a rule, and the published method with its several redeployments."""

from dataclasses import fields

import numpy as np
import pytest

from benchmarks.learning.methods import redeployment
from benchmarks.learning.methods.ablation import ABLATIONS, CONTROL_RULES, LEARNING_RULES, PRIOR
from benchmarks.learning.methods.redeployment import paper
from benchmarks.learning.methods.registry import default_methods, is_method, method_of
from benchmarks.learning.tasks import Task
from benchmarks.learning.trial import Trial
from stepgap.control.reference import Reference
from stepgap.control.settings import ALL_RULES, ControlSettings
from stepgap.experiment.settings import METHODS
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.twin.reality_gap import RealityGap

SHORT = Reference.from_segments(("speed", "height"), [(1, (0.0, 0.55)), (5, (0.17, 0.58))], steps=8)


@pytest.fixture
def trial() -> Trial:
    return Trial(ApexMap(), RealityGap(), Task("short", SHORT), twin=0, seed=0)


@pytest.fixture
def deployed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, LearningSettings, ControlSettings]]:
    """Iteration and settings of each deployment; none is made, except for the first one."""
    found: list[tuple[int, LearningSettings, ControlSettings]] = []

    def make(trial: Trial, learner: Learner, iteration: int, exploration: int = 0) -> Steps:
        assert learner.iteration == iteration
        found.append((iteration, learner.settings, trial.control))
        return trial.first

    monkeypatch.setattr(Trial, "measure", make)
    return found


def test_every_rule_is_a_setting_that_is_on_by_default() -> None:
    learning, control = LearningSettings(), ControlSettings()
    assert all(getattr(learning, name) is True for name in LEARNING_RULES)
    assert {field.name for field in fields(control) if getattr(control, field.name) is True} == set(CONTROL_RULES)
    assert set(ABLATIONS) == {*LEARNING_RULES, *CONTROL_RULES, PRIOR, "all_rules"}


@pytest.mark.parametrize("rule", [*LEARNING_RULES, *CONTROL_RULES])
def test_one_rule_is_off_and_the_first_deployment_is_the_common_one(
    rule: str, trial: Trial, deployed: list[tuple[int, LearningSettings, ControlSettings]]
) -> None:
    first = method_of(f"constant-{rule}")(trial)[0]
    assert first is trial.first
    ((iteration, learning, control),) = deployed
    off = [name for name in LEARNING_RULES if not getattr(learning, name)]
    off += [name for name in CONTROL_RULES if not getattr(control, name)]
    assert (iteration, off) == (1, [rule])
    method_of("constant")(trial)
    assert deployed[1][1:] == (LearningSettings(residual="constant"), ALL_RULES)


def test_names_of_methods_and_rules_are_checked() -> None:
    assert all(map(is_method, default_methods()))
    assert is_method("gp_on_linear-all_rules")
    for name in ("none", "magic", "gp_on_linear-magic", "magic-drift", "gp_on_linear-", "gp_on_linear-drift-cautious"):
        assert not is_method(name)


def test_the_published_method_makes_four_redeployments_and_learns_from_all(
    trial: Trial, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[tuple[int, list[int]]] = []
    start = Trial.learner

    def learner(trial: Trial, nominal: ApexMap, log: Steps, settings: LearningSettings, iteration: int) -> Learner:
        seen.append((iteration, log.iterations))
        return start(trial, nominal, log, settings, iteration)

    trial.first  # noqa: B018  (made before the learners are recorded)
    monkeypatch.setattr(Trial, "learner", learner)
    quick = METHODS["paper"]._replace(learning=LearningSettings(residual="linear", drift=False))
    monkeypatch.setattr(redeployment, "METHODS", {"paper": quick})
    deployments = paper(trial)
    assert seen == [(1, [0]), (2, [0, 1]), (3, [0, 1, 2]), (4, [0, 1, 2, 3])]
    assert [steps.iterations for steps in deployments] == [[0], [1], [2], [3], [4]]
    assert np.isfinite(deployments[-1].next_state).all()
