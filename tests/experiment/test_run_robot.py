"""The robot of a run folder: units and the published result come from its settings, not from names of columns."""

from pathlib import Path

import numpy as np
import pytest

from stepgap.experiment.replay import replay_of
from stepgap.experiment.run import Run
from stepgap.records.missing import Missing
from stepgap.robots.hopper.paper import paper_reference
from tests.report.runs import write_run

CUSTOM = """robot = "custom"
[[quantities.state]]
name = "speed"
unit = "mm/s"
lower = 0.0
upper = 400.0
[[quantities.state]]
name = "height"
unit = "mm"
lower = 500.0
upper = 700.0
[[quantities.command]]
name = "{command}"
unit = "kN"
lower = -1.0
upper = 1.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run along the paper's reference by a robot with the names of the hopper's state, and another command."""
    return write_run(tmp_path / "run", ("speed", "height"), 227, 1, targets=paper_reference().targets)


def test_units_are_those_of_the_settings(folder: Path) -> None:
    (folder / "experiment.toml").write_text(CUSTOM.format(command="push"), encoding="utf-8")
    run = Run(folder).checked()
    assert [quantity.unit for quantity in (*run.space.state, *run.space.command)] == ["mm/s", "mm", "kN"]
    np.testing.assert_array_equal(run.steps.target, paper_reference().targets)
    assert run.compared_result is None, "it is not the paper's robot"


@pytest.mark.parametrize("settings", [None, "seed = 1\n", CUSTOM.format(command="fx"), "no_setting = 1\n"])
def test_settings_of_other_steps_give_no_units(folder: Path, settings: str | None) -> None:
    if settings is not None:
        (folder / "experiment.toml").write_text(settings, encoding="utf-8")
    run = Run(folder).checked()
    for part in (run.robot, run.nominal, replay_of(run)):
        assert isinstance(part, Missing)
    assert [quantity.unit for quantity in (*run.space.state, *run.space.command)] == ["", "", ""]
    assert run.published is None
