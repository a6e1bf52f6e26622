import json
import re
import shutil
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import rc_context
from matplotlib.image import imread
from threadpoolctl import threadpool_info, threadpool_limits

from stepgap.experiment.bands import interval_coverage
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.learning.settings import LearningSettings
from stepgap.records.summary import MEASURED, MEASURES, NoiseFloor, Summary
from stepgap.records.text import decimal
from stepgap.report.drawing import LOOK
from stepgap.report.figures import drawn_figures
from stepgap.report.figures.steps import command_figure, error_figure, map_caption, tracking_figure
from stepgap.robots.hopper.paper import STATE_NAMES, paper_reference, paper_result
from stepgap.step import Quantity, StepSpace
from tests.control.maps import LossyHopper
from tests.quick_runs import leave_out_files_of_figures
from tests.report.pages import Page, check_alone, check_same_files
from tests.report.runs import make_run, report_of, write_run, write_summary

HOSTILE = "<img src=http://evil/?x='1' onerror=alert(1)>&\"--></svg></pre><script>alert(2)</script>$\\frac{"


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with its report."""
    folder = make_run(tmp_path_factory.mktemp("report") / "a run & <more>")
    content = json.loads((folder / "summary.json").read_text())
    content["versions"] = {"stepgap": "0.1.0"}
    (folder / "summary.json").write_text(json.dumps(content))
    (folder / "experiment.toml").write_text("seed = 0\nreference = 'a<b>.csv'\n")
    assert report_of(folder, space=LossyHopper().space, published=paper_result()) == folder / "report.html"
    return folder


@pytest.fixture(scope="module")
def page(written: Path) -> Page:
    return Page(written / "report.html")


@pytest.fixture(scope="module")
def like_paper(tmp_path_factory: pytest.TempPathFactory) -> Page:
    """The report of a run with the paper's reference, whose errors are all unknown."""
    targets = paper_reference().targets
    folder = write_run(tmp_path_factory.mktemp("like_paper") / "run", ("speed", "height"), 227, 5, targets=targets)
    with pytest.MonkeyPatch.context() as patch:
        leave_out_files_of_figures(patch)
        return Page(report_of(folder, published=paper_result()))


@pytest.fixture(scope="module")
def summary(written: Path) -> dict[str, Any]:
    return json.loads((written / "summary.json").read_text())


def test_page_stands_alone(page: Page) -> None:
    check_alone(page)
    assert len(page.source) < 2_000_000


def test_numbers_are_those_of_the_summary(page: Page, summary: dict[str, Any]) -> None:
    rows = [row for row in page.cells if any(kind.startswith("run") for kind, _ in row)]
    assert len(rows) == 2 * 3
    for name, table in (("speed", rows[:3]), ("height", rows[3:])):
        for iteration, row in enumerate(table):
            ours = [number for kind, number in row if kind.startswith("run")]
            assert ours == [summary["iterations"][iteration][measure][name] for measure in MEASURES]


def test_the_papers_numbers_are_shown_only_for_its_reference(page: Page, like_paper: Page) -> None:
    rows = [row for row in like_paper.cells if any(kind.startswith("paper") for kind, _ in row)]
    assert len(rows) == 2 * 5
    for row, (index, iteration) in zip(rows, product(range(2), range(5)), strict=True):
        theirs = [number for kind, number in row if kind.startswith("paper")]
        assert theirs == [paper_result().error(measure, iteration, index) for measure in MEASURED]
        assert len([kind for kind, _ in row if kind.startswith("run")]) == len(MEASURED), "true errors are not known"
    theirs = ("On the paper's hardware", "For comparison", "The paper's points", "Steps to the paper's band")
    assert not [text for text in theirs if text in page.text]
    assert not [text for text in theirs if text not in like_paper.text]
    assert not [row for row in page.cells if any(kind.startswith("paper") for kind, _ in row)]


def test_sentences_agree_with_the_summary(page: Page, summary: dict[str, Any]) -> None:
    before, after = (summary["iterations"][row]["rmse"]["speed"] for row in (0, -1))
    assert "It tracked: the last deployment made all its 40 steps without a fall" in page.text
    cells = f"<td>{decimal(before)}</td><td>{decimal(after)} ("
    assert cells in page.source
    assert f"<td>{decimal(before / after, 2)} times smaller</td>" in page.source
    assert "120 steps recorded in 3 deployments on the simulated twin, no falls." in page.text
    assert "tracked another reference than the paper's, so the paper's errors are not shown" in page.text
    assert "reference = 'a<b>.csv'" in page.text
    assert "stepgap: 0.1.0" in page.text
    assert "StepGap report: a run & <more>" in page.text


