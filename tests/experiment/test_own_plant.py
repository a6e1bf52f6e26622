"""The plants of docs/extensions.md, found by their names; the fixture `package` installs them."""

import json
from pathlib import Path

import pytest

from tests.cli.command_line import Command, refused

pytestmark = pytest.mark.usefixtures("package", "no_report")


@pytest.mark.parametrize("plant", ["driver", "worn"])
def test_a_run_learns_on_it(stepgap: Command, tmp_path: Path, plant: str) -> None:
    result = stepgap("run", "--robot", "ball", "--plant", plant, "--iterations", "1", "--out", plant, "--quiet")
    assert (result.code, result.err) == (0, "")
    deployments = json.loads((tmp_path / plant / "summary.json").read_text())["iterations"]
    before, after = (deployment["rmse"]["height"] for deployment in deployments)
    assert after < 0.3 * before


def test_a_simulated_plant_belongs_to_one_robot(stepgap: Command) -> None:
    refused(
        stepgap("run", "--plant", "worn"),
        "--plant worn: unknown; it must be one of twin, emulated-ring, ",
        "driver, process",
    )


def test_a_plant_refuses_the_options_of_a_rig(stepgap: Command) -> None:
    refused(stepgap("run", "--robot", "ball", "--plant", "driver", "--rig", "rig.toml"), "plant 'driver' takes neither")
