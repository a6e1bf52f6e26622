"""A wire in software: a veth pair, one end for the master, one for the ring; Linux only."""

import os
import shutil
import socket
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn

from stepgap.rigs.ethercat.emulator.frame import ETHERTYPE

LONGEST_NAME = 15
"""Characters of an interface's name (IFNAMSIZ − 1)."""

RING_END = "-ring"
"""What the name of the ring's end has after the master's."""

ADVICE = (
    "raw Ethernet needs root (CAP_NET_ADMIN and CAP_NET_RAW). Run it with sudo; or without, where your system "
    "allows it, in a network of its own: `unshare -Urn COMMAND`, master and ring in the same COMMAND; "
    "in a container add --cap-add NET_ADMIN --cap-add NET_RAW"
)


class NoNetwork(Exception):
    """The network interface cannot be had; the message says what to do."""


@contextmanager
def veth_pair(name: str) -> Iterator[str]:
    """Makes a veth pair, up on both ends, and takes it away in the end.

    Args:
        name: Of the master's end; the ring's end is called NAME-ring.

    Yields:
        The name of the ring's end.

    Raises:
        NoNetwork: It cannot be made.
    """
    other = name + RING_END
    if not name or len(other) > LONGEST_NAME:
        raise NoNetwork(f"the interface's name must have 1 to {LONGEST_NAME - len(RING_END)} characters, not '{name}'")
    _ip("link", "add", name, "type", "veth", "peer", "name", other)
    try:
        for end in (name, other):
            _ip("link", "set", end, "up")
        yield other
    finally:
        _ip("link", "del", name)


def raw_socket(interface: str) -> socket.socket:
    """A socket for the EtherCAT frames on an interface; it does not hear what it sends itself.

    Raises:
        NoNetwork: Raw sockets are not allowed, or there is no such interface.
    """
    if not hasattr(socket, "AF_PACKET"):
        raise NoNetwork("an emulated ring needs Linux: raw packet sockets are missing here")
    try:
        raw = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETHERTYPE))
    except PermissionError as refused:
        raise NoNetwork(ADVICE) from refused
    try:
        raw.bind((interface, ETHERTYPE))
    except OSError as missing:
        raw.close()
        raise NoNetwork(f"interface '{interface}' cannot be used: {missing.strerror}") from missing
    return raw


def run_in_namespace(command: Sequence[str]) -> NoReturn:
    """Becomes `command` in a user and network namespace of its own, where interfaces can be made without being root.

    Ring and master must both be in there; all interfaces in it end with the last process.

    Raises:
        NoNetwork: The system does not allow it.
    """
    program = shutil.which("unshare")
    if program is None:
        raise NoNetwork(f"the command `unshare` (util-linux) is missing; {ADVICE}")
    begin = [program, "--user", "--map-root-user", "--net"]
    trial = subprocess.run([*begin, "true"], capture_output=True, text=True, check=False)
    if trial.returncode:
        raise NoNetwork(f"{trial.stderr.strip()}: {ADVICE}")
    os.execv(program, [*begin, "--", *command])


def _ip(*arguments: str) -> None:
    program = shutil.which("ip", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    if program is None:
        raise NoNetwork("the command `ip` is missing; Debian, Ubuntu: apt install iproute2")
    outcome = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    if outcome.returncode:
        said = outcome.stderr.strip()
        if "not permitted" in said:
            raise NoNetwork(f"ip {' '.join(arguments)}: {said}: {ADVICE}")
        again = f"; if an emulator was killed, `ip link del {arguments[2]}` takes its interface away"
        raise NoNetwork(f"ip {' '.join(arguments)}: {said}" + (again if "exists" in said else ""))
