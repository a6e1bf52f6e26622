"""Differences of a simulated robot from its MuJoCo model: the reality gap of a robot from MJCF."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from copy import deepcopy
from dataclasses import dataclass
from math import cos, sin, sqrt
from typing import Any, Self

import mujoco
import numpy as np

from stepgap.robots.gap import NOT_NEGATIVE, POSITIVE, Drawn, Gap, difference, within


@dataclass(frozen=True)
class MjcfGap(Gap):
    """Differences of the simulated robot from its model; SI units."""

    mass_scale: float = difference(1.06, POSITIVE, exact=1.0, drawn=Drawn(0.9, 1.15))
    """Factor on all masses and inertias."""

    payload: float = difference(0.0, NOT_NEGATIVE, exact=0.0, whole=0.5)
    """Mass added to the first body [kg]."""

    friction_scale: float = difference(0.8, POSITIVE, exact=1.0, drawn=Drawn(0.6, 1.2))
    """Factor on the sliding friction of all geoms."""

    damping_scale: float = difference(1.5, POSITIVE, exact=1.0, drawn=Drawn(0.7, 2.0))
    """Factor on the damping of all joints with actuators."""

    joint_friction: float = difference(0.0, NOT_NEGATIVE, exact=0.0, whole=0.1)
    """Dry friction added to all joints with actuators [N·m or N]."""

    gear_scale: float = difference(0.93, POSITIVE, exact=1.0, drawn=Drawn(0.85, 1.05))
    """Factor on the forces of all actuators."""

    slope: float = difference(
        0.0, within(0.5, "lie between -0.5 and 0.5"), exact=0.0, drawn=Drawn(-0.01, 0.01), whole=0.01
    )
    """Slope of the ground in the direction of x, uphill positive [rad]."""

    delay: float = difference(0.002, NOT_NEGATIVE, exact=0.0, drawn=Drawn(0.0, 0.004))
    """Time by which control signals come later [s]; rounded to ticks."""

    ground_softness: float = difference(1.0, POSITIVE, exact=1.0, whole=1.5)
    """Factor on the static sinkage of all contacts, as far as their impedance (solimp) does not vary with it; their
    damping ratio stays."""

    motor_lag: float = difference(0.0, NOT_NEGATIVE, exact=0.0, whole=0.004)
    """Time constant of the first-order lag of all control signals [s]."""

    state_noise: float = difference(0.005, NOT_NEGATIVE, exact=0.0)
    """Standard deviation of the noise of measured states, in half ranges of use."""

    force_noise: float = difference(0.01, NOT_NEGATIVE, exact=0.0)
    """Standard deviation of the noise of each control signal, relative to the signal."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """Differences drawn independently and uniformly around those of the default robot."""
        return cls(**cls.draw(rng))

    def of(self, model: Any) -> Any:
        """A copy of a MuJoCo model with these differences; delay, lag and noise are not in it."""
        changed = deepcopy(model)
        changed.body_mass *= self.mass_scale
        changed.body_inertia *= self.mass_scale
        changed.body_mass[1] += self.payload
        changed.geom_friction[:, 0] *= self.friction_scale
        driven = np.unique(changed.actuator_trnid[:, 0])
        dofs = changed.jnt_dofadr[driven[driven >= 0]]
        changed.dof_damping[dofs] *= self.damping_scale
        changed.dof_frictionloss[dofs] += self.joint_friction
        servos = changed.actuator_biastype != int(mujoco.mjtBias.mjBIAS_NONE)
        changed.actuator_gear[~servos] *= self.gear_scale
        for forces in (changed.actuator_gainprm, changed.actuator_biasprm, changed.actuator_forcerange):
            forces[servos] *= self.gear_scale  # a gear would also change the position that a servo holds
        soften(changed.geom_solref, self.ground_softness)
        gravity = float(np.linalg.norm(changed.opt.gravity))
        changed.opt.gravity[:] = (-gravity * sin(self.slope), 0.0, -gravity * cos(self.slope))
        mujoco.mj_setConst(changed, mujoco.MjData(changed))
        return changed


def soften(solref: np.ndarray, factor: float) -> None:
    """Multiplies the static sinkage of contacts; (time constant, damping ratio) or −(stiffness, damping), shape (k, 2).

    The stiffness is proportional to the inverse square of the time constant.
    """
    direct = solref[:, 0] < 0
    solref[direct] /= np.array([factor, sqrt(factor)])
    solref[~direct, 0] *= sqrt(factor)
