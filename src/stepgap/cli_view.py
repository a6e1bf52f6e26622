"""The verb `stepgap view`."""

import os
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


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
    from stepgap.interrupt import terminated_as_interrupted
    from stepgap.plants.tick_ring import TickRing
    from stepgap.strict_toml import InputError
    from stepgap.view.page import Page
    from stepgap.view.source import Source
    from stepgap.view.watch import announce, start_server, watch

    parent = os.getppid()
    try:
        source = Source(run, TickRing.attach(ring) if ring else None)
    except FileNotFoundError:
        raise InputError(f"--ring {ring}: no such shared memory; the run that made it is over") from None
    if deployment is not None and deployment not in source.iterations:
        known = ", ".join(map(str, source.iterations))
        raise InputError(f"--deployment {deployment}: the run has none of that number; it has {known}")
    server = start_server(host, port)
    page = Page(server, source, deployment, live=ring is not None)
    with terminated_as_interrupted():
        announce(server)
        watch(server, page, lambda: ring is None or os.getppid() == parent)
