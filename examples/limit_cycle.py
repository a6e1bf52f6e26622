"""Limit cycles of the model: the commands that repeat an apex, and whether small errors decay."""

from stepgap import ApexMap, fixed_point

apex_map = ApexMap()
for speed in (0.1, 0.2, 0.3, 0.4):
    gait = fixed_point(apex_map, [speed, 0.58])
    fx, fy = gait.command
    sizes = ", ".join(f"{abs(multiplier):.2f}" for multiplier in gait.floquet_multipliers)
    verdict = "stable" if gait.stable else "not stable"
    print(f"{speed:.1f} m/s: fx {fx:+.1f} N, fy {fy:+.1f} N, |λ| = {sizes}, {verdict}")
