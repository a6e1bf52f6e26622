"""Twins that agree with Fig. 4 of the paper: presets `paper_1`, `paper_2` and so on of `[gap]`.

Made by `benchmarks/fit_paper_family.py`, which fits all differences of the family of random twins to the errors of the
hardware without learning; each began at another random twin. They were fitted with the bound
`--command.fx_lower -12.5`. So what they have in common is what the figure determines, given that bound;
docs/evidence.md compares them.
"""

from collections.abc import Mapping

from stepgap.robots.hopper.twin.reality_gap import RealityGap

PAPER_FAMILY: Mapping[str, RealityGap] = {
    "paper_1": RealityGap(
        body_mass_scale=1.036,
        leg_mass_scale=1.075,
        leg_inertia_scale=0.9789,
        body_com_offset=0.007273,
        boom_inertia_scale=2.088,
        boom_stiffness=3.224e04,
        boom_friction=0.1562,
        boom_drag=0.02333,
        boom_tilt=0.002066,
        ground_stiffness=7.03e04,
        ground_friction=0.3961,
        ground_roughness=0.0007767,
        ground_slope=-6.075e-05,
        joint_friction=0.01471,
        joint_damping=0.002078,
        rotor_inertia=0.0001169,
        torque_scale=0.7973,
        torque_imbalance=-0.006425,
        torque_saturation=38.39,
        torque_noise=0.01228,
        torque_lag=0.001036,
        delay=0.0007573,
        motor_offset_1=0.0005449,
        motor_offset_2=-0.002973,
    ),
    "paper_2": RealityGap(
        body_mass_scale=0.9856,
        leg_mass_scale=1.039,
        leg_inertia_scale=1.028,
        body_com_offset=0.009113,
        boom_inertia_scale=1.906,
        boom_stiffness=2.561e04,
        boom_friction=0.1453,
        boom_tilt=0.0019,
        ground_stiffness=6.858e04,
        ground_friction=0.5167,
        ground_roughness=0.0004488,
        ground_slope=3.176e-05,
        joint_friction=0.00676,
        joint_damping=0.00148,
        rotor_inertia=0.0002426,
        torque_scale=0.7459,
        torque_imbalance=-0.002081,
        torque_saturation=71.27,
        torque_noise=0.004321,
        torque_lag=0.001427,
        delay=0.00112,
        motor_offset_1=-0.004474,
        motor_offset_2=-0.007131,
    ),
    "paper_3": RealityGap(
        body_mass_scale=1.02,
        leg_mass_scale=1.051,
        leg_inertia_scale=0.9854,
        body_com_offset=0.007666,
        boom_inertia_scale=1.873,
        boom_stiffness=1.895e04,
        boom_friction=0.1941,
        boom_drag=0.04254,
        boom_tilt=0.0007894,
        ground_stiffness=5.991e04,
        ground_friction=0.5078,
        ground_roughness=0.0005648,
        ground_slope=-5.396e-05,
        joint_friction=0.008415,
        joint_damping=0.0008134,
        rotor_inertia=0.0001573,
        torque_scale=0.7804,
        torque_imbalance=0.006076,
        torque_saturation=51.36,
        torque_noise=0.01216,
        torque_lag=0.001309,
        delay=0.0008784,
        motor_offset_1=-0.00245,
        motor_offset_2=-0.00338,
    ),
}
"""The twins by the names of their presets, in the order of `benchmarks/paper_family.json`."""
