"""The page on a real server: access from other machines, and the effects of its buttons."""

import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.view.address import HERE
from stepgap.view.page import Page
from stepgap.view.source import Source
from stepgap.view.watch import start_server, stop_server, watch
from tests.shared_run import STEPS


@pytest.fixture(scope="module")
def source(run_folder: Path) -> Iterator[Source]:
    """A run whose motion is known; pages only read it."""
    source = Source(run_folder)
    for iteration in (0, 1):
        source.want(iteration)
        source.await_motion(iteration)
    yield source
    source.close()


@pytest.fixture
def page(source: Source) -> Iterator[Page]:
    server = start_server(HERE, None)
    yield Page(server, source)
    stop_server(server)


def test_only_this_machine_can_open_it(page: Page) -> None:
    port = page._server.get_port()
    listening = [
        line.split()[1]
        for table in ("/proc/net/tcp", "/proc/net/tcp6")
        if Path(table).exists()
        for line in Path(table).read_text().splitlines()[1:]
        if line.split()[3] == "0A" and line.split()[1].endswith(f":{port:04X}")
    ]
    if not listening:
        pytest.skip("this system does not list listening sockets")
    assert listening == [f"0100007F:{port:04X}"]


def test_it_shows_the_last_deployment_with_the_first_one_overlaid(page: Page) -> None:
    assert (page.iteration, page.overlaid) == (1, 0)
    assert page._deployment.value.startswith("1")
    assert list(page._overlay.options)[1:] == list(page._deployment.options)
    page.update(0.1)
    assert page._ghost._root.visible


def test_it_plays_step_by_step_and_its_charts_grow(page: Page) -> None:
    page.toggle()
    page.update(5.0)
    assert (page.player.step, page.player.share) == (0, 0.0)
    known = []
    for _ in range(1 + STEPS):
        page.one_step()
        page.update(5.0)
        apexes = page._tracking[0]._chart.data[-1]
        known.append((page.player.step, int(np.isfinite(apexes).sum()), page._step.value))
    assert known == [(step, step, step) for step in range(1 + STEPS)]
    assert "Paused" in page._status.content
    assert f"Step {STEPS}" in page._status.content


def test_deployment_overlay_and_speed_can_be_chosen(page: Page) -> None:
    page.choose(0)
    page.update(0.1)
    assert not page._ghost._root.visible, "a deployment is not overlaid on itself"
    page.overlay(1)
    page.update(0.1)
    assert page._ghost._root.visible
    page.overlay(None)
    page.update(0.0)
    assert not page._ghost._root.visible
    page.set_speed("4")
    before = page.player.share
    page.update(0.05)
    duration = page._duration(0)
    assert duration
    assert page.player.share - before == pytest.approx(4 * 0.05 / duration)


def test_the_newest_is_the_last_step_of_the_last_deployment(page: Page) -> None:
    page.choose(0)
    page.follow()
    assert (page.iteration, page.player.step, page.player.follow) == (1, STEPS, True)
    page.update(0.0)
    assert page.player.step == STEPS


def test_ghost_and_robot_begin_a_step_at_the_same_yaw(page: Page) -> None:
    page.player.playing = False
    page.player.show(3)
    page.update(0.0)
    robot, ghost = page._robot._balls["hip"].position, page._ghost._balls["hip"].position
    assert np.arctan2(robot[0], -robot[1]) == pytest.approx(np.arctan2(ghost[0], -ghost[1]), abs=1e-3)


def test_riding_along_the_robot_stays_in_view(page: Page) -> None:
    page.player.playing = False
    page.player.show(STEPS)
    page.update(0.0)
    w, _, _, z = page._world.wxyz
    yaw = 2 * np.arctan2(z, w)
    x, y, _ = page._robot._balls["hip"].position
    assert np.cos(yaw) * x - np.sin(yaw) * y == pytest.approx(0, abs=0.02)


def test_watching_ends_with_the_run_and_frees_the_port(run_folder: Path) -> None:
    with socket.socket() as free:  # a port that no other test takes, unlike the first of the server's own
        free.bind((HERE, 0))
        port = free.getsockname()[1]
    server, source = start_server(HERE, port), Source(run_folder)
    page = Page(server, source)
    running = iter([True, True, False])
    watch(server, page, lambda: next(running))
    source.close()
    again = start_server(HERE, port)
    assert again.get_port() == port
    stop_server(again)


def test_a_port_that_is_taken_is_refused_or_passed_over() -> None:
    with socket.socket() as taken:
        taken.bind((HERE, 0))
        taken.listen()
        with pytest.raises(InputError, match="taken"):
            start_server(HERE, taken.getsockname()[1])


@pytest.mark.parametrize(
    ("host", "port"), [("no.such.host.invalid", None), ("192.0.2.7", None), (HERE, 0), (HERE, 70000)]
)
def test_an_unusable_host_or_port_is_refused(host: str, port: int | None) -> None:
    with pytest.raises(InputError, match=r"--(host|port)"):
        start_server(host, port)
