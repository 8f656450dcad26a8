"""Values that jobs compute from airways: the wall field that holds a scope, and the measurements of the branches."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from carina.case import StoredMeasures
from carina.errors import CarinaError
from carina.session.derived.derived_value import Attempt, Derived
from carina.session.derived.measurement_cache import MeasuredAirways
from carina.session.engines import Parts
from carina.session.jobs.background_jobs import JobRunner
from carina.track import edits_to_json

if TYPE_CHECKING:
    from carina.scopes import WallField
    from carina.track import Airways, TreeMeasures
    from carina.volume import Volume


@dataclass(frozen=True, slots=True, eq=False)
class LumenWall:
    """Wall field of the airways, which constrains a scope in the lumen."""

    field: WallField
    made_from: dict[str, Any]
    """Inputs from which the wall field was computed; see :attr:`carina.navigate.Pilot.wall_made_from`."""


def derived_wall(
    volume: Volume, parts: Parts, *, jobs: JobRunner, lock: AbstractContextManager[Any]
) -> Derived[Airways, LumenWall]:
    """Create the value that computes the wall of airways in a volume by a job."""

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
    """Create the value that computes the measurements of airways in a volume by a job.

    Request no value where :attr:`Parts.measure_tree` is None.

    Parameters
    ----------
    volume
        The CT.
    parts
        Processing functions of the session.
    jobs, lock
        Job runner and lock of the session.
    changed
        Called when measurements are ready or cannot be computed.
    measured
        Measurements of earlier airways of the history, which are not computed again.
    lost
        Called with the error if stored measurements cannot be read; these airways are measured again.

    Returns
    -------
    Derived
        The measurements by airways.
    """

    def make(airways: Airways, attempt: Attempt[TreeMeasures]) -> TreeMeasures:
        assert parts.measure_tree is not None
        with lock:
            stored = measured.of(airways)
        if stored is not None:
            try:
                return _load_if_packed(stored)
            except CarinaError as error:
                lost(error)
        # Branches that an edit did not change reuse their cross-sections.
        before = attempt.before
        made = parts.measure_tree(volume, airways, previous=before, progress=attempt.progress, cancel=attempt.cancel)
        with lock:
            measured.add(airways, made)
        return made

    return Derived(jobs, lock, kind="measures", title="measuring the airways", make=make, settled=changed)


def _load_if_packed(stored: TreeMeasures | StoredMeasures) -> TreeMeasures:
    return stored.load() if isinstance(stored, StoredMeasures) else stored


def _made_from(wall: WallField, airways: Any) -> dict[str, Any]:
    """Return the inputs from which a replay computes the same wall, and the digest that verifies the wall."""
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
