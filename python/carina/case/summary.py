"""What a case file holds, for a list: read from its tables, without the CT and without arrays."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass

from carina.case import facts as f
from carina.case.packing import from_json
from carina.display import one_line

__all__ = ["CaseSummary", "read_summary"]


@one_line
@dataclass(frozen=True, slots=True)
class CaseSummary:
    """Of the step that holds."""

    num_branches: int | None
    """None where the case has no airways."""
    num_edits: int
    """Of the airways, by a person."""
    targets: tuple[str, ...]
    """Their names."""
    key_frames: tuple[str, ...]
    """The names of key frames, else their ids."""
    route: str | None
    """The title of the route that is shown."""
    saved_by: str | None
    """The version of Carina; None where nothing was saved yet."""
    is_packed: bool
    """The CT is in the file."""
    is_measured: bool = False
    """What the airways measure is in it."""


def read_summary(connection: sqlite3.Connection) -> CaseSummary:
    """With one transaction's view of the file.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    is_packed = connection.execute("SELECT EXISTS (SELECT 1 FROM ct)").fetchone()[0] == 1
    moment = connection.execute("SELECT position, facts FROM moment").fetchone()
    if moment is None:
        return CaseSummary(None, 0, (), (), None, None, is_packed)
    said: f.MomentFacts = from_json(moment[1], f.decoders().moment, "current state")
    row = connection.execute(
        "SELECT tree.num_branches, airways.facts, route.facts, targets.json, keys.json, "
        "EXISTS (SELECT 1 FROM measures WHERE measures.airways = document.airways) "
        "FROM (SELECT document FROM step ORDER BY n LIMIT 1 OFFSET ?) AS now "
        "JOIN document ON document.id = now.document "
        "JOIN value AS targets ON targets.id = document.targets JOIN value AS keys ON keys.id = document.keys "
        "LEFT JOIN airways ON airways.id = document.airways LEFT JOIN tree ON tree.id = airways.tree "
        "LEFT JOIN route ON route.id = document.route",
        (moment[0],),
    ).fetchone()
    if row is None:
        return CaseSummary(None, 0, (), (), None, said.saved_by, is_packed)
    num_branches, airways, route, targets, keys, is_measured = row
    decoders = f.decoders()
    frames = from_json(keys, decoders.keys, "the key frames").frames
    return CaseSummary(
        num_branches=num_branches,
        num_edits=0 if airways is None else len(from_json(airways, decoders.airways, "the airways").edits),
        targets=tuple(target.name for target in from_json(targets, decoders.targets, "the targets")),
        key_frames=tuple(frame.name or frame.key_id for frame in frames),
        route=None if route is None else from_json(route, decoders.route, "the route").title,
        saved_by=said.saved_by,
        is_packed=is_packed,
        is_measured=bool(is_measured),
    )
