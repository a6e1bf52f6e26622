"""Computation of the cases of a plan: by processes of this machine, or on a dask cluster."""

import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from multiprocessing import connection
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from time import sleep
from typing import Any, final

from stepgap.base.errors import InputError, StepGapError
from stepgap.base.start_method import process_context
from stepgap.base.versions import optional_package
from stepgap.sweep.cases.case_folder import CaseFolder
from stepgap.sweep.cases.plan import CaseResult, Compute, Plan, computed, reason_of

LOCAL = "local"  # Name of a dask cluster on this machine, which is started for the cases

LARGEST_BACKLOG = 1000
"""Number of cases that a dask scheduler has at the same time; more workers than this would wait."""

GRACE = 5.0  # Time that a process has to end by itself [s]
_SCHEDULER_WAIT = 30  # Longest time until a dask scheduler answers [s]


class ClusterLost(StepGapError):
    """The scheduler of a cluster has gone."""


class ProcessEnded(StepGapError):
    """The process of a call ended before the call."""


def execute(
    plan: Plan,
    folder: CaseFolder,
    numbers: Iterable[int],
    compute: Compute,
    executor: Executor,
    at_once: int,
    on_result: Callable[[int, CaseResult], None] = lambda number, result: None,
) -> None:
    """Computes and stores cases; one that fails, or ends its process, has the reason as its result.

    This function alone writes into the folder; the executor's processes get the data of a case and return its result.

    Args:
        numbers: Cases to compute.
        executor: Calls functions, in this or in other processes.
        at_once: Number of cases that the executor has at the same time.
        on_result: Called with the number and the result of every case that is stored.

    Raises:
        OSError: A file cannot be written, here or by the computation of a case.
        ClusterLost: The scheduler of a cluster has gone.
    """
    waiting = iter(numbers)
    running: dict[Future[CaseResult], int] = {}

    def store(number: int, result: CaseResult) -> None:
        folder.store(number, result)
        on_result(number, result)

    while True:
        begun = list(islice(waiting, at_once - len(running)))
        for number in begun:
            try:
                running[executor.submit(computed, compute, plan.case(number))] = number
            except InputError as error:
                store(number, CaseResult(failed=reason_of(error)))
        if running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                store(running.pop(future), _result_of(future))
        elif not begun:
            return


def _result_of(future: "Future[CaseResult]") -> CaseResult:
    try:
        return future.result()
    except CancelledError:
        raise ClusterLost("the dask scheduler has gone; start it again and continue with --resume") from None
    except ProcessEnded as error:
        return CaseResult(failed=reason_of(error))
    except Exception as error:
        if type(error).__name__ == "KilledWorker":  # of distributed.scheduler, which need not be installed
            return CaseResult(failed=f"its dask worker ended several times ({reason_of(error)})")
        raise


@final
class Processes(Executor):
    """An executor whose calls fail one by one: each of its processes is a pool of one, replaced when it has ended.

    A pool of several would give up all calls when one process ends, such as by a crash in compiled code or for lack of
    memory. No process outlives this one.
    """

    def __init__(self, count: int):
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="case")
        self._listener, self._lifeline = process_context().Pipe(duplex=False)
        self._pools: SimpleQueue[ProcessPoolExecutor] = SimpleQueue()
        for _ in range(count):
            self._pools.put(self._new_pool())

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(1, process_context(), _end_with_lifeline, (self._listener,))

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Calls a function of a module in one of the processes.

        The future raises the function's error, or `ProcessEnded`.
        """
        return self._threads.submit(self._call, fn, args, kwargs)

    def _call(self, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        pool = self._pools.get()
        try:
            return pool.submit(fn, *args, **kwargs).result()
        except BrokenProcessPool:
            pool = self._new_pool()
            cause = "by a crash of compiled code or for lack of memory"
            raise ProcessEnded(f"its process ended, such as {cause}") from None
        finally:
            self._pools.put(pool)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes: with `wait` after all calls, otherwise at once, so that unfinished calls fail."""
        if not wait:
            self._lifeline.close()
        self._threads.shutdown(wait=True, cancel_futures=cancel_futures or not wait)
        while not self._pools.empty():
            self._pools.get().shutdown(wait=True)
        self._lifeline.close()
        self._listener.close()


def _end_with_lifeline(listener: connection.Connection) -> None:
    """Begins a process that ends, even during a call, when the other end of a pipe is closed or its process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes of a terminal; the first one decides
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that a call removes its temporary files

    def listen() -> None:
        connection.wait([listener])
        os.kill(os.getpid(), signal.SIGTERM)
        sleep(GRACE)
        os._exit(1)

    Thread(target=listen, daemon=True).start()


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
    if address == LOCAL:
        options = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0", "threads_per_worker": 1}
        with distributed.LocalCluster(n_workers=processes, **options) as cluster, distributed.Client(cluster) as client:
            yield client.get_executor(pure=False)
        return
    target = {"address": address}
    if Path(address).suffix == ".json":
        if not Path(address).is_file():
            raise InputError(f"--dask {address}: no such file; `dask scheduler --scheduler-file` writes it")
        target = {"scheduler_file": address}
    try:
        client = distributed.Client(**target, timeout=_SCHEDULER_WAIT)
    except (OSError, ValueError) as error:
        remedy = "give its address, such as tcp://127.0.0.1:8786, its scheduler file, or local"
        raise InputError(f"--dask {address}: no scheduler answers ({error!s:.120}); {remedy}") from None
    with client:
        yield client.get_executor(pure=False)
