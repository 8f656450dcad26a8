"""Lasting notes of a case, for the headers of files."""

from __future__ import annotations

from collections.abc import Sequence

from carina.track.tree.airway_tree import AirwayTree
from carina.volume import Note


def badge_lines(badges: Sequence[Note]) -> list[str]:
    """Return one line per note in ASCII, which every format can store."""
    lines = [f"{badge.code}: {' '.join(badge.words.split())}" for badge in badges]
    return [line.encode("ascii", "replace").decode() for line in lines]


def lasting(tree: AirwayTree, badges: Sequence[Note]) -> tuple[Note, ...]:
    """Return the notes of a case and of its tree, without duplicates."""
    return tuple(dict.fromkeys([*badges, *tree.notes]))
