"""Summary of a case for a list of cases, read from the tables without the CT and without arrays."""

from __future__ import annotations

import sqlite3
from dataclasses import dataclass

from carina.case import json_records as f
from carina.case.compression import from_json
from carina.display import one_line


@one_line
@dataclass(frozen=True, slots=True)
class CaseSummary:
    """Summary of the current state of a case."""

    num_branches: int | None
    """Number of branches of the airway tree; None if the case has no airways."""
    num_edits: int
    """Number of the user's edits of the airways."""
    targets: tuple[str, ...]
    """Names of the targets."""
    key_frames: tuple[str, ...]
    """Names of the key frames, or their ids if they have no names."""
    route: str | None
    """Title of the shown route; None if none is shown."""
    saved_by: str | None
    """Version of Carina that saved the case; None if nothing was saved yet."""
    is_packed: bool
    """Whether the case file contains the CT itself, so that no other file is needed to open the case."""
    is_measured: bool = False
    """Whether the case file contains measurements of the airways."""


def read_summary(connection: sqlite3.Connection) -> CaseSummary:
    """Return the summary of a case, read in one transaction.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    is_packed = connection.execute("SELECT EXISTS (SELECT 1 FROM ct)").fetchone()[0] == 1
    moment = connection.execute("SELECT position, facts FROM moment").fetchone()
    if moment is None:
        return CaseSummary(None, 0, (), (), None, None, is_packed)
    json_text: f.MomentFacts = from_json(moment[1], f.decoders().moment, "current state")
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
        return CaseSummary(None, 0, (), (), None, json_text.saved_by, is_packed)
    num_branches, airways, route, targets, keys, is_measured = row
    decoders = f.decoders()
    frames = from_json(keys, decoders.keys, "the key frames").frames
    return CaseSummary(
        num_branches=num_branches,
        num_edits=0 if airways is None else len(from_json(airways, decoders.airways, "the airways").edits),
        targets=tuple(target.name for target in from_json(targets, decoders.targets, "the targets")),
        key_frames=tuple(frame.name or frame.key_id for frame in frames),
        route=None if route is None else from_json(route, decoders.route, "the route").title,
        saved_by=json_text.saved_by,
        is_packed=is_packed,
        is_measured=bool(is_measured),
    )
