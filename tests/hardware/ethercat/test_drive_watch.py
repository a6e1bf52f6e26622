"""Limits of what a drive reports: settings, and the judgement of any sequence of readings."""

from dataclasses import fields
from math import inf, isnan, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.hardware.bus_rig import MOST_WRONG
from stepgap.hardware.ethercat.drive_limits import DriveLimits
from stepgap.hardware.ethercat.drive_watch import (
    BEYOND,
    LARGEST_JUMP,
    MOST_DOUBTS,
    MOST_SAME,
    MOST_WARNED,
    ONLY_STO,
    DriveWatch,
    ReportedValue,
    Track,
    excess_of,
    reported_values,
    warning_of,
    with_value,
)
from stepgap.hardware.ethercat.pdo import Entry

ENTRIES = {
    "statusword": Entry(0x6041, 0, 16, "statusword"),
    "temperature": Entry(0x2100, 0, 16, "temperature"),
    "bus_voltage": Entry(0x6079, 0, 32, "bus_voltage"),
    "digital_inputs": Entry(0x60FD, 0, 32, "digital_inputs"),
}
LIMITS = DriveLimits(
    temperature_unit=0.1,
    temperature_warning=70.0,
    temperature_limit=80.0,
    bus_voltage=(20.0, 60.0),
    sto_bits=(16, 17),
    enable_bits=(18,),
    enable_open=1,
)
TEMPERATURE, VOLTAGE = reported_values(LIMITS, ENTRIES, 1e-3)
CLOSED = {"statusword": 0x1237, "temperature": 312, "bus_voltage": 48_000, "digital_inputs": 0x3_0000}


def tracked(reported: ReportedValue, values: list[float]) -> Track:
    track = Track()
    for value in values:
        track = with_value(reported, track, value)
    return track


def watch(limits: DriveLimits = LIMITS) -> DriveWatch:
    return DriveWatch("slave 1 'left'", limits, ENTRIES, 1e-3)


any_values = st.lists(st.floats() | st.sampled_from([nan, inf, 25.0, 69.0, 71.0, 81.0]), max_size=60)


@given(any_values)
def test_any_sequence_is_judged_by_plausible_readings_alone(values: list[float]) -> None:
    for reported in (TEMPERATURE, VOLTAGE):
        track = tracked(reported, values)
        least, most = reported.plausible
        assert isnan(track.value) or least <= track.value <= most
        low, high = reported.limits
        if excess_of(reported, track):
            plausible = [value for value in values if least <= value <= most]
            assert sum(not low <= value <= high for value in plausible) >= BEYOND
            assert f"{track.value:.1f}" in excess_of(reported, track)
        assert "\n" not in warning_of(reported, track) + excess_of(reported, track)


@given(st.lists(st.floats(20.0, 60.0), max_size=200), st.data())
def test_values_within_the_limits_never_stop_a_robot_nor_does_one_bad_reading(values: list[float], data) -> None:
    assert not excess_of(VOLTAGE, tracked(VOLTAGE, values))
    assert not warning_of(VOLTAGE, tracked(VOLTAGE, values))
    bad = data.draw(st.floats() | st.sampled_from([0.0, 61.0]))
    where = data.draw(st.integers(0, len(values)))
    track = tracked(VOLTAGE, [*values[:where], bad, *values[where:]])
    assert not excess_of(VOLTAGE, track)
    assert not warning_of(VOLTAGE, track)


@given(st.floats(1e-3, LARGEST_JUMP * 0.999))
def test_a_rising_temperature_first_warns_and_then_stops(step: float) -> None:
    track, value, warned_at = Track(), 25.0, 0.0
    while not excess_of(TEMPERATURE, track):
        track = with_value(TEMPERATURE, track, value)
        if warning_of(TEMPERATURE, track) and not warned_at:
            warned_at = value
        value += step
    assert warned_at <= 70.0 + BEYOND * step + 1e-9
    assert track.value <= 80.0 + BEYOND * step + 1e-9
    assert track.doubts == 0
    assert excess_of(TEMPERATURE, track).startswith("its temperature is ")


