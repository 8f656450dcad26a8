"""Key frames between client and session."""

from __future__ import annotations

from typing import Any

from carina.server import messages as wire
from carina.session import Session

__all__ = ["handle_keys"]


def handle_keys(session: Session, message: Any) -> bool:
    """Do what a client asks about key frames; False if it is not about them."""
    match message:
        case wire.EditKeys():
            _edit(session, message.edit)
        case wire.SetKeyFlight():
            session.set_key_flight(speed_mm_s=message.speed_mm_s, through=message.through)
        case wire.ShowKey():
            session.show_key(message.key_id)
        case _:
            return False
    return True


def _edit(session: Session, edit: Any) -> None:
    match edit:
        case wire.KeyAdd():
            session.add_key()
        case wire.KeyUpdate():
            session.update_key(edit.key_id)
        case wire.KeyMove():
            session.move_key(edit.key_id, edit.by)
        case wire.KeyRename():
            session.rename_key(edit.key_id, edit.name)
        case wire.KeySpeed():
            session.set_key_speed(edit.key_id, edit.speed_mm_s)
        case wire.KeyRemove():
            session.remove_key(edit.key_id)
