"""The address of the page."""

import errno
import socket

from stepgap.base.errors import InputError

HERE = "127.0.0.1"  # Host address that only this machine can reach

FIRST_PORT = 8080
PORTS_TRIED = 100
"""First port that is tried, and number of ports that are tried."""


def free_port(host: str, port: int | None) -> int:
    """A port on which a server can start.

    Args:
        host: Host name or address of the network interface.
        port: Port; None for the first free one.

    Raises:
        InputError: Host or port cannot be used.
    """
    if port is not None and not 0 < port < 2**16:
        raise InputError(f"--port {port}: it must lie between 1 and 65535")
    for candidate in [port] if port else range(FIRST_PORT, FIRST_PORT + PORTS_TRIED):
        if _is_free(host, candidate):
            return candidate
    tried = f"--port {port}: it is taken" if port else f"ports {FIRST_PORT} to {FIRST_PORT + PORTS_TRIED - 1} are taken"
    raise InputError(f"{tried}; choose another --port")


def _is_free(host: str, port: int) -> bool:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except (socket.gaierror, UnicodeError):
        raise InputError(f"--host {host}: no such address; without --host the page is local") from None
    except PermissionError:
        raise InputError(f"--port {port}: no permission; choose a port from 1024 on") from None
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            raise InputError(f"--host {host}: not an address of this machine; 0.0.0.0 means all of them") from None
        return False
    return True
