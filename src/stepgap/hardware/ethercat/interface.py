"""The network interface of a bus: one process at a time is its master, and has a raw socket on it."""

import socket
from pathlib import Path

from stepgap.rigs.rig import RigFault


def claimed(interface: str) -> socket.socket:
    """Claims an interface for this process, until it closes the returned socket or ends in any way.

    The claim is a name of an abstract Unix socket, which belongs to the network namespace, as the interface does.

    Raises:
        RigFault: Another process has claimed it.
    """
    claim = socket.socket(socket.AF_UNIX)
    try:
        claim.bind(f"\0stepgap-master-of-{interface}")
    except OSError:
        claim.close()
        raise RigFault(
            f"another process is already the master of {interface}; end it first, since a bus can have only one master"
        ) from None
    return claim


def open_sockets() -> set[int]:
    """Descriptors of this process that are sockets; pysoem does not report which one it opened."""
    found = set()
    for link in Path("/proc/self/fd").iterdir():
        try:
            if str(link.readlink()).startswith("socket:"):
                found.add(int(link.name))
        except FileNotFoundError:  # the descriptor that lists the folder
            continue
    return found
