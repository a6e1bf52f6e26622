"""The reality gap: all differences of the twin from the physics model."""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from math import inf, isfinite, isinf, pi
from typing import Self

import numpy as np

from stepgap.base.ranges import require
from stepgap.base.settings_file import parse_toml
from stepgap.robots.gap import NOT_NEGATIVE, POSITIVE, Drawn, Gap, Rule, difference, differences, within

LONGEST_DELAY = 1.0  # Longest delay of the drives [s]; the simulation keeps the torques of this time

SHARE = Drawn(0.0, 1.5)
EITHER_SIGN = Drawn(0.0, 1.5, signed=True)
"""Shares of the preset's difference in the family of random twins; 0 is no gap."""

STEEP = within(pi / 4, "lie within ±π/4 rad")


@dataclass(frozen=True)
class RealityGap(Gap):
    """Differences of the twin from the physics model, SI units.

    The defaults are the preset `paper`: with them the uncorrected controller of the model makes the errors that the
    paper reports for its hardware on average over the reference, but not stair by stair: the means on the 18 stairs
    explain a tenth of the variance of the hardware's. Torque scale and saturation, boom inertia, the friction of boom
    and ground and the zeros of the motor encoders were fitted to these errors by `benchmarks/fit_paper_gap.py`. Noise,
    roughness and tilt were chosen so that steady steps after learning scatter as in the paper; the other values are
    plausible. Other differences may explain the hardware equally well: the preset is a robot like the paper's, not an
    identification of it. `RealityGap.none()` is the model itself: planar, rigid and exact. Scales multiply the number
    in `RobotParameters`.

    Raises:
        ValueError: A value is out of its range, or the foot would have to scrub on the arc but cannot slip.
    """

    body_mass_scale: float = difference(1.03, POSITIVE, exact=1.0, drawn=EITHER_SIGN)
    """Factor on the body mass M."""

    leg_mass_scale: float = difference(1.05, POSITIVE, exact=1.0, drawn=EITHER_SIGN)
    """Factor on the link masses m₁, m₂."""

    leg_inertia_scale: float = difference(1.1, POSITIVE, exact=1.0, drawn=EITHER_SIGN)
    """Factor on the link inertias I₁, I₂."""

    body_com_offset: float = difference(0.01, exact=0.0, drawn=EITHER_SIGN)
    """Body's centre of mass ahead of the hip [m]. The body cannot turn against the boom, so this acts only through the
    boom's rotation: not at all in the plane, slightly on the arc."""

    boom_inertia_scale: float = difference(1.74, POSITIVE, exact=1.0, drawn=SHARE)
    """Factor on the boom inertias I_x, I_z."""

    boom_arc: bool = difference(True, exact=False)
    """The hip moves on a sphere about the boom's pivot and the leg tilts with the boom, so that the foot scrubs
    sideways, for which `ground_friction` must be finite; with false it moves in a plane."""

    boom_pivot_height: float = difference(0.4)
    """Height of the boom's pivot above the mean ground [m]. Known to the controller; in the plane it only converts
    between height and pitch counts."""

    boom_stiffness: float = difference(2e4, POSITIVE, exact=inf, drawn=SHARE)
    """Stiffness of the boom's tip against its root, vertically and horizontally [N/m]. The encoders sit at the root and
    do not see the deflection, at an apex some 0.5 mm."""

    boom_damping_ratio: float = difference(0.1, NOT_NEGATIVE)
    """Damping ratio of that deflection with the carried mass; no effect on a rigid boom."""

    boom_friction: float = difference(0.209, NOT_NEGATIVE, exact=0.0, drawn=SHARE)
    """Coulomb friction of the boom's horizontal bearing, at the tip [N]."""

    boom_drag: float = difference(0.0, NOT_NEGATIVE, exact=0.0, drawn=SHARE, whole=0.2)
    """Viscous friction there, bearing and air, at the tip [N·s/m]."""

    boom_tilt: float = difference(0.002, STEEP, exact=0.0, drawn=EITHER_SIGN)
    """Tilt of the boom's vertical axis from the vertical [rad]: on the arc, gravity accelerates the carried mass
    forward by g sin(tilt) sin ψ at yaw ψ; no effect in the plane."""

    ground_stiffness: float = difference(5e4, POSITIVE, exact=inf, drawn=SHARE)
    """Load per penetration [N/m]; with inf the impact is inelastic."""

    ground_damping_ratio: float = difference(0.1, NOT_NEGATIVE)
    """Damping ratio of the robot's whole mass on that ground; no effect on rigid ground."""

    ground_friction: float = difference(0.357, POSITIVE, exact=inf, drawn=Drawn(0.4, 1.2))
    """Coulomb coefficient; with inf the foot never slips. With `boom_arc` inf is refused: it would lock the boom's
    pitch in stance, because the foot could not scrub."""

    ground_roughness: float = difference(6e-4, NOT_NEGATIVE, exact=0.0, drawn=SHARE)
    """Standard deviation of a smooth random height profile around the circle [m]."""

    ground_slope: float = difference(0.0, STEEP, exact=0.0, drawn=EITHER_SIGN, whole=3e-4)
    """Tilt of the floor under the boom [rad]: height R tan(slope) sin ψ at yaw ψ. Slope and roughness change the height
    alone; the contact's normal stays vertical."""

    joint_friction: float = difference(0.03, NOT_NEGATIVE, exact=0.0, drawn=SHARE)
    """Coulomb friction in each of the four leg joints [N·m]."""

    joint_damping: float = difference(0.002, NOT_NEGATIVE, exact=0.0, drawn=SHARE)
    """Viscous friction in each of the four leg joints [N·m·s/rad]."""

    rotor_inertia: float = difference(3e-4, NOT_NEGATIVE, exact=0.0, drawn=SHARE)
    """Inertia of each motor's rotor [kg·m²]. A hollow 92 mm rotor of 0.2–0.3 kg, as of a T-motor U10 Plus, has about
    2e-4 to 4e-4."""

    torque_scale: float = difference(0.687, POSITIVE, exact=1.0, drawn=SHARE)
    """Torque delivered per torque applied."""

    torque_imbalance: float = difference(0.0, within(1, "lie within ±1"), exact=0.0, drawn=EITHER_SIGN, whole=0.01)
    """Motor 1 delivers `torque_scale` × (1 + this), motor 2 × (1 − this)."""

    torque_saturation: float = difference(43.3, POSITIVE, exact=inf, drawn=SHARE)
    """Torque T [N·m] at which a motor's iron saturates: a command τ gives T tanh(τ/T) before the scale. The drive does
    not report it."""

    torque_noise: float = difference(0.018, NOT_NEGATIVE, exact=0.0, drawn=SHARE)
    """Standard deviation of the torque noise of each motor [N·m]."""

    torque_noise_time: float = difference(0.1, NOT_NEGATIVE, exact=0.0)
    """Correlation time of that noise [s]; with 0 the noise of every tick is independent."""

    torque_lag: float = difference(1.5e-3, NOT_NEGATIVE, exact=0.0, drawn=SHARE)
    """Time constant of the current loop, a first-order lag [s]."""

    torque_limit: float = difference(38.0, POSITIVE, exact=inf)
    """Largest torque of the drives [N·m], in addition to the robot's own limit."""

    delay: float = difference(
        1e-3,
        NOT_NEGATIVE,
        Rule(lambda time: time <= LONGEST_DELAY, f"be at most {LONGEST_DELAY:g} s"),
        exact=0.0,
        drawn=SHARE,
    )
    """Time from writing a torque to its start in the drive [s]; at most 1 s."""

    motor_offset_1: float = difference(-0.0048, exact=0.0, drawn=EITHER_SIGN)
    """Offset of motor encoder 1, reading minus true angle [rad]."""

    motor_offset_2: float = difference(-0.0048, exact=0.0, drawn=EITHER_SIGN)
    """Offset of motor encoder 2, reading minus true angle [rad]."""

    motor_counts: float = difference(16384.0, POSITIVE, exact=inf)
    """Counts per turn of the motor encoders; inf is exact."""

    boom_counts_horizontal: float = difference(5000.0, POSITIVE, exact=inf)
    """Counts per turn of the yaw encoder; inf is exact."""

    boom_counts_vertical: float = difference(16384.0, POSITIVE, exact=inf)
    """Counts per turn of the pitch encoder; inf is exact."""

    touchdown_force: float = difference(5.0, NOT_NEGATIVE, exact=0.0)
    """Contact force that counts as touchdown [N]; changes the sensor model, not the motion."""

    takeoff_length: float = difference(0.273, POSITIVE, exact=inf)
    """Leg length that counts as take-off [m]; changes the sensor model, not the motion. With inf only the contact force
    decides."""

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = "be finite with boom_arc = true, where the foot must scrub sideways; or set boom_arc = false"
        require(isfinite(self.ground_friction) or not self.boom_arc, "ground_friction", self.ground_friction, rule)

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """A twin of a family of random twins, to measure learning on more than one robot.

        Differences are drawn between no gap and 1.5 times the preset's; those of either sign get a random sign. No draw
        is selected by how well learning works on it. Sensors, thresholds, the arc and damping ratios are the preset's.
        """
        return cls.of_shares(cls.draw(rng))

    @classmethod
    def of_shares(cls, shares: Mapping[str, float]) -> Self:
        """Differences by their shares of the preset's: no gap + share × (preset − no gap).

        Where no gap is an infinite value, such as that of a stiffness, the difference is preset / share.

        Args:
            shares: Share of each difference that is drawn; others are the preset's.

        Raises:
            ValueError: A difference is out of its range.
        """
        values = {}
        for name, share in shares.items():
            declared = differences(cls)[name]
            none = float(declared.exact or 0.0)
            whole = declared.whole
            values[name] = whole / max(share, 1e-3) if isinf(none) else none + share * (whole - none)
        return cls(**values)


_FAMILY = files("stepgap.robots.hopper.twin").joinpath("paper_family.toml").read_text("utf-8")
PAPER_FAMILY: Mapping[str, RealityGap] = {name: RealityGap(**table) for name, table in parse_toml(_FAMILY).items()}
"""Twins that agree with Fig. 4 of the paper by the names of their presets; the file tells how they were found."""
