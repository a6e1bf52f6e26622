"""Differences of a simulated walking robot from its model: those of any MuJoCo model, a load, and an individual."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from dataclasses import dataclass
from math import radians
from typing import Any, Self

import mujoco
import numpy as np

from stepgap.mujoco_robots.mjcf.mjcf_gap import MjcfGap
from stepgap.robots.gap import NOT_NEGATIVE, Drawn, Rule, difference, within

_WHOLE = Rule(lambda value: value >= 0 and value == int(value), "be a whole number from 0 on")


@dataclass(frozen=True)
class WalkingGap(MjcfGap):
    """Differences of the simulated walking robot from its model; SI units."""

    mass_scale: float = difference(1.0, exact=1.0, drawn=Drawn(0.95, 1.05))
    """Factor on all masses and inertias."""

    payload: float = difference(1.5, NOT_NEGATIVE, exact=0.0, drawn=Drawn(0.0, 3.0))
    """Mass of a load on the first body [kg]; its own moments of inertia are left out."""

    damping_scale: float = difference(1.0, exact=1.0, drawn=Drawn(0.7, 2.0), whole=1.5)
    """Factor on the damping of all joints with actuators."""

    slope: float = difference(0.03, within(0.5, "lie between -0.5 and 0.5"), exact=0.0, drawn=Drawn(-0.07, 0.07))
    """Slope of the ground in the direction of x, uphill positive [rad]."""

    delay: float = difference(0.004, NOT_NEGATIVE, exact=0.0, drawn=Drawn(0.0, 0.01))
    """Time by which control signals come later [s]; rounded to ticks."""

    state_noise: float = difference(0.02, NOT_NEGATIVE, exact=0.0)
    """Standard deviation of the noise of measured velocities, in half ranges of use."""

    force_noise: float = difference(0.0, NOT_NEGATIVE, exact=0.0)
    """Standard deviation of the noise of each control signal, relative to the signal."""

    payload_x: float = difference(0.05, exact=0.0, drawn=Drawn(-0.08, 0.08))
    """Place of the load, ahead of the middle of the first body [m]."""

    payload_y: float = difference(0.03, exact=0.0, drawn=Drawn(-0.05, 0.05))
    """Place of the load, to the left [m]."""

    payload_z: float = difference(0.05, exact=0.0, drawn=Drawn(0.0, 0.08))
    """Place of the load, upward [m]."""

    joint_offset: float = difference(radians(1.0), NOT_NEGATIVE, exact=0.0)
    """Standard deviation of the zeros of the joints that position servos move [rad]."""

    motor_spread: float = difference(0.1, within(0.9, "lie between -0.9 and 0.9"), exact=0.0)
    """Largest deviation of the strength of a single motor from that of the model, as a share."""

    individual: float = difference(1.0, _WHOLE, drawn=Drawn(1, 2**31))
    """Whole number of the individual, of which offsets and deviations of its motors are drawn."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """Differences drawn independently and uniformly, with another individual."""
        drawn = cls.draw(rng)
        return cls(**drawn | {"individual": float(int(drawn["individual"]))})

    def of(self, model: Any) -> Any:
        """A copy of a MuJoCo model with these differences; delay, lag and noise are not in it."""
        changed = super().of(model)
        place = np.array([self.payload_x, self.payload_y, self.payload_z])
        changed.body_ipos[1] += self.payload / changed.body_mass[1] * (place - changed.body_ipos[1])
        rng = np.random.default_rng(int(self.individual))
        strength = 1 + self.motor_spread * rng.uniform(-1, 1, (changed.nu, 1))
        offset = self.joint_offset * rng.standard_normal(changed.nu)
        for forces in (changed.actuator_gainprm, changed.actuator_biasprm, changed.actuator_forcerange):
            forces *= strength
        servos = changed.actuator_biastype != int(mujoco.mjtBias.mjBIAS_NONE)
        changed.actuator_biasprm[servos, 0] += (changed.actuator_gainprm[:, 0] * offset)[servos]
        mujoco.mj_setConst(changed, mujoco.MjData(changed))
        return changed
