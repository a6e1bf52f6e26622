"""The page of a sweep: its numbers are those of the table, text stays text, and the same table gives the same bytes."""

import builtins
import re
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from matplotlib.axes import Axes
from matplotlib.container import ErrorbarContainer

from stepgap.experiment.settings import Experiment, experiment_table
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.step import Array
from stepgap.sweep.report.level_figure import level_figure
from stepgap.sweep.report.page import report_sweep
from stepgap.sweep.results_table import RESULTS
from tests.browser import Watched
from tests.browser import chromium as chromium  # fixtures
from tests.browser import watched_page as watched_page
from tests.cli.command_line import Command
from tests.quick_runs import compute_in_a_thread
from tests.report.pages import Page, check_alone, check_same_files
from tests.sweep.report.tables import cases_in, combinations_of, write_results_table

AXES = {
    "twin": range(14),
    "gap.torque_scale": [0.6, 0.8, 1.0],
    "gap.ground_stiffness": [5000.0, 20000.0, 80000.0],
    "learning.residual": ["gp_on_linear", "linear"],
    "seed": [1, 2],
}
SWEEP = """
twins = 14
seeds = [1, 2]
[axes]
"gap.torque_scale" = [0.6, 0.8, 1.0]
"gap.ground_stiffness" = [5000.0, 20000.0, 80000.0]
"learning.residual" = ["gp_on_linear", "linear"]
"""
FAILED = {7: "no command leads to the target at step 3", 400: "case 400: a <b>"}
ABORTED = {10: 2, 11: 2, 12: 1}
HOSTILE = "<img src=http://evil/?x='1' onerror=alert(1)>&\"--></svg></pre><script>alert(2)</script>$\\frac{"


