"""``carina fly``: a flight along a route, through key frames or of a recording, as video."""

from __future__ import annotations

import hashlib
import itertools
import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.along import check_destination, print_drawn_parts, route_to
from carina.cli.arguments import check_needs, check_output_file, check_range
from carina.cli.case import open_case_recording
from carina.cli.cluster import opened_cluster
from carina.cli.console import print_json, print_note, progress_printer
from carina.cli.opened import OpenedInput, check_case_options, check_scan_exists, open_input
from carina.cli.stored_frames import StoredFrames
from carina.cluster import ClusterRenderer, render_frames
from carina.config import load_settings
from carina.errors import NoResultError, TrackingError, UsageError, VolumeImportError
from carina.export import VIDEO_SUFFIXES, VideoWriter
from carina.export.video import even_size, size_notes
from carina.navigate import AutoFlight, KeyFrameFile, KeyFrameFlight, Recording, open_key_frames
from carina.navigate.auto_flight import frame_times_s
from carina.navigate.recording import ReplayedPose, case_key, sampled
from carina.render import LEAD_VIEW, AirwayView, Backend, Renderer, TransferFunction, transfer_preset
from carina.scopes import DEFAULT_SCOPE, ImageField, WallField, scope_preset
from carina.session import RendererFactory, is_case_file, key_file, view_words
from carina.track import edits_from_json, wall_field
from carina.volume import Volume

SPEED_MM_S = 20.0
PAUSE_S = 1.0
"""Default values of the options."""


@dataclass(frozen=True, slots=True)
class _RenderOptions:
    """Options for the rendering of the frames."""

    size: tuple[int, int]
    scope: str | None
    step_vox: float


def report(
    path: Path,
    *,
    output: Path,
    tree: Path | None,
    to: str | None,
    recording: Path | None,
    keys: Path | None,
    size: tuple[int, int],
    rate_hz: float,
    speed_mm_s: float,
    pause_s: float,
    scope: str | None,
    step_vox: float,
    series: str | None,
    as_json: bool,
    cluster: str | None = None,
    token: Path | None = None,
    mixed: bool = False,
    keep: Path | None = None,
    ct: Path | None = None,
) -> int:
    """Render all frames and write the video, on a cluster if there is one, and continue from stored frames."""
    check_output_file(output, *VIDEO_SUFFIXES)
    check_range("--rate", rate_hz, 1.0, 240.0)
    check_range("--step-vox", step_vox, 0.01, 100.0)
    check_range("--speed", speed_mm_s, 0.1, 500.0, "mm/s")
    check_range("--pause", pause_s, 0.0, 60.0, "s")
    if (to is not None) + (recording is not None) + (keys is not None) != 1:
        raise UsageError("choose exactly one flight: --to (a branch or point), --recording or --keys")
    if to is None:
        moved = {
            "speed": None if speed_mm_s == SPEED_MM_S else speed_mm_s,
            "pause": None if pause_s == PAUSE_S else pause_s,
        }
        check_needs("a flight along a route (--to)", tree=tree, **moved)
    if recording is not None:
        check_needs("a route or key frames; a recording contains its scope", scope=scope)
    if cluster is None:
        check_needs("a cluster (--cluster)", mixed=mixed, token_file=token)
    check_case_options(path, ct, tree=tree)
    notes = size_notes(output, *size, rate_hz=rate_hz)
    for note in notes:
        print_note(f"note: {note}")
    size = even_size(*size)
    named = None if scope in {None, "none"} else scope_preset(str(scope)).name
    shown = _RenderOptions(size, (DEFAULT_SCOPE if scope is None else named), step_vox)
    if to is not None:
        check_destination(to, LEAD_VIEW)
        AutoFlight(carina.FlightPath([[0, 0, 1], [0, 0, 0]]), speed_mm_s=speed_mm_s, pause_s=pause_s)
    # Otherwise the message would name the recording or the key frames, although the scan is missing.
    check_scan_exists(path)
    recorded = None if recording is None else open_case_recording(path, recording)
    # For a case, --keys contains names of key frames, unless a file of that name exists.
    of_case = keys is not None and is_case_file(path) and not keys.is_file()
    given = None if keys is None or of_case else open_key_frames(keys)
    if given is not None:
        given.flight()
    progress = progress_printer()
    with (
        VideoWriter(output, *size, rate_hz=rate_hz) as video,
        opened_cluster(cluster, token=token, mixed=mixed) as used,
    ):
        source = open_input(path, series=series, progress=progress, ct=ct)
        volume, badges = source.volume, source.badges
        if of_case and source.moment is not None:
            given = key_file(volume, source.key_frames(str(keys)), source.moment.sight)
        facts: dict[str, Any] = {}
        if recorded is not None:
            recorded.check(volume, carina=carina.__version__)
            moments, facts = _replay_poses(recorded, volume, progress)
            times = frame_times_s(recorded.length_s, rate_hz)
            frames = sampled(moments, times)
        else:
            flight: AutoFlight | KeyFrameFlight
            if given is not None:
                given.check(volume)
                flight = given.flight()
                facts = {"key_times_s": list(flight.key_times_s), "path_mm": sum(flight.leg_mm)}
            else:
                way = route_to(source, str(to), tree_file=tree, progress=progress)
                flight = AutoFlight(way.path, speed_mm_s=speed_mm_s, pause_s=pause_s)
                print_drawn_parts(way)
                facts = {
                    "to": way.title,
                    "path_mm": way.length_mm,
                    **way.drawn.to_json(),
                    "stops_mm": list(way.lookouts_mm),
                }
            times = frame_times_s(flight.duration_s, rate_hz)
            view = _chosen_view(_stored_view(source, given), shown, chosen=scope is not None)
            turned = view.get("operator") == "facing"
            frames = [ReplayedPose(float(t), flight.pose_at(float(t)), view, turned) for t in times]
        shots, times_shown = _distinct_images(frames, shown)
        stored = None if keep is None else StoredFrames(keep, _job_digest(volume, frames, shown, mixed))
        num_kept = 0 if stored is None else min(stored.num, len(shots))
        if num_kept:
            print_note(f"continuing: {num_kept} of {len(shots)} frames are already in {keep}")
        began_s = time.perf_counter()
        renderer = _renderer(source, progress, None if used is None else used.make_renderer)
        for number, rgb in _render_images(renderer, shots, stored, size):
            for _ in range(times_shown[number]):
                video.add(rgb)
            progress("rendering frames", video.num_frames / len(frames))
        seconds = time.perf_counter() - began_s
    print_note(f"wrote {output}: {len(frames)} frames, {len(frames) / rate_hz:.2f} s")
    if as_json:
        print_json(
            {
                "file": str(output),
                "num_frames": len(frames),
                "rate_hz": rate_hz,
                "duration_s": len(frames) / rate_hz,
                "size": list(size),
                "notes": list(notes),
                "render_s": seconds,
                "num_kept": num_kept,
                **facts,
                "badges": badges.to_json(),
            }
        )
    return 0


