"""Conversion of session values to wire messages."""

from __future__ import annotations

import base64
import math
import time
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from carina.case.document import Document
from carina.commands import Look
from carina.plan.routes.main_carina import ROOT, RouteScale
from carina.plan.routes.route_width import RouteWidth
from carina.render import PictureLines
from carina.scopes import scope_presets
from carina.server.wire import messages as wire
from carina.session import (
    ChosenRoute,
    KeyFramesInfo,
    ListedCase,
    OpeningInfo,
    PoseInfo,
    Snapshot,
    StorageInfo,
    WallPoint,
)
from carina.track import CtAssessment
from carina.volume import Citation, Note, SeriesInfo, badges_of


def demos(patient_citation: Citation | None) -> tuple[wire.Demo, ...]:
    """Return the start-page entries of the bundled cases: the phantom, and the patient with its citation."""
    return (
        wire.Demo("phantom", "Phantom", "A synthetic chest CT with known airways, generated on this machine.", None),
        wire.Demo(
            "patient", "Patient", "A real chest CT, cropped around the airways and anonymised.", patient_citation
        ),
    )


def start_message(
    *,
    notice_accepted: bool,
    recent: tuple[ListedCase, ...],
    patient_citation: Citation | None,
    storage: StorageInfo | None = None,
    no_video: str | None = None,
    hints_read: bool = True,
) -> wire.Start:
    """Return the contents of the start page; the message contains no file paths."""
    cases = tuple(_case_list_entry(case) for case in recent)
    beside = None
    if storage is not None:
        beside = wire.Storage(
            storage.num_cts,
            storage.ct_bytes,
            storage.keeps_cts,
            tuple(_case_list_entry(case) for case in storage.forgotten),
        )
    scopes = tuple(
        wire.Scope(s.name, s.title, s.tip_mm, round(s.fit_mm, 2), s.channel_mm, s.fov_deg, s.view_up_deg)
        for s in scope_presets()
    )
    return wire.Start(notice_accepted, cases, demos(patient_citation), scopes, beside, no_video, hints_read)


def _case_list_entry(case: ListedCase) -> wire.CaseListEntry:
    """Return the list entry of a case; the URL of its thumbnail changes with the thumbnail, so browsers reload it."""
    made_s = case.pictured_s
    return wire.CaseListEntry(
        recent_id=case.recent_id,
        date=time.strftime("%Y-%m-%d", time.localtime(case.used_s)),
        title=case.title,
        used_s=None if case.num_changes is None else case.used_s,
        begun_s=case.begun_s,
        num_changes=case.num_changes,
        num_nodules=case.num_nodules,
        num_bytes=case.num_bytes,
        picture=None if made_s is None else f"api/cases/{case.recent_id}/picture.jpg?made={made_s:.3f}",
        opens=case.opens,
        scanned_on=case.scanned_on,
        named=case.named,
    )


# A frame header lists only some rows of a curved image, and the client interpolates between these rows linearly:
# every ROWS_APART-th row, at most MAX_ROWS_NAMED rows, because the size of a header is limited.
ROWS_APART = 6
MAX_ROWS_NAMED = 130


