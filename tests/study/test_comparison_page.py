import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from stepgap.base.errors import InputError
from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.records.summary import parse_summary
from stepgap.report import drawing
from stepgap.report.tables import changed_settings, differing, flat_settings
from stepgap.robots.hopper.paper import paper_reference, paper_result
from stepgap.study.cli.compare import compare_robots
from stepgap.study.comparison_page import FEWEST_SEEDS, comparison_html, run_names, seed_groups, spread_tables
from tests.report.pages import Page, check_alone
from tests.report.runs import make_run, write_run


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two runs, the second with one redeployment less and another seed."""
    parent = tmp_path_factory.mktemp("several")
    folders = [make_run(parent / "a <b>", 2), make_run(parent / "c", 1)]
    for seed, folder in enumerate(folders):
        (folder / "experiment.toml").write_text(f"seed = {seed}\n[gains]\nstiffness = 2400.0\n")
    return folders


@pytest.mark.usefixtures("drawn_page")
def test_runs_side_by_side(folders: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "_lay_out", lambda figure: figure.set_layout_engine(None))  # which takes seconds
    records = [Run(folder) for folder in folders]
    (tmp_path / "page.html").write_text(comparison_html(records), encoding="utf-8")
    page = Page(tmp_path / "page.html")
    check_alone(page, 1)
    assert "All runs tracked the same reference." in page.text
    assert "a <b>: It tracked" in page.text
    rows = [row for row in page.source.splitlines() if 'scope="row">seed<' in row or "gains.stiffness" in row]
    assert rows == ['<tr><th scope="row">seed</th><td>0</td><td>1</td></tr>']
    assert '<th scope="row">2</th>' in page.source
    assert page.source.count("<caption>") == 7


def test_the_papers_band_is_compared_along_its_reference_only(folders: list[Path], tmp_path: Path) -> None:
    targets = paper_reference().targets
    runs = [write_run(tmp_path / name, ("speed", "height"), 227, 1, targets=targets) for name in "ab"]
    like_paper = [Run(run, published=paper_result()) for run in runs]
    band = "until the error stays in the paper&#x27;s band"
    assert band in comparison_html(like_paper)
    assert band not in comparison_html([like_paper[0], Run(folders[0], published=paper_result())])
    assert band not in comparison_html([like_paper[0], Run(runs[1])])


def test_runs_of_another_state_are_refused(folders: list[Path], tmp_path: Path) -> None:
    other = write_run(tmp_path / "other", ("x",))
    with pytest.raises(ValueError, match=r"^[^\n]*only runs of the same state can be compared$"):
        comparison_html([Run(folders[0]), Run(other)])
    with pytest.raises(ValueError, match="1 runs to compare, but there must be 2 to 12"):
        comparison_html([Run(folders[0])])
    with pytest.raises(InputError, match="only runs of the same state can be compared"):
        compare_robots([folders[0], other], out=tmp_path / "page.html")
    assert not (tmp_path / "page.html").exists()


def test_unfinished_runs_are_compared(folders: list[Path], tmp_path: Path) -> None:
    shutil.copytree(folders[0], tmp_path / "run")
    (tmp_path / "run" / "summary.json").unlink()
    (tmp_path / "run" / "experiment.toml").unlink()
    text = comparison_html([Run(folders[1]), Run(tmp_path / "run")])
    assert "No deployment is finished yet." in text
    assert "No experiment.toml in: " in text


def test_names_are_paths_without_their_common_part() -> None:
    assert run_names([Path("/runs/a"), Path("/runs/b/c")]) == ["a", "b/c"]
    assert run_names([Path("/x/run"), Path("/y/run")]) == ["x/run", "y/run"]
    assert run_names([Path("/x/run"), Path("/x/run")]) == ["run (1)", "run (2)"]


def test_settings_that_differ() -> None:
    one = flat_settings({"a": 1, "t": {"b": 2.0, "c": [1, 2]}, "s": ""})
    two = flat_settings({"a": 1.0, "t": {"b": 2, "c": (1, 3)}, "d": True})
    assert differing([one, two]) == [["t.c", "[1, 2]", "[1, 3]"], ["s", "(empty)", "–"], ["d", "–", "true"]]
    assert "All settings are the defaults." in changed_settings({"x": 1}, {"x": 1.0})
    assert "&lt;" in changed_settings({"x": "<"}, json.loads('{"x": 2}'))


def test_exploratory_steps_are_no_other_reference(folders: list[Path], tmp_path: Path) -> None:
    """Their targets are the predicted states, as in a run with `--explore`."""
    record = Run(folders[0])
    first = next(iter(record.steps))
    steps = Steps(record.space, [replace(first, step=0, target=first.predicted), *record.steps])
    explored = Run(tmp_path, recorded=steps, space=record.space, summary=record.summary)
    assert "All runs tracked the same reference." in comparison_html([record, explored])


def test_the_spread_is_that_of_runs_that_differ_in_the_seed_only(folders: list[Path], tmp_path: Path) -> None:
    errors, records = [0.01, 0.02, 0.013, 0.5], []
    for seed, error in enumerate(errors):
        shutil.copytree(folders[1], tmp_path / str(seed))
        content = json.loads((tmp_path / str(seed) / "summary.json").read_text())
        content["seed"], content["iterations"][1]["rmse"]["speed"] = seed, error
        other = seed == len(errors) - 1
        settings = f"seed = {seed}\n[gains]\nstiffness = {2500 if other else 2400}\n"
        (tmp_path / str(seed) / "experiment.toml").write_text(settings)
        record = Run(tmp_path / str(seed))
        summary = parse_summary(json.dumps(content), record.space.state_names, "summary.json")
        records.append(Run(tmp_path / str(seed), summary=summary))
    assert seed_groups(records) == [[0, 1, 2]]
    assert seed_groups(records[: FEWEST_SEEDS - 1]) == []
    logs = np.log(errors[:3])
    low, high = np.exp(stats.t.interval(0.95, 2, logs.mean(), stats.sem(logs)))
    speed, height = spread_tables(records, ["a", "b", "c", "d"])
    cells = "".join(
        f"<td>{text}</td>"
        for text in ("3", f"{stats.gmean(errors[:3]):.4f}", f"{low:.5f} … {high:.4f}", "0.0100", "0.0200")
    )
    assert f'<th scope="row">1</th>{cells}' in speed
    assert "Spread over seeds of the RMSE of height" in height
    assert "Spread over seeds" in comparison_html(records)
