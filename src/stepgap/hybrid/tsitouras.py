"""One step of the explicit method Tsitouras 5(4), first same as last.

Ch. Tsitouras, Computers & Mathematics with Applications 62 (2011) 770–775.
"""

from stepgap.base.compiled import generic
from stepgap.hybrid.motion import moved, observe, rate

A2 = (0.161,)
A3 = (-0.008480655492356989, 0.335480655492357)
A4 = (2.8971530571054935, -6.359448489975075, 4.3622954328695815)
A5 = (5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525)
A6 = (5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401, -0.028269050394068383)
B = (
    0.09646076681806523,
    0.01,
    0.4798896504144996,
    1.379008574103742,
    -3.290069515436081,
    2.324710524099774,
)
E = (
    -0.00178001105222577714,
    -0.0008164344596567469,
    0.007880878010261995,
    -0.1447110071732629,
    0.5823571654525552,
    -0.45808210592918697,
    0.015151515151515152,
)
NOTHING = (0.0, 0.0, 0.0, 0.0)


@generic
def tsitouras_step(system, time, state, k1, h):
    """A step of size h from `state`, whose rate is `k1`: (end, (rate, guards) there, local error)."""
    k2 = rate(system, moved(state, h, A2, (k1,)))
    k3 = rate(system, moved(state, h, A3, (k1, k2)))
    k4 = rate(system, moved(state, h, A4, (k1, k2, k3)))
    k5 = rate(system, moved(state, h, A5, (k1, k2, k3, k4)))
    k6 = rate(system, moved(state, h, A6, (k1, k2, k3, k4, k5)))
    end = moved(state, h, B, (k1, k2, k3, k4, k5, k6))
    seen = observe(system, time + h, end)
    return end, seen, moved(NOTHING, h, E, (k1, k2, k3, k4, k5, k6, seen[0]))