@pytest.mark.parametrize("bad", [nan, inf, -inf, 3276.7, -273.0, 60.0], ids=str)
def test_a_temperature_that_is_implausible_is_doubted_and_not_believed(bad: float) -> None:
    good = [31.0] * 10
    assert not warning_of(TEMPERATURE, tracked(TEMPERATURE, good + [bad] * (MOST_DOUBTS - 1)))
    track = tracked(TEMPERATURE, good + [bad] * 200)
    assert track.value == 31.0
    assert warning_of(TEMPERATURE, track) == "its temperature is not plausible"
    assert not excess_of(TEMPERATURE, track)
    mostly = tracked(TEMPERATURE, good + [bad, bad, 31.0] * 60)
    assert warning_of(TEMPERATURE, mostly) == "its temperature is not plausible"


def test_a_frozen_value_is_doubted_after_its_time() -> None:
    limits = DriveLimits(bus_voltage=(20, 60), bus_voltage_frozen_time=0.5, temperature_frozen_time=1.0)
    temperature, voltage = reported_values(limits, ENTRIES, 1e-3)
    assert not warning_of(voltage, tracked(voltage, [48.0] * 500))
    assert warning_of(voltage, tracked(voltage, [48.0] * 501)) == "its bus voltage is frozen at 48.0 V"
    assert not warning_of(voltage, tracked(voltage, ([48.0] * 400 + [48.001]) * 3))
    assert "temperature is frozen" in warning_of(temperature, tracked(temperature, [31.0] * 1001))


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({}, ""),
        ({"digital_inputs": 0x1_0000}, "the STO input of slave 1 'left' is open"),
        ({"digital_inputs": 0x2_0000}, "the STO input of slave 1 'left' is open"),
        ({"digital_inputs": 0x7_0000}, "the enable input of slave 1 'left' is open"),
        ({"digital_inputs": 0x4_0000}, "the STO input and the enable input of slave 1 'left' are open"),
        ({"digital_inputs": 0xFFFF_FFFF - 0x4_0000}, ""),
    ],
)
def test_open_inputs_are_named_at_once(values: dict[str, int], expected: str) -> None:
    drive = watch()
    assert drive.update({**CLOSED, **values}) == expected
    logged = dict(zip(drive.units, drive.values, strict=True))
    assert (logged["sto"], logged["enable"]) == ("STO" in expected, "enable input" in expected)


def test_values_are_logged_in_their_units() -> None:
    drive = watch()
    assert list(map(isnan, drive.values)) == [True] * 6
    assert drive.update(CLOSED) == ""
    assert dict(zip(drive.units, drive.values, strict=True)) == {
        "statusword": 0x1237,
        "digital_inputs": 0x3_0000,
        "temperature": pytest.approx(31.2),
        "bus_voltage": pytest.approx(48.0),
        "sto": 0.0,
        "enable": 0.0,
    }
    assert (drive.units["temperature"], drive.units["bus_voltage"]) == ("°C", "V")
    assert drive.ranges == {"temperature": (-inf, 80.0), "bus_voltage": (20.0, 60.0)}
    assert drive.names["sto"] == {0: "closed", 1: "open"}


def test_the_numbers_for_no_value_are_no_values() -> None:
    drive = watch()
    for raw in (0x7FFF, -0x8000):
        drive.restart()
        for _ in range(MOST_DOUBTS):
            assert drive.update({**CLOSED, "temperature": raw, "bus_voltage": 2**32 - 1}) == ""
        assert drive.warning == "slave 1 'left': its temperature is not plausible"
    for _ in range(3 * MOST_DOUBTS):
        drive.update(CLOSED)
    assert drive.warning == ""


