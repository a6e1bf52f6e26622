"""Cases on a dask cluster."""

import os
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.base.errors import InputError
from stepgap.base.versions import optional_package

if TYPE_CHECKING:
    from distributed import Client

LOCAL = "local"
"""Name of a cluster on this machine, which is started for the sweep."""

LARGEST_BACKLOG = 2000
"""Number of cases that the scheduler has at the same time; more workers than this would wait."""

_WAIT = 30
"""Longest time until the scheduler answers [s]."""


@contextmanager
def dask_executor(address: str, processes: int) -> Iterator[Executor]:
    """Connects to a dask scheduler; yields an executor whose calls run on its workers.

    Args:
        address: Address of the scheduler, such as tcp://node7:8786, or its scheduler file; `local` starts a scheduler
            and workers on this machine.
        processes: Number of workers of a local cluster.

    Raises:
        InputError: dask.distributed is not installed, or there is no scheduler at the address.
    """
    distributed = optional_package("distributed", "--dask", "cluster")
    with ExitStack() as stack:
        if address == LOCAL:
            options = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "threads_per_worker": 1}
            target = stack.enter_context(distributed.LocalCluster(n_workers=processes, **options))
        else:
            target = address
        yield stack.enter_context(_client(target, address)).get_executor(pure=False)


@contextmanager
def _client(target: object, address: str) -> Iterator["Client"]:
    from distributed import Client

    try:
        if isinstance(target, str) and Path(target).suffix == ".json":
            if not Path(target).is_file():
                raise InputError(f"--dask {address}: no such file; `dask scheduler --scheduler-file` writes it")
            client = Client(scheduler_file=os.fspath(target), timeout=_WAIT)
        else:
            client = Client(target, timeout=_WAIT)
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        wanted = "give its address, such as tcp://127.0.0.1:8786, its scheduler file, or local"
        raise InputError(f"--dask {address}: no scheduler answers ({error!s:.120}); {wanted}") from None
    with client:
        yield client
