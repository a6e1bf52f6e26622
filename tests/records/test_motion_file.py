"""The motion file of a deployment: it is read back as written, or not at all."""

from pathlib import Path

import numpy as np

from stepgap.records.motion_file import read_motion, write_motion

NAMES = ("travel", "height", "force")


def channels(frames: int) -> dict[str, np.ndarray]:
    time = np.arange(frames) / 100
    return {"travel": 0.2 * time, "height": 0.5 + 0.1 * np.sin(7 * time), "force": np.zeros(frames)}


def test_a_kept_motion_is_that_of_its_origin(tmp_path: Path) -> None:
    path, kept = tmp_path / "replay" / "one.npz", channels(100)
    write_motion(path, kept, "origin")
    found = read_motion(path, NAMES, "origin")
    assert found is not None
    assert list(found) == list(NAMES)
    for name in NAMES:
        np.testing.assert_allclose(found[name], kept[name], rtol=1e-6)
    assert read_motion(path, NAMES, "another") is None
    assert read_motion(path, (*NAMES, "colour"), "origin") is None
    assert read_motion(tmp_path / "none.npz", NAMES, "origin") is None
    assert read_motion(tmp_path, NAMES, "origin") is None


def test_a_damaged_motion_is_none(tmp_path: Path) -> None:
    path = tmp_path / "one.npz"
    write_motion(path, channels(50), "origin")
    whole = path.read_bytes()
    for size in range(0, len(whole), 97):
        path.write_bytes(whole[:size])
        assert read_motion(path, NAMES, "origin") is None
    rng = np.random.default_rng(0)
    for _ in range(200):
        spoilt = bytearray(whole)
        spoilt[rng.integers(len(whole))] ^= 1 << rng.integers(8)
        path.write_bytes(spoilt)
        found = read_motion(path, NAMES, "origin")
        assert found is None or {len(values) for values in found.values()} == {50}
    np.savez(path, origin=np.array("origin"), step=np.array([{}], object))
    assert read_motion(path, ("step",), "origin") is None


def test_invalid_channels_give_no_motion(tmp_path: Path) -> None:
    for name, bad in (("nan", np.array([1.0, np.nan])), ("long", np.zeros(3)), ("square", np.zeros((2, 1)))):
        path = tmp_path / f"{name}.npz"
        write_motion(path, {"travel": np.zeros(2), "height": np.zeros(2), "force": bad}, "origin")
        assert read_motion(path, NAMES, "origin") is None
