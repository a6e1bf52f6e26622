"""States of a deployment on hardware, as they stand in a tick log."""

from enum import IntEnum


class RigState(IntEnum):
    """States of a deployment on hardware; torque is on only in STAND, STEP and STOP, and while a FAULT brakes."""

    OFF = 0
    CONNECT = 1
    CALIBRATE = 2
    READY = 3
    STAND = 4
    STEP = 5
    STOP = 6
    FAULT = 7
