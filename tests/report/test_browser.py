"""The report in a headless Chromium: it makes no request, has no error, and its replay can be scrubbed."""

import json
import re
from functools import partial
from pathlib import Path

import pytest
from playwright.sync_api import expect

from stepgap.experiment.run import Run
from stepgap.records.motion_file import Replay
from tests.browser import Watched
from tests.browser import chromium as chromium  # fixtures
from tests.browser import watched_page as watched_page
from tests.control.maps import LossyHopper
from tests.quick_runs import leave_out_files_of_figures
from tests.report.runs import SCENE, make_run, motion, report_of

pytestmark = pytest.mark.usefixtures("chromium")  # skips without it before anything is made for the browser


@pytest.fixture(scope="module")
def fallen(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of two deployments, of which the first one fell in its fourth step and has a replay."""
    folder = make_run(tmp_path_factory.mktemp("fallen") / "run", 1, lasts=(3,))
    with pytest.MonkeyPatch.context() as patch:
        leave_out_files_of_figures(patch)
        return report_of(folder, replay=Replay({0: motion(400)}, SCENE), space=LossyHopper().space)


def test_the_replay_scrubs_and_plays(run_folder: Path, watched_page: Watched) -> None:
    page = watched_page.page
    page.goto((run_folder / "report.html").resolve().as_uri())
    slider, canvas, moment = (page.locator(f"#replay-{name}") for name in ("slider", "canvas", "moment"))
    slider.scroll_into_view_if_needed()
    expect(moment).to_contain_text("deployment")
    last = int(slider.get_attribute("max") or 0)
    assert last > 0
    take_picture = partial(watched_page.picture_of, canvas)
    before, text = take_picture(), moment.inner_text()
    slider.fill(str(last // 2))
    expect(moment).not_to_have_text(text)
    watched_page.wait_for_change(take_picture, before)
    legend = page.locator(".signal-legend", has_text="torque of motor 1")
    expect(legend).to_contain_text("N·m")
    curves = page.locator("#replay-signals canvas").last
    take_picture = partial(watched_page.picture_of, curves)
    curves.scroll_into_view_if_needed()
    before = take_picture()
    slider.fill(str(last // 2 + 5))
    watched_page.wait_for_change(take_picture, before)
    slider.scroll_into_view_if_needed()
    watched_page.keep_screenshot("report_replay")

    slider.fill("0")
    page.locator("#replay-play").click()
    expect(page.locator("#replay-play")).to_have_text("Pause")
    expect(slider).not_to_have_value("0")


def test_all_of_it_is_printed_on_few_pages(run_folder: Path, watched_page: Watched) -> None:
    page = watched_page.page
    page.goto((run_folder / "report.html").resolve().as_uri())
    closed = page.locator("details:not([open])")
    expect(closed).to_have_count(1)
    opened = "document.querySelectorAll('details[open]').length"
    page.evaluate(f"addEventListener('beforeprint', () => {{ window.open_in_print = {opened} }})")
    printed = page.pdf(prefer_css_page_size=True)
    assert page.evaluate("window.open_in_print") == 1
    expect(closed).to_have_count(1)
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", printed)) <= 12
    widest = (
        "Math.max(...[...document.querySelectorAll('table, svg, pre')].map(each => each.getBoundingClientRect().right))"
    )
    page.emulate_media(media="print")
    page.set_viewport_size(
        {"width": 710, "height": 1000}
    )  # 188 mm, an A4 page between its margins, at 96 pixels an inch
    assert page.evaluate(widest) <= 710, "nothing is cut off at the edge of the paper"


def test_a_fall_is_described_as_one(fallen: Path, watched_page: Watched) -> None:
    page = watched_page.page
    page.goto(fallen.resolve().as_uri())
    watched_page.keep_screenshot("report")
    page.locator("#replay-slider").fill("399")
    moment = page.locator("#replay-moment")
    expect(moment).to_contain_text("deployment 0, 3.99 s of 3.99 s: step 4 of 4.")
    expect(moment).to_contain_text("; reached no end of the step; command")
    watched_page.keep_screenshot("report_fall")


def test_values_are_shown_at_the_pointer(fallen: Path, watched_page: Watched) -> None:
    page = watched_page.page
    page.goto(fallen.resolve().as_uri())
    figure = page.locator("figure[data-hover]").first
    figure.scroll_into_view_if_needed()
    (panel, *_) = json.loads(figure.get_attribute("data-hover") or "")
    label, *values = next(curve for curve in panel["curves"] if curve[0].startswith("deployment 1"))
    steps, speeds = map(str.split, values)
    (left, top, right, bottom), frame = panel["box"], figure.locator("svg").bounding_box()
    assert frame is not None
    across, up = (
        (float(value) - low) / (high - low)
        for value, (low, high, *_) in ((steps[20], panel["x"]), (speeds[20], panel["y"]))
    )
    x = frame["x"] + frame["width"] * (left + (right - left) * across)
    y = frame["y"] + frame["height"] * (bottom - (bottom - top) * up)
    page.mouse.move(x, y)
    expect(page.locator(".hover-note")).to_have_text(f"{label}\nStep: {steps[20]}\nSpeed [m/s]: {speeds[20]}")
    assert speeds == [f"{speed:.4g}" for speed in Run(fallen.parent).steps.of_iteration(1).next_state[:, 0]]
    page.mouse.move(1, 1)
    expect(page.locator(".hover-note")).to_be_hidden()
