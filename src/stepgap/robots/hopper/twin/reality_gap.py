"""The reality gap: all differences of the twin from the physics model."""

from dataclasses import dataclass, fields
from math import inf, isfinite, isnan, pi
from typing import Self

from stepgap.base.ranges import require

LONGEST_DELAY = 1.0
"""Longest delay of the drives [s]; the simulation keeps the torques of this time."""

POSITIVE = frozenset(
    {
        "body_mass_scale",
        "leg_mass_scale",
        "leg_inertia_scale",
        "boom_inertia_scale",
        "boom_stiffness",
        "ground_stiffness",
        "ground_friction",
        "torque_scale",
        "torque_saturation",
        "torque_limit",
        "motor_counts",
        "boom_counts_horizontal",
        "boom_counts_vertical",
        "takeoff_length",
    }
)
SIGNED = frozenset(
    {
        "body_com_offset",
        "boom_pivot_height",
        "boom_tilt",
        "ground_slope",
        "motor_offset_1",
        "motor_offset_2",
        "torque_imbalance",
    }
)
MAY_BE_INFINITE = frozenset(
    {
        "boom_stiffness",
        "ground_stiffness",
        "ground_friction",
        "torque_saturation",
        "torque_limit",
        "motor_counts",
        "boom_counts_horizontal",
        "boom_counts_vertical",
        "takeoff_length",
    }
)


