"""Descriptions and events in a tick log: what was written is read, also from damaged and recovered files."""

import json
from math import inf, isnan
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.plants.ticks.log_description import FieldMeaning, LogDescription, LogEvent
from stepgap.plants.ticks.tick_log import TickLog, read_description, recover_ticks

TEXTS = st.text(max_size=20)
TABLES = st.dictionaries(TEXTS, st.dictionaries(st.integers(0, 10**9), TEXTS, max_size=3), max_size=3)
ENDS = st.one_of(st.none(), st.floats(allow_nan=False, allow_infinity=False))
RANGES = st.tuples(
    st.floats(allow_nan=False, max_value=1e300).filter(lambda low: low != inf),
    st.floats(allow_nan=False, min_value=-1e300).filter(lambda high: high != -inf),
)
DESCRIPTIONS = st.builds(
    LogDescription,
    TEXTS,
    TEXTS,
    st.dictionaries(TEXTS, TEXTS, max_size=3),
    st.builds(FieldMeaning, TABLES, TABLES, st.dictionaries(TEXTS, RANGES, max_size=3)),
)


@given(DESCRIPTIONS)
def test_a_description_is_read_as_it_was_written(description):
    assert LogDescription.of_metadata(description.to_metadata()) == description


@given(st.floats(allow_nan=False), TEXTS, TEXTS)
def test_an_event_is_read_as_it_was_written(time, utc, text):
    event = LogEvent(time, utc, text)
    assert LogEvent.of_metadata(event.to_metadata()) == event


JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), TEXTS),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(TEXTS, inner, max_size=3)),
    max_leaves=8,
)


@given(
    st.dictionaries(
        st.sampled_from(["started", "settings", "versions", "names", "bits", "ranges"]), JSON.map(json.dumps)
    )
)
def test_a_broken_description_is_read_without_its_broken_parts(texts):
    found = LogDescription.of_metadata(texts)
    assert found.started == texts.get("started", "")
    for low, high in found.meaning.ranges.values():
        assert not isnan(low + high) or low == -high, "no limit is NaN"
    for names in [*found.meaning.names.values(), *found.meaning.bits.values()]:
        assert all(isinstance(number, int) and number >= 0 for number in names)


def test_events_are_in_a_truncated_log_and_in_a_recovered_one(tmp_path: Path):
    meaning = FieldMeaning({"state": {1: "HOP"}}, {"limited": {1: "TORQUE"}}, {"height": (-inf, 2.0)})
    description, events = LogDescription.here("mass = 1\n", meaning), [LogEvent.now(0.5, "one"), LogEvent.now(1.0, "2")]
    path = tmp_path / "a.mcap"
    with TickLog(path, {"time": "s", "state": ""}, description) as log:
        log.append(np.zeros((5, 2)))
        for event in events:
            log.note(event)
        log.flush()
        truncated = path.read_bytes()
    assert read_description(path) == (description, events)
    path.write_bytes(truncated)
    assert read_description(path) == (description, events)
    assert recover_ticks(path, tmp_path / "b.mcap").ticks == 5
    assert read_description(tmp_path / "b.mcap") == (description, events)


def test_a_log_without_a_description_has_an_empty_one(tmp_path: Path):
    with TickLog(tmp_path / "a.mcap", {"time": "s"}) as log:
        log.append(np.zeros((1, 1)))
    assert read_description(tmp_path / "a.mcap") == (LogDescription(), [])


@pytest.mark.parametrize("texts", [{}, {"time": "soon"}])
def test_an_event_without_a_time_is_refused(texts):
    with pytest.raises(ValueError, match="could not convert"):
        LogEvent.of_metadata(texts)
