"""Integration of motion that impacts interrupt; knows no robot.

Read in this order: `motion`, `tsitouras`, `rosenbrock`, `integrator`; `compiled` is how all of it is compiled,
and `compiling` tells when that happens.
"""
