"""The verb `stepgap view`."""

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from stepgap.base.errors import InputError
from stepgap.cli.options import Address, Integer, Port

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.plants.ticks.tick_ring import TickRing


def view(
    run: Path,
    /,
    *,
    deployment: Integer | None = None,
    host: Address = "127.0.0.1",
    port: Port | None = None,
    ring: Annotated[str | None, Parameter(show=False)] = None,
) -> None:
    """Show a run in the browser, also while it is running: the robot in 3-D, the errors and the learned model.

    Ctrl-C stops the server.

    Args:
        run: Folder of a run, finished or still running.
        deployment: Number of the deployment that is shown first. [default: the last]
        host: Address at which the page is served; only this machine can open the default address.
        port: TCP port of the page. [default: the first free one from 8080 on]
        ring: Shared memory with the ticks of the run that started this process.
    """
    from stepgap.base.signals import terminated_as_interrupted
    from stepgap.view.page import Page
    from stepgap.view.source import Source
    from stepgap.view.watch import start_server, watch

    parent = os.getppid()
    with contextlib.ExitStack() as stack:
        ticks = stack.enter_context(_attached(ring)) if ring else None
        source = Source(run, ticks)
        stack.callback(source.close)
        if deployment is not None and deployment not in source.iterations:
            known = ", ".join(map(str, source.iterations))
            raise InputError(f"--deployment {deployment}: the run has no deployment of this number; it has {known}")
        server = start_server(host, port)
        page = Page(server, source, deployment, live=ring is not None)
        stack.enter_context(terminated_as_interrupted())
        watch(server, page, lambda: ring is None or os.getppid() == parent)


def _attached(ring: str) -> "TickRing":
    from stepgap.plants.ticks.tick_ring import TickRing

    try:
        return TickRing.attach(ring)
    except (OSError, ValueError):
        raise InputError(f"--ring {ring}: there is no such ring of ticks; the run that made it has ended") from None
