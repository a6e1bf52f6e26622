"""The rig of docs/own_rig.md: its code runs, is found by its name, and keeps the contract."""

import re
import socket
import sys
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.rigs.entry_points import load_rig
from stepgap.rigs.rig import Rig, RigFault
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from tests.rigs.rig_contract import MakeRig, RigContract

ROOT, ROBOT = Path(__file__).parents[2], RobotParameters()
PAGE = (ROOT / "docs" / "own_rig.md").read_text("utf-8")
MODULE, TRY = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
(PYPROJECT,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the page's package, as pip installs it."""
    info = tmp_path / "own_robot-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: own-robot\nVersion: 1.0\n")
    ((group, points),) = tomllib.loads(PYPROJECT)["project"]["entry-points"].items()
    lines = [f"{name} = {value}" for name, value in points.items()]
    (info / "entry_points.txt").write_text("\n".join([f"[{group}]", *lines, ""]))
    (tmp_path / "own_robot.py").write_text(MODULE, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "own_robot", raising=False)
    return tmp_path


def names_of_the_page() -> dict[str, Any]:
    """The definitions of the page's second block, before it starts anything."""
    names: dict[str, Any] = {}
    exec(compile(TRY.partition("\nrobot = ")[0], "docs/own_rig.md", "exec"), names)  # noqa: S102  (our own document)
    return names


@contextmanager
def board_rig(folder: Path) -> Iterator[Rig]:
    """The page's rig by its name, connected to the twin."""
    board, settings = names_of_the_page()["board"], folder / "board.toml"
    twin = Twin(ROBOT, replace(RealityGap(), torque_limit=np.inf), np.random.default_rng(0))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        address = server.getsockname()
        thread = Thread(target=board, args=(server, twin))
        thread.start()
        settings.write_text(
            f'host = "127.0.0.1"\nport = {address[1]}\ntorque_limit = 20\npivot_height = 0.4\nreply_timeout = 2.0\n'
        )
        try:
            yield load_rig("board", settings, Hopper(parameters=ROBOT))
        finally:
            server.sendto(b"", address)
            thread.join()


@pytest.mark.usefixtures("installed")
def test_the_page_hops(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(TRY, "docs/own_rig.md", "exec"), {"__name__": "page"})  # noqa: S102  (our own document)
    printed = re.fullmatch(r"first apex: (.*) m/s, (.*) m\n", capsys.readouterr().out)
    assert printed
    assert 0.4 < float(printed[2]) < 0.7


class TestOwnRig(RigContract):
    torque_limit, torque_unit = 20.0, 1e-6

    @pytest.fixture
    def make_rig(self, installed: Path) -> MakeRig:
        return lambda: board_rig(installed)


def test_its_settings_are_read_strictly(installed: Path) -> None:
    path = installed / "board.toml"
    for text, expected in (
        ('host = "x"\nport = 1\ntorque_limit = -1\npivot_height = 0.4', "torque_limit = -1.0, but it must be positive"),
        ('hots = "x"', "hots: unknown key; did you mean host?"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=re.escape(f"{path}: {expected}")):
            load_rig("board", path, Hopper(parameters=ROBOT))


def test_a_missing_board_is_a_fault(installed: Path) -> None:
    path = installed / "board.toml"
    path.write_text('host = "127.0.0.1"\nport = 9\ntorque_limit = 20\npivot_height = 0.4\nreply_timeout = 0.001\n')
    with pytest.raises(RigFault, match="does not answer"):
        load_rig("board", path, Hopper(parameters=ROBOT)).connect()


def test_links_have_targets() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", PAGE):
        assert (ROOT / "docs" / target).exists(), target