@dataclass(frozen=True)
class RealityGap:
    """Differences of the twin from the physics model, SI units.

    The defaults are the preset `paper`: with them the uncorrected controller of the model makes the errors that the
    paper reports for its hardware on average over the reference, but not stair by stair: the means on the 18 stairs
    explain a tenth of the variance of the hardware's. Torque scale and saturation, boom inertia, the friction of boom
    and ground and the zeros of the motor encoders were fitted to these errors by `benchmarks/fit_paper_gap.py`. Noise,
    roughness and tilt were chosen so that steady steps after learning scatter as in the paper; the other values are
    plausible. Other differences may explain the hardware equally well: the preset is a robot like the paper's, not an
    identification of it. `RealityGap.none()` is the model itself: planar, rigid and exact. Scales multiply the number
    in `RobotParameters`, so 1 is no gap.

    Attributes:
        body_mass_scale: Factor on the body mass M; no gap 1.
        leg_mass_scale: Factor on the link masses m₁, m₂; no gap 1.
        leg_inertia_scale: Factor on the link inertias I₁, I₂; no gap 1.
        body_com_offset: Body's centre of mass ahead of the hip [m]; no gap 0. The body cannot turn
            against the boom, so this acts only through the boom's rotation: not at all in the plane,
            slightly on the arc.
        boom_inertia_scale: Factor on the boom inertias I_x, I_z; no gap 1.
        boom_arc: The hip moves on a sphere about the boom's pivot and the leg tilts with the boom, so
            that the foot scrubs sideways, for which `ground_friction` must be finite; no gap False, a plane.
        boom_pivot_height: Height of the boom's pivot above the mean ground [m]. Known to the
            controller; in the plane it only converts between height and pitch counts.
        boom_stiffness: Stiffness of the boom's tip against its root, vertically and horizontally [N/m].
            The encoders sit at the root and do not see the deflection, at an apex some 0.5 mm; no gap inf.
        boom_damping_ratio: Damping ratio of that deflection with the carried mass; no effect on a rigid boom.
        boom_friction: Coulomb friction of the boom's horizontal bearing, at the tip [N]; no gap 0.
        boom_drag: Viscous friction there, bearing and air, at the tip [N·s/m]; no gap 0.
        boom_tilt: Tilt of the boom's vertical axis from the vertical [rad]: on the arc, gravity accelerates the
            carried mass forward by g sin(tilt) sin ψ at yaw ψ; no effect in the plane; no gap 0.
        ground_stiffness: Load per penetration [N/m]; no gap inf, an inelastic impact.
        ground_damping_ratio: Damping ratio of the robot's whole mass on that ground; no effect on rigid ground.
        ground_friction: Coulomb coefficient; no gap inf, the foot never slips. With `boom_arc` inf is refused: it
            would lock the boom's pitch in stance, because the foot could not scrub.
        ground_roughness: Standard deviation of a smooth random height profile around the circle [m];
            no gap 0.
        ground_slope: Tilt of the floor under the boom [rad]: height R tan(slope) sin ψ at yaw ψ; no gap 0.
            Slope and roughness change the height alone; the contact's normal stays vertical.
        joint_friction: Coulomb friction in each of the four leg joints [N·m]; no gap 0.
        joint_damping: Viscous friction in each of the four leg joints [N·m·s/rad]; no gap 0.
        rotor_inertia: Inertia of each motor's rotor [kg·m²]; no gap 0. A hollow 92 mm rotor of 0.2–0.3 kg,
            as of a T-motor U10 Plus, has about 2e-4 to 4e-4.
        torque_scale: Torque delivered per torque applied; no gap 1.
        torque_imbalance: Motor 1 delivers `torque_scale` × (1 + this), motor 2 × (1 − this); no gap 0.
        torque_saturation: Torque T [N·m] at which a motor's iron saturates: a command τ gives
            T tanh(τ/T) before the scale. The drive does not report it; no gap inf.
        torque_noise: Standard deviation of the torque noise of each motor [N·m]; no gap 0.
        torque_noise_time: Correlation time of that noise [s]; with 0 the noise of every tick is independent.
        torque_lag: Time constant of the current loop, a first-order lag [s]; no gap 0.
        torque_limit: Largest torque of the drives [N·m], in addition to the robot's own limit; no gap inf.
        delay: Time from writing a torque to its start in the drive [s], rounded to an integer number
            of physics steps; at most 1 s, no gap 0.
        motor_offset_1: Offset of motor encoder 1, reading minus true angle [rad]; no gap 0.
        motor_offset_2: Offset of motor encoder 2, reading minus true angle [rad]; no gap 0.
        motor_counts: Counts per turn of the motor encoders; no gap inf, exact.
        boom_counts_horizontal: Counts per turn of the yaw encoder; no gap inf, exact.
        boom_counts_vertical: Counts per turn of the pitch encoder; no gap inf, exact.
        touchdown_force: Contact force that counts as touchdown [N]; changes the sensor model, not the
            motion; no gap 0.
        takeoff_length: Leg length that counts as take-off [m]; changes the sensor model, not the motion;
            no gap inf, where only the contact force decides.

    Raises:
        ValueError: A value is out of its range, or the foot would have to scrub on the arc but cannot slip.
    """

    body_mass_scale: float = 1.03
    leg_mass_scale: float = 1.05
    leg_inertia_scale: float = 1.1
    body_com_offset: float = 0.01
    boom_inertia_scale: float = 1.74
    boom_arc: bool = True
    boom_pivot_height: float = 0.4
    boom_stiffness: float = 2e4
    boom_damping_ratio: float = 0.1
    boom_friction: float = 0.209
    boom_drag: float = 0.0
    boom_tilt: float = 0.002
    ground_stiffness: float = 5e4
    ground_damping_ratio: float = 0.1
    ground_friction: float = 0.363
    ground_roughness: float = 6e-4
    ground_slope: float = 0.0
    joint_friction: float = 0.03
    joint_damping: float = 0.002
    rotor_inertia: float = 3e-4
    torque_scale: float = 0.687
    torque_imbalance: float = 0.0
    torque_saturation: float = 43.3
    torque_noise: float = 0.018
    torque_noise_time: float = 0.1
    torque_lag: float = 1.5e-3
    torque_limit: float = 38.0
    delay: float = 1e-3
    motor_offset_1: float = -0.0052
    motor_offset_2: float = -0.0052
    motor_counts: float = 16384.0
    boom_counts_horizontal: float = 5000.0
    boom_counts_vertical: float = 16384.0
    touchdown_force: float = 5.0
    takeoff_length: float = 0.273

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name != "boom_arc":
                _check(field.name, getattr(self, field.name))
        require(abs(self.ground_slope) < pi / 4, "ground_slope", self.ground_slope, "lie within ±π/4 rad")
        require(abs(self.boom_tilt) < pi / 4, "boom_tilt", self.boom_tilt, "lie within ±π/4 rad")
        require(self.delay <= LONGEST_DELAY, "delay", self.delay, f"be at most {LONGEST_DELAY:g} s")
        require(abs(self.torque_imbalance) < 1, "torque_imbalance", self.torque_imbalance, "lie within ±1")
        rule = "be finite with boom_arc = true, where the foot must scrub sideways; or set boom_arc = false"
        require(isfinite(self.ground_friction) or not self.boom_arc, "ground_friction", self.ground_friction, rule)

    @classmethod
    def none(cls) -> Self:
        """The twin that is the physics model: planar, rigid, exact."""
        return cls(
            body_mass_scale=1,
            leg_mass_scale=1,
            leg_inertia_scale=1,
            body_com_offset=0,
            boom_inertia_scale=1,
            boom_arc=False,
            boom_stiffness=inf,
            boom_friction=0,
            boom_drag=0,
            boom_tilt=0,
            ground_stiffness=inf,
            ground_friction=inf,
            ground_roughness=0,
            ground_slope=0,
            joint_friction=0,
            joint_damping=0,
            rotor_inertia=0,
            torque_scale=1,
            torque_imbalance=0,
            torque_saturation=inf,
            torque_noise=0,
            torque_noise_time=0,
            torque_lag=0,
            torque_limit=inf,
            delay=0,
            motor_offset_1=0,
            motor_offset_2=0,
            motor_counts=inf,
            boom_counts_horizontal=inf,
            boom_counts_vertical=inf,
            touchdown_force=0,
            takeoff_length=inf,
        )


def _check(name: str, value: float) -> None:
    """Raises ValueError naming field, value and rule."""
    require(not isnan(value), name, value, "be a number")
    require(isfinite(value) or (name in MAY_BE_INFINITE and value > 0), name, value, "be finite")
    require(name not in POSITIVE or value > 0, name, value, "be positive")
    require(name in POSITIVE | SIGNED or value >= 0, name, value, "not be negative")
