"""Objects that existed before the block are not visited; afterwards everything is as it was."""

import gc
from collections.abc import Iterator

import pytest

from stepgap.base.garbage_collection import paused_collection, settled_heap


@pytest.fixture(autouse=True)
def thawed() -> Iterator[None]:
    """The objects that the session froze are visited during the test."""
    frozen = bool(gc.get_freeze_count())
    gc.unfreeze()
    yield
    if frozen:
        gc.freeze()


def is_visited(thing: object) -> bool:
    return any(each is thing for each in gc.get_objects())


def test_only_new_objects_are_visited() -> None:
    old = [[]]
    with settled_heap():
        new = [[]]
        assert not is_visited(old)
        assert is_visited(new)
    assert is_visited(old)
    assert gc.get_freeze_count() == 0


def test_after_an_error_everything_is_visited_again() -> None:
    with pytest.raises(ZeroDivisionError), settled_heap():
        _ = 1 / 0
    assert gc.get_freeze_count() == 0


def test_what_the_caller_froze_remains_frozen() -> None:
    gc.freeze()
    count = gc.get_freeze_count()
    with settled_heap():
        assert gc.get_freeze_count() == count
    assert gc.get_freeze_count() == count
    gc.unfreeze()


@pytest.mark.parametrize("enabled", [True, False])
def test_a_pause_ends_as_it_began(enabled: bool) -> None:
    def fail() -> None:
        assert not gc.isenabled()
        raise ZeroDivisionError

    (gc.enable if enabled else gc.disable)()
    try:
        with pytest.raises(ZeroDivisionError), paused_collection():
            fail()
        assert gc.isenabled() == enabled
    finally:
        gc.enable()
