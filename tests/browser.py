"""Chromium for tests: pages may talk to this machine only, and must not complain."""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Locator, Page, expect, sync_playwright

ARTEFACTS = "STEPGAP_TEST_ARTEFACTS"
"""Environment variable with the folder that keeps screenshots; without it, they go where the test's files are."""

PATIENCE = 300_000
"""Longest wait for the browser [ms]; it ends a test that hangs, since a busy machine draws a picture in seconds."""

ROOT_NEEDS = ("--no-sandbox", "--disable-dev-shm-usage")
SOFTWARE_WEBGL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """The Chromium of the system, a new one for each module that imports this; skips where there is none."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no Chromium on this machine (Debian: apt install chromium), so pages are not looked at")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=program, args=[*ROOT_NEEDS, *SOFTWARE_WEBGL], timeout=PATIENCE
        )
        yield browser
        browser.close()


class Watched:
    """A page in the browser, with what it asked for and what it complained of.

    Attributes:
        page: Playwright's.
        complaints: Errors of its console, and exceptions.
        foreign: Requests, of web sockets too, to other machines than this one.
    """

    def __init__(self, browser: Browser, folder: Path):
        self.page: Page = browser.new_page(viewport={"width": 1280, "height": 800})
        self.page.set_default_timeout(PATIENCE)
        expect.set_options(timeout=PATIENCE)
        self.complaints: list[str] = []
        self.foreign: list[str] = []
        self._folder = Path(os.environ.get(ARTEFACTS) or folder)
        self.page.on("console", self._hear)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self._note(request.url))
        self.page.on("websocket", lambda websocket: self._note(websocket.url))

    def keep_screenshot(self, name: str) -> Path:
        """Saves what the page looks like as NAME.png."""
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"{name}.png"
        self.page.screenshot(path=path)
        return path

    def picture_of(self, element: Locator) -> bytes:
        """What is seen of an element, as PNG. A moving one need not come to rest, as for its own `screenshot`."""
        element.wait_for(state="visible")
        box = element.bounding_box()
        assert box is not None
        return self.page.screenshot(clip=box)

    def wait_for_change(self, take_picture: Callable[[], bytes], before: bytes) -> None:
        """Takes pictures until one differs from that of before."""
        deadline = monotonic() + PATIENCE / 1000
        while take_picture() == before:
            assert monotonic() < deadline, "it looks the same as before"

    def close(self) -> None:
        """Closes it and asserts that it behaved."""
        self.page.close()
        assert not self.complaints
        assert not self.foreign

    def _hear(self, message: ConsoleMessage) -> None:
        if message.type == "error":
            self.complaints.append(message.text)

    def _note(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in ("data", "blob", "file") and parts.hostname != "127.0.0.1":
            self.foreign.append(url)


@pytest.fixture
def watched_page(chromium: Browser, tmp_path: Path) -> Iterator[Watched]:
    """A new page; at the end it must have talked to nobody else, and have had no error."""
    watched = Watched(chromium, tmp_path)
    yield watched
    watched.close()
