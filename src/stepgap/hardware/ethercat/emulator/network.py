"""A virtual network cable: a veth pair, with one end for the master and one for the ring; Linux only."""

import ctypes
import os
import shutil
import socket
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn

from stepgap.base.errors import StepGapError
from stepgap.hardware.ethercat.emulator.frame import ETHERTYPE

_LONGEST_NAME = 15  # Characters of an interface's name (IFNAMSIZ − 1)
RING_END = "-ring"  # Suffix of the name of the ring's end

_ADVICE = (
    "raw Ethernet needs root (CAP_NET_ADMIN and CAP_NET_RAW). Run it with sudo; or without, where your system "
    "allows it, in a separate network: `unshare -Urn COMMAND`, master and ring in the same COMMAND; "
    "in a container add --cap-add NET_ADMIN --cap-add NET_RAW"
)


CLONE_NEWNET = 0x40000000


class NoNetwork(StepGapError):
    """The network interface cannot be created; the message contains the remedy."""


@contextmanager
def wire(name: str) -> Iterator[socket.socket]:
    """Creates a veth pair, up on both ends, and deletes it at the end.

    If the kernel allows it, the ring's end is in a network namespace that only its socket keeps alive: then both ends
    vanish with the process, even if it is killed.

    Args:
        name: Name of the master's end; the ring's end is called NAME-ring.

    Yields:
        A socket at the ring's end.

    Raises:
        NoNetwork: It cannot be created.
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
    """Moves this thread to a new network namespace, if allowed; yields `ip`'s arguments for the former one."""
    here = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    libc = ctypes.CDLL(None, use_errno=True)
    try:
        if libc.unshare(CLONE_NEWNET):
            yield ()
            return
        try:
            yield "netns", f"/proc/{os.getpid()}/fd/{here}"
        finally:
            if libc.setns(here, CLONE_NEWNET):
                raise OSError(ctypes.get_errno(), "cannot return to the network namespace")
    finally:
        os.close(here)


def raw_socket(interface: str) -> socket.socket:
    """Opens a socket for the EtherCAT frames on an interface; it does not receive the frames that it sends.

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
    """Replaces this process by `command` in a new user and network namespace, where interfaces need no root.

    Ring and master must both be in it; its interfaces vanish with its last process.

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
        error = outcome.stderr.strip()
        if "not permitted" in error:
            raise NoNetwork(f"ip {' '.join(arguments)}: {error}: {_ADVICE}")
        remedy = "; end the emulator that uses it, or delete it by `ip link del`" if "exists" in error else ""
        raise NoNetwork(f"ip {' '.join(arguments)}: {error}{remedy}")
