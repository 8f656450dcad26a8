"""The page for a phone, switched on and off. Nothing of it is loaded before."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from carina.errors import CarinaError
from carina.installation import extra_command, not_built
from carina.server.messages_of_devices import PhoneInfo
from carina.session import Session

if TYPE_CHECKING:
    from carina.phone.page import PhonePage

__all__ = ["PhoneSwitch"]

LIBRARIES = ("cryptography", "segno")


class PhoneSwitch:
    """Opens and closes the page for a phone; what a server is given to offer it (``server.device_desk.Phone``).

    Parameters
    ----------
    session
        What is driven.
    web
        Folder of the built client.
    address
        Where to listen; None takes this machine's address in its network.
    """

    def __init__(self, session: Session, web: Path | None, address: str | None = None) -> None:
        self.changed: Callable[[], None] = lambda: None
        """Told when a phone comes or goes; from any thread."""
        self._session = session
        self._web = web
        self._address = address
        self._page: PhonePage | None = None

    def __repr__(self) -> str:
        return f"PhoneSwitch(is_open={self.info() is not None})"

    @property
    def problem(self) -> str | None:
        """Why it cannot be opened, in words."""
        if self._web is None or not (self._web / "phone.html").is_file():
            return not_built("the phone page")
        if any(importlib.util.find_spec(name) is None for name in LIBRARIES):
            return f"the phone page needs two more libraries; install them with: {extra_command('phone')}"
        return None

    def start(self) -> PhoneInfo:
        """Open it, with a new key, certificate and token; the same again changes nothing.

        Raises
        ------
        CarinaError
            ``phone.missing`` if something is not installed; ``server.no-network``, ``server.host``.
        """
        problem = self.problem
        if problem is not None or self._web is None:
            raise CarinaError(problem or not_built("the phone page"), code="phone.missing")
        if self._page is None:
            from carina.phone.page import PhonePage

            self._page = PhonePage(self._session, web=self._web, address=self._address)
            self._page.changed = self._tell
        return self._page.start()

    def stop(self) -> None:
        """Close it: the link, its token and the certificate are void. Returns when nothing listens any more."""
        if self._page is not None:
            self._page.stop()

    def info(self) -> PhoneInfo | None:
        """What is shown of it; None while it is closed."""
        return None if self._page is None else self._page.info()

    def _tell(self) -> None:
        """Whoever listens now: a server that ends listens no more."""
        self.changed()
