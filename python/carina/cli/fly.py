"""``carina fly``: a flight along a route, through key frames or of a recording, as video."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import carina
from carina.breathing import Breathing, ChestFrame, ChestMotion
from carina.case.routes import ChosenRoute
from carina.cli.along import check_destination, print_drawn_parts, route_to
from carina.cli.arguments import check_needs, check_output_file, check_range
from carina.cli.case import open_case_recording
from carina.cli.cluster import opened_cluster
from carina.cli.console import ProgressCallback, print_json, print_note, progress_printer
from carina.cli.opened import OpenedInput, check_case_options, check_scan_exists, open_input
from carina.cli.stored_frames import StoredFrames
from carina.cluster import ClusterRenderer, render_frames
from carina.config import load_settings
from carina.errors import NoResultError, UsageError
from carina.export import VIDEO_SUFFIXES, VideoWriter
from carina.export.flight_film import FrameOptions, distinct_images, write_frames
from carina.export.video import even_size, size_notes
from carina.navigate import AutoFlight, KeyFrameFile, KeyFrameFlight, open_key_frames
from carina.navigate.recording import ReplayedPose, case_key, sampled
from carina.render import LEAD_VIEW, Backend, Renderer, transfer_preset
from carina.scopes import DEFAULT_SCOPE, scope_preset
from carina.session import RendererFactory, is_case_file, key_file, view_words
from carina.session.flights.film_flights import (
    CaptionRoute,
    checked_times_s,
    flight_captions,
    frames_of_flight,
    replay_recording,
    wall_builder,
)
from carina.volume import Volume
from carina.volume.inserted_structures import picture_mark

SPEED_MM_S = 20.0
PAUSE_S = 1.0
"""Defaults of the command's options."""


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
    strict: bool,
    as_json: bool,
    cluster: str | None = None,
    token: Path | None = None,
    mixed: bool = False,
    keep: Path | None = None,
    ct: Path | None = None,
    captions: bool = False,
    breathing: str | None = None,
    cough_s: str | None = None,
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
    if breathing is None:
        check_needs("breathing (--breathing)", cough=cough_s)
    breath = None if breathing is None else parse_breathing(breathing, cough_s)
    check_case_options(path, ct, tree=tree)
    notes = size_notes(output, *size, rate_hz=rate_hz)
    for note in notes:
        print_note(f"note: {note}")
    size = even_size(*size)
    named = None if scope in {None, "none"} else scope_preset(str(scope)).name
    shown = FrameOptions(size, (DEFAULT_SCOPE if scope is None else named), step_vox)
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
        source = open_input(path, series=series, strict=strict, progress=progress, ct=ct)
        volume, badges = source.volume, source.badges
        if of_case and source.moment is not None:
            given = key_file(volume, source.key_frames(str(keys)), source.moment.sight)
        facts: dict[str, Any] = {}
        way: ChosenRoute | None = None
        if recorded is not None:
            recorded.check(volume, carina=carina.__version__)
            times = checked_times_s(recorded.length_s, rate_hz)
            walls = wall_builder(volume, progress)
            moments, facts = replay_recording(recorded, walls, volume, print_note, progress=progress)
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
            view = _chosen_view(_stored_view(source, given), shown, chosen=scope is not None)
            frames = frames_of_flight(flight, view, rate_hz, progress=progress)
        if breath is not None:
            shown = replace(shown, motion=ChestMotion(breath, ChestFrame.of_tree(source.airways(progress).tree)))
        stored = None if keep is None else StoredFrames(keep, _job_digest(volume, frames, shown, mixed))
        num_images = len(distinct_images(frames, shown)[0])
        num_stored = 0 if stored is None else min(stored.num, num_images)
        if num_stored:
            print_note(f"continuing: {num_stored} of {num_images} frames are already in {keep}")
        began_s = time.perf_counter()
        renderer = _renderer(source, progress, None if used is None else used.make_renderer)
        write_frames(
            video,
            renderer,
            frames,
            shown,
            captions=_captions(source, way, renderer, progress) if captions else None,
            mark=picture_mark(volume.source),
            stored=stored,
            render_frames=render_frames,
            progress=progress,
        )
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
                "num_kept": num_stored,
                **facts,
                **({} if breath is None else {"breathing": breath.to_json()}),
                "badges": badges.to_json(),
            }
        )
    return 0


def parse_breathing(text: str, cough_s: str | None = None) -> Breathing:
    """Return the breathing of ``--breathing`` and ``--cough``: *quiet*, or amplitude in mm and period in s.

    Examples
    --------
    >>> parse_breathing("quiet") == Breathing()
    True
    >>> parse_breathing("18,5", "2.5,7").coughs_s
    (2.5, 7.0)
    """

    def numbers(option: str, given: str, expected: str) -> list[float]:
        try:
            return [float(part) for part in given.split(",")]
        except ValueError:
            raise UsageError(f"{option}: expected {expected}; found {given!r}") from None

    found = Breathing()
    if text != "quiet":
        expected = "quiet, or the amplitude in mm and the period in s, such as 12,3.6"
        given = numbers("--breathing", text, expected)
        if len(given) != 2:
            raise UsageError(f"--breathing: expected {expected}; found {text!r}")
        found = Breathing.of_movement(*given)
    if cough_s is None:
        return found
    return replace(found, coughs_s=tuple(numbers("--cough", cough_s, "times in s, separated by commas")))


def _captions(
    source: OpenedInput, way: ChosenRoute | None, renderer: Renderer | ClusterRenderer, progress: ProgressCallback
) -> Callable[[ReplayedPose, float], tuple[str, ...]]:
    """Return the function that writes the captions of the frames; a case without airways has only the time."""
    try:
        airways = source.airways(progress)
    except NoResultError:
        airways = None
    own = None
    if way is not None:
        own = CaptionRoute(way, "lumen" if source.document is None else source.document.cost_of(way))
        if own.cost != "lumen":
            print_note("note: this path was not searched in the airways, so the captions name no turns")
    return flight_captions(source.volume, airways, own, renderer if isinstance(renderer, Renderer) else None).lines


def _stored_view(source: OpenedInput, keys: KeyFrameFile | None) -> dict[str, Any]:
    """Return the display settings of the key frames, or else those of the case."""
    if keys is not None:
        return keys.view
    document, moment = source.document, source.moment
    return {} if document is None or moment is None else view_words(document, moment.sight)


def _chosen_view(own: dict[str, Any], shown: FrameOptions, *, chosen: bool) -> dict[str, Any]:
    """Return the view of a recording; the instrument of the command, if any, replaces the recorded one."""
    view = dict(own)
    if chosen and view:
        view = {name: value for name, value in view.items() if name not in {"mask", "fov_deg"}} | {"scope": shown.scope}
    return view


def _job_digest(volume: Volume, frames: list[ReplayedPose], shown: FrameOptions, mixed: bool) -> str:
    """Return a digest of everything on which the frames of a flight depend, without patient data."""
    digest = hashlib.sha256()
    settings = load_settings()
    facts = [case_key(volume), carina.__version__, shown.size, shown.scope, shown.step_vox, settings.backend, mixed]
    digest.update(json.dumps(facts).encode())
    for frame in frames:
        motion = shown.motion_of(frame)
        digest.update(b"" if motion is None else json.dumps([motion.to_json(), frame.time_s]).encode())
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
