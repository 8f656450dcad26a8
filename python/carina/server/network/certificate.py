"""Self-signed TLS certificates for the phone page and the viewing page in the local network."""

from __future__ import annotations

import datetime
import ipaddress
import secrets
import ssl
from dataclasses import dataclass

from carina.disk import scratch_folder

# The phone's clock may be behind; no session lasts 30 days.
VALID_BEFORE = datetime.timedelta(days=1)
VALID_FOR = datetime.timedelta(days=30)


@dataclass(frozen=True, slots=True)
class Certificate:
    """TLS context of a server, with the fingerprint that the user compares in the browser."""

    context: ssl.SSLContext
    sha256: str
    """Fingerprint in capital hexadecimal pairs with colons between, as browsers show it."""


def make_certificate(host: str) -> Certificate:
    """Create a new key and a self-signed certificate for one address.

    A browser warns because no authority signed the certificate; the user compares the fingerprint. The key is written
    to disk only encrypted, in a folder of this user, while the TLS library reads the key.

    Parameters
    ----------
    host
        Address or name in the link.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "Carina on this computer")])
    alternative: x509.GeneralName
    try:
        alternative = x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        alternative = x509.DNSName(host)
    now = datetime.datetime.now(datetime.UTC)
    usage = x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=False,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - VALID_BEFORE)
        .not_valid_after(now + VALID_FOR)
        .add_extension(x509.SubjectAlternativeName([alternative]), critical=False)
        # A leaf certificate (CA:FALSE): trust in it does not extend to other sites.
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .sign(key, hashes.SHA256())
    )
    password = secrets.token_bytes(32).hex().encode()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    with scratch_folder() as folder:
        file = folder / "page.pem"
        file.touch(mode=0o600)
        file.write_bytes(
            key.private_bytes(
                serialization.Encoding.PEM,
                serialization.PrivateFormat.PKCS8,
                serialization.BestAvailableEncryption(password),
            )
            + certificate.public_bytes(serialization.Encoding.PEM)
        )
        context.load_cert_chain(file, password=password)
    return Certificate(context, certificate.fingerprint(hashes.SHA256()).hex(":").upper())
