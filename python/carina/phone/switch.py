"""Switch that starts and stops the phone page and imports its libraries only at the first start."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from carina.errors import CarinaError
from carina.installation import extra_command, not_built
from carina.server.wire.messages_of_devices import PhoneInfo
from carina.session import Session

if TYPE_CHECKING:
    from carina.phone.page import PhonePage

LIBRARIES = ("cryptography", "segno")


class PhoneSwitch:
    """Switch for the phone page; implements the interface ``carina.server.devices.Phone``.

    Parameters
    ----------
    session
        Session whose tip the phone moves.
    web
        Folder of the built client.
    address
        Address to listen on; None selects this machine's address in the local network.
    """

    def __init__(self, session: Session, web: Path | None, address: str | None = None) -> None:
        self.changed: Callable[[], None] = lambda: None
        """Callback for a phone that connects or disconnects; called from any thread."""
        self._session = session
        self._web = web
        self._address = address
        self._page: PhonePage | None = None

    def __repr__(self) -> str:
        """Return a line of text with the state of the page."""
        return f"PhoneSwitch(is_open={self.info() is not None})"

    @property
    def problem(self) -> str | None:
        """Reason why the phone page cannot be started, as a message for the user; None if it can."""
        if self._web is None or not (self._web / "phone.html").is_file():
            return not_built("the phone page")
        if any(importlib.util.find_spec(name) is None for name in LIBRARIES):
            return f"the phone page needs two more libraries; install them with: {extra_command('phone')}"
        return None

    def start(self) -> PhoneInfo:
        """Start the page with a new key, certificate and token; do nothing if it runs already.

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
            self._page.changed = self._notify_change
        return self._page.start()

    def stop(self) -> None:
        """Stop the page, invalidate its link, token and certificate, and return when its port is closed."""
        if self._page is not None:
            self._page.stop()

    def info(self) -> PhoneInfo | None:
        """Return the state of the page for the wire; None while the page is stopped."""
        return None if self._page is None else self._page.info()

    def _notify_change(self) -> None:
        """Call the current ``changed`` callback, which a server replaces when it shuts down."""
        self.changed()
