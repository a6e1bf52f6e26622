"""MuJoCo's C library, and its callbacks, which hold for the whole process: no log file, no timing of stages."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import sys
from ctypes import CDLL, c_void_p

import mujoco


def c_library() -> CDLL:
    """MuJoCo's C library, as Python has loaded it.

    Raises:
        OSError: It cannot be reached.
    """
    return CDLL(sys.modules[mujoco.mj_step.__module__].__file__)


def set_mujoco_callbacks() -> None:
    """Sets the callbacks; to be called before a model is stepped.

    By default, MuJoCo writes warnings to `MUJOCO_LOG.TXT` in the current folder. They are left out:
    `mujoco_faults` says what they mean, and the plants report it as a failed step.

    MuJoCo's Python package installs a clock, which `mj_step` reads before and after each of its stages for
    `mjData.timer`. For models as small as the hopper's, that takes a sixth of a step. MuJoCo's C library starts without
    a clock, and so does StepGap. A clock that the caller has installed by `mujoco.set_mjcb_time` is kept.
    """
    mujoco.set_mju_user_warning(lambda message: None)
    if mujoco.get_mjcb_time() is None:
        try:
            clock = c_void_p.in_dll(c_library(), "mjcb_time")
        except (OSError, ValueError):
            return  # where the C library cannot be reached, steps only take longer
        clock.value = None
