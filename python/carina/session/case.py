"""The open case: what stays while its document changes, and how it is made from a volume."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from carina.errors import UsageError
from carina.navigate import KeyFrameFlight, Navigator, Pilot
from carina.render import GreyWindow, Sight
from carina.session.document import Document, Keys, Point
from carina.session.history import History
from carina.session.parts import Parts, RendererFactory
from carina.session.routes import AirwayIndex, ChosenRoute
from carina.session.scene import Renderer
from carina.session.snapshot import AirwayStatus, CaseSnapshot, FeatureOff, MaskQuestion, PoseInfo
from carina.session.start_pose import pose_before_airways
from carina.track import LumenOutline
from carina.volume import Volume

__all__ = ["HISTOGRAM_PRESET", "AskedMask", "OpenCase", "as_point", "in_lumen", "new_case", "pose_info"]

LUNG_WINDOW = GreyWindow(1500.0, -600.0)
HISTOGRAM_PRESET = "from histogram"


@dataclass(frozen=True, slots=True)
class AskedMask:
    """A mask of another tool that waits for an answer."""

    path: str
    label: int | None
    """As said so far."""
    question: MaskQuestion


@dataclass(slots=True)
class OpenCase:
    """All of it is guarded by the session's lock."""

    number: int
    info: CaseSnapshot
    renderer: Renderer
    pilot: Pilot
    history: History[Document]
    presets: tuple[str, ...]
    threshold_from_histogram: float | None
    airways_status: AirwayStatus = "waiting"
    airways_words: str | None = None
    index: AirwayIndex | None = None
    person_moved: bool = False
    """Once a person has moved, found airways do not move the tip to their root."""
    sight: Sight = Sight()
    wall_of: Any = None
    """The airways whose wall the pilot knows."""
    walling_of: Any = None
    """The airways whose wall a job measures now."""
    walling_job: str = ""
    """The newest such job."""
    unwalled: Any = None
    """The airways whose wall a person stopped, or that have none: no bridge starts it again by asking."""
    lays_scope: bool = False
    """A scope is laid once the wall is known."""
    laid_scope: str | None = None
    """The scope that was last laid in the lumen."""
    flown_route: Any = None
    """The route whose path the pilot was last given."""
    shown_transfer: Any = None
    """What the renderer was last given; the document may be ahead of it."""
    shown_airways: Any = None
    measures: Any = None
    """The newest :class:`carina.track.TreeMeasures`, of these airways:"""
    measures_of: Any = None
    wanted_measures_of: Any = None
    """The airways that a job measures or has measured."""
    display_wanted: int = 0
    """Grows with each change that the renderer must follow."""
    display_followed: bool = False
    """A job brings the renderer to the newest."""
    asked_mask: AskedMask | None = None
    has_lumen: bool = False
    """The renderer has been given a lumen."""
    content_number: int = 0
    keys_s: float | None = None
    """The tip's time in the flight through key frames; None once anything else has moved it."""
    by_device: bool = False
    """A device moved the tip last."""
    key_flight: tuple[Keys, Any, KeyFrameFlight | None, str | None] | None = None
    """The flight, or why there is none, and the key frames and airways that it is of."""
    content_wanted: int = 0
    """Grows when a person or a job decides on another transfer function or lumen..."""
    content_shown: int = 0
    """... and the one of these that the renderer has come to."""

    outlined: LumenOutline | None = None
    """The outline of the newest lumen that was looked at."""

    @property
    def outline(self) -> LumenOutline | None:
        """The outline of the lumen that the document has now; None where it has none."""
        airways = self.document.airways
        if airways is None:
            return None
        # Edits that leave the lumen as it is (a name, a smoother centreline) keep its outline.
        if self.outlined is None or self.outlined.lumen_zyx is not airways.lumen_zyx:
            self.outlined = LumenOutline(self.info.volume, airways)
        return self.outlined

    @property
    def navigator(self) -> Navigator:
        """The tip, to be read; moves go to the pilot."""
        return self.pilot.navigator

    @property
    def document(self) -> Document:
        """What the person decided so far."""
        return self.history.current

    def follow_route(self, route: ChosenRoute) -> None:
        """Another route without a step of undo: the hand that flies asked for it."""
        self.history.amend_current(lambda document: replace(document, route=route))

    def check_inside(self, lps: Point) -> None:
        """Refuse a point outside the volume.

        Raises
        ------
        UsageError
            ``session.outside``.
        """
        if not self.info.volume.contains_lps(np.asarray(lps, dtype=np.float64)):
            sides = zip(lps, ("L", "P", "S"), ("R", "A", "I"), strict=True)
            place = " ".join(f"{plus if mm >= 0 else minus} {abs(mm):.1f}" for mm, plus, minus in sides)
            raise UsageError(f"the point {place} mm lies outside the scan", code="session.outside")