def picture_lines(lines: PictureLines | None) -> wire.PictureLineRows | None:
    """Return the LPS geometry of selected rows of a curved image; None without such an image."""
    if lines is None:
        return None
    height = len(lines.path_mm)
    known = np.flatnonzero(np.isfinite(lines.path_mm))
    ends = known[[0, -1]] if known.size else np.empty(0, dtype=np.int64)
    rows = np.unique(
        np.concatenate([np.arange(0, height, max(ROWS_APART, -(-height // MAX_ROWS_NAMED))), ends, [height - 1]])
    )
    places = np.interp(rows, known, lines.path_mm[known]) if known.size else np.zeros(rows.size)
    return wire.PictureLineRows(
        row=_floats(rows + 0.5),
        start_lps=tuple(_point(p) for p in np.round(lines.start_lps[rows], 3)),
        # Six digits keep the position error below 0.01 mm over an image width of 4096 px.
        step_lps=tuple(_point(p) for p in np.round(lines.step_lps[rows], 6)),
        path_mm=_floats(np.round(places, 3)),
        path_column=_floats(np.round(lines.path_column[rows], 2)),
        mm_per_px=lines.mm_per_px,
    )


def _case_message(snapshot: Snapshot, *, names_ct: bool) -> wire.CaseInfo | None:
    case = snapshot.case
    if case is None:
        return None
    volume = case.volume
    source = volume.source
    return wire.CaseInfo(
        title=snapshot.neutral_title,
        format=source.format,
        is_hu=volume.is_hu,
        not_hu_reason=volume.not_hu_reason,
        shape_zyx=volume.shape_zyx,
        spacing_mm=volume.spacing_mm,
        lps_from_ijk=_flat_matrix(volume.lps_from_ijk),
        value_range=(float(case.value_range[0]), float(case.value_range[1])),
        warnings=tuple(source.warnings),
        notes=_note_messages(source.notes),
        quality=case.quality,
        other_series=tuple(_series_message(one, names_ct=names_ct) for one in source.other_series),
        citation=source.citation,
        off=case.off,
        number=snapshot.case_number,
        interpolated_slices=source.interpolated_slices,
        tilt_deg=source.tilt_deg,
        slice_places=source.slice_places,
        statement=_statement_message(snapshot.assessment),
        series=None if source.series is None else _series_message(source.series, names_ct=names_ct),
        ct_name=source.title if names_ct else None,
    )


def _statement_message(assessment: CtAssessment | None) -> wire.CtStatement | None:
    if assessment is None:
        return None
    return wire.CtStatement(
        tuple(wire.CtPropertyInfo(one.name, one.words, one.limits) for one in assessment.statement),
        assessment.trusted_generation,
        assessment.trusted_words,
    )


def _series_message(series: SeriesInfo, *, names_ct: bool) -> wire.OtherSeries:
    return wire.OtherSeries(
        series.key,
        series.modality,
        series.description,
        series.num_slices,
        series.refused,
        series.slice_distance_mm,
        series.thickness_mm,
        series.kernel,
        series.phase,
        series.acquired_on if names_ct else None,
        series.likeliest,
    )


def opening_message(info: OpeningInfo | None, *, names_ct: bool) -> wire.OpeningMessage:
    """Return the message with the preview of the CT that is being opened; without one, a message that removes it.

    ``names_ct`` adds the dates of the series, which only the user at this machine may read.
    """
    if info is None:
        return wire.OpeningMessage(None)
    found = info.preview.slice
    shown = None
    if found is not None:
        width_mm, height_mm = found.size_mm
        picture = base64.b64encode(found.png).decode()
        shown = wire.OpeningSlice(
            picture, found.number, found.num_slices, found.height_lps_mm, width_mm, height_mm, found.is_hu
        )
    preview = info.preview
    series = tuple(_series_message(one, names_ct=names_ct) for one in preview.series)
    return wire.OpeningMessage(info.job_id, info.list_id, series, preview.chosen_key, preview.num_patients, shown)


def _note_messages(notes: Sequence[Note]) -> tuple[wire.CaseNote, ...]:
    return tuple(wire.CaseNote(note.code, note.words, note.badge) for note in notes)


def state_message(snapshot: Snapshot, *, frame_rate_hz: float, names_ct: bool = False) -> wire.State:
    """Return the wire message of a case's state without the pose, the airway tree and the route.

    ``names_ct`` adds the name of the CT file, which only the user at this machine may read.
    """
    document = snapshot.document
    airways = None if document is None else document.airways
    return wire.State(
        case=_case_message(snapshot, names_ct=names_ct),
        stage=snapshot.stage,
        airways=snapshot.airways,
        airways_words=snapshot.airways_words,
        mode=snapshot.mode,
        look=Look() if document is None else document.look,
        sight=snapshot.sight,
        transfer="" if document is None else document.transfer.name,
        transfer_document=None if document is None else document.transfer.to_json(),
        transfer_presets=snapshot.transfer_presets,
        targets=()
        if document is None
        else tuple(_target_message(t, snapshot.target_places_mm.get(t.target_id)) for t in document.targets),
        route_id=None if document is None or document.route is None else document.route.route_id,
        can_undo=snapshot.undo_label,
        can_redo=snapshot.redo_label,
        root_lps=None if airways is None else _point(airways.root_lps),
        lumen_threshold=_threshold(document),
        frame_rate_hz=frame_rate_hz,
        airways_from=None if airways is None else "mask" if math.isnan(airways.threshold) else "search",
        mask_question=snapshot.mask_question,
        badges=() if snapshot.case is None else _note_messages(badges_of(snapshot.case.volume, airways)),
        saving=snapshot.saving,
        breathing=snapshot.breathing,
    )


def _target_message(target: Any, from_carina_mm: float | None) -> wire.TargetInfo:
    return wire.TargetInfo(
        target_id=target.target_id,
        name=target.name,
        lps=target.lps,
        used_lps=target.used_lps,
        snapped_mm=target.snapped_mm,
        length_mm=target.length_mm,
        problem=target.problem,
        cost=target.cost,
        root_lps=target.root_lps,
        outside_mm=target.outside_mm,
        crossings_mm=target.crossings_mm,
        value_range=target.value_range,
        note=target.note,
        priority=target.priority,
        has_size=target.lesion is not None,
        from_carina_mm=None if from_carina_mm is None else round(from_carina_mm, 2),
    )


def _threshold(document: Document | None) -> float | None:
    """Return the lumen threshold of the current airways or, before a search, of the next search."""
    if document is None:
        return None
    if document.airways is None:
        return document.lumen_threshold
    # NaN becomes None: an imported lumen mask has no threshold.
    threshold = float(document.airways.threshold)
    return None if math.isnan(threshold) else threshold


def route_message(
    route: ChosenRoute | None, measures: Any = None, scale: RouteScale | None = None, *, follows_airways: bool = True
) -> wire.RouteMessage:
    """Return the route message; the lists per route point have equal lengths.

    Parameters
    ----------
    route
        Current route; None sends a message without a route.
    measures
        Measures of the airways of the route; None until the airways are measured.
    scale
        Distances along the route; by default they count from its start.
    follows_airways
        Whether the path of the route was searched in the airways; otherwise their diameters are not those of the path.
    """
    if route is None:
        return wire.RouteMessage(None)
    scale = scale or RouteScale(ROOT, route.cumulative_mm)
    info = wire.RouteInfo(
        route_id=route.route_id,
        title=route.title,
        target_id=route.target_id,
        branch_id=route.branch_id,
        points_lps=tuple(_point(p) for p in np.round(route.points_lps, 3)),
        cumulative_mm=_floats(np.round(route.cumulative_mm, 3)),
        generation=tuple(int(g) for g in route.generation),
        radius_mm=_floats(np.round(route.radius_mm, 3)),
        wall_mm=_floats(np.round(route.wall_mm, 3)),
        forks_mm=tuple(round(mm, 3) for mm in route.forks_mm),
        lookouts_mm=tuple(round(mm, 3) for mm in route.lookouts_mm),
        spans=route.spans,
        length_mm=route.length_mm,
        drawn_mm=round(route.drawn.drawn_mm, 2),
        bridge_mm=round(route.drawn.bridge_mm, 2),
        lumen_known=route.lumen_known,
        needle=route.needle,
        origin=wire.RouteOrigin(scale.origin.kind, round(scale.origin.along_mm, 3)),
        centreline_mm=_floats(np.round(scale.along_mm, 3)),
        **_narrowest(route, measures if follows_airways else None, scale.along_mm),
    )
    return wire.RouteMessage(info)


def _narrowest(route: ChosenRoute, measures: Any, along_mm: NDArray[np.float64]) -> dict[str, Any]:
    """Return the fields of the narrowest diameter of a route; no fields without measures by the current method.

    Measures give positions along the centrelines, as does ``along_mm`` (n,) for each point of the route.
    """
    if measures is None or not route.lumen_known or any(one.is_by_earlier_method for one in measures.branches):
        return {}
    if not {span.branch_id for span in route.spans} <= {one.branch_id for one in measures.branches}:
        return {}
    starts: dict[int, float] = {}
    has_forks = len(route.forks_mm) == len(route.spans) - 1
    for n, span in enumerate(route.spans):
        # A branch starts at the fork; its span starts at the next point.
        starts.setdefault(span.branch_id, route.forks_mm[n - 1] if n and has_forks else span.from_mm)
    starts = {branch_id: float(np.interp(mm, route.cumulative_mm, along_mm)) for branch_id, mm in starts.items()}
    last = route.spans[-1]
    end_mm = float(np.interp(last.to_mm, route.cumulative_mm, along_mm))
    found = measures.narrowest_of_route(starts, end_mm - starts[last.branch_id])
    if found is None:
        return {}
    at_mm = float(np.interp(starts[found.branch_id] + found.at_mm, along_mm, route.cumulative_mm))
    figures = {"narrowest_mm": found.mm, "narrowest_error_mm": found.error_mm, "narrowest_at_mm": at_mm}
    width = RouteWidth(found.mm, found.error_mm, at_mm)
    fits = tuple(wire.ScopeFit(scope.name, width.fit(scope)) for scope in scope_presets())
    return {name: round(mm, 3) for name, mm in figures.items()} | {"scope_fits": fits}


def pose_message(info: PoseInfo) -> wire.PoseMessage:
    """Return the pose message of the current pose."""
    return wire.PoseMessage(
        pose_id=info.pose_id,
        lps_from_camera=_flat_matrix(info.pose.lps_from_camera),
        mode=info.mode,
        path_mm=info.path_mm,
        branch_id=None if info.branch is None else info.branch.id,
        branch_name=None if info.branch is None else info.branch.name,
        generation=None if info.branch is None else info.branch.generation,
        lumen_mm=info.lumen_mm,
        inside=info.inside,
        scope=_held_scope(info),
        key_frames_s=info.key_frames_s,
        flight=info.flight,
        by_device=info.by_device,
        back_to_route_mm=None if info.back_to_route_mm is None else round(info.back_to_route_mm, 1),
    )


def _held_scope(info: PoseInfo) -> wire.HeldScope | None:
    state = info.scope
    if state is None:
        return None
    contact = state.contact
    return wire.HeldScope(
        insertion_mm=round(state.insertion_mm, 3),
        roll_rad=round(state.roll_rad, 6),
        flexion_rad=round(state.flexion_rad, 6),
        red_out=min(max(state.red_out, 0.0), 1.0),
        limit=state.limit,
        needs_mm=None if state.passable_mm is None else round(state.passable_mm, 2),
        tip_mm=info.scope_tip_mm,
        contact_mm=None if contact is None else round(contact.depth_mm, 3),
        num_contacts=state.record.count,
        contact_s=round(state.record.time_s, 3),
    )


def key_frames_message(info: KeyFramesInfo) -> wire.KeyFramesMessage:
    """Return the wire message of the key frames and of the flight through them."""
    return wire.KeyFramesMessage(**msgspec.structs.asdict(info))


def history_message(snapshot: Snapshot) -> wire.HistoryMessage:
    """Return the wire message of the changes that can be undone and redone."""
    steps = tuple(wire.HistoryStep(step.label, round(step.at_s, 3)) for step in snapshot.steps)
    return wire.HistoryMessage(steps, snapshot.position)


def picked_message(pick_id: int, wall: WallPoint | None, depth_mm: float | None) -> wire.Picked:
    """Return the wall position under a click in the airway view; all fields are None if the click missed the wall."""
    if wall is None:
        return wire.Picked(pick_id, None, None, None, None, None, None)
    return wire.Picked(
        pick_id=pick_id,
        lps=wall.lps,
        depth_mm=depth_mm,
        voxel_value=wall.voxel_value,
        branch_id=None if wall.branch is None else wall.branch.id,
        branch_name=None if wall.branch is None else wall.branch.name,
        generation=None if wall.branch is None else wall.branch.generation,
    )


def _flat_matrix(matrix: Any) -> tuple[float, ...]:
    return tuple(float(v) for v in np.asarray(matrix, dtype=np.float64).ravel())


def _floats(values: Any) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _point(values: Any) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)
