"""Independent derivation of the hopper by SymPy from the positions of the links: an oracle for tests.

Only the robot's parameters are shared with `stepgap.robots.hopper.model.dynamics`.
"""

from functools import cache

import numpy as np

from stepgap.robots.hopper import RobotParameters


@cache
def oracle(robot: RobotParameters):
    """Functions of (q, qd): mass matrix, bias N, foot Jacobian J, J̇q̇, energy; and foot position of q."""
    import sympy as sp  # takes long, and few of the processes that share the tests need it

    positions = x, y, a1, a2 = sp.symbols("x y a1 a2")
    rates = sp.symbols("xd yd a1d a2d")

    def along(angle):
        return sp.Matrix([sp.sin(angle), -sp.cos(angle)])

    hip = sp.Matrix([x, y])
    beta = sp.asin(robot.top_length / robot.bottom_length * sp.sin(a2))
    links = []
    for side in (1, -1):
        top, bottom = a1 + side * a2, a1 - side * beta
        knee = hip + robot.top_length * along(top)
        links.append((hip + robot.top_com * along(top), top, robot.top_mass, robot.top_inertia))
        links.append((knee + robot.bottom_com * along(bottom), bottom, robot.bottom_mass, robot.bottom_inertia))
        foot = knee + (robot.bottom_length + robot.foot_length) * along(bottom)  # the rear knee's comes last

    q, qd = sp.Matrix(positions), sp.Matrix(rates)
    boom_x = robot.boom_inertia_horizontal / robot.boom_length**2
    boom_y = robot.boom_inertia_vertical / robot.boom_length**2
    half = sp.Rational(1, 2)
    kinetic = half * ((robot.body_mass + boom_x) * rates[0] ** 2 + (robot.body_mass + boom_y) * rates[1] ** 2)
    potential = robot.body_mass * robot.gravity * y
    for position, angle, mass, inertia in links:
        velocity = position.jacobian(q) * qd
        spin = (sp.Matrix([angle]).jacobian(q) * qd)[0]
        kinetic += half * (mass * velocity.dot(velocity) + inertia * spin**2)
        potential += mass * robot.gravity * position[1]

    momentum = sp.Matrix([kinetic]).jacobian(qd).T
    mass_matrix = momentum.jacobian(qd)
    bias = momentum.jacobian(q) * qd - sp.Matrix([kinetic - potential]).jacobian(q).T
    jacobian = foot.jacobian(q)
    drift = (jacobian * qd).jacobian(q) * qd
    arguments = [*positions, *rates]
    functions = [
        sp.lambdify(arguments, expression, "numpy", cse=True)
        for expression in (mass_matrix, bias, jacobian, drift, kinetic + potential, foot)
    ]
    return [lambda q, qd, f=f: np.squeeze(np.asarray(f(*q, *qd), float)) for f in functions]
