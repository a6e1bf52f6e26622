"""The part of YAML that trainings write is read as PyYAML reads it; nothing in a file is called."""

import pytest
import yaml

from stepgap.mujoco_robots.velocity.policy.yaml_text import parse_yaml

DOCUMENT = """# a comment
---
joint_ids_map: [3, 4,
  -5]  # goes on
step_dt: 2e-2
half: .5
sub: {command_name: base, nested: {a: [1, 'x, y'], b: null}, empty: {}}
"quoted key": "a: b # no comment"
description: Joint action that applies the joints'
  targets as commands.
note: 'The positions.

  Note: only some.'
actions:
- name: first
  clip: null
  joint_names: &names
  - FL_hip
  - .*_calf
-
  name: ~
  joint_names: *names
- - 1
  - true
- [[-100.0, 100.0], []]
last:
"""


def test_a_document_is_read_as_by_another_reader() -> None:
    assert parse_yaml(DOCUMENT.replace("\n\n", "\n")) == yaml.safe_load(DOCUMENT.replace("\n\n", "\n")) | {
        "step_dt": 0.02  # a number for YAML 1.2, not for the 1.1 of PyYAML
    }


def test_tags_are_passed_over_and_nothing_is_called() -> None:
    text = "a: !!python/object/apply:os.system ['touch gone']\nb: !!python/tuple\n- 1\nc: !x 2\n"
    assert parse_yaml(text) == {"a": ["touch gone"], "b": [1], "c": 2}
    assert parse_yaml("") is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: [1, 2", "brackets that are not closed"),
        ("a: [1] 2", "goes on behind its last bracket"),
        ("a: 1\n  b: 2\n", "'b: 2' is neither a key, nor an item"),
        ("[" * 100_000, "nested too deeply|not closed"),
        ("- " * 5000 + "a", "nested too deeply"),
    ],
)
def test_what_it_is_not_is_said(text: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_yaml(text)
