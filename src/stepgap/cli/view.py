"""The verb `stepgap view`."""

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:  # what takes time to import is imported where it is used
    from stepgap.plants.ticks.tick_ring import TickRing


def view(
    run: Path,
    /,
    *,
    deployment: int | None = None,
    host: str = "127.0.0.1",
    port: int | None = None,
    ring: Annotated[str | None, Parameter(show=False)] = None,
) -> None:
    """Show a run in the browser: the robot in 3-D, targets and apexes step by step, what was learnt. Ctrl-C ends it.

    Args:
        run: Folder of a run, also of one that goes on.
        deployment: Shown first; without it the last.
        host: Address that the page is served on; without it, only this machine sees it.
        port: Of the page; without it the first free one from 8080 on.
        ring: Shared memory with the ticks of the run that started this.
    """
    from stepgap.base.errors import InputError
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
            raise InputError(f"--deployment {deployment}: the run has none of that number; it has {known}")
        server = start_server(host, port)
        page = Page(server, source, deployment, live=ring is not None)
        stack.enter_context(terminated_as_interrupted())
        watch(server, page, lambda: ring is None or os.getppid() == parent)


def _attached(ring: str) -> "TickRing":
    from stepgap.base.errors import InputError
    from stepgap.plants.ticks.tick_ring import TickRing

    try:
        return TickRing.attach(ring)
    except (OSError, ValueError):
        raise InputError(f"--ring {ring}: no such ring of ticks; the run that made it is over") from None