def test_only_the_paper_has_hardware(page: Page, like_paper: Page) -> None:
    assert set(re.findall(r"(\S+) hardware", like_paper.text)) == {"paper's", "paper:", "its"}
    assert re.findall(r"(\S+) hardware", page.text) == []
    assert "this run: simulated twin" in page.text


def test_pictures_are_pictures(written: Path) -> None:
    names = sorted(path.name for path in (written / "figures").iterdir())
    kinds = ["commands", "errors", "left_out", "map_height", "map_speed", "state_errors", "surface", "tracking"]
    assert names == [f"{kind}.{form}" for kind in kinds for form in ("pdf", "png")]
    for name in names[1::2]:
        assert (written / "figures" / name).with_suffix(".pdf").read_bytes().startswith(b"%PDF")
        picture = imread(written / "figures" / name)
        assert picture.shape[1:] == (1432, 4)
        most = 0.8 if name.startswith("surface") else 0.5
        assert 0.01 < np.mean(picture[..., :3].min(axis=-1) < 0.9) < most


@pytest.mark.usefixtures("every_format")
def test_writing_again_gives_the_same_bytes(written: Path, tmp_path: Path) -> None:
    again = shutil.copytree(written, tmp_path / written.name, ignore=shutil.ignore_patterns("figures"))
    report_of(again, space=LossyHopper().space, published=paper_result())
    check_same_files(again, written)


