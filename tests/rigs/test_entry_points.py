"""Rigs are found by name, and a fault of one is reported in a line."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from stepgap.base.errors import InputError
from stepgap.hardware.ethercat.ethercat_rig import EthercatRig
from stepgap.hardware.moteus.moteus_rig import MoteusRig
from stepgap.rigs.entry_points import load_rig, rig_names
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.sensors import hopper_sensors

ROOT, ROBOT = Path(__file__).parents[2], Hopper()
Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Installs a package with rigs where Python finds it, as pip does."""
    monkeypatch.syspath_prepend(tmp_path)

    def write(package: str, code: str, metadata: str = "", **rigs: str) -> None:
        info = tmp_path / f"{package}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n{metadata}")
        lines = [f"{name} = {value}" for name, value in rigs.items()]
        (info / "entry_points.txt").write_text("\n".join(["[stepgap.rigs]", *lines, ""]))
        (tmp_path / f"{package}.py").write_text(code)

    return write


@pytest.mark.parametrize(
    ("name", "settings", "kind"), [("ethercat", "rig.toml", EthercatRig), ("moteus", "moteus.toml", MoteusRig)]
)
def test_our_rigs_are_found_with_their_examples(name: str, settings: str, kind: type) -> None:
    assert name in rig_names()
    rig = load_rig(name, ROOT / "examples" / settings, ROBOT)
    assert isinstance(rig, kind)
    assert hopper_sensors(rig.sensor_model).boom_length == ROBOT.parameters.boom_length
    with pytest.raises(RigFault, match="not connected"):
        rig.read()


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"^rig 'motues': unknown; did you mean moteus\? .*here are ethercat, moteus"):
        load_rig("motues", Path("any.toml"), ROBOT)
    with pytest.raises(InputError, match=r"^rig 'xyzzy': unknown; the rigs installed here are ethercat, moteus"):
        load_rig("xyzzy", Path("any.toml"), ROBOT)


def test_an_error_of_a_rigs_settings_is_passed_on(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: No such file"):
        load_rig("moteus", tmp_path / "none.toml", ROBOT)


def test_another_packages_rig_gets_settings_and_robot(install: Install) -> None:
    code = """
from stepgap import Twin, RealityGap
import numpy as np
def make(settings, robot):
    return Twin(robot.parameters, RealityGap(), np.random.default_rng(0), start_height=float(settings.name))
"""
    install("own_twin", code, own="own_twin:make")
    assert "own" in rig_names()
    with load_rig("own", Path("0.5"), ROBOT) as rig:
        rig.read()


BROKEN = {
    "missing": (
        "import no_such_driver",
        "",
        "broken:make",
        "rig 'own' needs no_such_driver: pip install 'no_such_driver'",
    ),
    "extra": (
        "import no_such_driver.can",
        "Provides-Extra: own\n",
        "broken:make",
        "rig 'own' needs no_such_driver: pip install 'broken[own]'",
    ),
    "library": (
        "raise ImportError('libsocket.so: cannot open')",
        "",
        "broken:make",
        "rig 'own': broken:make of broken cannot be imported: libsocket.so: cannot open",
    ),
    "attribute": ("", "", "broken:make", "rig 'own': broken:make of broken cannot be imported: module 'broken' has no"),
    "no callable": ("make = 3", "", "broken:make", "rig 'own': broken:make of broken must be callable with (settings"),
    "no rig": (
        "def make(settings, robot): return 3",
        "",
        "broken:make",
        "rig 'own': its entry point must return a stepgap Rig, not int",
    ),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_rig_is_reported_in_a_line(install: Install, monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    code, metadata, value, expected = BROKEN[what]
    monkeypatch.delitem(sys.modules, "broken", raising=False)
    install("broken", code, metadata, own=value)
    with pytest.raises(InputError) as caught:
        load_rig("own", Path("any.toml"), ROBOT)
    assert str(caught.value).startswith(expected)
    assert "\n" not in str(caught.value)


def test_two_packages_with_one_name_are_refused(install: Install) -> None:
    install("one_robot", "", own="one_robot:make")
    install("other_robot", "", own="other_robot:make")
    with pytest.raises(InputError, match="rig 'own': offered by one_robot and by other_robot; uninstall one of them"):
        load_rig("own", Path("any.toml"), ROBOT)
