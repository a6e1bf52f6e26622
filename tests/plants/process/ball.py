"""The program of a robot for tests: a ball on a paddle. Its argument says what it does wrong, and in which step."""

import json
import math
import os
import sys
import time

fault, at = (sys.argv[1], int(sys.argv[2])) if len(sys.argv) > 2 else ("", 0)
height = 0.5


def answer(content: object) -> None:
    print(content if isinstance(content, str) else json.dumps(content), flush=True)


for line in sys.stdin:
    message = json.loads(line)
    if "stepgap" in message:
        units = {kind: {one["name"]: one["unit"] for one in message[kind]} for kind in ("state", "command")}
        if fault == "units":
            units["state"] = {"height": "mm"}
        answer({"ready": units})
    elif "start" in message:
        answer({"state": {"height": math.nan if fault == "start" else height}})
    elif "step" in message:
        number, paddle = message["step"], message["command"]["paddle"]
        leaving = 0.8 * math.sqrt(2 * 9.81 * height) + 1.8 * 0.9 * paddle
        reply = {"step": number, "next": {"height": leaving**2 / (2 * 9.81)}, "status": "ok"}
        if number == at:
            if fault == "exit":
                sys.exit(3)
            elif fault == "kill":
                os.kill(os.getpid(), 9)
            elif fault == "stall":
                time.sleep(60)
            elif fault == "close":
                os.close(1)
                time.sleep(60)
            elif fault == "fell":
                reply = {"step": number, "status": "fell"}
            elif fault == "long":
                reply["more"] = "x" * 100_000
            elif fault == "twice":
                answer(reply)
            elif fault == "applied":
                reply |= {"applied": {"paddle": 0.25}, "yaw": 1.5}
            elif fault == "flood":
                for _ in range(100):
                    answer(reply)
            elif fault == "deaf":
                sys.stdin.close()
            elif fault:
                reply = fault.replace("'", '"')
        answer(reply)
        if reply != fault and isinstance(reply, dict) and "next" in reply:
            height = reply["next"]["height"]
    elif "stop" in message:
        print("at rest", file=sys.stderr)
        break
