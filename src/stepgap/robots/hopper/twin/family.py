"""A family of random twins, to measure learning on more than one robot.

Every difference of the preset `RealityGap()` is drawn independently, between no gap and 1.5 times the preset's
difference; differences of either sign get a random sign. No draw is selected by how well learning works on it.
"""

from collections.abc import Mapping
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
    """Draws a twin of the family."""
    return gap_of_shares(random_shares(rng))


def random_shares(rng: np.random.Generator) -> dict[str, float]:
    """Draws the share of each difference in `DRAWN`."""
    return {name: _random_share(shares, rng) for name, shares in DRAWN.items()}


def gap_of_shares(wanted: Mapping[str, float]) -> RealityGap:
    """Differences by their shares of the preset's: no gap + share × (preset − no gap).

    Where no gap is an infinite value, such as that of a stiffness, the difference is preset / share.

    Args:
        wanted: Share of each difference in `DRAWN`; others are the preset's.

    Raises:
        ValueError: A difference is out of its range.
    """
    none, preset = RealityGap.none(), replace(RealityGap(), **NOT_IN_PRESET)
    values = {}
    for name, share in wanted.items():
        absent, present = getattr(none, name), getattr(preset, name)
        values[name] = present / max(share, 1e-3) if isinf(absent) else absent + share * (present - absent)
    return replace(preset, **values)


def _random_share(shares: Shares, rng: np.random.Generator) -> float:
    share = rng.uniform(shares.lowest, shares.highest)
    return -share if shares.signed and rng.random() < 0.5 else share