def new_case(volume: Volume, number: int, *, parts: Parts, renderer_factory: RendererFactory) -> OpenCase:
    """A case that shows a volume, before anything was found in it."""
    off: tuple[FeatureOff, ...] = ()
    threshold: float | None = None
    window = LUNG_WINDOW
    presets = parts.presets
    low, high = volume.value_range
    if volume.is_hu:
        transfer = parts.transfer_preset("endoscopic")
    else:
        transfer, threshold = parts.transfer_from_histogram(volume)
        window = GreyWindow(float(max(1, high - low)), (high + low) / 2.0)
        presets = (HISTOGRAM_PRESET,)
        why = volume.not_hu_reason or "the numbers of this volume are not HU"
        off = (
            FeatureOff("transfer functions and windows in HU", why),
            FeatureOff("the quality check of the lungs", why),
            FeatureOff("a lumen threshold in HU (the one above is in the file's own numbers)", why),
        )
    document = Document(transfer=transfer, lumen_threshold=threshold)
    return OpenCase(
        number=number,
        info=CaseSnapshot(volume, parts.quality_words(volume), off, (low, high)),
        renderer=renderer_factory(volume, transfer),
        pilot=Pilot(Navigator(pose_before_airways(volume), volume=volume)),
        history=History(document),
        presets=presets,
        threshold_from_histogram=threshold,
        shown_transfer=transfer,
        sight=Sight(window=window),
    )


def pose_info(case: OpenCase, pose_id: int) -> PoseInfo:
    """Where the tip is: in which branch, how far along, how wide."""
    tip, index, document = case.navigator, case.index, case.document
    at = tip.pose.position_lps
    airways, route, path_mm = document.airways, document.route, tip.path_mm
    inside = case.info.volume.contains_lps(at)
    if airways is not None:
        inside = inside and in_lumen(case.info.volume, airways.lumen_zyx, at)
    branch_id: int | None = None
    lumen_mm: float | None = None
    if path_mm is not None and route is not None:
        n = int(np.argmin(np.abs(route.cumulative_mm - path_mm)))
        branch_id, lumen_mm = int(route.branch_ids[n]), 2.0 * float(route.radius_mm[n])
    elif index is not None and inside:
        branch_id, radius_mm, _ = index.nearest(at)
        lumen_mm = 2.0 * radius_mm
    return PoseInfo(
        pose_id=pose_id,
        pose=tip.pose,
        mode=tip.mode,
        path_mm=path_mm,
        branch_id=branch_id,
        branch_name=None if index is None or branch_id is None else index.name(branch_id),
        generation=None if index is None or branch_id is None else index.generation(branch_id),
        lumen_mm=lumen_mm,
        inside=inside,
        scope=tip.scope_state,
        scope_tip_mm=tip.scope_tip_mm,
        keys_s=case.keys_s,
        by_device=case.by_device,
    )


def as_point(values: Iterable[Any]) -> Point:
    """Three plain floats."""
    x, y, z = (float(v) for v in values)
    return x, y, z


def in_lumen(volume: Volume, lumen_zyx: Any, point_lps: Any) -> bool:
    """Whether the voxel that a point lies in is lumen."""
    i, j, k = np.rint(volume.to_ijk(point_lps)).astype(int)
    nz, ny, nx = volume.shape_zyx
    return 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and bool(lumen_zyx[k, j, i])
