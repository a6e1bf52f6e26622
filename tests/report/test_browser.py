"""The report in a headless Chromium: it makes no request, has no error, and its replay can be scrubbed."""

from functools import partial
from pathlib import Path

import pytest
from playwright.sync_api import expect

from stepgap.report import RunContext
from stepgap.report.motion import Replay
from tests.browser import Watched
from tests.browser import chromium as chromium  # fixtures
from tests.browser import watched_page as watched_page
from tests.report.runs import SCENE, make_run, motion, report_of
from tests.view.conftest import run_folder as run_folder


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
    watched_page.keep_screenshot("report_replay")

    slider.fill("0")
    page.locator("#replay-play").click()
    expect(page.locator("#replay-play")).to_have_text("Pause")
    expect(slider).not_to_have_value("0")
    page.evaluate("scrollTo(0, 0)")
    watched_page.keep_screenshot("report")


@pytest.mark.usefixtures("drawn_page")
def test_a_fall_is_described_as_one(tmp_path: Path, watched_page: Watched) -> None:
    folder = make_run(tmp_path / "run", 0, lasts=(3,))
    replay = Replay({0: motion(400)}, SCENE)
    page = watched_page.page
    page.goto(report_of(folder, RunContext(replay=replay)).resolve().as_uri())
    page.locator("#replay-slider").fill("399")
    moment = page.locator("#replay-moment")
    expect(moment).to_contain_text("deployment 0, 3.99 s of 3.99 s: step 4 of 4.")
    expect(moment).to_contain_text("; reached no end of the step; command")
    watched_page.keep_screenshot("report_fall")
