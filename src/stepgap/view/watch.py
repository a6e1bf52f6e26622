"""The server of the page, which runs until it is ended."""

import errno
import io
import socket
import sys
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from time import monotonic, sleep

from viser import ViserServer

from stepgap.base.errors import InputError
from stepgap.view.access import guarded
from stepgap.view.page import Page

HERE = "127.0.0.1"
"""Host address that only this machine can reach."""

FIRST_PORT, PORTS_TRIED = 8080, 100
"""First port that is tried, and number of ports that are tried."""

FRAME = 1 / 30
"""Time between two frames [s]."""


def start_server(host: str, port: int | None) -> ViserServer:
    """Starts a server on a free port, which answers no page of another site.

    Args:
        host: Host name or address of the network interface.
        port: Port; None for the first free one.

    Raises:
        InputError: Host or port cannot be used.
        StepGapError: This version of viser cannot be guarded.
    """
    with redirect_stdout(io.StringIO()), guarded(host):  # `announce` prints the address
        return ViserServer(host, free_port(host, port), label="StepGap", verbose=False)


def free_port(host: str, port: int | None) -> int:
    """A port on which a server can start.

    Args:
        host: Host name or address of the network interface.
        port: Port; None for the first free one.

    Raises:
        InputError: Host or port cannot be used.
    """
    if port is not None and not 0 < port < 2**16:
        raise InputError(f"--port {port}: it must lie between 1 and 65535")
    for candidate in [port] if port else range(FIRST_PORT, FIRST_PORT + PORTS_TRIED):
        if _is_free(host, candidate):
            return candidate
    tried = f"--port {port}: it is taken" if port else f"ports {FIRST_PORT} to {FIRST_PORT + PORTS_TRIED - 1} are taken"
    raise InputError(f"{tried}; choose another --port")


def _is_free(host: str, port: int) -> bool:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (socket.gaierror, UnicodeError):
        raise InputError(f"--host {host}: no such address; without --host the page is local") from None
    except PermissionError:
        raise InputError(f"--port {port}: no permission; choose a port from 1024 on") from None
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            raise InputError(f"--host {host}: not an address of this machine; 0.0.0.0 means all of them") from None
        return False
    return True


def announce(server: ViserServer) -> None:
    """Prints the address of the page on stderr, and a warning if other machines can open it."""
    host, port = server.get_host(), server.get_port()
    name = f"[{host}]" if ":" in host else host
    print(f"stepgap: open http://{name}:{port} in a browser; Ctrl-C ends it", file=sys.stderr)
    if not (host.startswith("127.") or host in ("localhost", "::1")):
        print(
            f"stepgap: warning: --host {host} opens the page to everyone who can reach this machine, without a "
            "password; they can see the run and press every button, which does not affect the run itself",
            file=sys.stderr,
        )
    sys.stderr.flush()


def watch(server: ViserServer, page: Page, runs: Callable[[], bool] = lambda: True) -> None:
    """Announces the page and updates it until `runs` is false or Ctrl-C is pressed; then stops the server."""
    last = monotonic()
    try:
        with suppress(KeyboardInterrupt):
            announce(server)
            while runs():
                now = monotonic()
                page.update(now - last)
                last = now
                sleep(max(0.0, FRAME - (monotonic() - now)))
    finally:
        stop_server(server)


def stop_server(server: ViserServer) -> None:
    """Stops a server without its messages."""
    with redirect_stdout(io.StringIO()):
        server.stop()
