"""Tests of encrypted connections and passwords, with servers in the test process on loopback."""

from __future__ import annotations

import datetime
import http.server
import ipaddress
import json
import ssl
import threading
from contextlib import contextmanager

import pytest

from carina.errors import PacsError
from carina.pacs import PacsConnection, check_connection, find_studies

pynetdicom = pytest.importorskip("pynetdicom", reason="needs the extra dicom")
pytest.importorskip("dicomweb_client", reason="needs the extra dicom")
x509 = pytest.importorskip("cryptography.x509", reason="needs the extra phone")


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """Return the paths of a self-signed certificate for 127.0.0.1 and of its key."""
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    folder = tmp_path_factory.mktemp("certificate")
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "PACS")])
    now = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]), critical=False)
        .sign(key, hashes.SHA256())
    )
    (folder / "cert.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
    (folder / "key.pem").write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return folder / "cert.pem", folder / "key.pem"


def server_context(certificate):
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*certificate)
    return context


@contextmanager
def dicom_server(context):
    entity = pynetdicom.AE(ae_title="SECURE")
    entity.add_supported_context("1.2.840.10008.1.1")
    server = entity.start_server(("127.0.0.1", 0), block=False, ssl_context=context)
    try:
        yield server.socket.getsockname()[1]
    finally:
        server.shutdown()


@contextmanager
def web_server(context=None):
    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            right = self.headers.get("Authorization") == "Basic ZXJpa2E6Z2VoZWlt"  # erika:geheim
            body = json.dumps([]).encode() if right else b""
            self.send_response(200 if right else 401)
            self.send_header("Content-Type", "application/dicom+json")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_):
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.handle_error = lambda *_: None  # a client that refuses the certificate
    if context is not None:
        server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def dimse(port, **values):
    return PacsConnection("test", host="127.0.0.1", port=port, called_ae="SECURE", **values)


def test_encrypted_association_with_a_trusted_certificate_passes(certificate):
    with dicom_server(server_context(certificate)) as port:
        check = check_connection(dimse(port, tls=True, ca_file=str(certificate[0])))
    assert check.passed, check


def test_untrusted_certificate_is_named_with_the_remedy(certificate):
    with dicom_server(server_context(certificate)) as port:
        (step,) = check_connection(dimse(port, tls=True)).steps
    assert not step.passed
    assert "certificate of the PACS is not trusted" in step.message
    assert "--ca-file" in step.message


def test_tls_to_a_port_without_tls_is_named():
    with dicom_server(None) as port:
        (step,) = check_connection(dimse(port, tls=True)).steps
    assert "check whether this port uses TLS" in step.message or "does not answer" in step.message


def test_missing_certificate_file_is_named(tmp_path):
    with dicom_server(None) as port:
        (step,) = check_connection(dimse(port, tls=True, ca_file=str(tmp_path / "none.pem"))).steps
    assert "is not a certificate file (PEM)" in step.message


def test_untrusted_certificate_of_a_web_service_is_named(certificate):
    with web_server(server_context(certificate)) as port:
        with pytest.raises(PacsError, match="certificate of the PACS is not trusted") as found:
            find_studies(PacsConnection("test", url=f"https://127.0.0.1:{port}"), date="2026-11-03")
        assert found.value.code == "pacs.certificate"
        trusted = PacsConnection(
            "test", url=f"https://127.0.0.1:{port}", ca_file=str(certificate[0]), user="erika", password="geheim"
        )
        assert len(find_studies(trusted, date="2026-11-03")) == 0


def test_wrong_password_is_named():
    with web_server() as port:
        right = PacsConnection("test", url=f"http://127.0.0.1:{port}", user="erika", password="geheim")
        assert len(find_studies(right, date="2026-11-03")) == 0
        wrong = PacsConnection("test", url=f"http://127.0.0.1:{port}", user="erika", password="falsch")
        with pytest.raises(PacsError, match="user and password") as found:
            find_studies(wrong, date="2026-11-03")
    assert found.value.code == "pacs.login"
    assert "falsch" not in str(found.value)
