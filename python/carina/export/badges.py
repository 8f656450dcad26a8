"""Lasting notes of a case in the headers of files."""

from __future__ import annotations

from collections.abc import Sequence

from carina.track.tree.airway_tree import AirwayTree
from carina.volume import Note

__all__ = ["badge_lines", "lasting"]


def badge_lines(badges: Sequence[Note]) -> list[str]:
    """One line each, in ASCII, which every format takes."""
    lines = [f"{badge.code}: {' '.join(badge.words.split())}" for badge in badges]
    return [line.encode("ascii", "replace").decode() for line in lines]


def lasting(tree: AirwayTree, badges: Sequence[Note]) -> tuple[Note, ...]:
    """Those of a case and those of its tree, none twice."""
    return tuple(dict.fromkeys([*badges, *tree.notes]))
