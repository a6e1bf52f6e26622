"""Plans are matched by time: a lost one affects its step alone, and what is ambiguous is not used."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.logs.sections.plans import read_plans, step_values
from stepgap.logs.sections.section_settings import SectionSettings
from stepgap.logs.sections.signals import Signal, read_signal_log
from stepgap.records.steps_csv import RecordError

SECTIONS = np.array([0.0, 1.0, 2.1, 3.0, 4.2, 5.0])


@given(
    parts=st.lists(st.floats(-0.04, 0.84), min_size=5, max_size=5),
    lost=st.sets(st.integers(0, 4), max_size=3),
)
def test_each_step_has_the_plan_made_in_it(parts: list[float], lost: set[int]) -> None:
    """At most a tenth before its section, and whichever others were lost."""
    kept = [step for step in range(5) if step not in lost]
    durations = np.diff(SECTIONS)
    before = np.append(durations[0], durations[:-1])
    times = [SECTIONS[step] + parts[step] * (durations if parts[step] >= 0 else before)[step] for step in kept]
    found = step_values(Signal(np.array(times), np.array(kept, float)), SECTIONS)
    expected = [step if step in kept else np.nan for step in range(5)]
    np.testing.assert_array_equal(found.values, expected)
    assert [bool(doubt) for doubt in found.doubts] == [step in lost for step in range(5)]


@pytest.mark.parametrize(
    ("times", "doubts"),
    [
        ([0.2, 0.5, 2.2, 3.1, 4.3], ["several plans", "no plan", "", "", ""]),
        ([0.2, 1.99, 3.1, 4.3], ["", "a plan between two steps", "no plan", "", ""]),
        ([-0.3, 5.4], ["no plan"] * 5),
        ([], ["no plan"] * 5),
    ],
)
def test_ambiguous_plans_are_not_used(times: list[float], doubts: list[str]) -> None:
    found = step_values(Signal(np.array(times), np.arange(len(times), dtype=float)), SECTIONS)
    assert list(found.doubts) == doubts
    assert np.isnan(found.values).tolist() == [bool(doubt) for doubt in doubts]


@pytest.mark.parametrize(
    ("which", "planned", "held"),
    [("first", [3.0, 7.0], [3.0, 0.5]), ("last", [0.5, 0.0], [0.5, 0.0]), ("largest", [-4.0, 7.0], [-4.0, 7.0])],
)
def test_one_of_several_commands_may_be_chosen(which: str, planned: list[float], held: list[float]) -> None:
    """On at landing and off at take-off, as plans and as a signal that is sampled."""
    plans = Signal(np.array([0.2, 0.5, 0.7, 1.4, 1.6]), np.array([3.0, -4.0, 0.5, 7.0, 0.0]))
    sections = np.array([0.0, 1.0, 2.1])
    assert step_values(plans, sections).doubts == ("several plans",) * 2
    assert step_values(plans, sections, which).values.tolist() == planned
    time = np.arange(0.2, 2.1, 0.01)
    sampled = Signal(time, plans.values[np.searchsorted(plans.time, time + 1e-9, "right") - 1])
    assert set(step_values(sampled, sections).doubts) == {"the command changes during the step"}
    assert step_values(sampled, sections, which).values.tolist() == held


def test_a_sampled_command_is_held() -> None:
    time = np.arange(0, 5, 0.01)
    command = np.searchsorted(SECTIONS, time, "right").astype(np.float64)
    command[(time > 2.4) & (time < 2.6)] = 9.0
    found = step_values(Signal(time, command), SECTIONS)
    np.testing.assert_array_equal(found.values, [1, 2, np.nan, 4, 5])
    assert found.doubts[2] == "the command changes during the step"


def test_rows_without_times_are_found_by_a_number(tmp_path: Path) -> None:
    """A number that occurs in two separate parts of the log, or never, gives no time."""
    rows = [f"{0.1 * row:.1f},{position}" for row, position in enumerate([1.5, 1.5, 2.5, 2.5, 3.5, 1.5, 4.5, 4.5])]
    (tmp_path / "log.csv").write_text("\n".join(["t,position", *rows]))
    (tmp_path / "plan.csv").write_text('start,v\n1.5,"[7 0]"\n2.5,"[8, 0]"\n9.5,[9]\n4.5,[]\n')
    log = read_signal_log(str(tmp_path / "log.csv"), "", {})
    settings = SectionSettings(height="y", state=("y",), plan_match="start=position", factors={"v[0]": 10.0})
    plans = read_plans(tmp_path / "plan.csv", log, settings)
    np.testing.assert_allclose(plans.time, [np.nan, 0.2, np.nan, 0.6])
    found = plans.signal("v[0]")
    assert found is not None
    assert (found.time.tolist(), found.values.tolist()) == ([0.2], [80.0])
    assert plans.signal("w") is None


def test_a_plan_needs_times(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,position\n0,1\n1,2\n")
    (tmp_path / "plan.csv").write_text("start,v\n7,1\n8,2\n")
    log = read_signal_log(str(tmp_path / "log.csv"), "", {})
    settings = {"height": "y", "state": ("y",)}
    with pytest.raises(RecordError, match=r"plan.csv: no column 'time'.*name the time of the plan by --plan-time"):
        read_plans(tmp_path / "plan.csv", log, SectionSettings(**settings))
    with pytest.raises(RecordError, match=r"plan.csv: no number of 'start' occurs once in 'position' of .*log.csv"):
        read_plans(tmp_path / "plan.csv", log, SectionSettings(**settings, plan_match="start=position"))
