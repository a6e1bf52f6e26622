"""The program of a robot in Python, for `stepgap run --plant process`; it needs no package, StepGap included.

    stepgap run --plant process --iterations 2 --out runs/python -- python3 examples/process/robot.py

For your robot, replace the body of `hop`: give the command to your controller, wait until the robot is at the next
apex, and return the state there. docs/process.md describes the lines that are exchanged.
"""

import json
import random
import sys

UNITS = {"state": {"speed": "m/s", "height": "m"}, "command": {"fx": "N", "fy": "N"}}


def hop(state: dict[str, float], command: dict[str, float]) -> dict[str, float]:
    """One hop of a robot that differs from StepGap's model, from apex to apex."""
    speed, height, fx, fy = state["speed"], state["height"], command["fx"], command["fy"]
    return {
        "speed": 0.66 * speed + 0.017 * fx - 1.5e-4 * fy * speed + 0.34 * (height - 0.58) + 0.115
        + random.gauss(0, 0.003),
        "height": 0.9 * height + 0.0036 * fy + 2e-5 * fy**2 + 0.05 * speed**2 + 0.0755 + random.gauss(0, 0.0006),
    }  # fmt: skip


def main() -> None:
    """Answers every line of StepGap by one line, until its input ends."""
    state = {"speed": 0.0, "height": 0.55}
    for line in sys.stdin:
        message = json.loads(line)
        if "stepgap" in message:
            answer = {"ready": UNITS}
        elif "start" in message:
            answer = {"state": state}
        elif "step" in message:
            state = hop(state, message["command"])
            answer = {"step": message["step"], "next": state, "status": "ok"}
        else:
            break  # stop: here a real robot comes to rest, and also after the loop if the input just ends
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
