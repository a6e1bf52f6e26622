"""One step of the explicit method Tsitouras 5(4), first same as last.

Ch. Tsitouras, Computers & Mathematics with Applications 62 (2011) 770–775.
"""

from stepgap.base.compiled import generic
from stepgap.hybrid.motion import axpy, rate, rate_and_guards

_A2 = (0.161,)
_A3 = (-0.008480655492356989, 0.335480655492357)
_A4 = (2.8971530571054935, -6.359448489975075, 4.3622954328695815)
_A5 = (5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525)
_A6 = (5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383)
_B = (
    0.09646076681806523,
    0.01,
    0.4798896504144996,
    1.379008574103742,
    -3.290069515436081,
    2.324710524099774,
)
_E = (
    -0.00178001105222577714,
    -0.0008164344596567469,
    0.007880878010261995,
    -0.1447110071732629,
    0.5823571654525552,
    -0.45808210592918697,
    0.015151515151515152,
)
_ZERO = (0.0, 0.0, 0.0, 0.0)


@generic
def tsitouras_step(system, time, state, k1, h):
    """Takes a step of size h from `state`, whose rate is `k1`: (end, (rate, guards) there, local error)."""
    k2 = rate(system, axpy(state, h, _A2, (k1,)))
    k3 = rate(system, axpy(state, h, _A3, (k1, k2)))
    k4 = rate(system, axpy(state, h, _A4, (k1, k2, k3)))
    k5 = rate(system, axpy(state, h, _A5, (k1, k2, k3, k4)))
    k6 = rate(system, axpy(state, h, _A6, (k1, k2, k3, k4, k5)))
    end = axpy(state, h, _B, (k1, k2, k3, k4, k5, k6))
    evaluated = rate_and_guards(system, time + h, end)
    return end, evaluated, axpy(_ZERO, h, _E, (k1, k2, k3, k4, k5, k6, evaluated[0]))
