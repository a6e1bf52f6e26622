"""The page answers its own pages only, and no message ends it or prints a traceback."""

from collections.abc import Iterator
from contextlib import suppress
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import msgspec
import pytest
import viser
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from stepgap.base.errors import StepGapError
from stepgap.view.access import guarded, is_known, is_welcome, names_here
from stepgap.view.address import HERE
from stepgap.view.page import Page
from stepgap.view.source import Source
from stepgap.view.watch import start_server, stop_server

NAMES = names_here(HERE)
PROTOCOL: Any = [f"viser-v{viser.__version__}"]


@pytest.fixture
def page(run_folder: Path) -> Iterator[Page]:
    source, server = Source(run_folder), start_server(HERE, None)
    yield Page(server, source)
    stop_server(server)
    source.close()


def address(page: Page) -> str:
    return f"{HERE}:{page._server.get_port()}"


def status(page: Page, **headers: str) -> int:
    connection = HTTPConnection(address(page))
    try:
        connection.request("GET", "/", headers=headers)
        return connection.getresponse().status
    finally:
        connection.close()


@pytest.mark.parametrize(
    ("host", "origin", "welcome"),
    [
        ("127.0.0.1:8080", None, True),
        ("localhost:9000", None, True),  # through a tunnel
        ("[::1]:8080", "http://[::1]:8080", True),
        ("192.0.2.7:8080", "http://192.0.2.7:8080", True),
        ("localhost", "http://localhost", True),
        ("LOCALHOST.:8080", "http://localhost:8080", True),
        ("evil.example:8080", None, False),  # DNS rebinding
        ("evil.example:8080", "http://evil.example:8080", False),
        ("127.0.0.1.evil.example", None, False),
        ("127.0.0.1:8080", "http://evil.example", False),
        ("127.0.0.1:8080", "http://127.0.0.1:8081", False),  # another program of this computer
        ("127.0.0.1:8080", "http://localhost:8080", False),
        ("127.0.0.1:8080", "null", False),  # of a file or a sandbox
        ("user@evil.example:8080", None, False),
        ("[::1", None, False),
        ("127.0.0.1:x", "http://127.0.0.1:x", False),
        ("", None, False),
    ],
)
def test_a_request_names_this_computer_and_comes_from_its_own_page(
    host: str, origin: str | None, welcome: bool
) -> None:
    assert is_welcome([host], [] if origin is None else [origin], NAMES) is welcome


def test_a_header_that_is_missing_or_twofold_is_refused() -> None:
    assert not is_welcome([], [], NAMES)
    assert not is_welcome(["localhost", "evil.example"], [], NAMES)
    assert not is_welcome(["localhost"], ["http://localhost", "http://evil.example"], NAMES)


def test_another_site_gets_neither_the_page_nor_its_data(page: Page) -> None:
    assert status(page) == 200
    assert status(page, Host="localhost") == 200
    assert status(page, Host="evil.example") == 403
    assert status(page, Origin="http://evil.example") == 403
    own, url = f"http://{address(page)}", f"ws://{address(page)}"
    for origin in (Origin(own), None):
        with connect(url, subprotocols=PROTOCOL, origin=origin) as client:
            assert client.recv()
    others = [(Origin(name), {}) for name in ("http://evil.example", "null")]
    for origin, headers in (*others, (None, {"Host": "evil.example"})):
        with (
            pytest.raises(InvalidStatus, match="403"),
            connect(url, subprotocols=PROTOCOL, origin=origin, additional_headers=headers),
        ):
            pass
    with pytest.raises(InvalidStatus, match="400"), connect(url):
        pass


def encoded(**content: Any) -> bytes:
    return msgspec.msgpack.encode(content)


def update(control: Any, **updates: Any) -> bytes:
    return encoded(type="GuiUpdateMessage", uuid=control._impl.uuid, updates=updates)


CAMERA = encoded(
    type="ViewerCameraMessage",
    wxyz=(1.0, 0.0, 0.0, 0.0),
    position=(0.0, 0.0, 1.0),
    look_at=(0.0, 0.0, 0.0),
    up_direction=(0.0, 0.0, 1.0),
    fov=1.0,
    near=0.1,
    far=9.0,
    image_height=9,
    image_width=9,
)
"""First message of a browser; before it, its other messages do nothing."""


def test_wrong_messages_end_neither_the_page_nor_its_quiet(page: Page, capfd: pytest.CaptureFixture[str]) -> None:
    controls = (page._deployment, page._overlay, page._step, page._speed, page._ride, page._buttons)
    values = ("nonsense", 10**18, -1, 1e300, float("nan"), None, [1], {"a": 1}, "")
    messages = [
        "text",
        b"",
        b"\x00\xff\xc1",
        b"\x91" * 2000,
        encoded(),
        encoded(type=1),
        encoded(type="Unknown"),
        encoded(type="GuiUpdateMessage"),
        encoded(type="ViewerCameraMessage", wxyz="x"),
        encoded(type="FileTransferStartUpload", source_component_uuid="x"),
        update(page._deployment, sync_cb=1),
        update(page._deployment, value="1", update_cb=()),
        *(update(control, value=value) for control in controls for value in values),
    ]
    url = f"ws://{address(page)}"
    for message in messages:
        with suppress(ConnectionClosed), connect(url, subprotocols=PROTOCOL) as client:
            client.send(CAMERA)
            client.send(message)
            client.send(update(page._ride, value=not page._ride.value))
            client.ping().wait(5)
        page.update(0.01)
    with connect(url, subprotocols=PROTOCOL) as client:
        client.send(CAMERA)
        client.send(update(page._speed, value="4"))
        while page.player.speed != 4.0:
            page.update(0.0)
        assert client.recv()
    out, err = capfd.readouterr()
    assert (out, err) == ("", "stepgap: warning: the page ignores messages that it does not understand\n")


def test_a_message_that_is_too_large_closes_its_connection(page: Page) -> None:
    with connect(f"ws://{address(page)}", subprotocols=PROTOCOL) as client:
        client.send(b"\x00" * (2**20 + 1))
        with pytest.raises(ConnectionClosed, match="1009"):
            list(client)


def test_only_the_value_of_a_control_may_be_changed() -> None:
    assert is_known(encoded(type="GuiUpdateMessage", uuid="x", updates={"value": 1}))
    assert is_known(CAMERA)
    assert not is_known(encoded(type="GuiUpdateMessage", uuid="x", updates={"value": 1, "visible": False}))


def test_a_server_that_is_not_guarded_is_no_page() -> None:
    with pytest.raises(StepGapError, match="cannot be guarded with viser"), guarded(HERE):
        pass
