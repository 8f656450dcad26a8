"""Saved connections to PACS: addresses in the settings folder, passwords in the keyring or a private file."""

from __future__ import annotations

import contextlib
import json
import re
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from carina.disk import make_folder, write_whole
from carina.display import one_line
from carina.errors import PacsError, UsageError

__all__ = ["PacsConnection", "PacsConnections"]

_FILE, _PASSWORDS, _SERVICE = "pacs.json", "pacs-passwords.json", "carina-pacs"
_NAME = re.compile(r"[\w][\w .-]{0,39}")
_MAX_BYTES = 1 << 20


@one_line
@dataclass(frozen=True, slots=True)
class PacsConnection:
    """Address of a PACS: host, port and AE titles (DIMSE), or the URL of a DICOMweb service."""

    name: str
    host: str = ""
    port: int = 104
    called_ae: str = "ANY-SCP"
    """AE title of the PACS."""
    calling_ae: str = "CARINA"
    """AE title of this machine, which the administrator of the PACS has to enter there."""
    listen_port: int | None = None
    """Port on which this machine receives images (C-MOVE); None retrieves through the same connection (C-GET)."""
    listen_host: str = ""
    """Address on which this machine receives images; empty for the address from which it reaches the PACS."""
    tls: bool = False
    url: str = ""
    """URL of a DICOMweb service; then host, port and AE titles are not used."""
    user: str = ""
    ca_file: str = ""
    """File with the certificate (PEM) of the PACS or of its authority, if the system does not trust it."""
    password: str = field(default="", repr=False)
    """Password for DICOMweb; never written with the other values."""

    def __post_init__(self) -> None:
        """Refuse values that no PACS can have.

        Raises
        ------
        UsageError
            ``usage.pacs``.
        """
        problem = self._problem()
        if problem is not None:
            raise UsageError(f"PACS connection: {problem}", code="usage.pacs")

    @property
    def is_web(self) -> bool:
        """Whether the connection uses DICOMweb."""
        return bool(self.url)

    def _problem(self) -> str | None:
        if not _NAME.fullmatch(self.name):
            return "expected a name of at most 40 letters, digits, spaces and -._"
        texts = (self.url, self.host, self.listen_host, self.called_ae, self.calling_ae, self.user, self.ca_file)
        if not all(isinstance(text, str) for text in texts):
            return "expected texts for host, URL, AE titles and user"
        if self.url:
            try:
                parts = urlsplit(self.url)
            except ValueError:
                return "expected a URL such as https://pacs.example.org/dicom-web"
            if parts.scheme not in ("http", "https") or not parts.hostname:
                return "expected a URL such as https://pacs.example.org/dicom-web"
            if parts.username or parts.password:
                return "the URL contains a password; give the user and the password separately"
            return None
        if not self.host or len(self.host) > 253 or not self.host.isprintable() or " " in self.host:
            return "expected the host name or address of the PACS, or the URL of its DICOMweb service"
        ports = [self.port] if self.listen_port is None else [self.port, self.listen_port]
        if not all(isinstance(port, int) and 0 < port < 65536 for port in ports):
            return "expected ports from 1 to 65535"
        if self.tls and self.listen_port is not None:
            return (
                "the images on the second port would not be encrypted; leave out the port, so that they come through "
                "the encrypted connection (C-GET)"
            )
        if self.listen_port is not None and self.called_ae == "ANY-SCP":
            return (
                "the second port accepts images only from the AE title of the PACS; give this AE title, or leave out "
                "the port"
            )
        for title in (self.called_ae, self.calling_ae):
            if not 0 < len(title.strip()) <= 16 or not title.isascii() or not title.isprintable() or "\\" in title:
                return f"expected an AE title of 1 to 16 characters; found {title[:20]!r}"
        return None


