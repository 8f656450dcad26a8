"""Maps of the lungs around the targets and of an instrument's reach, computed on request and not stored."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from carina.case.document import Document
from carina.display import one_line
from carina.session.derived.derived_value import Attempt, Cached, Derived, Standing
from carina.session.engines import Parts
from carina.session.jobs.background_jobs import JobRunner
from carina.session.scene.layer_lines import ShownLayers

if TYPE_CHECKING:
    from carina.plan import Landmark, ReachAtlas
    from carina.plan.lungs.lung_map import LungMap
    from carina.scopes import WallField
    from carina.track import Airways
    from carina.volume import Volume

ReachInputs = tuple[Any, str, str]
"""Inputs of a reach map: airways, name of the scope, and name of the tool."""


@one_line
@dataclass(frozen=True, slots=True)
class LungsInfo:
    """State of the maps of vessels, fissures and lobes in the lungs around the targets."""

    lungs: LungMap | None
    """Map of the lungs with the structures computed so far; None if none is available."""
    standing: Standing
    problem: str | None
    """Reason why the map of the lungs failed; None if it did not fail."""
    stations: tuple[Landmark, ...]
    reach: ReachAtlas | None
    reach_standing: Standing
    reach_problem: str | None
    outdated: bool
    """Whether the airways have changed since a map was requested, so that the map must be requested again."""


class CaseLungs:
    """Maps of the lungs of a case.

    Parameters
    ----------
    volume, parts, jobs, lock
        The CT, and the processing functions, job runner and lock of the session
        (`carina.session.derived.derived_value`).
    wall
        Returns the wall of airways if it has been computed for another purpose, else None.
    changed
        Called when a map has changed.
    """

    def __init__(
        self,
        volume: Volume,
        parts: Parts,
        *,
        jobs: JobRunner,
        lock: AbstractContextManager[Any],
        wall: Callable[[Airways], WallField | None],
        changed: Callable[[], None],
    ) -> None:
        self._volume = volume
        self._parts = parts
        self._lock = lock
        self._wall_at_hand = wall
        self._changed = changed
        derived = partial(Derived, jobs, lock, settled=changed)
        self._lungs: Derived[Airways, LungMap] = derived(
            kind="lungs", title="mapping the structures around the target", make=self._make_lungs
        )
        self._reach: Derived[ReachInputs, ReachAtlas] = derived(
            kind="reach", title="mapping the reach of the instrument", make=self._make_reach, same=_are_same_inputs
        )
        self._early: tuple[Airways, LungMap] | None = None
        """Airways and their lung map with vessels only, shown while the job still segments the lobes."""
        self._requested_reach: tuple[str, str] | None = None
        self._are_lungs_requested = False
        self._document: Document | None = None
        self._stations: Cached[Airways, tuple[Landmark, ...]] = Cached(partial(_stations, volume, parts))
        self._shown: Cached[tuple[Any, ...], ShownLayers] = Cached(
            lambda made: ShownLayers(made[0], made[1], tuple(made[2]))
        )

    def info(self) -> LungsInfo:
        """Return the state of the maps; the caller holds the session's lock."""
        airways = None if self._document is None else self._document.airways
        lungs, inputs = self._lung_inputs(airways), self._reach_inputs(airways)
        reach = self._reach.of(inputs)
        standing, reach_standing = self._lungs.standing(airways), self._reach.standing(inputs)
        outdated = (self._are_lungs_requested and standing == "unwanted") or (
            self._requested_reach is not None and reach_standing == "unwanted"
        )
        is_requested = airways is not None and self._are_lungs_requested and standing != "unwanted"
        return LungsInfo(
            lungs=lungs,
            standing=standing,
            problem=str(self._lungs.error) if standing == "failed" else None,
            stations=self._stations.of(airways) if is_requested and airways is not None else (),
            reach=reach,
            reach_standing=reach_standing,
            reach_problem=str(self._reach.error) if reach_standing == "failed" else None,
            outdated=outdated and airways is not None,
        )

    def shown(self) -> ShownLayers | None:
        """Return the layers of the document's airways; None if there are none."""
        document = self._document
        if document is None or document.airways is None:
            return None
        lungs, inputs = self._lung_inputs(document.airways), self._reach_inputs(document.airways)
        reach = self._reach.of(inputs)
        if lungs is None and reach is None:
            return None
        nodules = tuple(target.lesion.nodule for target in document.targets if target.lesion is not None)
        return self._shown.of((lungs, reach, nodules))

    def map_lungs(self, airways: Airways) -> None:
        """Start the map of the lungs that the user requested; the caller holds the session's lock."""
        self._are_lungs_requested = True
        self._lungs.again()
        self._lungs.want(airways)
        self._changed()

    def map_reach(self, airways: Airways, scope: str, tool: str) -> None:
        """Start the map of an instrument's reach that the user requested; the caller holds the session's lock."""
        self._requested_reach = (scope, tool)
        self._reach.again()
        self._reach.want((airways, scope, tool))
        self._changed()

    def follow(self, document: Document) -> None:
        """Cancel maps of other airways after a change of the document; the caller holds the session's lock."""
        before, self._document = self._document, document
        if before is not None and before.airways is not document.airways:
            airways = document.airways
            # Maps that were computed for these airways earlier are used again, such as after an undo.
            self._lungs.want(airways if airways is not None and self._lungs.of(airways) is not None else None)
            inputs = self._reach_inputs(airways)
            self._reach.want(inputs if inputs is not None and self._reach.of(inputs) is not None else None)

    def discard(self) -> None:
        """Stop all maps and release their data, because the case is being closed."""
        self._lungs.discard()
        self._reach.discard()
        self._early = self._document = None
        self._shown.forget()

    def _lung_inputs(self, airways: Airways | None) -> LungMap | None:
        made = self._lungs.of(airways)
        if made is None and self._early is not None and self._early[0] is airways:
            return self._early[1]
        return made

    def _reach_inputs(self, airways: Airways | None) -> ReachInputs | None:
        return None if airways is None or self._requested_reach is None else (airways, *self._requested_reach)

    def _wall_of(self, airways: Airways, attempt: Attempt[Any]) -> WallField:
        with self._lock:
            known = self._wall_at_hand(airways)
        if known is not None:
            return known
        attempt.progress("measuring the airway wall", None)
        made: WallField = self._parts.wall_field(self._volume, airways, cancel=attempt.cancel)
        return made

    def _make_lungs(self, airways: Airways, attempt: Attempt[LungMap]) -> LungMap:
        wall = self._wall_of(airways, attempt)

        def tell(early: LungMap) -> None:
            with self._lock:
                attempt.check()
                self._early = (airways, early)
                self._changed()

        made = self._parts.map_lungs(self._volume, airways, wall, progress=attempt.progress, found=tell)
        with self._lock:
            self._early = None
        return made

    def _make_reach(self, inputs: ReachInputs, attempt: Attempt[ReachAtlas]) -> ReachAtlas:
        airways, scope, tool = inputs
        wall = self._wall_of(airways, attempt)
        return self._parts.reach_atlas(
            self._volume,
            airways,
            scope=scope,
            tool=tool,
            wall=wall,
            progress=attempt.progress,
            cancel=attempt.cancel,
        )


def _stations(volume: Volume, parts: Parts, airways: Airways) -> tuple[Landmark, ...]:
    from carina.plan import ebus_landmarks

    return ebus_landmarks(airways.tree, origin=parts.distance_origin(volume, airways))


def _are_same_inputs(a: ReachInputs, b: ReachInputs) -> bool:
    return a[0] is b[0] and a[1:] == b[1:]
