"""The program of a ball on a paddle whose height changes: it reports where it found it, and takes another command."""

import json
import sys

height, floors = 0.5, iter([0.1, -0.05, 0.0])
late, breaks = "late" in sys.argv, "breaks" in sys.argv


def answer(content: object) -> None:
    print(json.dumps(content), flush=True)


for line in sys.stdin:
    message = json.loads(line)
    if "stepgap" in message:
        answer({"ready": {"state": {"height": "m"}, "command": {"paddle": "m/s"}}})
    elif "start" in message:
        answer({"state": {"height": height}, "floor": 0.0})
    elif "step" in message:
        number, floor, first = message["step"], next(floors), message["command"]
        answer({"step": number, "touchdown": {"floor": floor}})
        command = json.loads(sys.stdin.readline())["command"]
        if breaks:
            answer({"error": "it is hot"})
        if late:
            command = first
        height = 0.6 * (height - floor) + 0.2 * command["paddle"] + floor
        reply = {"step": number, "next": {"height": height}, "status": "ok", "floor": floor}
        answer(reply | ({"requested": command} if late else {}))
    elif "stop" in message:
        break