def _replay_poses(recorded: Recording, volume: Volume, progress: Any) -> tuple[list[ReplayedPose], dict[str, Any]]:
    build_wall = _wall_builder(volume, progress) if recorded.needs_wall else None
    moments, different = [], 0
    for moment, same in recorded.replay(volume, wall=build_wall):
        moments.append(moment)
        different += not same
    if not moments:
        raise NoResultError("the recording contains no poses")
    if different:
        print_note(
            f"note: {different} of {len(moments)} poses differ from the recorded ones; the recording was probably "
            "made with another build of Carina"
        )
    if not recorded.complete:
        print_note("note: the recording is incomplete; the replay stops where it ends")
    return moments, {"num_moments": len(moments), "num_different": different, "complete": recorded.complete}


def _wall_builder(volume: Volume, progress: Any) -> Callable[[dict[str, Any]], WallField]:
    """Return a function that rebuilds the airway wall of a recording by repeating its airway search and its edits."""
    known: dict[str, WallField] = {}

    def build_wall(stored: dict[str, Any]) -> WallField:
        digest = str(stored.get("digest", ""))
        if digest in known:
            return known[digest]
        searches: list[dict[str, Any]] = [{}]
        if stored.get("root_lps") is not None:
            # The recording does not state which of these the user gave: search with neither, threshold, both.
            searches += [
                {"lumen_threshold": stored.get("lumen_threshold")},
                {"root_lps": stored["root_lps"], "lumen_threshold": stored.get("lumen_threshold")},
            ]
        edits = () if stored.get("edits") is None else edits_from_json(stored["edits"])
        for search in searches:
            try:
                airways = carina.find_airways(volume, **search, progress=progress)
                for edit in edits:
                    airways = carina.edit_airways(volume, airways, edit, progress=progress)
                made = wall_field(volume, airways, progress=progress)
            except (TrackingError, UsageError):
                # This search can fail (no root) or give airways without the edited branches; try the next one.
                if search is searches[-1] and not digest:
                    raise
                continue
            if digest in {"", made.digest()}:
                known[digest] = made
                return made
        raise VolumeImportError(
            "the airways that guided the scope in this recording differ from those found here, probably because they "
            "came from an imported segmentation or from another build of Carina; replay the recording with the "
            "segmentation and the build that it was made with",
            code="navigate.recording",
        )

    return build_wall


