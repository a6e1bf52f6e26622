"""`stepgap rig incident`: what a log says about the end of a deployment, from logs whose content is known."""

from math import inf, nan
from pathlib import Path

import numpy as np
import pytest

from stepgap.hardware.incident import changes_of, describe_incident, margins_of, reaction_of, read_incident
from stepgap.hardware.incident_figure import incident_picture
from stepgap.plants.ticks.log_description import FieldMeaning, LogDescription, LogEvent
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import TickLog, TickLogError

UNITS = {
    "time": "s",
    "state": "",
    "phase": "",
    "limited": "",
    "drive_statusword": "CiA 402",
    "motor": "counts",
    "speed": "rad/s",
    "applied_1": "N·m",
    "late": "s",
}
MEANING = FieldMeaning(
    {"phase": {0: "FLIGHT", 1: "STANCE"}},
    {"limited": {1: "TORQUE", 2: "TORQUE_STEP"}},
    {"speed": (-inf, 8.0), "motor": (-100.0, 300.0), "applied_1": (-inf, inf), "unknown": (0.0, 1.0)},
)
ENABLED, FAULTY = 0x1237, 0x0218
COUNT, FAULT = 3000, 2500
"""Numbers of ticks in all and until the fault."""


def stopped_rows() -> np.ndarray:
    """A robot that stands, hops from 2 s on, and is stopped at 2.5 s; torque is off after two more ticks."""
    rows = np.zeros((COUNT, len(UNITS)))
    column = dict(zip(UNITS, rows.T, strict=True))
    column["time"][:] = 1e-3 * np.arange(COUNT)
    column["state"][:] = RigState.STAND
    column["state"][2000:] = RigState.STEP
    column["state"][FAULT:] = RigState.FAULT
    column["phase"][2300:] = 1
    column["limited"][[2200, 2201]] = 1, 3
    column["drive_statusword"][:] = ENABLED
    column["drive_statusword"][2499:] = FAULTY
    column["motor"][:] = 150 - 40 * np.sin(column["time"])
    column["speed"][2000:] = 4 + 1e-3 * np.arange(1000)
    column["applied_1"][2000 : FAULT + 2] = -3.0
    column["applied_1"][FAULT] = -7.0
    column["late"][2400] = 2.5e-3
    return rows


def written(path: Path, rows: np.ndarray, description: LogDescription | None, *events: LogEvent) -> Path:
    with TickLog(path, UNITS, description) as log:
        log.append(rows)
        for event in events:
            log.note(event)
    return path


EVENTS = (LogEvent(0.0, "2026-03-01T10:00:00.000+00:00", "first tick"), LogEvent(2.5, "later", "the speed is 8.5"))


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return written(tmp_path / "a.mcap", stopped_rows(), LogDescription(versions={"x": "1"}, meaning=MEANING), *EVENTS)


def test_the_changes_before_a_fault_are_listed_in_their_order(log: Path):
    found = read_incident(log, 1.0)
    assert (found.fault, found.time, found.begin) == (True, 2.5, 1.5)
    assert [(round(change.time, 6), change.text) for change in changes_of(found)] == [
        (2.0, "state: STAND → STEP"),
        (2.2, "limited: torque, in 2 ticks"),
        (2.201, "limited: torque step, in 1 tick"),
        (2.3, "phase: FLIGHT → STANCE"),
        (2.4, "late by 2.50 ms"),
        (2.499, "drive_statusword: operation enabled → fault"),
        (2.5, "state: STEP → FAULT"),
        (2.5, "message: the speed is 8.5"),
    ]
    assert [change.text for change in changes_of(read_incident(log, 0.05))] == [
        "drive_statusword: operation enabled → fault",
        "state: STEP → FAULT",
        "message: the speed is 8.5",
    ]


