"""Sockets that listen, and this machine's address in its network."""

from __future__ import annotations

import errno
import os
import socket

from carina.errors import CarinaError

__all__ = ["bind", "lan_address"]


def bind(host: str, port: int) -> socket.socket:
    """A listening socket.

    Raises
    ------
    CarinaError
        ``server.port`` if the port is taken or not allowed; ``server.host`` if this machine has no such address.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError) as trouble:
        raise CarinaError(
            f"cannot listen on {host!r}: this machine has no such address", code="server.host"
        ) from trouble
    # Named as TCP: asyncio sends at once only on its connections. On others a picture waits until the window
    # has acknowledged the message before it, which it puts off by up to 40 ms (Nagle, delayed acknowledgements).
    sock = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        if os.name == "posix":
            # A port whose last connections are still closing is free; on Windows this flag would share a port in use.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(address)
        sock.listen(64)
    except OSError as trouble:
        sock.close()
        if trouble.errno == errno.EADDRINUSE:
            msg = f"port {port} is in use by another program; choose another with --port, or omit it to use a free one"
            raise CarinaError(msg, code="server.port") from trouble
        if trouble.errno == errno.EACCES:
            msg = f"port {port} is reserved; choose one above 1023, or omit it to use a free one"
            raise CarinaError(msg, code="server.port") from trouble
        msg = f"cannot listen on {host!r}: {trouble.strerror}"
        raise CarinaError(msg, code="server.host") from trouble
    sock.set_inheritable(False)
    return sock


def lan_address() -> str:
    """The address by which machines of the local network reach this one.

    Raises
    ------
    CarinaError
        ``server.no-network`` if there is none.
    """
    found = ""
    for family, elsewhere in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            try:
                # A datagram socket sends nothing by this: the system only chooses the way, and with it our address.
                probe.connect((elsewhere, 9))
                found = str(probe.getsockname()[0])
            except OSError:
                continue
        if found and not found.startswith(("127.", "::1", "fe80:")):
            return found
    msg = "this machine has no network address that a phone can reach; connect it to a wireless network first"
    raise CarinaError(msg, code="server.no-network")
