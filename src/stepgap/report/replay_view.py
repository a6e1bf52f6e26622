"""The replay on the page: a 3-D drawing that can be played, scrubbed and rotated, without a library."""

import json
from base64 import b64encode
from importlib.resources import files
from typing import Any, Final

import numpy as np

from stepgap.learning.step_log import StepLog
from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord
from stepgap.report.html import absence, safe
from stepgap.report.motion import RATE, DeploymentMotion, Replay
from stepgap.step import Array

REPLAY_SCRIPT: Final = files("stepgap.report").joinpath("replay.js").read_text(encoding="utf-8")
"""Script that draws the replay; its data are in the page."""

LEVELS: Final = 65535
"""Number of levels into which the range of a channel is divided."""

MOST_FRAMES: Final = 60_000
"""Largest number of frames of a motion on the page; a longer motion is thinned."""

CONTROLS: Final = """<div id="replay-view">
<canvas id="replay-canvas" tabindex="0" role="img" aria-label="The hopper on its boom; drag to turn the view"></canvas>
<p id="replay-moment" aria-live="off">The replay needs JavaScript, which does not run here.</p>
<input id="replay-slider" type="range" min="0" max="0" value="0" aria-label="Time">
<p class="controls"><button id="replay-play" type="button">Play</button>
<label>deployment <select id="replay-deployment"></select></label>
<label>speed <select id="replay-speed"><option>0.1</option><option>0.25</option><option>0.5</option>
<option selected>1</option><option>2</option><option>8</option></select></label>
<label>zoom <input id="replay-zoom" type="range" min="0" max="100" value="75"></label>
<label><input id="replay-follow" type="checkbox" checked> follow the hopper</label></p>
</div>"""


def replay_view(record: RunRecord, replay: Replay | Missing) -> str:
    """Canvas, controls and data of the replay, or the reason why there are none."""
    if isinstance(replay, Missing):
        return absence("replay", replay)
    robot = replay.robot
    data = {
        "levels": LEVELS,
        "leg": [robot.top_length, robot.bottom_length, robot.foot_length],
        "boom": robot.boom_length,
        "pivot": replay.pivot_height,
        "motions": [_motion(number, motion, record.steps) for number, motion in replay.motions.items()],
    }
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    kept = f'<script type="application/json" id="replay-data">{text}</script>'
    return f'{CONTROLS}\n<p class="note">{safe(_legend())}</p>\n{kept}'


def _legend() -> str:
    return (
        "Drag to rotate; the keys ← and → move by one frame. The leg is drawn as a closed chain; the foot is filled "
        "while it bears load. Dashed: target height of the next apex. Circles: measured apexes; bars: their targets. "
        "The motion was measured by the sensors of boom and motors; motion that they cannot measure, such as the "
        f"boom's bending, is not shown. There are {RATE} frames per second."
    )


def _motion(number: int, motion: DeploymentMotion, log: StepLog) -> dict[str, Any]:
    """JSON data of a motion: its channels as consecutive 16-bit integers, and its steps."""
    every = -(-len(motion.step) // MOST_FRAMES)
    channels = [channel[::every] for channel in motion.channels.values()]
    ranges = [[float(channel.min()), float(channel.max())] for channel in channels]
    packed = b"".join(_levels(channel).astype("<u2").tobytes() for channel in channels)
    steps = [
        [logged.step, *_rounded(logged.target), *_rounded(logged.record.next_state), *_rounded(logged.record.command)]
        for logged in log.of_iteration(number)
    ]
    return {
        "deployment": number,
        "rate": RATE / every,
        "frames": len(channels[0]),
        "channels": list(motion.channels),
        "ranges": ranges,
        "packed": b64encode(packed).decode(),
        "steps": steps,
    }


def _levels(channel: Array) -> Array:
    """The channel scaled from 0 at its smallest to `LEVELS` at its largest value."""
    span = float(np.ptp(channel))
    return np.round((channel - channel.min()) / span * LEVELS) if span > 0 else np.zeros(len(channel))


def _rounded(values: Array) -> list[float | None]:
    return [round(float(value), 5) if np.isfinite(value) else None for value in values]
