"""A quadruped of the class of Unitree's Go2 that pronks in the sagittal plane: all four legs act as one virtual leg.

Read in this order: `model` (the machine), `pronk` (the control law of a tick), `spring_mass` (the template of a step),
`robot` (what `stepgap run --robot quadruped` uses).
"""
