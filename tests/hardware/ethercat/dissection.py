"""Recorded frames as Wireshark understands them, by its program for the command line, tshark."""

import os
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

needs_tshark = pytest.mark.skipif(
    shutil.which("tshark") is None,
    reason="no tshark on this machine (Debian: apt install tshark), so frames are not dissected",
)


class Dissected(NamedTuple):
    """What Wireshark found in a frame; of several datagrams or messages all, with commas between them.

    Attributes:
        protocols: Protocols, outermost first.
        source: Source address.
        command: Commands of the datagrams.
        service: CoE services of mailbox messages.
        abort: Abort codes of SDOs.
        refusal: Codes of refused requests for information on objects.
        malformed: Not empty if the frame cannot be dissected to its end.
        remarks: Wireshark's expert information.
    """

    protocols: str
    source: str
    command: str
    service: str
    abort: str
    refusal: str
    malformed: str
    remarks: str


_FIELDS = (
    "frame.protocols",
    "eth.src",
    "ecat.cmd",
    "ecat_mailbox.coe.type",
    "ecat_mailbox.coe.abortcode",
    "ecat_mailbox.coe.sdoinfoerrorcode",
    "_ws.malformed",
    "_ws.expert.message",
)


def dissected(frames: Path) -> list[Dissected]:
    """Dissects a recording."""
    fields = [argument for field in _FIELDS for argument in ("-e", field)]
    command = ["tshark", "-n", "-r", str(frames), "-T", "fields", *fields]
    environment = os.environ | {"HOME": str(frames.parent)}  # without a user's preferences
    output = subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout
    return [Dissected(*line.split("\t")) for line in output.splitlines()]