def test_limits_torque_and_time_of_day_of_a_fault(log: Path):
    found = read_incident(log, 1.0)
    speed, motor = margins_of(found)
    assert (speed.field, speed.most, speed.used) == ("speed", 4.5, 4.5 / 8)
    assert motor.used == pytest.approx((150 - 40 * np.sin(2.5) - 100) / 200)
    after, most = reaction_of(found) or (inf, inf)
    assert (after, most) == (pytest.approx(2e-3), 7.0)
    text = describe_incident(found)
    for part in (
        "3000 ticks, 2.999 s",
        "recorded with x 1",
        "fault at 2.500 s, 2026-03-01 10:00:02.500 UTC",
        "     -1 ms  drive_statusword: operation enabled → fault\n",
        "torque was off 2 ms after the fault; largest torque from the fault on 7.00 N·m",
    ):
        assert part in text
    assert "beyond" not in text


def test_a_limit_that_was_passed_is_marked(tmp_path: Path):
    rows = stopped_rows()
    rows[FAULT, list(UNITS).index("speed")] = 8.5
    found = read_incident(written(tmp_path / "b.mcap", rows, LogDescription(meaning=MEANING)), 1.0)
    assert margins_of(found)[0].used == 8.5 / 8
    assert [line.split()[0] for line in describe_incident(found).splitlines() if line.endswith("beyond")] == ["speed"]


def test_a_log_that_ends_while_the_robot_hops_has_a_fault(tmp_path: Path):
    """The process was killed, so what followed is not in the log."""
    found = read_incident(written(tmp_path / "b.mcap", stopped_rows()[:2400], LogDescription(meaning=MEANING)), 1.0)
    assert (found.fault, found.time) == (True, 2.399)
    assert reaction_of(found) == (inf, 3.0)
    assert "fault: the log ends in the state STEP at 2.399 s\n" in describe_incident(found)
    assert "torque was off not until the end of the log" in describe_incident(found)


def test_a_log_that_ends_as_it_should_has_no_fault(tmp_path: Path):
    rows = stopped_rows()
    rows[FAULT:, 1] = RigState.OFF
    found = read_incident(written(tmp_path / "b.mcap", rows, None), 1.0)
    assert (found.fault, found.time, reaction_of(found)) == (False, 2.999, None)
    assert "no fault; the log ends at 2.999 s\n" in describe_incident(found)
    assert "limits: the log contains none" in describe_incident(found)


def test_numbers_that_are_missing_or_have_no_name_are_described(tmp_path: Path):
    rows = stopped_rows()
    rows[2400:, 2] = 7
    rows[2450:, 3:] = nan
    rows[2460, 1:4] = 1e300, -1e300, 1e300
    found = read_incident(written(tmp_path / "b.mcap", rows, LogDescription(meaning=MEANING)), 1.0)
    assert "phase: STANCE → 7" in describe_incident(found)
    assert reaction_of(found) == (0.0, 0.0), "a tick without values gives no torque"
    assert incident_picture(found, "png").startswith(b"\x89PNG")


@pytest.mark.parametrize(("form", "start"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_the_figure_shows_every_field(log: Path, form: str, start: bytes):
    picture = incident_picture(read_incident(log, 1.0), form)
    assert picture.startswith(start)
    if form == "svg":
        drawn = picture.decode()
        assert all(
            f"<!-- {text} -->" in drawn for text in ["state", "phase", "STANCE", "torque step", "motor", "speed"]
        )


@pytest.mark.parametrize(
    ("units", "rows", "message"),
    [
        ({"time": "s", "height": "m"}, 1, "has no field 'state'; give a log of stepgap run or rig dry-run on a rig"),
        ({"time": "s", "state": ""}, 0, "contains no ticks"),
    ],
)
def test_a_log_without_an_incident_is_refused(tmp_path: Path, units: dict[str, str], rows: int, message: str):
    with TickLog(tmp_path / "b.mcap", units) as log:
        log.append(np.zeros((rows, 2)))
    with pytest.raises(TickLogError, match=message):
        read_incident(tmp_path / "b.mcap", 1.0)
