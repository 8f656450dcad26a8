"""Listening sockets, and the address of this machine in the local network."""

from __future__ import annotations

import errno
import os
import socket

from carina.errors import CarinaError


def bind(host: str, port: int) -> socket.socket:
    """Return a listening TCP socket.

    Raises
    ------
    CarinaError
        With code ``server.port`` if the port is taken or not allowed; with code
        ``server.host`` if this machine has no such address.
    """
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    except (OSError, UnicodeError) as error:
        raise CarinaError(f"cannot listen on {host!r}: this machine has no such address", code="server.host") from error
    # IPPROTO_TCP is explicit because asyncio sets TCP_NODELAY only on such sockets. Without it, a frame can wait up to
    # 40 ms for the acknowledgement of the previous message (Nagle's algorithm, delayed acknowledgements).
    sock = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        if os.name == "posix":
            # Allows a port whose last connections are still closing; on Windows this flag would share a port in use.
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(address)
        sock.listen(64)
    except OSError as error:
        sock.close()
        if error.errno == errno.EADDRINUSE:
            msg = f"port {port} is in use by another program; choose another with --port, or omit it to use a free one"
            raise CarinaError(msg, code="server.port") from error
        if error.errno == errno.EACCES:
            msg = f"port {port} is reserved; choose one above 1023, or omit it to use a free one"
            raise CarinaError(msg, code="server.port") from error
        msg = f"cannot listen on {host!r}: {error.strerror}"
        raise CarinaError(msg, code="server.host") from error
    sock.set_inheritable(False)
    return sock


def lan_address() -> str:
    """Return the address at which other machines of the local network reach this machine.

    Raises
    ------
    CarinaError
        With code ``server.no-network`` if there is no such address.
    """
    found = ""
    for family, elsewhere in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):
        with socket.socket(family, socket.SOCK_DGRAM) as probe:
            try:
                # connect() on a datagram socket sends nothing; the system only chooses the route and the local address.
                probe.connect((elsewhere, 9))
                found = str(probe.getsockname()[0])
            except OSError:
                continue
        if found and not found.startswith(("127.", "::1", "fe80:")):
            return found
    msg = "this machine has no network address that a phone can reach; connect it to a wireless network first"
    raise CarinaError(msg, code="server.no-network")