def test_without_limits_values_are_only_logged() -> None:
    drive, limits = watch(DriveLimits()), DriveLimits()
    for raw in (30, 150, 20_000, 0x7FFF) * 30:
        assert drive.update({**CLOSED, "temperature": raw, "bus_voltage": raw, "digital_inputs": raw}) == ""
        assert drive.warning == ""
    found = limits.remarks("slave 1 'left'", ENTRIES)
    assert [text.split(" reports ")[1].split(",")[0] for text in found] == [
        "temperature",
        "bus_voltage",
        "digital_inputs",
    ]
    assert limits.remarks("slave 1 'left'", {}) == []
    assert LIMITS.remarks("slave 1 'left'", ENTRIES) == []


numbers = st.floats() | st.sampled_from([0.0, 1.0, 25.0, 70.0, 80.0, 1e300])
given_limits = st.fixed_dictionaries(
    {},
    optional={
        **dict.fromkeys(("temperature_unit", "temperature_warning", "temperature_limit"), numbers),
        **dict.fromkeys(("temperature_frozen_time", "bus_voltage_frozen_time", "bus_voltage_unit"), numbers),
        "bus_voltage": st.lists(numbers, max_size=3).map(tuple),
        **dict.fromkeys(("sto_bits", "enable_bits"), st.lists(st.integers(-2, 40), max_size=3).map(tuple)),
        **dict.fromkeys(("sto_open", "enable_open"), st.integers(-1, 2)),
    },
)


@given(given_limits, st.sets(st.sampled_from(sorted(ENTRIES))), st.integers(), st.integers(), st.integers())
def test_any_settings_are_refused_by_the_name_of_a_key_or_judge_any_reading(
    changes: dict, mapped: set[str], temperature: int, voltage: int, inputs: int
) -> None:
    entries = {name: ENTRIES[name] for name in {"statusword", *mapped}}
    refusal = ""
    try:
        limits = DriveLimits(**changes)
        limits.require_values("motor_1", "left", entries)
    except ValueError as error:
        refusal, limits = str(error), DriveLimits()
    if refusal:
        named = refusal.partition(" = ")[0].removeprefix("motor_1.")
        assert named in {field.name for field in fields(DriveLimits)}
        assert "\n" not in refusal
        return
    assert limits.temperature_warning < limits.temperature_limit or limits.temperature_limit == inf
    assert not limits.sto_bits or "digital_inputs" in mapped
    assert not limits.bus_voltage or "bus_voltage" in mapped
    drive = DriveWatch("it", limits, entries, 1e-3)
    values = {
        "statusword": 0x27,
        "temperature": temperature % 2**16 - 2**15,
        "bus_voltage": voltage % 2**32,
        "digital_inputs": inputs % 2**32,
    }
    for _ in range(MOST_DOUBTS + 1):
        drive.update({name: values[name] for name in entries})
    assert len(drive.values) == len(drive.units)
    if limits.bus_voltage and not drive.warning:
        low, high = limits.bus_voltage
        value = values["bus_voltage"] * limits.bus_voltage_unit
        assert bool(drive.update({name: values[name] for name in entries})) >= (not low <= value <= high)


@pytest.mark.parametrize(
    ("changes", "entry", "expected"),
    [
        (
            {"temperature_warning": 90.0, "temperature_limit": 150.0},
            Entry(0x2000, 0, 8, "temperature"),
            "motor_1.temperature_limit = 150.0, but it",
        ),
        ({"bus_voltage": (20.0, 66.0)}, Entry(0x2000, 0, 16, "bus_voltage"), "motor_1.bus_voltage = [20.0, 66.0], but"),
        (
            {"sto_bits": (16,)},
            Entry(0x251A, 0, 16, "digital_inputs"),
            "motor_1.sto_bits = [16], but it must be bits of",
        ),
    ],
)
def test_a_limit_that_the_entry_cannot_reach_is_refused(changes: dict, entry: Entry, expected: str) -> None:
    with pytest.raises(ValueError, match="but it must") as caught:
        DriveLimits(**changes).require_values("motor_1", "left", {entry.name: entry})
    assert str(caught.value).startswith(expected)


