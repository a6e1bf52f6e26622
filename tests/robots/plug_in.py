"""Packages with robots, as pip installs them, without pip: those of the documentation."""

import re
import tomllib
from pathlib import Path

_DOCS = Path(__file__).parents[2] / "docs"
_PAGE = (_DOCS / "own_robot.md").read_text("utf-8")
(_BALL,) = re.findall(r"```python\n(.*?)```", _PAGE, re.DOTALL)
(_SPRING_HOPPER,) = re.findall(r"```python\n(.*?)```", (_DOCS / "mujoco_robot.md").read_text("utf-8"), re.DOTALL)
PYPROJECT, CUSTOM_TOML, TEMPLATE_TOML = re.findall(r"```toml\n(.*?)```", _PAGE, re.DOTALL)


def install(folder: Path) -> None:
    """Makes the files of a package with the robots of both pages in a folder, which is to be on the search path."""
    project = tomllib.loads(PYPROJECT)["project"]
    info = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {project['name']}\nVersion: {project['version']}\n")
    ((group, points),) = project["entry-points"].items()
    points["spring_hopper"] = "spring_hopper:SpringHopper"
    lines = [f"[{group}]", *(f"{name} = {value}" for name, value in points.items()), ""]
    (info / "entry_points.txt").write_text("\n".join(lines))
    (folder / "ball_robot.py").write_text(_BALL, "utf-8")
    (folder / "spring_hopper.py").write_text(_SPRING_HOPPER, "utf-8")
