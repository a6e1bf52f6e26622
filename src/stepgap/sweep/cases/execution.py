"""Execution of the cases of a plan that have no result yet."""

from collections.abc import Callable, Iterable
from concurrent.futures import CancelledError, Executor, Future
from queue import SimpleQueue

from stepgap.base.errors import InputError, StepGapError
from stepgap.sweep.cases.case_folder import CaseFolder
from stepgap.sweep.cases.plan import CaseResult, Compute, Plan, computed, reason_of
from stepgap.sweep.cases.processes import ProcessEnded


class ClusterLost(StepGapError):
    """The scheduler of a cluster has gone."""


def execute(
    plan: Plan,
    folder: CaseFolder,
    numbers: Iterable[int],
    compute: Compute,
    executor: Executor,
    at_once: int,
    on_result: Callable[[int, CaseResult], None] = lambda number, result: None,
) -> None:
    """Claims, computes and stores cases, except those that have a result or that another process has claimed.

    A case that fails has its reason as the result. This function alone writes into the folder; the executor's processes
    get the text of a case and return its result.

    Args:
        plan: Describes the cases.
        folder: Folder of the plan.
        numbers: Cases to execute.
        compute: Computes a case.
        executor: Calls functions, in this or in other processes.
        at_once: Number of cases that the executor has at the same time.
        on_result: Called with the number and the result of every case that is stored.

    Raises:
        OSError: A file cannot be written, here or by the computation of a case.
        ClusterLost: The scheduler of a cluster has gone.
    """
    finished: SimpleQueue[tuple[int, Future[CaseResult]]] = SimpleQueue()
    running = 0

    def store(number: int, result: CaseResult) -> None:
        folder.store(number, result)
        on_result(number, result)

    for number in numbers:
        if not folder.claim(number):
            continue
        try:
            case = plan.case(number)
        except InputError as error:
            store(number, CaseResult(failed=reason_of(error)))
            continue
        executor.submit(computed, compute, case).add_done_callback(
            lambda future, number=number: finished.put((number, future))
        )
        running += 1
        if running == at_once:
            store(*_awaited(finished))
            running -= 1
    for _ in range(running):
        store(*_awaited(finished))


def _awaited(finished: "SimpleQueue[tuple[int, Future[CaseResult]]]") -> tuple[int, CaseResult]:
    """Waits for the next finished case; returns its number and result."""
    number, future = finished.get()
    try:
        return number, future.result()
    except CancelledError:
        raise ClusterLost("the dask scheduler has gone; start it again and continue with --resume") from None
    except ProcessEnded as error:
        return number, CaseResult(failed=reason_of(error))
    except Exception as error:
        if type(error).__name__ == "KilledWorker":  # of distributed.scheduler, which need not be installed
            return number, CaseResult(failed=f"its dask worker ended several times ({reason_of(error)})")
        raise
