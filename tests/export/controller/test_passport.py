"""The passport of a robot: from a run, in words, and in the files that carry it."""

from pathlib import Path

import pytest

from stepgap.base.errors import InputError
from stepgap.experiment.run import Run
from stepgap.export.controller.passport import LONGEST_NAME, checked_robot_name, passport_lines, passport_of
from tests.report.runs import make_run


def test_it_says_what_a_run_was_good_for(tmp_path: Path) -> None:
    run = Run(make_run(tmp_path / "run", 2))
    (run.folder / "experiment.toml").write_text("seed = 1\n")
    passport, summary = passport_of(run, None, "unit 7"), run.deployments
    assert (passport["robot"], passport["name"], passport["steps"]) == ("hopper", "unit 7", len(run.recorded))
    assert passport["deployments"] == len(summary)
    speed = passport["errors"][0]
    assert (speed["before"], speed["after"]) == (summary[0].rmse[0], summary[-1].rmse[0])
    assert speed["after_interval"][0] < speed["after"] < speed["after_interval"][1]
    assert passport_of(run, 1)["steps"] == len(run.recorded.before(1))
    (run.folder / "experiment.toml").write_text("seed = 2\n")
    assert passport_of(Run(run.folder), None)["settings_sha256"] != passport["settings_sha256"]
    first, second, _ = passport_lines(passport)
    assert first.startswith("Robot hopper 'unit 7', plant twin, until 20")
    assert "speed" in second
    assert passport_lines({}) == []


@pytest.mark.parametrize("name", ["x" * (LONGEST_NAME + 1), "two\nlines", "\x1b[31m"])
def test_a_name_that_cannot_be_printed_is_refused(name: str) -> None:
    with pytest.raises(InputError, match="printable characters"):
        checked_robot_name(name)
