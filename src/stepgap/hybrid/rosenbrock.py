"""One step of the linearly implicit method Rodas5P, order 5(4), for stiff motion.

G. Steinebach, BIT Numerical Mathematics 63 (2023) 27; in the form of Hairer and Wanner, Solving ODEs II, IV.7, where a
stage solves (I/(γh) − J) u = rate + Σ C u / h. With J = [[0, I], [P, V]] for coordinates and their rates, that is two
equations in two unknowns, whose matrix is inverted once per step.
"""

from stepgap.base.compiled import compiled, generic
from stepgap.hybrid.motion import axpy, rate, rate_and_guards

GAMMA = 0.21193756319429014
_A2 = (3.0,)
_A3 = (2.849394379747939, 0.45842242204463923)
_A4 = (-6.954028509809101, 2.489845061869568, -10.358996098473584)
_A5 = (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641)
_A6 = (-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946)
_C2 = (-14.155112264123755,)
_C3 = (-17.97296035885952, -2.859693295451294)
_C4 = (147.12150275711716, -1.41221402718213, 71.68940251302358)
_C5 = (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306)
_C6 = (24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471)
_C7 = (
    30.91273214028599,
    -3.1208243349937974,
    77.79954646070892,
    34.28646028294783,
    -19.097331116725623,
    -28.087943162872662,
)
_C8 = (
    37.80277123390563,
    -3.2571969029072276,
    112.26918849496327,
    66.9347231244047,
    -40.06618937091002,
    -54.66780262877968,
    -9.48861652309627,
)


@compiled
def factorised(jacobian, h):
    """Factors of I/(γh) − J for `_solved`: 1/(γh), V, and the inverse of I/(γh)² − P − V/(γh).

    Args:
        jacobian: Rows of P and V: ∂(acceleration)/∂(coordinates, rates), as tuples (p11, p12, v11, v12), (p21, …).
        h: Size of the step.
    """
    c = 1.0 / (GAMMA * h)
    (p11, p12, v11, v12), (p21, p22, v21, v22) = jacobian
    a = c * c - p11 - c * v11
    b = -p12 - c * v12
    d = -p21 - c * v21
    e = c * c - p22 - c * v22
    inverse = 1.0 / (a * e - b * d)
    return c, (v11, v12, v21, v22), (e * inverse, -b * inverse, -d * inverse, a * inverse)


@compiled
def _solved(factors, right):
    """The solution u of (I/(γh) − J) u = right."""
    c, v, inverse = factors
    p = right[2] + c * right[0] - v[0] * right[0] - v[1] * right[1]
    q = right[3] + c * right[1] - v[2] * right[0] - v[3] * right[1]
    u1 = inverse[0] * p + inverse[1] * q
    u2 = inverse[2] * p + inverse[3] * q
    return u1, u2, c * u1 - right[0], c * u2 - right[1]


@generic
def rosenbrock_step(system, time, state, here, jacobian, h):
    """Takes a step of size h from `state`, whose rate is `here`: (end, (rate, guards) there, local error)."""
    # A stage solves for u instead of the rate k, so no product with J is needed. In this stiffly accurate method, each
    # of the last three points is the one before plus its u; the last u is the difference to the solution of order 4.
    factors = factorised(jacobian, h)
    w = 1.0 / h
    u1 = _solved(factors, here)
    k2 = rate(system, axpy(state, 1.0, _A2, (u1,)))
    u2 = _solved(factors, axpy(k2, w, _C2, (u1,)))
    k3 = rate(system, axpy(state, 1.0, _A3, (u1, u2)))
    u3 = _solved(factors, axpy(k3, w, _C3, (u1, u2)))
    k4 = rate(system, axpy(state, 1.0, _A4, (u1, u2, u3)))
    u4 = _solved(factors, axpy(k4, w, _C4, (u1, u2, u3)))
    k5 = rate(system, axpy(state, 1.0, _A5, (u1, u2, u3, u4)))
    u5 = _solved(factors, axpy(k5, w, _C5, (u1, u2, u3, u4)))
    sixth = axpy(state, 1.0, _A6, (u1, u2, u3, u4, u5))
    u6 = _solved(factors, axpy(rate(system, sixth), w, _C6, (u1, u2, u3, u4, u5)))
    seventh = axpy(sixth, 1.0, (1.0,), (u6,))
    u7 = _solved(factors, axpy(rate(system, seventh), w, _C7, (u1, u2, u3, u4, u5, u6)))
    eighth = axpy(seventh, 1.0, (1.0,), (u7,))
    error = _solved(factors, axpy(rate(system, eighth), w, _C8, (u1, u2, u3, u4, u5, u6, u7)))
    end = axpy(eighth, 1.0, (1.0,), (error,))
    return end, rate_and_guards(system, time + h, end), error


@generic
def difference_rate_jacobian(system, state, here):
    """∂(acceleration)/∂(coordinates, rates) by finite differences of the rate; rows as in `factorised`."""
    s = state
    d = 1e-7
    a = rate(system, (s[0] + d, s[1], s[2], s[3]))
    b = rate(system, (s[0], s[1] + d, s[2], s[3]))
    e = rate(system, (s[0], s[1], s[2] + d, s[3]))
    f = rate(system, (s[0], s[1], s[2], s[3] + d))
    return (
        ((a[2] - here[2]) / d, (b[2] - here[2]) / d, (e[2] - here[2]) / d, (f[2] - here[2]) / d),
        ((a[3] - here[3]) / d, (b[3] - here[3]) / d, (e[3] - here[3]) / d, (f[3] - here[3]) / d),
    )
