"""The paper's hopper on its boom.

Read in this order: `parameters`; `model`, its equations of motion (Secs. 3, 4.1); `tick`, what it computes in a tick,
with sensors and safety limits; `twin`, the simulation in place of the real robot; `kinematics`, how it is drawn;
`paper`, what the paper measured; `robot`, all of it as a `Robot`. `model`, `tick` and `twin` import only those before.
"""

from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters

__all__ = ["CommandBounds", "Gains", "RobotParameters"]
