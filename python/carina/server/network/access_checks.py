"""Access control of the server: Host, Origin, start token, cookie, and bearer secret (docs/contracts.md).

The server has the images of a patient and listens on a port that every web page in the same browser can address.
Therefore the Host header is checked on every request (DNS rebinding), and the Origin header on every request that
changes something (cross-site requests). Clients without the cookie or the secret receive only the files of the web
client.
"""

from __future__ import annotations

import ipaddress
import secrets
import socket
import threading
from collections.abc import Mapping
from http.cookies import CookieError, SimpleCookie
from typing import Any, Literal

SAFE_METHODS = frozenset({"GET", "HEAD"})
MAX_COOKIE_BYTES = 8192
COOKIE_S = 30 * 24 * 3600
"""Lifetime of the cookie of a browser on this machine, s; the cookie is valid only as long as this process runs."""


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def comes_from_this_machine(scope: Mapping[str, Any]) -> bool:
    """Return whether the other end of a connection is on this machine, by the addresses of the ASGI scope.

    A connection to a loopback address, or one whose two ends have the same address, does not leave the machine. A proxy
    or a tunnel on this machine counts as this machine: its user has set it up.
    """
    client, server = scope.get("client"), scope.get("server")
    if client is None:
        return False
    host = str(client[0]).removeprefix("::ffff:")
    return is_loopback(host) or (server is not None and host == str(server[0]).removeprefix("::ffff:"))


def _split_host(header: str) -> tuple[str, int | None] | None:
    """Return the name and port of a Host header; None if the header is invalid."""
    name, port_text = header, ""
    if header.startswith("["):
        name, bracket, rest = header[1:].partition("]")
        if not bracket or (rest and not rest.startswith(":")):
            return None
        port_text = rest[1:]
    elif header.count(":") == 1:
        name, _, port_text = header.partition(":")
    if port_text and not (port_text.isascii() and port_text.isdigit() and len(port_text) <= 5):
        return None
    return name.lower().rstrip("."), int(port_text) if port_text else None


def host_allowed(header: str, *, bound_host: str, port: int) -> bool:
    """Return whether a Host header names the address on which the server listens.

    In a DNS rebinding attack the Host header contains the domain name of the attacker. A server on a loopback address
    accepts only loopback names. A server on another address also accepts that address, the name of this machine, and
    literal IP addresses, which DNS cannot redirect.
    """
    parts = _split_host(header)
    if parts is None or (parts[1] or 80) != port:
        return False
    name = parts[0]
    if is_loopback(name):
        return True
    if is_loopback(bound_host):
        return False
    if name in {bound_host.lower(), socket.gethostname().lower()}:
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


class TokenGate:
    """Token of a link for clients in the local network, with a count of refused tokens.

    Wrong tokens never block the correct one: a token of 128 bits cannot be guessed, and a lock-out would let any
    machine of the network exclude the others.
    """

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(16)
        self.num_refused = 0

    def admits(self, token: str) -> bool:
        """Return whether a token is that of the observers' link; count a wrong token."""
        if token.isascii() and secrets.compare_digest(token, self.token):
            return True
        self.num_refused += 1
        return False

    def renew(self) -> None:
        """Replace the token; the previous one is no longer accepted."""
        self.token = secrets.token_urlsafe(16)


class Gate:
    """Secrets of one server, and the checks of each request.

    Programs send ``secret`` as bearer token. The cookie has a different value, so that neither value reveals the other.
    """

    def __init__(self, *, host: str, port: int, scheme: Literal["http", "https"] = "http") -> None:
        self.host = host
        self.port = port
        self.scheme = scheme
        self.secret = secrets.token_urlsafe(32)
        self._cookie_value = secrets.token_urlsafe(32)
        self._tokens: set[str] = set()
        self._used_tokens: set[str] = set()
        self._lock = threading.Lock()

    @property
    def cookie_name(self) -> str:
        """Name of the cookie; it contains the port, because cookies of one host are shared by all ports."""
        return f"carina_{self.port}"

    @property
    def set_cookie(self) -> str:
        """Value of the Set-Cookie header; the browser removes the cookie when the user closes the browser."""
        return f"{self.cookie_name}={self._cookie_value}; Path=/; HttpOnly; SameSite=Strict"

    @property
    def set_lasting_cookie(self) -> str:
        """Value of the Set-Cookie header of a cookie that a closed browser keeps, for browsers on this machine."""
        return f"{self.set_cookie}; Max-Age={COOKIE_S}"

    def new_token(self) -> str:
        """Return a new token for a start URL: valid once for any user, and repeatedly for the user of this process."""
        token = secrets.token_urlsafe(32)
        with self._lock:
            self._tokens.add(token)
        return token

    def redeem(self, token: str) -> bool:
        """Return whether a start token is valid, and invalidate the token for other users."""
        if not token.isascii():
            return False
        with self._lock:
            found = [known for known in self._tokens if secrets.compare_digest(known, token)]
            self._tokens.difference_update(found)
            self._used_tokens.update(found)
        return bool(found)

    def is_used(self, token: str) -> bool:
        """Return whether a start token was valid and has been redeemed."""
        if not token.isascii():
            return False
        with self._lock:
            # Every token is compared, so that the time does not depend on the position of the match.
            return any([secrets.compare_digest(known, token) for known in self._used_tokens])  # noqa: C419

    def refusal(self, *, method: str | None, headers: Mapping[str, str]) -> str | None:
        """Return the reason why a request is refused, or None; cookies are not checked here.

        Parameters
        ----------
        method
            HTTP method; None for a WebSocket.
        headers
            Headers of the request.
        """
        if not host_allowed(headers.get("host", ""), bound_host=self.host, port=self.port):
            return "this is not the address that Carina is listening on"
        origin = headers.get("origin")
        if origin is None:
            if (method is None or method not in SAFE_METHODS) and not self._bearer_matches(headers):
                return "the request does not state which page it comes from"
            return None
        scheme, _, rest = origin.partition("://")
        # The origin must have the host and port of the Host header, which was checked above.
        if scheme != self.scheme or rest.lower() != headers.get("host", "").lower():
            return "the request comes from another page"
        return None

    def authorised(self, headers: Mapping[str, str]) -> bool:
        """Return whether a request contains the cookie or the bearer secret."""
        return self._bearer_matches(headers) or self._cookie_matches(headers)

    def _bearer_matches(self, headers: Mapping[str, str]) -> bool:
        scheme, _, value = headers.get("authorization", "").partition(" ")
        return scheme.lower() == "bearer" and value.isascii() and secrets.compare_digest(value.strip(), self.secret)

    def _cookie_matches(self, headers: Mapping[str, str]) -> bool:
        text = headers.get("cookie", "")
        if len(text) > MAX_COOKIE_BYTES:
            return False
        try:
            morsel = SimpleCookie(text).get(self.cookie_name)
        except CookieError:
            return False
        return (
            morsel is not None and morsel.value.isascii() and secrets.compare_digest(morsel.value, self._cookie_value)
        )
