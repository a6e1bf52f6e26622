"""The verb `stepgap view`."""

import contextlib
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from stepgap.base.errors import InputError
from stepgap.cli.options import Address, Integer, Overrides, Port
from stepgap.cli.terminal import announces_compilation, warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.plants.ticks.tick_ring import TickRing


@announces_compilation
def view(
    run: Path | None = None,
    /,
    *,
    deployment: Integer | None = None,
    host: Address = "127.0.0.1",
    port: Port | None = None,
    ring: Annotated[str | None, Parameter(show=False)] = None,
    overrides: Overrides = None,
) -> None:
    """Show a run in the browser, also while it is running: the robot in 3-D, and the errors.

    Without a run, as in --robot NAME, some steps of the robot are simulated and shown. Ctrl-C stops the server.

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
        if run is None:
            run = Path(stack.enter_context(TemporaryDirectory()))
            _simulate(overrides, run)
        elif overrides:
            raise InputError(f"{run}, --{overrides[0][0]}: a run is shown with its own settings; give only one of them")
        source = Source(run, ticks)
        stack.callback(source.close)
        if deployment is not None and deployment not in source.iterations:
            existing = ", ".join(map(str, source.iterations))
            raise InputError(f"--deployment {deployment}: the run has no deployment of this number; it has {existing}")
        server = start_server(host, port)
        page = Page(server, source, deployment, live=ring is not None)
        stack.enter_context(terminated_as_interrupted())
        watch(server, page, lambda: ring is None or os.getppid() == parent)


def _simulate(overrides: Overrides, folder: Path) -> None:
    """Simulates some steps of a robot, without a correction, into a folder."""
    from stepgap.cli.nominal import kept_surrogate, nominal_with_progress
    from stepgap.control.limit_cycle import held_reference
    from stepgap.experiment.inputs import load_reference, trial_reference
    from stepgap.experiment.settings import read_experiment
    from stepgap.experiment.trial import trial_run

    if not overrides:
        raise InputError("give the folder of a run, or a robot by --robot NAME")
    settings = read_experiment(None, overrides)
    if not settings.simulated:
        raise InputError(f"plant '{settings.plant}' is no simulation; the view shows its runs, or a simulated robot")
    nominal = nominal_with_progress(settings)
    if path := kept_surrogate(nominal):
        warn(f"the simulated steps of the surrogate are kept: --nominal.file {path}")
    reference = load_reference(settings, settings.space)
    held = held_reference(nominal.map, reference)
    if held is None:
        raise InputError(f"robot '{settings.robot.name}': no target is held; stepgap check shows what is wrong")
    if held is not reference:
        warn("some targets of the reference are not held; the nearest held states take their place")
    trial_run(settings, nominal, trial_reference(settings, held), folder)


def _attached(ring: str) -> "TickRing":
    from stepgap.plants.ticks.tick_ring import TickRing

    try:
        return TickRing.attach(ring)
    except (OSError, ValueError):
        raise InputError(f"--ring {ring}: there is no such ring of ticks; the run that made it has ended") from None
