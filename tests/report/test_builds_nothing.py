"""The report needs only a finished record: its modules import no simulator, plant or experiment."""

import subprocess
import sys
from pathlib import Path

import stepgap.report

BUILDERS = (
    "mujoco",
    "stepgap.experiment.loop",
    "stepgap.experiment.plants",
    "stepgap.sweep",
    "stepgap.plants.model_plant",
    "stepgap.hardware.realtime",
    "stepgap.plants.rig_plant",
    "stepgap.robots.hopper.twin",
)
"""Modules that build or run a plant or a twin."""


def test_no_module_of_the_report_imports_a_builder() -> None:
    folder = Path(stepgap.report.__file__).parent
    paths = [path.relative_to(folder).with_suffix("") for path in sorted(folder.rglob("*.py"))]
    modules = [f"stepgap.report.{'.'.join(path.parts)}" for path in paths if path.stem != "__init__"]
    assert len(modules) > 10
    imports = "\n".join(f"import {module}" for module in modules)
    reached = f"{imports}\nimport sys\nprint([name for name in {BUILDERS} if name in sys.modules])"
    result = subprocess.run([sys.executable, "-c", reached], capture_output=True, text=True, check=True)
    assert result.stdout == "[]\n"
