"""What follows from airways and takes a while: their wall, for a scope that is held by it, and what they measure."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from carina.case import KeptMeasures
from carina.errors import CarinaError
from carina.session.derived import Attempt, Derived
from carina.session.jobs import JobRunner
from carina.session.measured import MeasuredAirways
from carina.session.parts import Parts
from carina.track import edits_to_json

if TYPE_CHECKING:
    from carina.scopes import WallField
    from carina.track import Airways, TreeMeasures
    from carina.volume import Volume

__all__ = ["LumenWall", "derived_measures", "derived_wall"]


@dataclass(frozen=True, slots=True, eq=False)
class LumenWall:
    """The wall of airways, which a scope is held by."""

    field: WallField
    made_from: dict[str, Any]
    """See :attr:`carina.navigate.Pilot.wall_made_from`."""


def derived_wall(
    volume: Volume, parts: Parts, *, jobs: JobRunner, lock: AbstractContextManager[Any]
) -> Derived[Airways, LumenWall]:
    """The wall of airways in a volume."""

    def make(airways: Airways, attempt: Attempt[LumenWall]) -> LumenWall:
        field: WallField = parts.wall_field(volume, airways, progress=attempt.progress, cancel=attempt.cancel)
        return LumenWall(field, _made_from(field, airways))

    return Derived(jobs, lock, kind="scope", title="preparing the airway wall for the scope", make=make)


def derived_measures(
    volume: Volume,
    parts: Parts,
    *,
    jobs: JobRunner,
    lock: AbstractContextManager[Any],
    changed: Callable[[], None],
    measured: MeasuredAirways,
    lost: Callable[[CarinaError], None],
) -> Derived[Airways, TreeMeasures]:
    """What airways in a volume measure; nothing is to be wanted where :attr:`Parts.measure_tree` is None.

    Parameters
    ----------
    measured
        What airways of the history measured before: none of them is measured again.
    lost
        Told of what was kept and cannot be read: those airways are measured again.
    """

    def make(airways: Airways, attempt: Attempt[TreeMeasures]) -> TreeMeasures:
        assert parts.measure_tree is not None
        with lock:
            kept = measured.of(airways)
        if kept is not None:
            try:
                return _loaded(kept)
            except CarinaError as trouble:
                lost(trouble)
        # Branches that an edit did not touch keep their sections.
        before = attempt.before
        made = parts.measure_tree(volume, airways, previous=before, progress=attempt.progress, cancel=attempt.cancel)
        with lock:
            measured.put(airways, made)
        return made

    return Derived(jobs, lock, kind="measures", title="measuring the airways", make=make, settled=changed)


def _loaded(kept: TreeMeasures | KeptMeasures) -> TreeMeasures:
    return kept.load() if isinstance(kept, KeptMeasures) else kept


def _made_from(wall: WallField, airways: Any) -> dict[str, Any]:
    """What a replay makes a wall from again: search, edits, and how to tell that it is the same."""
    found = getattr(airways, "base", None) or airways
    edits = getattr(airways, "edits", ())
    return {
        "digest": wall.digest(),
        "root_lps": [float(v) for v in found.root_lps],
        "lumen_threshold": float(getattr(found, "threshold", math.nan)) if _has_threshold(found) else None,
        "edits": edits_to_json(edits) if edits else None,
    }


def _has_threshold(airways: Any) -> bool:
    return math.isfinite(float(getattr(airways, "threshold", math.nan)))
