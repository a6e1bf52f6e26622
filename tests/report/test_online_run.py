"""The report of a run that explores, and learns after every step of its only deployment."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from stepgap.experiment.bands import steps_to_band
from stepgap.experiment.run import Run
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.report.analysis import Analysis
from stepgap.report.figures.steps import command_figure, error_figure, map_figure, tracking_figure
from stepgap.report.run_report import write_report
from stepgap.report.tables import band_table
from stepgap.robots.hopper.paper import paper_result
from stepgap.study.comparison_page import comparison_html
from tests.control.maps import LossyHopper
from tests.report.pages import Page
from tests.report.runs import TARGETS, make_run

EXPLORATION = 6

STEP_FIGURES: dict[str, Callable[[Run], Figure]] = {
    "tracking": tracking_figure,
    "commands": command_figure,
    "map": lambda record: map_figure(record, 0),
}
"""Figures over the step number."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_run(tmp_path_factory.mktemp("online") / "run", iterations=0, exploration=EXPLORATION)


@pytest.fixture(scope="module")
def record(folder: Path) -> Run:
    return Run(folder)


def test_the_model_after_the_run_is_described(record: Run) -> None:
    final = Learner.start(LossyHopper(), record.steps, LearningSettings("gp"), 1).residual
    written = write_report(Run(record.folder, nominal=LossyHopper(), final=final))
    text = Page(written.path).text
    assert "Deployment 0 learned while it ran. A further deployment would begin with the residual 'gp'" in text
    assert f"of {len(TARGETS) + EXPLORATION} earlier steps." in text
    assert "Corrected map: 4 of 4 targets are held" in text
    assert not [part for part in written.missing if "model" in part]


def test_a_model_that_is_not_known_is_not_denied(record: Run) -> None:
    written = write_report(Run(record.folder, nominal=LossyHopper(), final=Missing("nobody kept it")))
    text = Page(written.path).text
    reason = "deployment 0 learned while it ran, but what it learned is not known: nobody kept it"
    assert f"There is no model to describe: {reason}." in text
    assert f"the learned model ({reason})" in written.missing
    assert "used the nominal map" not in text
    assert "Nominal map: 4 of 4 targets are held" in text


def test_an_unfinished_deployment_that_learns_did_not_use_the_nominal_map(record: Run) -> None:
    none_finished = replace(record.summary, deployments=())
    running = Run(record.folder, summary=none_finished, final=Missing("it is still learned"))
    assert running.residual_name(0) is None
    first = Steps(record.space, list(record.steps)[:1])
    one_step = Run(record.folder, summary=none_finished, recorded=first)
    assert one_step.residual_name(0) is None, "the first step is planned by beliefs, without having learned"
    learned = Analysis(running).learned
    assert learned == Missing(
        "deployment 0 learned while it ran, but what it learned is not known: it is still learned"
    )


def test_the_axis_of_deployments_says_which_maps_were_used(record: Run, tmp_path: Path) -> None:
    assert error_figure(record).axes[-1].get_xlabel() == "Deployment (all of this run: corrected map)"
    offline = Run(make_run(tmp_path / "offline", iterations=0))
    assert "0: nominal map" in error_figure(offline).axes[-1].get_xlabel()


def test_all_figures_of_steps_have_the_same_steps(record: Run) -> None:
    limits = {name: make(record).axes[-1].get_xlim() for name, make in STEP_FIGURES.items()}
    assert len(set(limits.values())) == 1
    low, high = limits["tracking"]
    assert 0 < 1 - EXPLORATION - low < 2
    assert 0 < high - len(TARGETS) < 2


def test_predictions_of_exploratory_steps_are_no_reference(record: Run) -> None:
    for panel in tracking_figure(record).axes:
        (reference,) = (line for line in panel.lines if line.get_label() == "reference")
        np.testing.assert_array_equal(reference.get_xdata(), np.arange(1, len(TARGETS) + 1))
    labels = [line.get_label() for line in map_figure(record, 0).axes[1].lines]
    changes = [line for line in map_figure(record, 0).axes[1].lines if np.ptp(np.asarray(line.get_xdata())) == 0]
    assert "change of the target" in labels
    assert [np.asarray(line.get_xdata())[0] for line in changes] == [11, 21, 31]


def test_hops_to_the_band_include_exploratory_ones(record: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    tracking = steps_to_band(record.steps.tracking_errors(), paper_result().band)
    assert tracking is not None
    monkeypatch.setattr(Run, "compared_result", paper_result())
    total, hops = len(TARGETS) + EXPLORATION, tracking + EXPLORATION
    assert f'<th scope="row">all</th><td>{total}</td><td>{hops}</td>' in band_table(record)
    other = Run(record.folder.parent / "other", recorded=record.steps, space=record.space, summary=record.summary)
    assert f'<th scope="row">steps</th><td>{hops}</td><td>{hops}</td>' in comparison_html([record, other])
