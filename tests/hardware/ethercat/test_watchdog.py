"""The proof that drives switch torque off by themselves, in the time of an emulated ring."""

import pytest

from stepgap.hardware.ethercat import ethercat_rig
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.rigs.rig import RigFault
from tests.hardware.ethercat.ring_process import LiveRing, live_ring
from tests.hardware.ethercat.test_ethercat_rig import SETTINGS, cycles_to_connect, rig_of

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")


@pytest.fixture
def time_of(monkeypatch: pytest.MonkeyPatch):
    """Lets the rig sleep in the time of a ring, whose ticks then go on without frames."""

    def take(ring: LiveRing) -> None:
        now = 0.0

        def sleep(duration: float) -> None:
            nonlocal now
            now += duration
            ring.wait(round(1e3 * duration))

        monkeypatch.setattr(ethercat_rig, "sleep", sleep)
        monkeypatch.setattr(ethercat_rig, "monotonic", lambda: now)

    return take


def test_the_time_until_the_drives_give_no_torque_is_measured(time_of) -> None:
    with live_ring() as ring, rig_of() as rig:
        time_of(ring)
        found = rig.watchdog_times()
        assert found.setting == SETTINGS.watchdog
        assert found.measured == {name: pytest.approx(SETTINGS.watchdog, abs=2e-3) for name in ("drive_1", "drive_2")}
        assert ring.look().enabled == [False, False]
        assert not any(map(any, ring.look().torques))
        rig.close()
        with pytest.raises(RigFault, match="not connected"):
            rig.watchdog_times()


def test_a_drive_that_ignores_its_watchdog_is_named(time_of) -> None:
    """Its slave controller leaves OP, but its application hangs and remains enabled."""
    with live_ring(Fault("stalled", cycles_to_connect(), "drive_2", cycles=10_000)) as ring, rig_of() as rig:
        time_of(ring)
        with pytest.raises(RigFault, match=r"slave 2 'drive_2' accepts torque 1\.10 s after the last frame"):
            rig.watchdog_times()
