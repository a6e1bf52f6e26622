"""The page in a headless Chromium: it contacts no other machine, has no error, and its buttons work."""

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from threading import Event, Thread

import pytest
from playwright.sync_api import FloatRect, ViewportSize, expect

from stepgap.view.address import HERE
from stepgap.view.page import Page
from stepgap.view.source import Source
from stepgap.view.watch import start_server, watch
from tests.browser import Watched
from tests.browser import chromium as chromium  # fixtures
from tests.browser import watched_page as watched_page
from tests.shared_run import STEPS

SMALL: ViewportSize = {"width": 800, "height": 500}
"""Without a graphics card the processor computes every pixel of the scene, in every frame."""


ROBOT: FloatRect = {"x": 100, "y": 190, "width": 250, "height": 110}
"""Part of the small window that shows only the scene, with the leg in the middle."""


pytestmark = pytest.mark.usefixtures("chromium")  # skips without it before anything is made for the browser


@pytest.fixture
def served(run_folder: Path) -> Iterator[str]:
    """Address of the page of a run."""
    server, over = start_server(HERE, None), Event()
    source = Source(run_folder)
    page = Page(server, source)
    page.toggle()
    thread = Thread(target=watch, args=(server, page, lambda: not over.is_set()))
    thread.start()
    yield f"http://{HERE}:{server.get_port()}"
    over.set()
    thread.join()
    source.close()


def test_the_page(served: str, watched_page: Watched) -> None:
    page = watched_page.page
    page.set_viewport_size(SMALL)
    page.goto(served)
    body = page.locator("body")
    expect(body).to_contain_text("The robot is released.")
    robot = partial(page.screenshot, clip=ROBOT)
    held = robot()
    page.get_by_text("One step", exact=True).click()  # the hop of the release
    expect(body).to_contain_text("The robot has been released.")
    expect(body).to_contain_text("Paused.")
    page.get_by_text("One step", exact=True).click()
    expect(body).to_contain_text("Step 1")
    expect(body).to_contain_text("Paused.")
    watched_page.wait_for_change(robot, held)  # the robot has moved
    watched_page.keep_screenshot("view_tracking")

    expect(page.locator(".uplot:visible").first).to_be_visible()

    choose(watched_page, "Deployment", "0: nominal map")
    expect(body).to_contain_text("The robot is released.")
    choose(watched_page, "Overlay", "1: corrected map")
    choose(watched_page, "Speed", "16")
    page.get_by_text("Pause / play").click()
    expect(body).to_contain_text(re.compile(f"Step {STEPS}"))
    watched_page.keep_screenshot("view_uncorrected")


def choose(watched: Watched, label: str, option: str) -> None:
    """Picks an option of a dropdown."""
    watched.page.get_by_label(label, exact=True).first.click()
    watched.page.get_by_role("option", name=option, exact=True).click()
