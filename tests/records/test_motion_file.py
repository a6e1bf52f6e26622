"""The motion file of a deployment: it is read back as written, or not at all."""

import os
import tracemalloc
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepgap.records.motion_file import read_motion, write_motion
from stepgap.robots.scene import Link, Motion, Scene

SCENE = Scene({"body": 0.1, "foot": 0.02}, (Link("body", "foot", 0.01),), "body", ("foot",), signals={"torque": "N·m"})


def motion(frames: int) -> Motion:
    time = np.arange(frames) / 100
    positions = np.stack([np.outer(np.sin(7 * time), [1.0, 2.0, 3.0]), np.outer(time, [3.0, 2.0, 1.0])], axis=1)
    return Motion(time, np.floor(time), positions, np.zeros((frames, 1)), np.zeros(frames), np.sin(time)[:, None])


def test_a_kept_motion_is_that_of_its_origin(tmp_path: Path) -> None:
    path, kept = tmp_path / "replay" / "one.npz", motion(100)
    written = write_motion(path, kept, "origin")
    found = read_motion(path, SCENE, "origin")
    assert found is not None
    for name in ("time", "step", "positions", "touching", "ground"):
        np.testing.assert_allclose(getattr(found, name), getattr(kept, name), rtol=1e-6)
        np.testing.assert_array_equal(getattr(found, name), getattr(written, name))
    assert read_motion(path, SCENE, "another") is None
    assert read_motion(path, replace(SCENE, points={**SCENE.points, "tail": 0.0}), "origin") is None
    assert read_motion(path, replace(SCENE, feet=()), "origin") is None
    assert read_motion(tmp_path / "none.npz", SCENE, "origin") is None
    assert read_motion(tmp_path, SCENE, "origin") is None


def test_a_damaged_motion_is_none(tmp_path: Path) -> None:
    path = tmp_path / "one.npz"
    write_motion(path, motion(50), "origin")
    whole = path.read_bytes()
    for size in range(0, len(whole), 97):
        path.write_bytes(whole[:size])
        assert read_motion(path, SCENE, "origin") is None
    rng = np.random.default_rng(0)
    for _ in range(200):
        spoilt = bytearray(whole)
        spoilt[rng.integers(len(whole))] ^= 1 << rng.integers(8)
        path.write_bytes(spoilt)
        found = read_motion(path, SCENE, "origin")
        assert found is None or len(found.time) == 50
    np.savez(path, origin=np.array("origin"), step=np.array([{}], object))
    assert read_motion(path, SCENE, "origin") is None


def test_what_is_no_motion_file_takes_neither_memory_nor_time(tmp_path: Path) -> None:
    """One of 3 MB may claim, or hold, gigabytes."""
    np.save(tmp_path / "array.npy", np.zeros(3))
    bomb = b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999,), }".ljust(117)
    members = {
        "decompressed": [("time.npy", bytes(2**28))],
        "claimed": [("time.npy", bomb + b"\n" + bytes(100))],
        "members": [(f"{number}.npy", b"") for number in range(5000)],
    }
    for name, entries in members.items():
        with zipfile.ZipFile(tmp_path / f"{name}.npz", "w", zipfile.ZIP_DEFLATED) as archive:
            for entry, content in entries:
                archive.writestr(entry, content)
    (tmp_path / "array.npy").rename(tmp_path / "array.npz")
    os.mkfifo(tmp_path / "pipe.npz")
    tracemalloc.start()
    for path in tmp_path.glob("*.npz"):
        assert read_motion(path, SCENE, "origin") is None
    assert tracemalloc.get_traced_memory()[1] < 2**24
    tracemalloc.stop()


@pytest.mark.parametrize(
    "changes",
    [{"ground": np.array([1.0, np.nan])}, {"step": np.zeros(3)}, {"time": np.zeros(0)}, {"time": np.float64(1.0)}],
)
def test_an_invalid_motion_is_refused(changes: dict[str, np.ndarray]) -> None:
    with pytest.raises(ValueError, match="motion must"):
        replace(motion(2), **changes)
