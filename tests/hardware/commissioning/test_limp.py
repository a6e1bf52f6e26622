"""What is kept and shown of the ticks of a limp robot."""

from collections.abc import Mapping
from math import inf, nan

import numpy as np

from stepgap.hardware.commissioning.limp import LastTick, LimpRig, describe_devices
from stepgap.hardware.hopper.still import StillRig
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import SensorModel

NAMES = ("time", "alpha_1", "left_temperature", "left_sto")


class ReportingRig(StillRig):
    @property
    def diagnostic_units(self) -> Mapping[str, str]:
        return {"left_temperature": "°C", "left_sto": "", "left_statusword": "CiA 402"}

    @property
    def diagnostic_ranges(self) -> Mapping[str, tuple[float, float]]:
        return {"left_temperature": (-inf, inf)}

    @property
    def diagnostic_names(self) -> Mapping[str, Mapping[int, str]]:
        return {"left_sto": {0: "closed", 1: "open"}}

    @property
    def warning(self) -> str:
        return "the left drive is hot"


def test_of_a_tick_that_failed_the_known_values_are_kept() -> None:
    last = LastTick(NAMES)
    last.append(np.array([[0.0, nan, 31.0, 0.0]]))
    assert last.fields == {}, "until all are known"
    last.append(np.array([[0.1, 0.5, 31.0, 0.0], [0.2, 0.6, 31.0, 0.0], [0.3, nan, 31.0, 0.0], [0.4, nan, nan, 1.0]]))
    assert last.fields == {"time": 0.4, "alpha_1": 0.6, "left_temperature": 31.0, "left_sto": 1.0}
    last.append(np.array([[0.5, 0.7, 32.0, 0.0]]))
    assert last.fields == {"time": 0.5, "alpha_1": 0.7, "left_temperature": 32.0, "left_sto": 0.0}
    last.append(np.empty((0, 4)))
    last.append(np.array([[nan, nan, 33.0, nan]]))
    assert last.fields == {"time": 0.5, "alpha_1": 0.7, "left_temperature": 33.0, "left_sto": 0.0}


def test_what_a_rig_judges_is_described_by_names_and_units() -> None:
    rig = ReportingRig(SensorModel(tick=1e-3), ())
    tick = {"time": 1.0, "left_temperature": 31.26, "left_sto": 1.0, "left_statusword": 0x27}
    assert describe_devices(rig, tick) == {"left_temperature": "31.3 °C", "left_sto": "open"}
    assert describe_devices(rig, {**tick, "left_temperature": nan, "left_sto": 3.0}) == {"left_sto": "3"}
    assert describe_devices(StillRig(SensorModel(tick=1e-3), ()), tick) == {}


def test_a_limp_rig_tells_what_its_rig_tells() -> None:
    rig = ReportingRig(SensorModel(tick=1e-3), ())
    limp = LimpRig(rig, RigLimits())
    for name in ("diagnostic_units", "diagnostic_ranges", "diagnostic_names", "warning"):
        assert getattr(limp, name) == getattr(rig, name)
    assert describe_devices(limp, {"left_sto": 0.0}) == {"left_sto": "closed"}
