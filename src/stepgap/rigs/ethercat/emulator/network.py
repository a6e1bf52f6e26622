"""A wire in software: a veth pair, one end for the master, one for the ring; Linux only."""

import ctypes
import os
import shutil
import socket
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn

from stepgap.base.errors import StepGapError
from stepgap.rigs.ethercat.emulator.frame import ETHERTYPE

_LONGEST_NAME = 15
"""Characters of an interface's name (IFNAMSIZ − 1)."""

RING_END = "-ring"
"""What the name of the ring's end has after the master's."""

_ADVICE = (
    "raw Ethernet needs root (CAP_NET_ADMIN and CAP_NET_RAW). Run it with sudo; or without, where your system "
    "allows it, in a network of its own: `unshare -Urn COMMAND`, master and ring in the same COMMAND; "
    "in a container add --cap-add NET_ADMIN --cap-add NET_RAW"
)


CLONE_NEWNET = 0x40000000


class NoNetwork(StepGapError):
    """The network interface cannot be had; the message says what to do."""


@contextmanager
def wire(name: str) -> Iterator[socket.socket]:
    """Makes a veth pair, up on both ends, and takes it away in the end.

    Where the kernel grants one, the ring's end lies in a network namespace that only its socket keeps alive: both ends
    then go with the process, even if it is killed.

    Args:
        name: Of the master's end; the ring's end is called NAME-ring.

    Yields:
        A socket at the ring's end.

    Raises:
        NoNetwork: It cannot be made.
    """
    other = name + RING_END
    if not name or len(other) > _LONGEST_NAME:
        raise NoNetwork(f"the interface's name must have 1 to {_LONGEST_NAME - len(RING_END)} characters, not '{name}'")
    with _other_namespace() as ours:
        _ip("link", "add", other, "type", "veth", "peer", "name", name, *ours)
        _ip("link", "set", other, "up")
        raw = raw_socket(other)
    with raw:
        try:
            _ip("link", "set", name, "up")
            yield raw
        finally:
            _ip("link", "del", name)


@contextmanager
def _other_namespace() -> Iterator[Sequence[str]]:
    """This thread in a network namespace of its own, if it may; `ip`'s words for where it was, else none."""
    here, libc = os.open("/proc/thread-self/ns/net", os.O_RDONLY), ctypes.CDLL(None, use_errno=True)
    try:
        if libc.unshare(CLONE_NEWNET):
            yield ()
            return
        try:
            yield "netns", f"/proc/{os.getpid()}/fd/{here}"
        finally:
            if libc.setns(here, CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "cannot go back to the network namespace")
    finally:
        os.close(here)


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
        raise NoNetwork(_ADVICE) from refused
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
        raise NoNetwork(f"the command `unshare` (util-linux) is missing; {_ADVICE}")
    begin = [program, "--user", "--map-root-user", "--net"]
    trial = subprocess.run([*begin, "true"], capture_output=True, text=True, check=False)
    if trial.returncode:
        raise NoNetwork(f"{trial.stderr.strip()}: {_ADVICE}")
    os.execv(program, [*begin, "--", *command])


def _ip(*arguments: str) -> None:
    program = shutil.which("ip", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")
    if program is None:
        raise NoNetwork("the command `ip` is missing; Debian, Ubuntu: apt install iproute2")
    outcome = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    if outcome.returncode:
        said = outcome.stderr.strip()
        if "not permitted" in said:
            raise NoNetwork(f"ip {' '.join(arguments)}: {said}: {_ADVICE}")
        exists = "; end the emulator that has it, or take it away by `ip link del`" if "exists" in said else ""
        raise NoNetwork(f"ip {' '.join(arguments)}: {said}{exists}")
