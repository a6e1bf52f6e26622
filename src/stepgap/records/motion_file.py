"""Motion files `replay/deployment_K.npz`: the robot's motion in a deployment, as named channels."""

import zipfile
import zlib
from collections.abc import Collection, Mapping
from io import BytesIO
from pathlib import Path
from typing import Final

import numpy as np

from stepgap.base.files import write_whole
from stepgap.step import Array

LARGEST_MOTION: Final = 2**27
"""Largest motion file that is read [bytes]."""

ORIGIN: Final = "origin"
"""Entry that identifies the data from which a motion was computed."""


def motion_path(folder: Path, iteration: int) -> Path:
    """Path of the motion of a deployment."""
    return folder / "replay" / f"deployment_{iteration}.npz"


def check_channels(channels: Mapping[str, Array]) -> None:
    """Raises ValueError unless the channels are rows of finite numbers of equal length, with at least one frame."""
    sizes = {values.shape for values in channels.values()}
    if len(sizes) != 1 or len(next(iter(sizes))) != 1 or sizes == {(0,)}:
        raise ValueError(f"the channels of a motion must be rows of equal length, not of shapes {sorted(sizes)}")
    if not all(np.isfinite(values).all() for values in channels.values()):
        raise ValueError("the channels of a motion must be finite numbers")


def write_motion(path: Path, channels: Mapping[str, Array], origin: str) -> None:
    """Writes the channels of a motion in single precision.

    Args:
        path: The file; replaced if it exists.
        channels: Arrays of shape (F,) by name.
        origin: Identifies the data from which the motion was computed.
    """
    stream = BytesIO()
    single = {name: values.astype(np.float32) for name, values in channels.items()}
    np.savez_compressed(stream, allow_pickle=False, **{ORIGIN: np.array(origin)}, **single)
    write_whole(path, stream.getvalue())


def read_motion(path: Path, names: Collection[str], origin: str) -> dict[str, Array] | None:
    """Reads the channels of a motion; None if there is no file, it is damaged, or it has another origin.

    Args:
        path: The file.
        names: Names of the channels.
        origin: Identifies the data from which the motion must have been computed.
    """
    try:
        if path.stat().st_size > LARGEST_MOTION:
            return None
        with np.load(BytesIO(path.read_bytes()), allow_pickle=False) as kept:
            if str(kept[ORIGIN]) != origin:
                return None
            channels = {name: kept[name].astype(float) for name in names}
        check_channels(channels)
        return channels
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, RuntimeError):
        return None  # RuntimeError: a damaged header may mark an entry as encrypted or give an unknown compression
