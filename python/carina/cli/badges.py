"""The lasting notes of what a command works on, which its output repeats."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from carina.cli.console import say
from carina.export import read_badges
from carina.volume import Note

__all__ = ["Badges"]


class Badges:
    """The lasting notes of what a command works on; each is said once on stderr."""

    def __init__(self) -> None:
        self._notes: dict[Note, None] = {}

    @property
    def notes(self) -> tuple[Note, ...]:
        """All of them, in the order in which they came."""
        return tuple(self._notes)

    def add(self, notes: Iterable[Note]) -> None:
        """Say those that are new, and keep them."""
        for note in notes:
            if note not in self._notes:
                self._notes[note] = None
                say(f"note: {note.words}")

    def take_airways(self, airways: object) -> None:
        """Keep those of a search or of an imported mask; what it found is said by the caller, with all its notes."""
        for note in getattr(airways, "badges", ()):
            self._notes.setdefault(note, None)

    def add_tree(self, path: Path) -> None:
        """Those that a tree was written with."""
        self.add(read_badges(path))

    def to_json(self) -> list[dict[str, str]]:
        """As every ``--json`` has them under ``badges``."""
        return [{"code": note.code, "words": note.words} for note in self._notes]
