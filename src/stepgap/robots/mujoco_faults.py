"""What MuJoCo finds wrong in a simulation, and would mend without a word.

By default, `mj_step` puts a model that diverges back to its first posture within the step, after which all numbers are
finite again; it leaves out contacts for which its buffers have no room, and control signals that are no numbers. It
counts all of this in `mjData.warning`.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from math import isfinite
from typing import Any, Final

import mujoco

_OF_MOTION: Final = {
    mujoco.mjtWarning.mjWARN_BADQPOS: ("position", "qpos"),
    mujoco.mjtWarning.mjWARN_BADQVEL: ("velocity", "qvel"),
    mujoco.mjtWarning.mjWARN_BADQACC: ("acceleration", "qacc"),
}
"""Name and array of what is no number, or too large, by the warning, in the order in which a step looks at them."""

_FULL: Final = {
    mujoco.mjtWarning.mjWARN_CONTACTFULL: "some contacts were left out, since there is no memory for so many",
    mujoco.mjtWarning.mjWARN_CNSTRFULL: "some forces of contacts were left out, since there is no memory for so many",
}
_INERTIA: Final = "the inertia of a joint was too small to compute with; make it larger, or give the joint armature"
_CAUSES: Final = (
    "lower gains that are too high for so light a joint, give it more armature, or make time step and tick shorter"
)


def keep_divergence(model: Any) -> None:
    """Lets a model that diverges do so, instead of being reset within a step; to be called before it is stepped."""
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)


def mujoco_fault(model: Any, data: Any) -> str:
    """What is wrong in a simulation since its last reset, with its time and what to do; empty if nothing is."""
    counts = data.warning.number
    if not counts.any():
        return ""
    now = f"after {data.time:.4g} s"
    number = int(data.warning[mujoco.mjtWarning.mjWARN_BADCTRL].lastinfo)
    if counts[mujoco.mjtWarning.mjWARN_BADCTRL] and not isfinite(data.ctrl[number]):
        name = model.actuator(number).name or number
        return f"{now} the control signal of actuator {name!r} was {data.ctrl[number]}; correct the controller"
    first = max(_OF_MOTION, key=lambda warning: counts[warning])  # what is bad first is counted most often
    if counts[first]:
        what, key = _OF_MOTION[first]
        joint, value = _worst(model, getattr(data, key), data.warning[first].lastinfo, key)
        size = f" ({value:.2g})" if isfinite(value) else ""
        return (
            f"the simulation became unstable {now}: the {what} of joint {joint!r} grew without bound{size}, with a "
            f"time step of {model.opt.timestep:g} s; {_CAUSES}"
        )
    for warning, sentence in _FULL.items():
        if counts[warning]:
            return f'{now} {sentence}; give the model <size memory="100M"/>'
    if counts[mujoco.mjtWarning.mjWARN_INERTIA]:
        return f"{now} {_INERTIA}"
    return f"the simulation became unstable {now}: a control signal is too large; {_CAUSES}"


def _worst(model: Any, values: Any, first: int, key: str) -> tuple[str | int, float]:
    """Name, or number, of the joint whose number is largest, or of the first bad one; and this number."""
    largest = int(abs(values).argmax()) if all(map(isfinite, values)) else first
    starts = model.jnt_qposadr if key == "qpos" else model.jnt_dofadr
    joint = int((starts <= largest).sum()) - 1
    return model.joint(joint).name or joint, float(values[largest])
