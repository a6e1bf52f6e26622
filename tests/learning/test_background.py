"""A deferred value is computed once, and does not depend on the thread that computes it."""

from threading import Event, get_ident

import pytest

from stepgap.learning.background import BackgroundThread, Deferred


def test_it_is_computed_once_and_only_when_needed() -> None:
    calls: list[int] = []

    def compute() -> int:
        calls.append(1)
        return 3

    deferred = Deferred(compute)
    doubled = deferred.then(lambda value: 2 * value)
    assert not calls
    assert (doubled.result(), deferred.result(), doubled.result()) == (6, 3, 6)
    assert len(calls) == 1


def test_a_thread_computes_it_while_this_one_continues() -> None:
    started, may_end, threads = Event(), Event(), []

    def compute() -> int:
        started.set()
        assert may_end.wait(timeout=60)
        threads.append(get_ident())
        return 4

    with BackgroundThread() as background:
        deferred = Deferred(compute)
        background.compute(deferred)
        background.compute(deferred.then(lambda value: value + 1))
        background.compute(None)
        assert started.wait(timeout=60)
        may_end.set()
        assert deferred.then(lambda value: value + 2).result() == 6
    (thread,) = threads
    assert thread != get_ident()


def test_an_error_in_the_thread_is_raised_where_the_value_is_needed() -> None:
    def compute() -> int:
        raise ArithmeticError("no such fit")

    deferred = Deferred(compute)
    with BackgroundThread() as background:
        background.compute(deferred)
    with pytest.raises(ArithmeticError, match="no such fit"):
        deferred.result()
