"""Integration of motion with impacts; knows no robot.

Read in this order: `motion`, `tsitouras`, `rosenbrock`, `integrator`. `base.compiled` compiles all of it, and
`base.compiling` detects when that happens.
"""
