"""The sentences of the diagnosis, for robots with a known deficiency."""

import re
from dataclasses import replace

import numpy as np
import pytest

from stepgap.experiment.run import Run
from stepgap.experiment.state_ranges import offset_sentences
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.report.diagnosis_sentences import diagnosis_sentences
from tests.learning.test_diagnosis import NOMINAL, SPACE, Error, plain, steps_of, varying, with_memory
from tests.report.runs import write_run


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return Run(write_run(tmp_path_factory.mktemp("runs") / "run", ("speed", "height")))


def sentences(record: Run, error: Error, steps: int = 200) -> str:
    changed = Run(record.folder, space=SPACE, recorded=steps_of(steps, 1, error), nominal=NOMINAL)
    return "\n".join(diagnosis_sentences(changed))


def test_without_a_deficiency_it_says_so(record: Run) -> None:
    assert sentences(record, plain) == (
        "The step before does not help to predict the error of speed and height (200 steps of deployment 0): as far as "
        "they show, the state is sufficient."
    )


def test_memory_and_noise_are_named_with_their_coordinate(record: Run) -> None:
    text = sentences(record, with_memory)
    assert "The step before helps to predict the error of speed, beyond state and command. With inputs" in text
    assert re.search(r"it is smaller, by \d+ % with its error(\.| and by \d+ % with its error, command)", text)
    assert "error of height" not in text
    assert "The unexplained error of speed depends on state and command" in sentences(record, varying, 227)


def test_a_command_at_its_bound_is_named(record: Run) -> None:
    steps = [
        replace(
            one,
            target=np.array([0.2, 0.58 + 2.0 * (one.step % 2)]),
            record=replace(one.record, requested=np.array([15.0, one.record.requested[1]])),
        )
        for one in steps_of(200, 1, plain)
    ]
    text = "\n".join(
        diagnosis_sentences(Run(record.folder, space=SPACE, recorded=Steps(SPACE, steps), nominal=NOMINAL))
    )
    assert "fx was at a bound in 100 % of the steps of deployment 0" in text


def test_a_state_in_the_wrong_unit_is_named_even_without_a_nominal_map(record: Run) -> None:
    steps = [
        replace(one, record=replace(one.record, state=one.record.state * [1, 1000])) for one in steps_of(20, 1, plain)
    ]
    named, rest = diagnosis_sentences(
        Run(record.folder, space=SPACE, recorded=Steps(SPACE, steps), nominal=Missing("no map"))
    )
    assert named.startswith("In the first 5 steps of deployment 0, height was about 5")
    assert rest == "Not available: no map."


def test_an_offset_of_the_nominal_map_is_no_finding_but_one_that_learning_leaves_is() -> None:
    rng, count = np.random.default_rng(0), 30
    for offset, std, found in ((0.01, 0.0, 0), (0.01, 0.002, 1), (0.3, 0.0, 1), (0.0, 0.002, 0)):
        target = np.tile([0.2, 0.58], (count, 1))
        ends = target - [0.0, offset] + [0.01, 0.001] * rng.normal(size=(count, 2))
        steps = Steps.of_columns(SPACE, state=target, target=target, next_state=ends, std=np.full((count, 2), std))
        assert len(offset_sentences(steps)) == found


def test_what_cannot_be_judged_is_said(record: Run) -> None:
    assert "Deployment 0 has 10 steps with a known error, too few" in sentences(record, plain, 10)
    assert diagnosis_sentences(Run(record.folder, nominal=Missing("no map"))) == ["Not available: no map."]
