"""The program of a robot that walks at a commanded velocity, for `stepgap run --robot velocity --plant process`.

    stepgap run --robot velocity --plant process --out runs/walker -- python3 examples/process/walker.py

It needs no package, StepGap included. For your robot, replace the body of `walk`: give the command to the controller,
as a joystick does, wait for half a second, and return the mean velocity of that time in the frame of the body.
"""

import json
import random
import sys

UNITS = {
    "state": {"vx": "m/s", "vy": "m/s", "wz": "rad/s"},
    "command": {"command_vx": "m/s", "command_vy": "m/s", "command_wz": "rad/s"},
}


def walk(velocity: dict[str, float], command: dict[str, float]) -> dict[str, float]:
    """Half a second of a robot that is too slow, drifts to the left, and does not move where it is told little."""
    forward, left, turn = (command[name] for name in UNITS["command"])
    if abs(forward) + abs(left) + abs(turn) < 0.08:
        wanted = {"vx": 0.0, "vy": 0.0, "wz": 0.0}
    else:
        wanted = {"vx": 0.7 * forward - 0.04, "vy": 0.8 * left + 0.05 * forward + 0.02, "wz": 0.75 * turn - 0.2 * left}
    return {name: 0.2 * velocity[name] + 0.8 * wanted[name] + random.gauss(0, 0.01) for name in velocity}


def main() -> None:
    """Answers every line of StepGap by one line, until its input ends."""
    velocity = {"vx": 0.0, "vy": 0.0, "wz": 0.0}
    for line in sys.stdin:
        message = json.loads(line)
        if "stepgap" in message:
            answer = {"ready": UNITS}
        elif "start" in message:
            answer = {"state": velocity}
        elif "step" in message:
            velocity = walk(velocity, message["command"])
            answer = {"step": message["step"], "next": velocity, "status": "ok"}
        else:
            break  # stop: here a real robot comes to rest, and also after the loop if the input just ends
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
