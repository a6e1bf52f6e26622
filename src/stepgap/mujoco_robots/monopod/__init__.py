"""A hopper on one leg in three dimensions: it moves forward and sideways, and its body can tilt.

Read in this order: `model` (the machine), `hopping` (the control law of a tick), `robot` (states, commands, maps).
"""
