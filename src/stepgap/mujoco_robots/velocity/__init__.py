"""Robots that walk at a commanded velocity: the state of a step is the velocity that they had, averaged over a time.

Read in this order: `walking_control` (what moves the joints: a gait or a trained policy), `walking_robot` (the robot
around it, its state and nominal map), `walking_gap` (how the simulated robot differs), and the gait that is built in:
`trot`, `model`, `robot`.
"""