def errors_of(settings: Mapping[str, list[str]], rng: np.random.Generator) -> Array:
    """Errors of three deployments, which depend on torque scale and residual; shape (N, 3, 2)."""
    scale = np.array(settings["gap.torque_scale"], float)
    linear = np.array([name == "linear" for name in settings["learning.residual"]])
    logs = np.stack([-scale, -2 - scale + 0.3 * linear, -2 - scale + 0.3 * linear], axis=1)[:, :, np.newaxis]
    return np.exp(np.log([0.06, 0.02]) + logs + rng.normal(0, 0.1, (len(scale), 3, 2)))


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep with failed and aborted cases, and its report."""
    folder = tmp_path_factory.mktemp("report") / "a sweep & <more>"
    settings, rng = combinations_of(AXES), np.random.default_rng(0)
    hops = {case: 40 + case % 50 for case in range(504) if settings["learning.residual"][case] == "gp_on_linear"}
    write_results_table(folder, settings, errors_of(settings, rng), aborted=ABORTED, hops=hops, failed=FAILED)
    (folder / "experiment.toml").write_text(tomli_w.dumps(experiment_table(Experiment()) | {"seed": 3}))
    (folder / "sweep.toml").write_text(SWEEP)
    for case, name in ((int(worst_case(folder)), "report.html"), (10, "steps.csv")):
        (folder / f"runs/{case:08d}").mkdir(parents=True)
        (folder / f"runs/{case:08d}" / name).touch()
    report_sweep(folder, figures=True)
    return folder


@pytest.fixture(scope="module")
def page(sweep: Path) -> Page:
    return Page(sweep / "report.html")


def worst_case(folder: Path) -> np.int64:
    """Number of the case with the largest last errors."""
    cases = cases_in(folder)
    return cases.numbers[np.nanargmax(cases.last_errors.prod(axis=1))]


def check_page(page: Page, pictures: int) -> None:
    """Asserts that the page stands alone, except for links to the runs below its folder."""
    for _, given in page.tags:
        if "href" in given and not given["href"].startswith("#"):
            assert re.fullmatch(r"runs/\d{8}/(report\.html)?", given.pop("href"))
    check_alone(page, pictures)


def medians_in(panel: Axes) -> list[Array]:
    """Abscissas of the points with bars."""
    return [
        np.asarray(curve[0].get_xdata(), float) for curve in panel.containers if isinstance(curve, ErrorbarContainer)
    ]


def median(values: Array) -> float:
    return float(np.quantile(values, 0.5, method="inverted_cdf"))


def test_the_page_stands_alone(page: Page) -> None:
    check_page(page, 1)
    assert len(page.source) < 1_000_000


def test_the_sentences_agree_with_the_table(sweep: Path, page: Page) -> None:
    cases = cases_in(sweep)
    known = cases.comparable & np.isfinite(cases.first_errors).all(axis=1)
    before, after = (
        [median(column) for column in errors[known].T] for errors in (cases.first_errors, cases.last_errors)
    )
    assert (
        f"502 cases: from deployment 0 to the last one, the median RMSE changed from {before[0]:.4f} m/s in speed and "
        f"{before[1]:.5f} m in height to {after[0]:.5f} m/s in speed and {after[1]:.5f} m in height."
    ) in page.text
    assert "All 504 cases of the sweep are finished, in 1508 rows of the table." in page.text
    assert "Without a result because they failed: 2 cases" in page.text
    assert "In 3 cases (0.6 %) a deployment was aborted by a failed step, in 2 of them the last one." in page.text
    assert f"larger than that of deployment 0 in none of {np.count_nonzero(known)} cases" in page.text


def test_the_tables_show_medians_by_level(sweep: Path, page: Page) -> None:
    (row,) = re.findall(r'<tr><th scope="row">linear</th>(.*?)</tr>', page.source)
    count, speed, height, aborted, steps = re.findall(r"<td>(.*?)</td>", row)
    cases = cases_in(sweep)
    errors = cases.last_errors[(cases.settings["learning.residual"] == "linear") & cases.comparable]
    assert (count, aborted, steps) == ("251", "2", "never")
    assert [float(speed), float(height)] == pytest.approx([median(column) for column in errors.T], rel=1e-2)
    assert '<th scope="row">5000</th>' in page.source


def test_cases_are_linked_to_what_was_kept(sweep: Path) -> None:
    source = (sweep / "report.html").read_text()
    worst = worst_case(sweep)
    assert f'<a href="runs/{worst:08d}/report.html">{worst}</a>' in source
    assert '<a href="runs/00000010/">10</a>' in source
    assert '<th scope="row">11</th>' in source
    assert f"stepgap report runs/{worst:08d}" in source
    assert source.count('href="runs/') == 2


def test_failed_cases_and_settings_are_listed(page: Page) -> None:
    assert "case 400: a <b>" in page.text
    assert '<tr><th scope="row">seed</th><td>3</td><td>0</td></tr>' in page.source
    assert "base of the sweep" in page.text
    assert '<th scope="row">gap.body_mass_scale' not in page.source
    assert "StepGap report of a sweep: a sweep & <more>" in page.text


@pytest.mark.usefixtures("every_format")
def test_the_same_table_gives_the_same_bytes(sweep: Path, tmp_path: Path) -> None:
    again = shutil.copytree(sweep, tmp_path / sweep.name, ignore=shutil.ignore_patterns("figures"))
    report_sweep(again, figures=True)
    check_same_files(again, sweep)
    assert sorted(path.name for path in (again / "figures").iterdir()) == ["levels.pdf", "levels.png"]


def test_points_are_medians(sweep: Path) -> None:
    cases = cases_in(sweep)
    panels = np.array(level_figure(cases, cases.axes, CommandBounds().space().state).axes).reshape(4, 2)
    for points, errors in zip(medians_in(panels[1, 1]), (cases.first_errors, cases.last_errors), strict=True):
        of_levels = [errors[cases.axes[1].codes == level, 1] for level in range(3)]
        np.testing.assert_allclose(points, [median(values[np.isfinite(values)]) for values in of_levels])
    assert panels[1, 0].get_ylabel() == "gap.torque_scale"
    assert panels[-1, 1].get_xlabel() == "RMSE of height [m]"
    assert [text.get_text() for text in panels[3, 0].get_yticklabels()] == ["gp_on_linear", "linear"]


@pytest.mark.usefixtures("drawn_page", "unplaced")
def test_an_unfinished_sweep_says_so(tmp_path: Path) -> None:
    settings = {name: texts[:100] for name, texts in combinations_of(AXES).items()}
    folder = write_results_table(tmp_path, settings, errors_of(settings, np.random.default_rng(0)))
    written = report_sweep(folder)
    assert "without a valid sweep.toml the number of planned cases is not known" in Page(written.path).text
    assert written.missing == ("settings (the folder contains no experiment.toml)",)
    (folder / "sweep.toml").write_text(SWEEP)
    page = Page(report_sweep(folder).path)
    check_page(page, 1)
    assert "not finished: the table has 300 rows of 100 of its 504 cases (19.8 %)" in page.text
    assert "No deployment was aborted by a failed step." in page.text


@pytest.mark.parametrize("count", [1, 2, 9])
def test_few_cases_have_a_page(tmp_path: Path, count: int) -> None:
    settings = {"a": [str(row % 2) for row in range(count)], "seed": list(map(str, range(count)))}
    folder = write_results_table(tmp_path, settings, np.random.default_rng(0).uniform(1, 2, (count, 2, 2)))
    page = Page(report_sweep(folder).path)
    check_page(page, 0 if count == 1 else 1)
    assert f"{count} case" in page.text


def test_all_cases_failed(tmp_path: Path) -> None:
    settings = combinations_of({"a": range(30), "seed": [0]})
    failed = {case: f"reason {case}" for case in range(30)}
    page = Page(report_sweep(write_results_table(tmp_path, settings, np.ones((30, 1, 2)), failed=failed)).path)
    check_page(page, 0)
    assert "None of the 30 cases in the table has a result: all failed." in page.text
    assert "The first 20 failed cases; 10 more failed" in page.text
    assert "reason 19" in page.text
    assert "reason 20" not in page.text


def test_all_cases_are_aborted(tmp_path: Path) -> None:
    settings = combinations_of({"a": range(3), "seed": range(10)})
    folder = write_results_table(tmp_path, settings, np.ones((30, 2, 2)), aborted=dict.fromkeys(range(30), 1))
    page = Page(report_sweep(folder).path)
    check_page(page, 0)
    assert "30 cases, but no error of a last deployment is known." in page.text
    assert "In 30 cases (100.0 %) a deployment was aborted by a failed step, in 30 of them the last one." in page.text
    assert "Cases whose last deployment was aborted (the first 10 of 30)" in page.text


def test_deployment_0_alone(tmp_path: Path) -> None:
    settings = combinations_of({"a": range(3), "seed": range(10)})
    errors = np.random.default_rng(0).uniform(1, 2, (30, 1, 1))
    page = Page(report_sweep(write_results_table(tmp_path, settings, errors, names=("x",))).path)
    check_page(page, 1)
    assert f"30 cases: the median RMSE of the last deployment is {median(errors.ravel()):.2f} in x." in page.text
    assert "before learning" not in page.source


def test_what_is_not_tracked_is_left_out(package: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    compute_in_a_thread(monkeypatch)
    Path("targets.csv").write_text("speed,height\n" + "0.2,0.58\n0.25,0.59\n" * 4)
    Path("e.toml").write_text("robot = 'pitching'\nreference = 'targets.csv'\n[learning]\niterations = 1\n")
    Path("s.toml").write_text("base = 'e.toml'\nseeds = [1, 2]\n[axes]\n'weights.height' = [0.5, 2]\n")
    result = stepgap("sweep", "s.toml", "--out", "out", "--quiet", "--processes", "1")
    assert result.code == 0, result.err
    page = Page(Path("out/report.html"))
    assert "4 cases: from deployment 0 to the last one, the median RMSE changed from " in page.text
    for name, shown in (("speed [m/s]", True), ("height [m]", True), ("pitch [rad]", False), ("pitch_rate", False)):
        assert (f"last RMSE of {name}" in page.text) == shown, name
    assert "pitch" not in page.text.partition("Settings that no axis changes")[0].replace("pitching", "")


def test_only_the_first_settings_are_drawn(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    settings = {f"s{row:02d}": list(map(str, rng.integers(0, 2, 200))) for row in range(10)}
    errors = np.exp(rng.normal(0, 0.3, (200, 2, 2)))
    page = Page(report_sweep(write_results_table(tmp_path, {**settings, "seed": ["0"] * 200}, errors)).path)
    assert "The figure shows the first 8 settings, not: s08, s09." in page.text


@pytest.mark.usefixtures("drawn_page")
def test_hostile_text_stays_text(tmp_path: Path) -> None:
    text = HOSTILE.replace("\n", "")
    axes = {text: [f"{text}{row}" for row in range(3)], "名\u202e": ["\x1b[31m", "$x"], "seed": range(6)}
    settings = combinations_of(axes)
    folder = write_results_table(
        tmp_path / "<b>",
        settings,
        np.random.default_rng(0).uniform(1, 2, (36, 2, 2)),
        failed={3: text * 3},
        aborted={4: 1},
    )
    (folder / "experiment.toml").write_text(f"robot = '''{text}'''\n")
    (tmp_path / "precious").write_text("precious")
    (folder / "report.html.partial").symlink_to(tmp_path / "precious")
    page = Page(report_sweep(folder, figures=True).path)
    check_page(page, 1)
    assert page.text.count(text) > 10
    assert (tmp_path / "precious").read_text() == "precious"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["<b>", "precious"]
    for path in (folder / "figures").iterdir():
        assert re.fullmatch(r"[a-z0-9_-]+\.(pdf|png)", path.name)


@pytest.mark.parametrize("name", [HOSTILE.replace("\n", "").replace(",", ""), "../../x"])
def test_a_state_whose_name_is_no_identifier_is_refused(tmp_path: Path, name: str) -> None:
    settings = combinations_of({"x": ["1", "2"], "seed": range(2)})
    folder = write_results_table(tmp_path, settings, np.ones((4, 2, 2)))
    table = (folder / "results.csv").read_text()
    (folder / "results.csv").write_text(table.replace("_speed", f"_{name}"))
    with pytest.raises(ValueError, match=r"results\.csv"):
        report_sweep(folder)


@pytest.mark.usefixtures("made_figures")
def test_no_matplotlib_is_needed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    imported = builtins.__import__

    def without(name: str, *rest: object) -> object:
        if name.startswith("matplotlib"):
            raise ImportError("libfreetype.so.6: cannot open shared object file")
        return imported(name, *rest)  # pyright: ignore[reportArgumentType]

    settings = combinations_of({"a": range(3), "seed": range(10)})
    folder = write_results_table(tmp_path, settings, np.random.default_rng(0).uniform(1, 2, (30, 2, 2)))
    monkeypatch.setattr(builtins, "__import__", without)
    page = Page(report_sweep(folder).path)
    check_page(page, 0)
    assert page.text.count("could be drawn (ImportError: libfreetype.so.6") == 1
    assert not (folder / "figures").exists()


def test_nothing_is_written_for_a_bad_table(sweep: Path, tmp_path: Path) -> None:
    whole = (sweep / RESULTS).read_text()
    for damaged in (whole[: len(whole) // 2], "", "a,b\n1,2\n", whole.replace("\n1,", "\n-1,")):
        (tmp_path / RESULTS).write_text(damaged)
        with pytest.raises(ValueError, match=rf"^{re.escape(str(tmp_path / RESULTS))}[^\n]+$"):
            report_sweep(tmp_path)
        assert [path.name for path in tmp_path.iterdir()] == [RESULTS]


def test_the_browser_shows_the_page(sweep: Path, watched_page: Watched) -> None:
    watched_page.page.goto((sweep / "report.html").resolve().as_uri())
    watched_page.keep_screenshot("sweep_report")
    assert watched_page.page.locator("figure svg").count() == 1
    width = watched_page.page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth")
    assert width == 0, "the page must not scroll sideways"
