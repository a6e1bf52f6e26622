"""Slaves are searched for again, since on a busy computer the answer with an identity may be lost."""

from types import SimpleNamespace

import pytest

from stepgap.hardware.ethercat import bus
from stepgap.rigs.rig import RigFault
from tests.hardware.ethercat.test_ethercat_rig import SETTINGS

RIGHT = [SimpleNamespace(man=slave.vendor, id=slave.product, rev=0) for slave in SETTINGS.slaves]
WRONG = [SimpleNamespace(man=0, id=0, rev=0), *RIGHT[1:]]


class ScriptedMaster:
    """Finds other slaves in each search; the last ones remain."""

    def __init__(self, *searches: list[SimpleNamespace]) -> None:
        self.left = list(searches)
        self.slaves: list[SimpleNamespace] = []

    def config_init(self) -> int:
        self.slaves = self.left.pop(0)
        return len(self.slaves)


def searched(monkeypatch: pytest.MonkeyPatch, time: float, *searches: list[SimpleNamespace]) -> ScriptedMaster:
    """A master after the search in `time` [s]."""
    monkeypatch.setattr(bus, "SEARCH_TIME", time)
    master = ScriptedMaster(*searches)
    own_bus = bus.Bus(SETTINGS)
    own_bus._master = master
    own_bus._check_identities(own_bus._search(master))
    return master


@pytest.mark.parametrize("time", [60.0, -1.0])
def test_a_wrong_identity_is_read_again_before_it_is_refused(monkeypatch: pytest.MonkeyPatch, time: float) -> None:
    assert searched(monkeypatch, time, WRONG, RIGHT, WRONG).left == [WRONG]


@pytest.mark.parametrize(("time", "count"), [(60.0, bus.MOST_SEARCHES), (-1.0, 2)])
def test_an_identity_that_stays_wrong_is_refused(monkeypatch: pytest.MonkeyPatch, time: float, count: int) -> None:
    with pytest.raises(RigFault, match="must be vendor 0x0000009A"):
        searched(monkeypatch, time, *[WRONG] * count)


def test_missing_slaves_are_refused_when_the_time_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RigFault, match="is missing: 2 of 6 slaves answer"):
        searched(monkeypatch, -1.0, RIGHT[:2])
