"""Differences of a simulated robot from its MuJoCo model: the reality gap of a robot from MJCF."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from copy import deepcopy
from dataclasses import dataclass, fields
from math import cos, isfinite, sin, sqrt
from typing import Any, Self

import mujoco
import numpy as np

from stepgap.base.ranges import require


@dataclass(frozen=True)
class MjcfGap:
    """Differences of the simulated robot from its model; SI units.

    Attributes:
        mass_scale: Factor on all masses and inertias.
        payload: Mass added to the first body [kg].
        friction_scale: Factor on the sliding friction of all geoms.
        damping_scale: Factor on the damping of all joints with actuators.
        joint_friction: Dry friction added to all joints with actuators [N·m or N].
        gear_scale: Factor on the forces of all actuators.
        slope: Slope of the ground in the direction of x, uphill positive [rad].
        delay: Time by which control signals come later [s]; rounded to ticks.
        ground_softness: Factor on the static sinkage of all contacts, as far as their impedance (solimp) does not vary
            with it; their damping ratio stays.
        motor_lag: Time constant of the first-order lag of all control signals [s].
        state_noise: Standard deviation of the noise of measured states, in half ranges of use.
        force_noise: Standard deviation of the noise of each control signal, relative to the signal.
    """

    mass_scale: float = 1.06
    payload: float = 0.0
    friction_scale: float = 0.8
    damping_scale: float = 1.5
    joint_friction: float = 0.0
    gear_scale: float = 0.93
    slope: float = 0.0
    delay: float = 0.002
    ground_softness: float = 1.0
    motor_lag: float = 0.0
    state_noise: float = 0.005
    force_noise: float = 0.01

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            require(isfinite(value), entry.name, value, "be finite")
            if entry.name.endswith("_scale") or entry.name == "ground_softness":
                require(value > 0, entry.name, value, "be positive")
            elif entry.name != "slope":
                require(value >= 0, entry.name, value, "not be negative")
        require(abs(self.slope) < 0.5, "slope", self.slope, "lie between -0.5 and 0.5")

    @classmethod
    def none(cls) -> Self:
        """No difference."""
        return cls(
            mass_scale=1.0,
            friction_scale=1.0,
            damping_scale=1.0,
            gear_scale=1.0,
            delay=0.0,
            state_noise=0.0,
            force_noise=0.0,
        )

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """Differences drawn independently and uniformly around those of the default robot."""
        return cls(
            mass_scale=rng.uniform(0.9, 1.15),
            friction_scale=rng.uniform(0.6, 1.2),
            damping_scale=rng.uniform(0.7, 2.0),
            gear_scale=rng.uniform(0.85, 1.05),
            slope=rng.uniform(-0.01, 0.01),
            delay=rng.uniform(0.0, 0.004),
        )

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
        changed.actuator_gear *= self.gear_scale
        _soften(changed.geom_solref, self.ground_softness)
        gravity = float(np.linalg.norm(changed.opt.gravity))
        changed.opt.gravity[:] = (-gravity * sin(self.slope), 0.0, -gravity * cos(self.slope))
        mujoco.mj_setConst(changed, mujoco.MjData(changed))
        return changed


def _soften(solref: np.ndarray, factor: float) -> None:
    """Multiplies the static sinkage of contacts; (time constant, damping ratio) or −(stiffness, damping), shape (k, 2).

    The stiffness is proportional to the inverse square of the time constant.
    """
    direct = solref[:, 0] < 0
    solref[direct] /= np.array([factor, sqrt(factor)])
    solref[~direct, 0] *= sqrt(factor)