def test_it_computes_with_one_thread_of_blas(written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    threads = set[int]()

    def counted(*arguments: Any) -> Any:
        threads.update(each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas")
        return drawn_figures(*arguments)

    monkeypatch.setattr("stepgap.report.run_report.drawn_figures", counted)
    with threadpool_limits(2, user_api="blas"):
        report_of(shutil.copytree(written, tmp_path / "run"))
    assert threads == {1}


def test_curves_are_the_steps(written: Path) -> None:
    record = Run(written)
    curves = {line.get_label(): np.asarray(line.get_ydata()) for line in tracking_figure(record).axes[1].lines}
    last = record.steps.of_iteration(2)
    np.testing.assert_array_equal(curves["reference"], last.target[:, 1])
    np.testing.assert_array_equal(curves["deployment 2, corrected by gp"], last.next_state[:, 1])
    np.testing.assert_array_equal(curves["deployment 0, nominal map"], record.steps.of_iteration(0).next_state[:, 1])
    inside, known = (counts[0] for counts in interval_coverage(last))
    assert known == 40
    assert 30 <= inside <= 40


def test_legends_with_all_entries_are_within_their_figures(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a run along the paper's reference, whose noise floor is known."""
    monkeypatch.setattr(Run, "compared_result", paper_result())
    record = Run(written)
    floor = np.full(2, 0.01)
    record = Run(written, summary=replace(record.summary, noise_floor=NoiseFloor(floor, floor, 100.0)))
    with rc_context(LOOK):
        figures = tracking_figure(record), command_figure(record), error_figure(record)
        for figure in figures:
            figure.draw_without_rendering()
            (legend,) = figure.legends
            assert figure.bbox.padded(1).count_contains(legend.get_window_extent().corners()) == 4
    assert len(figures[-1].legends[0].get_texts()) == 6


def test_along_the_papers_reference(like_paper: Page) -> None:
    assert "The run tracked the paper's reference." in like_paper.text
    assert "but not every error is known, so that none is compared with deployment 0." in like_paper.text
    assert len(like_paper.source) < 2_000_000


@pytest.mark.parametrize(
    ("steps", "failed", "finished", "like"), [(227, 0, 2, True), (50, 0, 2, False), (50, 1, 2, True), (50, 0, 0, True)]
)
def test_a_part_of_the_papers_reference_is_another_one(
    tmp_path: Path, steps: int, failed: int, finished: int, like: bool
) -> None:
    folder = write_run(tmp_path / "run", STATE_NAMES, steps, 2, targets=paper_reference().targets[:steps])
    record = Run(folder, published=paper_result())
    deployments = tuple(replace(each, failed_steps=failed) for each in record.deployments[:finished])
    summary = replace(record.summary, deployments=deployments)
    found = Run(folder, published=record.published, summary=summary).compared_result
    assert found is (record.published if like else None)
    assert Run(folder).compared_result is None


@pytest.mark.usefixtures("drawn_page", "unplaced")
def test_first_deployment_alone(tmp_path: Path) -> None:
    page = Page(report_of(make_run(tmp_path / "run", iterations=0)))
    check_alone(page)
    assert "made all its 40 steps without a fall, with the nominal map: nothing was learned yet." in page.text
    assert "Tracking of a single deployment" in page.text
    assert "first and" not in page.text
    assert "The map gave no standard deviation" in page.text


@pytest.mark.usefixtures("drawn_page", "unplaced")
def test_falls(tmp_path: Path) -> None:
    page = Page(report_of(make_run(tmp_path / "run", iterations=1, lasts=(15, 0))))
    check_alone(page)
    assert "It did not track to the end: deployment 1 fell at step 1." in page.text
    assert "Deployment 0 fell at step 16; its errors include only the steps before." in page.text
    assert "17 steps recorded in 2 deployments on the simulated twin, 2 falls." in page.text


def test_a_stop_is_no_fall(tmp_path: Path) -> None:
    folder = make_run(tmp_path / "run", iterations=0, lasts=(15,))
    for name, texts in {"steps.csv": (",fell", ",stopped"), "summary.json": ("steps_sha256", "former_sha256")}.items():
        (folder / name).write_text((folder / name).read_text().replace(*texts))
    text = Page(report_of(folder)).text
    assert "It did not track to the end: deployment 0 was stopped at step 16." in text
    assert "16 steps recorded in 1 deployment on the simulated twin, 1 step stopped by the plant." in text
    assert "fall." not in text


@pytest.mark.usefixtures("drawn_page", "unplaced")
def test_a_run_in_progress(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", ("x",), steps=3)
    write_summary(folder, ("x",), 3, 1)
    with (folder / "steps.csv").open("a") as file:
        file.write("1,4,0.")
    assert "Deployment 1 is running or was interrupted: its 3 steps so far" in Page(report_of(folder)).text
    (folder / "summary.json").unlink()
    page = Page(report_of(folder))
    check_alone(page)
    assert "No deployment is finished yet." in page.text
    assert "paper's hardware" not in page.text


@pytest.mark.usefixtures("drawn_page")
def test_steps_without_any_target_have_a_report(tmp_path: Path) -> None:
    """Such as a run in progress whose reference leaves its first steps open."""
    folder = make_run(tmp_path / "run", iterations=0)
    space = LossyHopper().space
    steps = Run(folder, space=space).steps.with_columns(target=np.nan)
    nominal = LossyHopper()
    page = Page(report_of(folder, space=space, recorded=steps, summary=Summary(), nominal=nominal))
    assert "No deployment is finished yet." in page.text
    assert "no target was tracked yet" in page.text
    assert "nan" not in page.text


def test_hostile_text_stays_text(tmp_path: Path) -> None:
    names = ("script", "AUX", "con")
    folder = write_run(tmp_path / "run", names, residual=HOSTILE[:100])
    content = json.loads((folder / "summary.json").read_text())
    content["versions"] = {HOSTILE: HOSTILE + "\ud800\x00"}
    (folder / "summary.json").write_text(json.dumps(content))
    (folder / "experiment.toml").write_text(f"robot = '''{HOSTILE}'''\n")
    (tmp_path / "precious").write_text("precious")
    (folder / "report.html.partial").symlink_to(tmp_path / "precious")
    page = Page(report_of(folder, plant=HOSTILE))
    check_alone(page)
    assert page.text.count(HOSTILE) >= 6
    assert (tmp_path / "precious").read_text() == "precious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["precious", "run"]
    for path in (folder / "figures").iterdir():
        assert re.fullmatch(r"[a-z0-9_-]+\.(pdf|png)", path.name)


def test_equal_file_names_are_kept_apart(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", ("a_b", "A_b"), steps=2, iterations=1)
    report_of(folder)
    assert len(list((folder / "figures").glob("*.png"))) == 6


def test_units_of_a_given_space(tmp_path: Path) -> None:
    space = StepSpace((Quantity("tilt", "rad", -1, 1),), (Quantity("push", "N", -1, 1),))
    page = Page(report_of(write_run(tmp_path / "run", ("tilt",), steps=2), plant="hardware of ours", space=space))
    assert "Error of tilt [rad]" in page.text
    assert "this run: hardware of ours" in page.text


def test_nothing_is_written_for_a_bad_run(written: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run"
    shutil.copytree(written, folder)
    (folder / "summary.json").write_text("{}")
    before = (folder / "report.html").read_bytes()
    with pytest.raises(ValueError, match=r"^[^\n]*summary\.json: schema is missing, but it must be 1[^\n]*$"):
        report_of(folder)
    assert (folder / "report.html").read_bytes() == before


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0381, "0.0381"), (-0.0000601, "−0.0000601"), (0, "0"), (np.nan, "–"), (12345.6, "12346"), (1e-9, "1e−09")],
)
def test_decimal(value: float, text: str) -> None:
    assert decimal(value) == text


def test_jumps_of_the_standard_deviation_are_explained_where_beliefs_plan(written: Path) -> None:
    jumps = "It jumps where what is believed of the robot changes."
    for drift in (True, False):
        run = Run(written, settings=Experiment(learning=LearningSettings(drift=drift)))
        assert "It is larger where state and command are farther" in map_caption(run, 0)
        assert (jumps in map_caption(run, 0)) == drift
