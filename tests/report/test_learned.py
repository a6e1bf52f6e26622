"""The learned residual in the report of a run on a map with a closed form."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from stepgap.experiment.run import Run
from stepgap.learning.residual import HistoryInputs
from stepgap.records.missing import Missing
from stepgap.records.text import decimal
from stepgap.report.analysis import Analysis, input_quantities
from stepgap.report.gait_text import gait_table
from stepgap.report.learned_residual import LearnedResidual
from stepgap.report.learned_table import coverage_table, learned_tables
from stepgap.report.reference_gait import reference_gait
from tests.control.maps import LossyHopper
from tests.report.pages import Page, check_alone
from tests.report.runs import TARGETS, report_of

SPACE = LossyHopper().space


def test_the_last_model_and_its_numbers(hopper_run: Path) -> None:
    record, saved = (
        Run(hopper_run, space=SPACE),
        json.loads((hopper_run / "models" / "iteration_2.json").read_text()),
    )
    learned = Analysis(record).learned
    assert isinstance(learned, LearnedResidual)
    assert len(learned.residual.regressions) == 2
    text = learned_tables(record, learned)
    for entry in saved["regressions"]:
        for length, scale in zip(entry["length_scale"], entry["input_scale"], strict=True):
            assert f"<td>{decimal(length * scale)}</td>" in text
        assert f"<td>{decimal(entry['noise_std'])}</td>" in text
    assert "fx [N]" in text
    for standardised in learned.standardised_errors:
        assert 0.5 < np.sqrt(np.mean(standardised**2)) < 1.5
    assert "of 40" in coverage_table(record)


def test_a_missing_model_is_reported(hopper_run: Path, tmp_path: Path) -> None:
    assert Run(hopper_run).residual(0) == Missing("deployment 0 used the nominal map")
    shutil.copytree(hopper_run, tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "models")
    page = Page(report_of(tmp_path / "run"))
    check_alone(page)
    assert "There is no model to describe: there is no models/iteration_2.json." in page.text


def test_a_damaged_model_is_reported(hopper_run: Path, tmp_path: Path) -> None:
    shutil.copytree(hopper_run, tmp_path / "run")
    (tmp_path / "run" / "models" / "iteration_2.json").write_text("{}")
    page = Page(report_of(tmp_path / "run"))
    assert re.search(r"There is no model to describe: [^\n]*iteration_2\.json: not a residual", page.text)


@pytest.mark.parametrize("part", [0, 1, 100, 1000, -1])
def test_a_truncated_model_is_refused(hopper_run: Path, tmp_path: Path, part: int) -> None:
    whole = (hopper_run / "models" / "iteration_2.json").read_bytes()
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "iteration_2.json").write_bytes(whole[:part])
    found = Run(tmp_path, space=SPACE).residual(2)
    assert isinstance(found, Missing)
    assert re.fullmatch(r"[^\n]*iteration_2\.json: not a residual[^\n]*", found.reason)


@pytest.mark.parametrize(
    "text", ["[]", "3", "{}", '{"kind": "gp", "regressions": [{"kind": "gp"}]}', "[" * 100_000, "\\ud800"]
)
def test_a_foreign_model_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "iteration_2.json").write_text(text)
    found = Run(tmp_path, space=SPACE).residual(2)
    assert isinstance(found, Missing)
    assert re.fullmatch(r"[^\n]*iteration_2\.json: not a residual[^\n]*", found.reason)


@pytest.mark.parametrize("forgetting_time", [np.inf, 50.0])
def test_every_input_has_a_name(forgetting_time: float) -> None:
    history_inputs = HistoryInputs(forgetting_time)
    names = [quantity.name for quantity in input_quantities(SPACE, history_inputs)]
    assert len(names) == len(set(names)) == 4 + history_inputs.count


def test_gaits_hold_the_targets(hopper_run: Path) -> None:
    record, nominal = Run(hopper_run), LossyHopper()
    learned = Analysis(record).learned
    gait = reference_gait(record, nominal, learned)
    np.testing.assert_array_equal(gait.targets, TARGETS.targets[::10])
    assert [each.name for each in gait.maps] == ["nominal", "corrected"]
    for target, by_model, by_both in zip(gait.targets, *(each.points for each in gait.maps), strict=True):
        assert by_model is not None
        assert by_both is not None
        np.testing.assert_allclose(nominal(target, by_model.command), target, atol=1e-6)
        assert by_both.held
        assert np.abs(by_both.command - by_model.command).max() > 0.1, "the real robot loses more"
    assert gait_table(gait).count("<tr>") == 1 + len(gait.targets)


@pytest.mark.usefixtures("drawn_page", "unplaced")
def test_the_gait_is_on_the_page(hopper_run: Path, tmp_path: Path) -> None:
    shutil.copytree(hopper_run, tmp_path / "run")
    page = Page(report_of(tmp_path / "run", nominal=LossyHopper()))
    check_alone(page, 6)
    assert "Nominal map: 4 of 4 targets are held by a constant command within its bounds" in page.text
    assert (tmp_path / "run" / "figures" / "gait.pdf").is_file()


def test_a_run_that_still_explores_has_no_gait(hopper_run: Path, tmp_path: Path) -> None:
    header, first, *_ = (hopper_run / "steps.csv").read_text().splitlines(keepends=True)
    (tmp_path / "steps.csv").write_text(header + first.replace("0,1,", "0,0,", 1))
    page = Page(report_of(tmp_path, nominal=LossyHopper()))
    check_alone(page)
    assert "There is no gait: no target was tracked yet." in page.text
