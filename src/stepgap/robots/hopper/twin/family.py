"""A family of random twins, to measure learning on more than one robot.

Every difference of the preset `RealityGap()` is drawn independently, between no gap and 1.5 times the preset's
difference; differences of either sign get a random sign. No draw is selected by how well learning works on it.
"""

from dataclasses import replace
from math import isinf
from typing import NamedTuple

import numpy as np

from stepgap.robots.hopper.twin.reality_gap import RealityGap


class Shares(NamedTuple):
    """Range of a difference as a multiple of the preset's difference; 0 is no gap."""

    lowest: float = 0.0
    highest: float = 1.5
    signed: bool = False


EITHER_SIGN = Shares(signed=True)
DRAWN = {
    "body_mass_scale": EITHER_SIGN,
    "leg_mass_scale": EITHER_SIGN,
    "leg_inertia_scale": EITHER_SIGN,
    "body_com_offset": EITHER_SIGN,
    "boom_inertia_scale": Shares(),
    "boom_stiffness": Shares(),
    "boom_friction": Shares(),
    "boom_drag": Shares(),
    "boom_tilt": EITHER_SIGN,
    "ground_stiffness": Shares(),
    "ground_friction": Shares(lowest=0.4, highest=1.2),  # on the arc a foot that never slips would lock the boom
    "ground_roughness": Shares(),
    "ground_slope": EITHER_SIGN,
    "joint_friction": Shares(),
    "joint_damping": Shares(),
    "rotor_inertia": Shares(),
    "torque_scale": Shares(),
    "torque_imbalance": EITHER_SIGN,
    "torque_saturation": Shares(),
    "torque_noise": Shares(),
    "torque_lag": Shares(),
    "delay": Shares(),
    "motor_offset_1": EITHER_SIGN,
    "motor_offset_2": EITHER_SIGN,
}
"""Differences that are drawn; all others (sensors, thresholds, the arc, damping ratios) are the preset's."""

NOT_IN_PRESET = {"boom_drag": 0.2, "torque_imbalance": 0.01, "ground_slope": 3e-4}
"""Differences that the preset does not have, with the values used instead of the preset's."""


def random_gap(rng: np.random.Generator) -> RealityGap:
    """Draws a twin of the family: no gap + share × (preset − no gap), or preset / share where no gap is infinite."""
    none, preset = RealityGap.none(), replace(RealityGap(), **NOT_IN_PRESET)
    values = {}
    for name, shares in DRAWN.items():
        share = rng.uniform(shares.lowest, shares.highest)
        if shares.signed and rng.random() < 0.5:
            share = -share
        absent, present = getattr(none, name), getattr(preset, name)
        values[name] = present / max(share, 1e-3) if isinf(absent) else absent + share * (present - absent)
    return replace(preset, **values)