class PacsConnections:
    """The saved connections of this user.

    Parameters
    ----------
    folder
        Folder of the settings; None is the user's.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> saved = PacsConnections(Path(tempfile.mkdtemp()))
    >>> saved.save(PacsConnection("hospital", host="pacs.example.org"))
    >>> [connection.name for connection in saved.all()]
    ['hospital']
    """

    def __init__(self, folder: Path | None = None) -> None:
        if folder is None:
            from carina.config import load_settings

            folder = load_settings().config_dir
        self._folder = folder

    def __repr__(self) -> str:
        """Return a text with the number of the saved connections."""
        return f"PacsConnections({len(self._read(_FILE))} saved)"

    def all(self) -> tuple[PacsConnection, ...]:
        """Return all connections without their passwords, by name."""
        found = []
        for name, values in sorted(self._read(_FILE).items()):
            # A connection that another version wrote may have values that this one refuses.
            with contextlib.suppress(TypeError, UsageError):
                found.append(PacsConnection(name=name, **values))
        return tuple(found)

    def get(self, name: str) -> PacsConnection:
        """Return a connection with its password.

        Raises
        ------
        UsageError
            ``usage.pacs``: no connection has this name.
        """
        found = next((one for one in self.all() if one.name == name), None)
        if found is None:
            known = ", ".join(one.name for one in self.all()) or "none"
            raise UsageError(
                f"no PACS connection has the name {name[:40]!r} (saved: {known}); add it with `carina pacs add`",
                code="usage.pacs",
            )
        return replace(found, password=self._password(name))

    def save(self, connection: PacsConnection) -> None:
        """Store a connection under its name; the password goes to the keyring, or else to a file of this user only."""
        values = asdict(connection)
        del values["name"], values["password"]
        connections = self._read(_FILE)
        connections[connection.name] = values
        self._write(_FILE, connections)
        self._set_password(connection.name, connection.password)

    def remove(self, name: str) -> None:
        """Delete a connection and its password.

        Raises
        ------
        UsageError
            ``usage.pacs``: no connection has this name.
        """
        self.get(name)
        connections = self._read(_FILE)
        del connections[name]
        self._write(_FILE, connections)
        self._set_password(name, "")

    def _password(self, name: str) -> str:
        keyring = _keyring()
        if keyring is not None:
            with contextlib.suppress(Exception):  # a locked or missing keyring raises errors of its backend
                stored = keyring.get_password(_SERVICE, name)
                if stored:
                    return str(stored)
        return str(self._read(_PASSWORDS).get(name, ""))

    def _set_password(self, name: str, password: str) -> None:
        keyring = _keyring()
        in_keyring = False
        if keyring is not None:
            with contextlib.suppress(Exception):
                if password:
                    keyring.set_password(_SERVICE, name, password)
                    in_keyring = True
                elif keyring.get_password(_SERVICE, name):
                    keyring.delete_password(_SERVICE, name)
        stored = self._read(_PASSWORDS)
        if password and not in_keyring:
            stored[name] = password
            self._write(_PASSWORDS, stored)
        elif stored.pop(name, None) is not None:
            self._write(_PASSWORDS, stored)

    def _read(self, name: str) -> dict[str, Any]:
        path = self._folder / name
        try:
            if path.stat().st_size > _MAX_BYTES:
                raise ValueError
            values = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return {}
        except (OSError, ValueError):
            raise PacsError(
                f"the saved PACS connections cannot be read; delete {path} and add them again", code="pacs.settings"
            ) from None
        if not isinstance(values, dict):
            return {}
        return {str(key): value for key, value in values.items()}

    def _write(self, name: str, values: dict[str, Any]) -> None:
        make_folder(self._folder, what="the settings", private=True)
        text = json.dumps(values, indent=2).encode()
        path = self._folder / name
        write_whole(path, text, what="the PACS connections", private=True)


def _keyring() -> Any:
    """Return the keyring library if it is installed and has a real backend, else None."""
    try:
        import keyring
        from keyring.backends import fail
    except ImportError:
        return None
    return None if isinstance(keyring.get_keyring(), fail.Keyring) else keyring
