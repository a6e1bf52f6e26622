"""The sentences of the diagnosis, for robots with a known deficiency."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.experiment.outcome import offset_sentences
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.report.diagnosis_sentences import diagnosis_sentences
from tests.experiment.test_command_response import NOMINAL, steps_of
from tests.report.runs import write_run

SPACE = NOMINAL.space


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return Run(write_run(tmp_path_factory.mktemp("runs") / "run", ("speed", "height")))


@pytest.mark.parametrize("count", [1, 10, 200])
def test_without_a_deficiency_it_says_nothing(record: Run, count: int) -> None:
    changed = Run(record.folder, space=SPACE, recorded=steps_of(count, 1), nominal=NOMINAL)
    assert diagnosis_sentences(changed) == []


def test_a_command_at_its_bound_is_named(record: Run) -> None:
    steps = [
        replace(
            one,
            target=np.array([0.2, 0.58 + 2.0 * (one.step % 2)]),
            record=replace(one.record, requested=np.array([15.0, one.record.requested[1]])),
        )
        for one in steps_of(200, 1)
    ]
    text = "\n".join(
        diagnosis_sentences(Run(record.folder, space=SPACE, recorded=Steps(SPACE, steps), nominal=NOMINAL))
    )
    assert "fx was at a bound in 100 % of the steps of deployment 0" in text


def test_a_state_in_the_wrong_unit_is_named_even_without_a_nominal_map(record: Run) -> None:
    steps = [replace(one, record=replace(one.record, state=one.record.state * [1, 1000])) for one in steps_of(20, 1)]
    named, rest = diagnosis_sentences(
        Run(record.folder, space=SPACE, recorded=Steps(SPACE, steps), nominal=Missing("no map"))
    )
    assert named.startswith("In the first 5 steps of deployment 0, height was about 5")
    assert rest == "Not available: no map."


def test_steps_without_a_command_are_counted(record: Run) -> None:
    steps = [
        replace(one, std=np.zeros(2), predicted=np.full(2, np.nan) if one.step in (4, 9) else one.predicted)
        for one in steps_of(20, 1)
    ]
    (sentence,) = diagnosis_sentences(
        Run(record.folder, space=SPACE, recorded=Steps(SPACE, steps), nominal=Missing("no map"))
    )[:-1]
    assert sentence.startswith("In 2 of the 20 steps of deployment 0, first in step 4, the search found no command")


def test_an_offset_of_the_nominal_map_is_no_finding_but_one_that_learning_leaves_is() -> None:
    rng, count = np.random.default_rng(0), 30
    for offset, std, found in ((0.01, 0.0, 0), (0.01, 0.002, 1), (0.3, 0.0, 1), (0.0, 0.002, 0)):
        target = np.tile([0.2, 0.58], (count, 1))
        ends = target - [0.0, offset] + [0.01, 0.001] * rng.normal(size=(count, 2))
        steps = Steps.of_columns(SPACE, state=target, target=target, next_state=ends, std=np.full((count, 2), std))
        assert len(offset_sentences(steps)) == found


def test_without_a_nominal_map_it_says_so(record: Run) -> None:
    assert diagnosis_sentences(Run(record.folder, nominal=Missing("no map"))) == ["Not available: no map."]
