"""Permanent notes (badges) about the input of a command, which the output of the command repeats."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from carina.cli.console import say
from carina.export import read_badges
from carina.volume import Note

__all__ = ["Badges"]


class Badges:
    """Permanent notes about the input of a command; each is printed once on stderr."""

    def __init__(self) -> None:
        self._notes: dict[Note, None] = {}

    @property
    def notes(self) -> tuple[Note, ...]:
        """All notes in the order in which they were added."""
        return tuple(self._notes)

    def add(self, notes: Iterable[Note]) -> None:
        """Print the new notes on stderr, and store them."""
        for note in notes:
            if note not in self._notes:
                self._notes[note] = None
                say(f"note: {note.words}")

    def take_airways(self, airways: object) -> None:
        """Store the notes of an airway search or an imported mask; the caller prints them with the result."""
        for note in getattr(airways, "badges", ()):
            self._notes.setdefault(note, None)

    def add_tree(self, path: Path) -> None:
        """Print and store the notes that the file of a tree contains."""
        self.add(read_badges(path))

    def to_json(self) -> list[dict[str, str]]:
        """Return the notes as ``--json`` prints them under ``badges``."""
        return [{"code": note.code, "words": note.words} for note in self._notes]
