"""Three hops of the twin through the 1 kHz loop, and the content of one tick."""

import numpy as np

from stepgap import CommandBounds, Gains, HopperControl, RealityGap, RigPlant, RobotParameters, Twin
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.tick_row import TickRow

robot, rows = RobotParameters(), []
twin = Twin(robot, RealityGap(), np.random.default_rng(0))
control = HopperControl(robot, Gains(), CommandBounds())
with RigPlant(twin, control, on_ticks=lambda ticks, step: rows.extend(ticks)) as plant:
    state = plant.start()
    print("first apex: {:.3f} m/s, {:.3f} m".format(*state))
    for _ in range(3):
        record = plant.take_step(np.array([-5.0, -5.0]))
        print("next apex:  {:.3f} m/s, {:.3f} m".format(*record.next_state))
ticks = [TickRow(*row) for row in rows]
peak = max(ticks, key=lambda tick: abs(tick.applied_1))
print(f"{len(ticks)} ticks; largest torque {abs(peak.applied_1):.1f} N·m in phase {Phase(int(peak.phase)).name}")
