"""Robots from MuJoCo models: a controller for a tick, a section, and the state there, make a `Robot`.

Read in this order: `section` (when a step ends), `mjcf_gap` (how the simulated robot differs), `mjcf_robot` (the robot
of a user, and its steps, tick by tick), `mjcf_kinematics` (how it is drawn).
`model_files` copies a model of others.
"""
