"""Who may open the page, and which messages it accepts.

A browser lets the page of every site send requests to this computer, and open WebSockets to it. A site may also give
its own name the address of this computer (DNS rebinding). So a request is answered only if it names this computer, by a
name of its own or by any address, and does not come from the page of another origin. A message that is not one of the
page's is not passed on.
"""

import asyncio
import socket
import sys
from collections.abc import Awaitable, Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from http import HTTPStatus
from ipaddress import ip_address
from logging import NullHandler, getLogger
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server as listening
from viser import infra
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode

from stepgap.base.errors import StepGapError

LARGEST_MESSAGE = 2**20  # Largest message to the page [bytes]
CHANGEABLE = {"value"}  # What messages may change of a control

Handler = Callable[[Any], Awaitable[None]]
"""Handles a connection until it is closed."""

_QUIET = getLogger(f"{__name__}.quiet")
_QUIET.addHandler(NullHandler())
_QUIET.propagate = False


def names_here(host: str) -> frozenset[str]:
    """Names by which a server at a host name or address may be opened, besides addresses."""
    own = socket.gethostname().lower()
    return frozenset({"localhost", own, f"{own}.local", socket.getfqdn().lower(), host.lower()})


def is_welcome(hosts: Collection[str], origins: Collection[str], names: Collection[str]) -> bool:
    """Whether a request is answered.

    Args:
        hosts: Values of its header Host; one is needed.
        origins: Values of its header Origin; a program that is no browser sends none.
        names: Names of this computer, besides its addresses.
    """
    if len(hosts) != 1 or len(origins) > 1:
        return False
    try:
        (host,) = (urlsplit(f"//{value}") for value in hosts)
        name = (host.hostname or "").removesuffix(".")
        is_own_page = all(_endpoint(origin) == (name, host.port or urlsplit(origin).scheme) for origin in origins)
    except ValueError:
        return False
    return is_own_page and (name in names or _is_address(name))


def _endpoint(origin: str) -> tuple[str, int | str]:
    """Host and port of an origin; the scheme in place of a port that is not given."""
    parts = urlsplit(origin)
    return (parts.hostname or "").removesuffix("."), parts.port or parts.scheme


def _is_address(name: str) -> bool:
    try:
        return bool(ip_address(name))
    except ValueError:
        return False


def is_known(message: Any) -> bool:
    """Whether a message can be one of the page's: it changes nothing but the value of a control."""
    if not isinstance(message, bytes):
        return False
    try:
        content = infra.Message.deserialize(message)
        return set(getattr(content, "updates", CHANGEABLE)) == CHANGEABLE
    except Exception:  # of any kind: viser does not check what it is sent
        return False


@contextmanager
def guarded(host: str) -> Iterator[None]:
    """Every server of viser that starts within it checks its requests and messages.

    viser has no parameter for this. So the function with which it listens is replaced meanwhile.

    Raises:
        StepGapError: No server has started in the way that can be guarded, as in an unknown version of viser.
    """
    listen = listening.serve
    guards = list[_Guard]()

    def serve(handler: Handler, *place: Any, process_request: Any, **options: Any) -> Any:
        guards.append(_Guard(handler, process_request, names_here(host)))
        options |= {"max_size": LARGEST_MESSAGE, "logger": _QUIET}
        return listen(guards[-1].handle, *place, process_request=guards[-1].process, **options)

    listening.serve = serve  # pyright: ignore[reportAttributeAccessIssue]
    try:
        yield
    finally:
        listening.serve = listen
    if not guards:
        raise StepGapError(
            f"the page cannot be guarded with viser {viser.__version__}; install the version of the lock"
        )


class _Guard:
    """Stands between the network and the two functions of a server.

    Args:
        handler: Handles a connection.
        answer: Answers a request that is no WebSocket.
        names: Names of this computer.
    """

    def __init__(self, handler: Handler, answer: Callable[[Any, Any], Any], names: frozenset[str]):
        self._handler = handler
        self._answer = answer
        self._names = names
        self._said = False

    def process(self, connection: Any, request: Any) -> Any:
        """Answers a request that is not welcome, or of another version of viser, with a refusal."""
        headers = request.headers
        if not is_welcome(headers.get_all("Host"), headers.get_all("Origin"), self._names):
            return connection.respond(HTTPStatus.FORBIDDEN, "Open this page by the address that stepgap printed.\n")
        spoken = ",".join(headers.get_all("Sec-WebSocket-Protocol"))
        if headers.get_all("Upgrade") and f"viser-v{viser.__version__}" not in map(str.strip, spoken.split(",")):
            return connection.respond(HTTPStatus.BAD_REQUEST, "Reload this page: it is of another version.\n")
        return self._answer(connection, request)

    async def handle(self, connection: Any) -> None:
        """Handles a connection, which ends at the first unknown message, without a traceback."""
        asyncio.get_running_loop().set_exception_handler(lambda loop, context: self._say_once())
        receive = connection.recv

        async def received() -> bytes:
            message = await receive()
            if not is_known(message):
                self._say_once()
                await connection.close(CloseCode.UNSUPPORTED_DATA, "not a message of this page")
                return await receive()  # raises that the connection is closed
            return message

        connection.recv = received
        try:
            with suppress(ConnectionClosed):
                await self._handler(connection)
        except Exception:
            self._say_once()

    def _say_once(self) -> None:
        """Says that somebody sends what the page does not understand."""
        if not self._said:
            print(
                "stepgap: warning: the page ignores messages that it does not understand", file=sys.stderr, flush=True
            )
        self._said = True
