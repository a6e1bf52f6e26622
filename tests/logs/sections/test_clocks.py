"""The clock of a log: one for all topics, and said; clocks that begin anew, and times that cannot tell rows apart."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from stepgap.base.errors import StepGapWarning
from stepgap.logs.sections.signals import SignalLog, read_signal_log
from stepgap.records.steps_csv import RecordError

RNG = np.random.default_rng(0)
WALL = 1.7e9  # [s]
LOGGED = np.sort(WALL + np.arange(0, 20, 0.01) + RNG.uniform(0, 0.004, 2000))  # with the time of transport
SENT = np.arange(WALL + 0.5, WALL + 19, 0.5)

Topics = dict[str, tuple[Any, list[dict[str, Any]]]]


def stamp(seconds: float) -> dict[str, Any]:
    return {"stamp": {"sec": int(seconds), "nanosec": int(seconds % 1 * 1e9)}}


def simulation(speed: float, start: float = 100.0) -> Topics:
    """A foot with stamps that moves by 0.5 m/s in their time, and commands without."""
    times = start + speed * np.round(LOGGED - WALL, 2)
    foot = [{"header": stamp(time), "x": 0.5 * (time - start)} for time in times.tolist()]
    return {"/foot": (LOGGED, foot), "/push": (SENT, [{"data": number} for number in range(len(SENT))])}


def written(path: Path, topics: Topics) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, (times, messages) in topics.items():
            channel = writer.register_channel(topic, "json", 0)
            for time, message in zip(times, messages, strict=True):
                nanoseconds = int(time * 1e9)
                writer.add_message(channel, nanoseconds, json.dumps(message).encode(), nanoseconds)
        writer.finish()
    return path


def read(path: Path, time: str, *said: str) -> SignalLog:
    if not said:
        return read_signal_log(str(path), time, {})
    with pytest.warns(StepGapWarning) as caught:
        log = read_signal_log(str(path), time, {})
    text = " | ".join(str(one.message) for one in caught)
    assert all(part in text for part in said), text
    return log


def rate(log: SignalLog) -> float:
    x = log.signal("/foot:x")
    return float(np.polyfit(x.time - x.time[0], np.asarray(x.values, float), 1)[0])


@pytest.mark.parametrize("speed", [0.4, 0.97, 1.03, 5.0])
@pytest.mark.parametrize("time", ["", "header.stamp", "/foot:header.stamp"])
def test_rates_are_by_the_stamps_of_a_simulation(speed: float, time: str, tmp_path: Path) -> None:
    said = f"the stamps of /foot run at {speed:.3g} of the speed of log_time" if not time else "/push: no header.stamp"
    log = read(written(tmp_path / "log.mcap", simulation(speed)), time, said)
    assert rate(log) == pytest.approx(0.5, abs=1e-6)
    assert log.clock == "header.stamp of /foot"
    np.testing.assert_allclose(log.signal("/push:data").time, 100 + speed * (SENT - WALL), atol=0.01 * speed + 1e-6)


@pytest.mark.parametrize("start", [WALL - 0.002, 0.0])
def test_stamps_at_the_rate_of_the_recording_change_nothing(start: float, tmp_path: Path) -> None:
    path = written(tmp_path / "log.mcap", simulation(1.0, start))
    log = read(path, "")
    assert log.clock == "log_time"
    np.testing.assert_allclose(log.signal("/push:data").time, SENT, atol=1e-6)
    np.testing.assert_allclose(read(path, "log_time").signal("/foot:x").time, LOGGED, atol=1e-6)


def test_a_simulation_that_pauses(tmp_path: Path) -> None:
    """Its mean rate is that of the recording, but its stamps stop for some seconds."""
    topics = simulation(1.0)
    late = np.where(LOGGED > WALL + 10, LOGGED + 4.0, LOGGED)
    topics["/foot"] = late, topics["/foot"][1]
    log = read(written(tmp_path / "log.mcap", topics), "", "the stamps of /foot run at")
    x = log.signal("/foot:x")
    np.testing.assert_allclose(np.asarray(x.values, float), 0.5 * (x.time - 100), atol=1e-6)


def test_the_topic_of_the_simulated_time(tmp_path: Path) -> None:
    topics = simulation(0.4)
    foot = [{"x": message["x"]} for message in topics["/foot"][1]]
    clock = [{"clock": message["header"]["stamp"]} for message in topics["/foot"][1]]
    topics |= {"/foot": (LOGGED, foot), "/clock": (LOGGED, clock)}
    log = read(written(tmp_path / "log.mcap", topics), "", "the stamps of /clock run at 0.4 of the speed")
    assert rate(log) == pytest.approx(0.5, abs=1e-3)


def test_topics_whose_stamps_disagree(tmp_path: Path) -> None:
    """A sensor with a clock of its own does not move the others, and does not count."""
    topics = simulation(1.0, WALL)
    own = [{"header": stamp(0.5 * at * 0.01), "y": at} for at in range(2000)]
    path = written(tmp_path / "log.mcap", topics | {"/sensor": (LOGGED, own)})
    log = read(path, "", "the stamps of /sensor run at 0.5 of the speed of log_time, but others do not")
    np.testing.assert_allclose(log.signal("/sensor:y").time, LOGGED, atol=1e-6)
    log = read(path, "/foot:header.stamp", "/sensor: its header.stamp is not by the clock of /foot")
    np.testing.assert_allclose(log.signal("/sensor:y").time, LOGGED, atol=0.01)


def test_a_field_named_time_that_some_messages_have(tmp_path: Path) -> None:
    """It would place their topics by another clock."""
    topics = simulation(1.0, WALL)
    boot = [{"time": at * 0.01, "y": at} for at in range(2000)]
    log = read(written(tmp_path / "log.mcap", topics | {"/imu": (LOGGED, boot)}), "")
    np.testing.assert_allclose(log.signal("/imu:y").time, LOGGED, atol=1e-6)


def test_a_simulation_that_was_reset(tmp_path: Path) -> None:
    topics = simulation(0.4)
    moved = topics["/foot"][1]
    topics["/foot"] = LOGGED, moved[:1500] + moved[:500]
    with (
        pytest.warns(StepGapWarning),
        pytest.raises(RecordError, match=r"the time goes back from .* split the log there"),
    ):
        read_signal_log(str(written(tmp_path / "log.mcap", topics)), "", {})


def test_stamps_in_another_order_than_they_were_recorded(tmp_path: Path) -> None:
    topics = simulation(0.4)
    foot = topics["/foot"][1]
    foot[100], foot[101] = foot[101], foot[100]
    log = read(written(tmp_path / "log.mcap", topics), "", "run at 0.4")
    assert (np.diff(log.signal("/foot:x").values.astype(float)) > 0).all()


def test_a_table_without_a_time_is_named(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "log.h5", "w") as file:
        file["a/time"], file["a/x"], file["b/y"] = [0.0, 1.0], [1.0, 2.0], [1.0, 2.0, 3.0]
    log = read_signal_log(str(tmp_path / "log.h5"), "", {})
    with pytest.raises(RecordError, match=r"log.h5, b: its 'y' has no time; name it by --time; there is y"):
        log.signal("y")


def midnight(cells: list[str], tmp_path: Path, factor: float = 1.0) -> np.ndarray:
    path = tmp_path / "log.csv"
    path.write_text("t,y\n" + "".join(f"{cell},{at}\n" for at, cell in enumerate(cells)))
    with pytest.warns(StepGapWarning, match=r"log.csv, line 5, column 't': the time goes back .* are added from there"):
        return read_signal_log(str(path), "", {"t": factor}).signal("y").time


@pytest.mark.parametrize(
    ("cells", "factor", "step"),
    [
        (["23:59:59.7", "23:59:59.8", "23:59:59.9", "00:00:00.0", "00:00:00.1"], 1.0, 0.1),
        (["12:59:58", "12:59:58.5", "12:59:59.5", "01:00:00", "01:00:00.5"], 1.0, 0.5),
        (["86399.7", "86399.8", "86399.9", "0", "0.1"], 1.0, 0.1),
        (["604798", "604799", "604799.5", "0.5", "1.5"], 1.0, 1.0),
        (["4294967275", "4294967285", "4294967295", "9", "19"], 1e-6, 1e-5),
        (["65515", "65525", "65535", "9", "19"], 1e-3, 1e-2),
    ],
)
def test_a_clock_that_begins_anew(cells: list[str], factor: float, step: float, tmp_path: Path) -> None:
    time = midnight(cells, tmp_path, factor)
    assert time[4] - time[3] == pytest.approx(step, abs=1e-6)
    assert 0 < time[3] - time[2] <= 1.01 * step


@pytest.mark.parametrize(
    ("begin", "kind", "message"),
    [
        (1.7e9, "single", "all 60000 rows have the time 17"),
        (1.7e9 - 400, "single", "60000 rows have only 6 different times, written in single precision"),
        (4.0e5, "single", "60000 rows have only 19201 different times, written in single precision"),
        (1.7e6, "digits", "60000 rows have only 61 different times, written with too few digits"),
    ],
)
def test_times_that_cannot_tell_rows_apart(begin: float, kind: str, message: str, tmp_path: Path) -> None:
    """They do not blame the motion, in which no tops are found then."""
    times = begin + np.arange(0, 600 if begin != 1.7e9 else 60, 0.01 if begin != 1.7e9 else 0.001)
    cells = times.astype("f4").astype(float).tolist() if kind == "single" else [f"{time:g}" for time in times.tolist()]
    (tmp_path / "log.csv").write_text("t,y\n" + "".join(f"{cell},0\n" for cell in cells))
    with pytest.raises(RecordError, match=f"column 't': {message}"):
        read_signal_log(str(tmp_path / "log.csv"), "", {})


@pytest.mark.parametrize(
    ("times", "message"),
    [
        (np.zeros(20), "all 20 rows have the time 0; write more digits"),
        (45413 + np.arange(20) / 8.64e6, "days, as of"),
    ],
)
def test_times_that_are_none(times: np.ndarray, message: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,y\n" + "".join(f"{time!r},0\n" for time in times.tolist()))
    with pytest.raises(RecordError, match=f"log.csv, column 't': {message}"):
        read_signal_log(str(tmp_path / "log.csv"), "", {})
    if message.startswith("days"):
        time = read_signal_log(str(tmp_path / "log.csv"), "", {"t": 86400.0}).signal("y").time
        np.testing.assert_allclose(np.diff(time), 0.01, atol=2e-6)


def test_times_that_are_rounded_a_little_are_right(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,y\n" + "".join(f"{at // 10 / 100},0\n" for at in range(1000)))
    assert len(read_signal_log(str(tmp_path / "log.csv"), "", {}).signal("y")) == 1000


@pytest.mark.parametrize(("factor", "advice"), [(1e3, "timestamp = 0.001"), (1e6, "timestamp = 1e-06")])
def test_times_in_another_unit_are_not_taken_for_seconds(tmp_path: Path, factor: float, advice: str) -> None:
    """At 100 rows a second; speeds would be wrong by the factor, without a word."""
    rows = np.arange(50) / 100
    (tmp_path / "log.csv").write_text("timestamp,x\n" + "".join(f"{factor * row},{row}\n" for row in rows.tolist()))
    with pytest.raises(RecordError, match=rf"'timestamp': in seconds, its rows were .* such as {advice}, or 1 if"):
        read_signal_log(str(tmp_path / "log.csv"), "", {})
    in_seconds = read_signal_log(str(tmp_path / "log.csv"), "", {"timestamp": 1 / factor}).signal("x")
    np.testing.assert_allclose(in_seconds.time, rows, atol=1e-12)
    slow = read_signal_log(str(tmp_path / "log.csv"), "", {"timestamp": 1.0}).signal("x")
    np.testing.assert_allclose(slow.time, factor * rows)


def test_a_slow_file_beside_a_fast_one_is_in_seconds(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,x\n" + "".join(f"{row / 100},{row}\n" for row in range(2000)))
    (tmp_path / "plan.csv").write_text("t,push\n" + "".join(f"{row},{row}\n" for row in range(20)))
    log = read_signal_log(f"{tmp_path / 'log.csv'}+{tmp_path / 'plan.csv'}", "", {})
    np.testing.assert_array_equal(log.signal("push").time, np.arange(20.0))