def _stored_view(source: OpenedInput, keys: KeyFrameFile | None) -> dict[str, Any]:
    """Return the display settings of the key frames, or else those of the case."""
    if keys is not None:
        return keys.view
    document, moment = source.document, source.moment
    return {} if document is None or moment is None else view_words(document, moment.sight)


def _chosen_view(own: dict[str, Any], shown: _RenderOptions, *, chosen: bool) -> dict[str, Any]:
    """Return the view of a recording; the instrument of the command, if any, replaces the recorded one."""
    view = dict(own)
    if chosen and view:
        view = {name: value for name, value in view.items() if name not in {"mask", "fov_deg"}} | {"scope": shown.scope}
    return view


def _job_digest(volume: Volume, frames: list[ReplayedPose], shown: _RenderOptions, mixed: bool) -> str:
    """Return a digest of everything on which the frames of a flight depend, without patient data."""
    digest = hashlib.sha256()
    settings = load_settings()
    facts = [case_key(volume), carina.__version__, shown.size, shown.scope, shown.step_vox, settings.backend, mixed]
    digest.update(json.dumps(facts).encode())
    for frame in frames:
        digest.update(np.ascontiguousarray(frame.pose.lps_from_camera, "<f8").tobytes())
        digest.update(json.dumps([frame.view, frame.picture_turned], sort_keys=True).encode())
    return digest.hexdigest()


def _renderer(source: OpenedInput, progress: Any, make: RendererFactory | None) -> Renderer | ClusterRenderer:
    volume = source.volume
    renderer: Renderer | ClusterRenderer
    if make is None:
        renderer = Renderer(volume, backend=Backend(load_settings().backend))
    else:
        renderer = make(volume, transfer_preset("endoscopic"))  # type: ignore[assignment]
    if volume.is_hu:
        try:
            airways = source.airways(progress)
            source.badges.add(getattr(airways, "badges", ()))
            renderer.set_lumen(airways.lumen_zyx, airways.tree)
        except NoResultError as error:
            print_note(f"note: {error}; thin walls are shown as they appear in the CT")
    return renderer


@dataclass(frozen=True, slots=True, eq=False)
class _FrameImage:
    """Description of one image to render."""

    transfer: Any
    """Transfer function as JSON; None for the default."""
    view: AirwayView


def _distinct_images(frames: list[ReplayedPose], shown: _RenderOptions) -> tuple[list[_FrameImage], list[int]]:
    """Return the distinct images of a flight, with the number of frames for which each is shown."""
    shots: list[_FrameImage] = []
    times_shown: list[int] = []
    last: tuple[int, int] | None = None
    for frame in frames:
        same = (id(frame.pose), id(frame.view))
        if same == last:
            times_shown[-1] += 1
            continue
        last = same
        shots.append(_FrameImage(frame.view.get("transfer"), _view(frame, shown)))
        times_shown.append(1)
    return shots, times_shown


def _view(frame: ReplayedPose, shown: _RenderOptions) -> AirwayView:
    view = frame.view
    settings: dict[str, Any] = {"width": shown.size[0], "height": shown.size[1], "step_vox": shown.step_vox}
    settings |= {name: view[name] for name in ("shading", "texture", "fov_deg") if name in view}
    scope = view.get("scope", shown.scope)
    outline = view.get("mask")
    if scope is None:
        field = ImageField() if outline is None else ImageField(outline)
        settings.setdefault("fov_deg", 90.0)
        return AirwayView(frame.pose, field=field, **settings)
    preset = scope_preset(scope)
    if outline is not None:
        settings["field"] = replace(preset.field, outline=outline)
    return AirwayView.of_scope(preset, frame.pose, picture_turned=frame.picture_turned, **settings)


def _render_images(
    renderer: Renderer | ClusterRenderer, shots: list[_FrameImage], stored: StoredFrames | None, size: tuple[int, int]
) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """Yield all images with their numbers, in order: first the stored images, then newly rendered images."""
    first = 0 if stored is None else min(stored.num, len(shots))
    for number in range(first):
        assert stored is not None
        yield number, stored.load(number, size)
    start = 0
    for transfer, run in itertools.groupby(shots, key=lambda shot: shot.transfer):
        views = [shot.view for shot in run]
        end = start + len(views)
        if end > first:
            renderer.set_transfer(
                transfer_preset("endoscopic") if transfer is None else TransferFunction.from_json(transfer)
            )
            renderer.prepare()
            for n, picture in render_frames(renderer, views, first=max(0, first - start)):
                if stored is not None:
                    stored.store_frame(start + n, picture)
                yield start + n, picture.rgb
        start = end
