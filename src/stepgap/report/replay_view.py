"""The replay on the page: a 3-D drawing that can be played, scrubbed and rotated, without a library."""

import json
import zlib
from base64 import b64encode
from importlib.resources import files
from typing import Any, Final

import numpy as np

from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.records.motion_file import INTERVAL, Replay
from stepgap.records.text import decimals_of
from stepgap.report.html import absence, safe
from stepgap.robots.scene import GroundPieces, Motion, Scene
from stepgap.step import Array, Quantity

REPLAY_SCRIPT: Final = files("stepgap.report").joinpath("replay.js").read_text(encoding="utf-8")
"""Script that draws the replay; its data are in the page."""

LEVELS: Final = 65535
"""Number of levels into which the ranges of step and position are divided, which may grow with the run."""

COARSE_LEVELS: Final = 8191
"""Number of levels of all other channels, such as points relative to the body: 0.1 mm in 0.8 m, in half the bytes."""

MOST_FRAMES: Final = 60_000  # Largest number of frames of a motion on the page; a longer motion is thinned

CONTROLS: Final = """<div id="replay-view">
<canvas id="replay-canvas" tabindex="0" role="img" aria-label="The robot; drag to turn the view"></canvas>
<p id="replay-moment" aria-live="off">The replay needs JavaScript, which does not run here.</p>
<input id="replay-slider" type="range" min="0" max="0" value="0" aria-label="Time">
<p class="controls"><button id="replay-play" type="button">Play</button>
<label>deployment <select id="replay-deployment"></select></label>
<label>speed <select id="replay-speed"><option>0.1</option><option>0.25</option><option>0.5</option>
<option selected>1</option><option>2</option><option>8</option></select></label>
<label>zoom <input id="replay-zoom" type="range" min="0" max="100" value="75"></label>
<label><input id="replay-follow" type="checkbox" checked> follow the robot</label></p>
</div>"""

CHARTS: Final = '<div id="replay-signals" role="img" aria-label="Curves over the step that is shown"></div>'


def replay_view(run: Run, replay: Replay | Missing) -> str:
    """Canvas, controls and data of the replay of a run, or the reason why there are none."""
    if isinstance(replay, Missing):
        return absence("replay", replay)
    scene = replay.scene
    space = run.steps.space
    names = list(scene.points)
    has_height = scene.height in space.state_names
    height = space.state_names.index(scene.height) if has_height else None
    above = "" if height is None else space.state[height].above
    data = {
        "points": list(scene.points.values()),
        "links": [[names.index(link.start), names.index(link.end), link.radius, link.shade] for link in scene.links],
        "body": names.index(scene.body),
        "feet": [names.index(foot) for foot in scene.feet],
        "height": height,
        "circle": scene.circle,
        "signals": list(scene.signals.items()),
        "state": [_described(quantity) for quantity in space.state],
        "command": [_described(quantity) for quantity in space.command],
        "motions": [
            _packed(number, motion, scene, run.steps, above) | {"ground": _drawn(replay.grounds.get(number))}
            for number, motion in replay.motions.items()
        ],
    }
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")
    kept = f'<script type="application/json" id="replay-data">{text}</script>'
    signals = f"{CHARTS}\n" if scene.signals else ""
    return f'{CONTROLS}\n{signals}<p class="note">{safe(_legend(replay, has_height))}</p>\n{kept}'


def _legend(replay: Replay, height: bool) -> str:
    """Sentences on what is drawn of this robot; `height` says whether its height has a target."""
    scene = replay.scene
    parts = ["Drag to rotate; the keys ← and → move by one frame."]
    if scene.feet:
        parts.append("A foot is filled while it touches the ground.")
    if height:
        parts.append(
            "Dashed: target height at the end of the step. Circles: measured heights at the ends of steps; bars: their "
            "targets."
        )
    if any(ground.changed.any() for ground in replay.grounds.values()):
        parts.append("Yellow: ground that is softer or more slippery, or the contrary, than elsewhere.")
    if scene.signals:
        rate = f"at most {1 / INTERVAL:g} values per second"
        parts.append(f"Curves: the step that is shown, with {rate}; short peaks may be missing.")
    bending = ", such as the bending of the boom," if scene.circle else ""
    parts.append(f"The motion is drawn from the ticks; what they do not contain{bending} is not shown.")
    return " ".join(parts)


def _described(quantity: Quantity) -> list[str | int]:
    """Name, unit and number of decimals of a quantity."""
    return [quantity.name, quantity.unit, decimals_of(quantity)]


def _drawn(ground: GroundPieces | None) -> list[list[float | int]]:
    """Start and end of each piece of the ground, its heights there [m, to 0.1 mm], and 1 where it is changed."""
    return [] if ground is None else np.round(np.column_stack(ground), 4).tolist()


def _packed(number: int, motion: Motion, scene: Scene, log: Steps, above: str) -> dict[str, Any]:
    """JSON data of a motion: the bends of its channels as consecutive 16-bit integers, compressed, and its steps.

    Each step has the height of its ground, which is the quantity `above` which its own height is measured. The channels
    are the step, the position of the body, those of all points relative to it, the contacts and the signals. Of a
    channel that is constant, only the value is there.
    """
    every = -(-len(motion.time) // MOST_FRAMES)
    body = motion.positions[:, scene.index(scene.body), :]
    relative = (motion.positions - body[:, None]).reshape(len(body), -1)
    channels = np.column_stack([motion.step, body, relative, motion.touching, motion.signals])[::every].T
    ends = (1 + len(body.T)) * [LEVELS] + (len(channels) - 1 - len(body.T)) * [COARSE_LEVELS]
    ranges = [[float(channel.min()), float(channel.max()), end] for channel, end in zip(channels, ends, strict=True)]
    scaled = [_levels(channel, end) for channel, end in zip(channels, ends, strict=True) if np.ptp(channel)]
    frames = channels.shape[1]
    levels = np.array(scaled, np.int64).reshape(-1, frames)
    bends = np.diff(np.diff(levels, prepend=0), prepend=0)  # of a smooth motion they are small, and are packed densely
    packed = zlib.compress((bends % (LEVELS + 1)).astype("<u2").tobytes(), 9)
    steps = [
        [
            logged.step,
            *map(_rounded, (logged.target, logged.record.next_state, logged.record.command)),
            float(f"{np.nan_to_num(logged.record.context.get(above, 0.0)):.9g}"),
        ]
        for logged in log.of_iteration(number)
    ]
    return {
        "deployment": number,
        "rate": (frames - 1) / max(float(np.ptp(motion.time[::every])), 1e-9),
        "frames": frames,
        "ranges": ranges,
        "packed": b64encode(packed).decode(),
        "steps": steps,
    }


def _levels(channel: Array, end: int) -> Array:
    """The channel scaled from 0 at its smallest to `end` at its largest value."""
    return np.round((channel - channel.min()) / np.ptp(channel) * end)


def _rounded(values: Array) -> list[float | None]:
    return [float(f"{value:.9g}") if np.isfinite(value) else None for value in values]
