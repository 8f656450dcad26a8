"""Errors of the network as one message with one remedy, and a check of host, port and certificate before a request."""

from __future__ import annotations

import socket
import ssl
from typing import TYPE_CHECKING

from carina.errors import PacsError

if TYPE_CHECKING:
    from carina.pacs.connections import PacsConnection

__all__ = ["CONNECT_S", "certificate_error", "check_port", "missing_library", "offline", "tls_context"]

CONNECT_S = 10.0
"""Time in s after which a connection that the PACS has not accepted fails."""


def missing_library() -> PacsError:
    """Return the error for a missing extra ``dicom``."""
    from carina.installation import extra_command

    return PacsError(
        f"a PACS needs packages that are not installed; run: {extra_command('dicom')}", code="pacs.not-installed"
    )


def offline(connection: PacsConnection, error: OSError | None) -> PacsError:
    """Return the error for a PACS that does not answer."""
    place = connection.url if connection.is_web else f"{connection.host}, port {connection.port}"
    if isinstance(error, socket.gaierror):
        return PacsError(
            f"{connection.name}: the host name of {place} is unknown; check its spelling, or give the IP address",
            code="pacs.offline",
        )
    if isinstance(error, ConnectionRefusedError):
        return PacsError(
            f"{connection.name}: no program answers at {place}; check the port with the administrator of the PACS",
            code="pacs.offline",
        )
    return PacsError(
        f"{connection.name}: {place} does not answer; check that the PACS is on and in the network of this machine",
        code="pacs.offline",
    )


def certificate_error(connection: PacsConnection, error: ssl.SSLError | None) -> PacsError:
    """Return the error for a certificate that is not trusted, or for a port without TLS."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return PacsError(
            f"{connection.name}: the certificate of the PACS is not trusted ({error.verify_message}); get the "
            "certificate file from its administrator and give it with --ca-file",
            code="pacs.certificate",
        )
    return PacsError(
        f"{connection.name}: the PACS does not accept the encrypted connection; check whether this port uses TLS",
        code="pacs.certificate",
    )


def tls_context(connection: PacsConnection) -> ssl.SSLContext:
    """Return the TLS settings of a connection: certificate and host name are always checked.

    Raises
    ------
    PacsError
        ``pacs.certificate``: the certificate file cannot be read.
    """
    try:
        return ssl.create_default_context(cafile=connection.ca_file or None)
    except (OSError, ssl.SSLError):
        raise PacsError(
            f"{connection.name}: {connection.ca_file} is not a certificate file (PEM); get it again from the "
            "administrator of the PACS",
            code="pacs.certificate",
        ) from None


def check_port(connection: PacsConnection) -> None:
    """Connect to the port of a PACS and close the connection, to learn the reason if that is impossible.

    Raises
    ------
    PacsError
        ``pacs.offline`` or ``pacs.certificate``.
    """
    try:
        with socket.create_connection((connection.host, connection.port), timeout=CONNECT_S) as plain:
            if connection.tls:
                with tls_context(connection).wrap_socket(plain, server_hostname=connection.host):
                    pass
    except ssl.SSLError as error:
        raise certificate_error(connection, error) from None
    except OSError as error:
        raise offline(connection, error) from None
