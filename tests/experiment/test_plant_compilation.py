"""The process that compiles a plant: it is started only if there is something to compile, and never left behind."""

from multiprocessing.process import BaseProcess
from types import SimpleNamespace
from typing import Any

import pytest

from stepgap.base.compiled import generic
from stepgap.base.start_method import process_context
from stepgap.experiment import plants
from stepgap.experiment.plants import plant_compiled_beside
from stepgap.experiment.settings import Experiment
from stepgap.robots.hopper.robot import Hopper

SETTINGS = Experiment(Hopper())


@pytest.fixture(autouse=True)
def started(monkeypatch: pytest.MonkeyPatch) -> list[BaseProcess]:
    """The processes that were made on a machine with two cores."""
    made = list[BaseProcess]()

    def make(**arguments: Any) -> BaseProcess:
        made.append(process_context().Process(**arguments))
        return made[-1]

    monkeypatch.setattr(plants, "usable_cores", lambda: 2)
    monkeypatch.setattr(plants, "process_context", lambda: SimpleNamespace(Process=make))
    return made


def compile_something() -> None:
    assert generic(lambda number: number + 1)(2) == 3


def test_it_compiles_while_this_process_compiles_and_is_awaited(started: list[BaseProcess]) -> None:
    with plant_compiled_beside(SETTINGS):
        assert not started
        compile_something()
        compile_something()
    (other,) = started
    assert other.exitcode == 0


def test_it_is_stopped_with_this_process(started: list[BaseProcess]) -> None:
    def interrupted() -> None:
        with plant_compiled_beside(SETTINGS):
            compile_something()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    (other,) = started
    assert not other.is_alive()


def test_it_does_not_exist_without_a_plant_a_core_or_a_cache(
    started: list[BaseProcess], monkeypatch: pytest.MonkeyPatch
) -> None:
    with plant_compiled_beside(Experiment(Hopper(), plant="ethercat", rig="rig.toml")):
        compile_something()
    for name, value in (("usable_cores", lambda: 1), ("cache_folder", lambda: None)):
        with monkeypatch.context() as patch:
            patch.setattr(plants, name, value)
            with plant_compiled_beside(SETTINGS):
                compile_something()
    assert not started


def test_what_it_cannot_do_is_left_to_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise OSError("no more processes")

    monkeypatch.setattr(plants, "process_context", fail)
    with plant_compiled_beside(SETTINGS):
        compile_something()
