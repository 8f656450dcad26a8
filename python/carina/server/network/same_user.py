"""Check whether a connection comes from a program of the user who runs the server."""

from __future__ import annotations

import ipaddress
import os
import socket
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from carina.server.network.access_checks import is_loopback

SOCKET_TABLES = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
"""Tables of the TCP sockets of this machine, with the user of each; only Linux has them."""
ESTABLISHED = "01"


def comes_from_same_user(scope: Mapping[str, Any], tables: tuple[Path, ...] = SOCKET_TABLES) -> bool:
    """Return whether the program at the other end of a loopback connection belongs to the user of this process.

    The kernel records the user of each socket, so no program can state another user. The result is False for
    connections from other machines and on systems that do not show the user of a socket.

    Parameters
    ----------
    scope
        ASGI scope of the request, with the addresses of both ends.
    tables
        Files in the format of ``/proc/net/tcp``.
    """
    client, server = scope.get("client"), scope.get("server")
    if client is None or server is None or not hasattr(os, "getuid"):
        return False
    if not (is_loopback(str(client[0])) and is_loopback(str(server[0]))):
        return False
    try:
        ends = _table_addresses(str(client[0]), int(client[1])), _table_addresses(str(server[0]), int(server[1]))
    except (ValueError, OSError):
        return False
    users = {user for table in tables for user in _users_of_socket(table, *ends)}
    return users == {os.getuid()}


def _table_addresses(host: str, port: int) -> set[str]:
    """Return an address and port as the socket tables write them: words of four bytes in the order of the machine."""
    address = ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
    forms = [address.packed]
    if address.version == 4:
        # A socket for IPv6 lists an IPv4 address in its mapped form.
        forms.append(socket.inet_pton(socket.AF_INET6, f"::ffff:{address}"))
    texts = set()
    for packed in forms:
        words = struct.unpack(f"={len(packed) // 4}I", packed)
        texts.add("".join(f"{word:08X}" for word in words) + f":{port:04X}")
    return texts


def _users_of_socket(table: Path, client: set[str], server: set[str]) -> set[int]:
    """Return the users of the established sockets from ``client`` to ``server`` in one table."""
    try:
        lines = table.read_text("ascii").splitlines()[1:]
    except (OSError, UnicodeDecodeError):
        return set()
    users = set()
    for line in lines:
        fields = line.split()
        if len(fields) > 7 and fields[1] in client and fields[2] in server and fields[3] == ESTABLISHED:
            users.add(int(fields[7]))
    return users
