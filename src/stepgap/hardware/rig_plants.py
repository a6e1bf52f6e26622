"""The plants of a run on a rig: the loop in real time, with torque only after all proofs."""

from functools import partial
from pathlib import Path

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.files import own_folder
from stepgap.experiment.loop import Plants
from stepgap.experiment.plants import PlantRequest
from stepgap.hardware.commissioning.check import checked
from stepgap.hardware.commissioning.proof import JOG, proven
from stepgap.hardware.realtime.consent import supervised
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.realtime_plant import KeptEvidence, RealtimePlant
from stepgap.plants.plant import Plant
from stepgap.rigs.entry_points import load_rig
from stepgap.rigs.limits import RigLimits


def rig_plants(request: PlantRequest) -> Plants:
    """The plants of a rig, found by its name; before each deployment, the proofs of commissioning are read again.

    Raises:
        InputError: The rig cannot be made, gives no torque with these options, or lacks a proof.
    """
    settings = request.settings
    if not settings.rig:
        raise InputError(f"--plant {settings.plant}: give the rig's file by --rig RIG.toml")
    control = settings.robot.control()
    if control is None:
        raise InputError(f"--plant {settings.plant}: robot '{settings.robot.name}' has no control for a rig")
    make_rig = partial(load_rig, settings.plant, Path(settings.rig), settings.robot)
    limits = make_rig().limits  # reports errors before the first deployment
    if not request.arm:
        raise InputError(
            f"--plant {settings.plant}: gives torque only with --arm; `stepgap rig dry-run` tests all but torque"
        )
    simulated = require_limits(settings.rig, limits).simulated
    loop, consent = supervised(LoopSettings(), control.consent_request, simulated)
    setup = RealtimeSetup(make_rig, control, loop)
    logs = own_folder(request.folder, "ticks")
    kept = KeptEvidence()

    def require_proofs() -> None:
        checked(Path(settings.rig))
        if not simulated:
            proven(Path(settings.rig), JOG)

    def make(_: np.random.Generator) -> Plant:
        require_proofs()
        return RealtimePlant(setup, logs, consent, Path(settings.rig).read_text("utf-8"), kept)

    require_proofs()
    return Plants(make, replays=False)


def require_limits(rig: str, limits: RigLimits | None) -> RigLimits:
    """Returns the limits of a rig, after ensuring that all of them limit something.

    Raises:
        InputError: One of them does not, or there are none.
    """
    if limits is None:
        raise InputError(f"{rig}: the rig has no limits; torque needs a rig whose `limits` are all finite")
    if lacking := limits.without_effect():
        raise InputError(
            f"{rig}: [limits] lacks {', '.join(lacking)}; torque needs a finite value of each, as in examples/rig.toml"
        )
    return limits
