"""Packages with plug-ins, as pip installs them, without pip: those of the documentation."""

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_DOCS = Path(__file__).parents[2] / "docs"
_PAGE = (_DOCS / "own_robot.md").read_text("utf-8")
WEIGHTS_TOML, PYPROJECT, CUSTOM_TOML, TEMPLATE_TOML = re.findall(r"```toml\n(.*?)```", _PAGE, re.DOTALL)


PITCHING = """
from dataclasses import dataclass, field

from stepgap import MapSimulation, Robot
from tests.control.maps import PitchingHopper


@dataclass(frozen=True)
class Gap:
    mass: float = 0.25
    lean: float = 0.1


@dataclass(frozen=True)
class PitchingRobot(Robot):
    name = "pitching"

    gap: Gap = field(default_factory=Gap)

    @property
    def space(self):
        return PitchingHopper().space

    def nominal_maps(self):
        return {"equations": PitchingHopper}

    def simulations(self):
        nominal = PitchingHopper()
        real = PitchingHopper(mass=nominal.mass + self.gap.mass, lean=nominal.lean + self.gap.lean)
        noise = [0.002, 0.0005, 0.004, 0.02]
        return {"heavier": lambda world: MapSimulation(real, start=[0.2, 0.58, 0.0, 0.0], noise=noise)}
"""
"""A robot with more states than commands: pitch and pitch rate are predicted, but not tracked."""


def install(folder: Path) -> None:
    """Makes the files of the packages of these pages in a folder, which is to be on the search path."""
    robots = tomllib.loads(PYPROJECT)["project"]
    robots["entry-points"]["stepgap.robots"]["spring_hopper"] = "spring_hopper:SpringHopper"
    robots["entry-points"]["stepgap.robots"]["pitching"] = "pitching_robot:PitchingRobot"
    modules = {"ball_robot": module_of("own_robot.md"), "spring_hopper": module_of("mujoco_robot.md")}
    install_package(folder, robots, **modules, pitching_robot=PITCHING)
    for heading in ("A verb", "A plant"):
        install_extension(folder, heading)


def install_extension(folder: Path, heading: str) -> None:
    """Makes the files of the package of a section of "extensions.md" with one module and one `pyproject.toml`."""
    section = section_of("extensions.md", heading)
    (text,) = re.findall(r"```toml\n(.*?)```", section, re.DOTALL)
    project = tomllib.loads(text)["project"]
    install_package(folder, project, **{project["name"].replace("-", "_"): module_in(section)})


def section_of(page: str, heading: str) -> str:
    """What stands in a page under a heading of the second level."""
    return (_DOCS / page).read_text("utf-8").partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


def module_of(page: str) -> str:
    """The module of a page, whose later parts are explained further down."""
    return module_in((_DOCS / page).read_text("utf-8"))


def module_in(text: str) -> str:
    """The module of a text, in one part or several."""
    return "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))


def install_package(folder: Path, project: Mapping[str, Any], **modules: str) -> None:
    """Makes the files of a package from the table `project` of its `pyproject.toml` and the texts of its modules."""
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    lines = []
    for group, points in project["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items()), ""]
    (info / "entry_points.txt").write_text("\n".join(lines))
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text, "utf-8")