IGNORES = f"it ignores its commands (bit 12 of its status word); {ONLY_STO}"
MOTION = {"statusword": 0x1237, "torque": 0, "position": 100, "velocity": 0}
MOTION_ENTRIES = {name: Entry(0x6041, 0, 16, name) for name in MOTION}


def judged(limits: DriveLimits, frames: list[tuple[int, dict[str, int]]]) -> tuple[int, str, str]:
    """Number of readings until torque must go off, the reason, and the warning then; of commands and inputs."""
    watch = DriveWatch("drive", limits, MOTION_ENTRIES, 1e-3)
    for number, (command, values) in enumerate(frames, 1):
        watch.command(command)
        if excess := watch.update(MOTION | values):
            return number, excess, watch.warning
    return len(frames), "", watch.warning


def moving(command: int, number: int, **values: int) -> tuple[int, dict[str, int]]:
    """A command, and the inputs of a drive that follows it while its motor moves."""
    return command, {"torque": command, "position": 100 + 3 * number, **values}


def test_a_drive_that_follows_its_commands_is_neither_doubted_nor_warned_of():
    frames = [moving(round(400 * (number % 7 - 3)), number) for number in range(200)]
    assert judged(DriveLimits(), frames) == (200, "", "")


def test_another_torque_than_commanded_ends_torque():
    frames = [moving(100, number, torque=-100 if number >= 20 else 100) for number in range(60)]
    found, excess, _ = judged(DriveLimits(), frames)
    assert found == 20 + MOST_WRONG
    assert excess.startswith("drive: its torque is -100, commanded were 100 (1/1000 of the rated torque); it may keep")
    assert judged(DriveLimits(torque_tolerance=inf), frames)[1] == ""


def test_a_drive_that_hangs_is_found_although_its_torque_is_near_the_commands():
    frames = [(30 * (number % 2), {"torque": 20}) for number in range(60)]
    assert judged(DriveLimits(), frames)[1] == "", "so small a change proves nothing"
    frames = [(70 * (number % 2), {"torque": 35}) for number in range(60)]
    found, excess, _ = judged(DriveLimits(), frames)
    assert found <= 2 + MOST_SAME
    assert "none of its values changes any more" in excess
    assert "only its STO input stops it" in excess


def test_a_resting_drive_without_changing_commands_does_not_hang():
    assert judged(DriveLimits(), [(0, {})] * 500) == (500, "", "")


def test_a_drive_that_ignores_its_commands_ends_torque_unless_it_never_used_that_bit():
    frames = [moving(0, number, statusword=0x0237 if number >= 20 else 0x1237) for number in range(60)]
    assert judged(DriveLimits(), frames)[:2] == (20 + MOST_WRONG, f"drive: {IGNORES}")
    assert judged(DriveLimits(ignored_status_bits=(12,)), frames)[1] == ""
    assert judged(DriveLimits(), [moving(0, number, statusword=0x0237) for number in range(60)])[1] == ""


@pytest.mark.parametrize(("bit", "text"), [(7, "warns"), (11, "is at an internal limit")])
def test_a_warning_and_an_internal_limit_that_last_let_the_robot_land(bit, text):
    frames = [moving(0, number, statusword=0x1237 | 1 << bit) for number in range(MOST_WARNED)]
    assert judged(DriveLimits(), frames[1:]) == (MOST_WARNED - 1, "", "")
    found = judged(DriveLimits(), frames)
    assert found[:2] == (MOST_WARNED, "")
    assert found[2].startswith(f"drive: it {text}")
    assert judged(DriveLimits(ignored_status_bits=(bit,)), frames)[2] == ""


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"torque_tolerance": 0.0}, "at least 0.01"),
        ({"torque_delay": 1.0}, "between 0.001 and 0.05"),
        ({"ignored_status_bits": (3,)}, "some of"),
    ],
)
def test_settings_of_obedience_have_ranges(settings, rule):
    with pytest.raises(ValueError, match=rule):
        DriveLimits(**settings)
