"""Arrays in messages whose names change their places: each name is a column of its own."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.reading import read_log_tables

KNEE = np.arange(6) * 0.5
HIP = 10.0 - np.arange(6)


def read(path: Path, messages: list[dict[str, Any]]) -> LogTable:
    path.write_text("".join(f"{json.dumps(message)}\n" for message in messages))
    return read_log_tables(path)[""]


def joint_states(turned: set[int]) -> list[dict[str, Any]]:
    """Messages with two joints, whose order is another one in some of them."""
    rows = []
    for row in range(6):
        joints = [("knee", KNEE[row]), ("hip", HIP[row])][:: -1 if row in turned else 1]
        rows.append({"t": row, "name": [name for name, _ in joints], "position": [value for _, value in joints]})
    return rows


def test_joints_that_change_their_places_are_columns_by_name(tmp_path: Path) -> None:
    with pytest.warns(StepGapWarning, match=r"order of name differs from message to message, so .* by name"):
        table = read(tmp_path / "log.jsonl", joint_states({1, 4, 5}))
    np.testing.assert_array_equal(table.numbers("position[knee]"), KNEE)
    np.testing.assert_array_equal(table.numbers("position[hip]"), HIP)
    assert table.fault_of("position[0]") == "no column 'position[0]'; did you mean 'position[hip]'?"


def test_joints_in_one_order_are_columns_by_index(tmp_path: Path) -> None:
    table = read(tmp_path / "log.jsonl", joint_states(set()))
    np.testing.assert_array_equal(table.numbers("position[1]"), HIP)
    assert "position[hip]" not in table.columns


def test_two_programs_that_publish_their_joints_on_one_topic(tmp_path: Path) -> None:
    messages = [{"name": ["arm"], "position": [7.0]} if row % 2 else joint_states(set())[row] for row in range(6)]
    with pytest.warns(StepGapWarning, match="by name"):
        table = read(tmp_path / "log.jsonl", messages)
    np.testing.assert_array_equal(table.numbers("position[arm]"), [np.nan, 7, np.nan, 7, np.nan, 7])
    np.testing.assert_array_equal(table.numbers("position[hip]"), [10, np.nan, 8, np.nan, 6, np.nan])


def test_transforms_of_several_bodies(tmp_path: Path) -> None:
    """Each message has one, as those of turtles, motion capture and robot state publishers."""
    messages = [
        {"transforms": [{"child_frame_id": "trunk" if row % 2 else "foot 1", "transform": {"x": float(row)}}]}
        for row in range(4)
    ]
    with pytest.warns(StepGapWarning, match=r"transforms\[foot_1\]"):
        table = read(tmp_path / "log.jsonl", messages)
    np.testing.assert_array_equal(table.numbers("transforms[trunk].transform.x"), [np.nan, 1, np.nan, 3])
    np.testing.assert_array_equal(table.numbers("transforms[foot_1].transform.x"), [0, np.nan, 2, np.nan])


def test_interfaces_of_joints_within_joints(tmp_path: Path) -> None:
    """As of `control_msgs/DynamicJointState`, whose joints and their interfaces both have names."""

    def of_joint(names: list[str], first: float) -> dict[str, Any]:
        return {"interface_names": names, "values": [first + "pv".index(name) for name in names]}

    messages = [
        {"joint_names": ["a", "b"], "interface_values": [of_joint(["p", "v"], 0.0), of_joint(["p", "v"], 10.0)]},
        {"joint_names": ["b", "a"], "interface_values": [of_joint(["v", "p"], 10.0), of_joint(["p", "v"], 0.0)]},
    ]
    with pytest.warns(StepGapWarning, match="by name"):
        table = read(tmp_path / "log.jsonl", messages)
    np.testing.assert_array_equal(table.numbers("interface_values[b].values[v]"), [11, 11])
    np.testing.assert_array_equal(table.numbers("interface_values[a].values[1]"), [1, 1])


@pytest.mark.parametrize(
    ("names", "reason"), [(["a", "a"], "position was left out: .* 'a' twice"), (["b:", "b;"], "two names differ")]
)
def test_names_that_do_not_tell_apart_are_left_out_with_the_reason(
    tmp_path: Path, names: list[str], reason: str
) -> None:
    messages = [{"t": 0, "name": ["a", "b"], "position": [1, 2]}, {"t": 1, "name": names, "position": [3, 4]}]
    table = read(tmp_path / "log.jsonl", messages)
    assert list(table.columns) == ["t"]
    assert re.search(reason, table.fault_of("position[0]"))
