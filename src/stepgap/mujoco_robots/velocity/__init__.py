"""Robots that walk at a commanded velocity: the state of a step is the velocity that they had, averaged over a time.

`walking_robot` is any such robot, `robot` the one with a built-in gait, `policy` the one of a trained policy.
"""
