"""What the robot is and how it hops: the physics model of Sec. 3 with the joint control of Sec. 4.1.

Read in this order: `parameters`, `leg`, `dynamics`, `joint_control`, `reduced`, `hop`,
`apex_map`; `sampled_hop` and `sampled_map` are the same with torques held from tick to tick.
"""

from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters

__all__ = ["CommandBounds", "Gains", "RobotParameters"]
