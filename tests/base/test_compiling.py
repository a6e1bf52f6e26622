"""Signals while code is compiled."""

import signal
from collections.abc import Callable

import numba
import pytest
from numba.core.event import Event, Listener, install_listener

from stepgap.base import compiling
from stepgap.base.compiling import on_compilation, signals_between_passes
from stepgap.base.signals import handled


class _SignalInAPass(Listener):
    """Raises a signal at the start of one pass, and notes when it was handled."""

    def __init__(self, number: signal.Signals):
        self.number, self.passes = number, 0

    def on_start(self, event: Event) -> None:  # noqa: ARG002
        self.passes += 1
        if self.passes == 3:
            signal.raise_signal(self.number)

    def on_end(self, event: Event) -> None:
        """Does nothing."""


def _new_function() -> Callable[[float], float]:
    @numba.njit
    def doubled(x: float) -> float:
        return 2 * x

    return doubled


def test_ctrl_c_while_a_function_is_compiled_comes_after_the_pass_and_the_next_compilation_works() -> None:
    doubled, listener = _new_function(), _SignalInAPass(signal.SIGINT)
    before = signal.getsignal(signal.SIGINT)
    with signals_between_passes(), pytest.raises(KeyboardInterrupt), install_listener("numba:run_pass", listener):
        doubled(1.0)
    assert listener.passes == 3
    assert signal.getsignal(signal.SIGINT) is before
    assert doubled(2.0) == 4


def test_a_signal_whose_handler_goes_on_does_not_end_the_compilation() -> None:
    doubled, listener, seen = _new_function(), _SignalInAPass(signal.SIGTERM), []
    note = handled(lambda number, _: seen.append((number, listener.passes)))
    with signals_between_passes(), note, install_listener("numba:run_pass", listener):
        assert doubled(1.0) == 2
    assert seen == [(signal.SIGTERM, 3)]


def test_compilation_is_reported_from_time_to_time(monkeypatch: pytest.MonkeyPatch) -> None:
    reports: list[int] = []
    for interval, expected in ((0.0, [0, 1, 2]), (1e9, [0])):
        monkeypatch.setattr(compiling, "REPORT_INTERVAL", interval)
        with on_compilation(lambda functions, _: reports.append(functions)):
            for _ in range(2):
                _new_function()(1.0)
        assert reports == expected
        reports.clear()
