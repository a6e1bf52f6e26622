"""The server of the page, which runs until it is ended."""

import io
import sys
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from time import monotonic, sleep

from viser import ViserServer

from stepgap.view.access import guarded
from stepgap.view.address import free_port
from stepgap.view.page import Page

FRAME = 1 / 30  # Time between two frames [s]
UNSEEN = 0.5  # The same while no browser shows the page; a run in progress is still read [s]


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


def announce(server: ViserServer) -> None:
    """Prints the address of the page on stderr, and a warning if other machines can open it."""
    host = server.get_host()
    port = server.get_port()
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
                period = FRAME if server.get_clients() else UNSEEN
                sleep(max(0.0, period - (monotonic() - now)))
    finally:
        stop_server(server)


def stop_server(server: ViserServer) -> None:
    """Stops a server without its messages."""
    with redirect_stdout(io.StringIO()):
        server.stop()
