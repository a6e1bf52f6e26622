"""The paper's hopper: its physics model (Sec. 3), joint control (Sec. 4.1), sensors, safety limits, simulated twin.

Read in this order: `parameters`, `leg`, `dynamics`, `joint_control`, `reduced`, `hop`,
`apex_map`; `sampled_hop` and `sampled_map` are the same with torques held from tick to tick.
"""

from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters

__all__ = ["CommandBounds", "Gains", "RobotParameters"]
