"""Tests of turn clips, each of which flies from the picture of one turn to the picture of the next."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
import simplejpeg
from fork_trees import route_in

from cached_test_data import cached_airways, cached_phantom
from carina.errors import CancelledError, NoResultError, UsageError
from carina.plan import TurnClip, TurnList, turn_clips, turn_flight, turn_list, turn_pictures
from carina.plan.routes.plan_route import PlannedRoute
from carina.render import Renderer, letter_edges

CHEST: dict[str, Any] = {"seed": 4, "spacing_mm": 1.2, "generations": 4}
SIZE, FRAMES = 64, 5


@cache
def renderer() -> Renderer:
    made = Renderer(cached_phantom(**CHEST).volume)
    made.set_lumen(cached_airways(**CHEST).lumen_zyx)
    return made


@cache
def route() -> PlannedRoute:
    tree = cached_airways(**CHEST).tree
    return route_in(tree, min(tree.tips(), key=lambda tip: float(tip.tip_lps[0])).id)


@cache
def turns() -> TurnList:
    return turn_list(cached_airways(**CHEST).tree, route())


def clips_of(found: TurnList, **options: Any) -> tuple[TurnClip | None, ...]:
    options = {"size_px": SIZE, "num_frames": FRAMES, "renderer": renderer(), **options}
    return turn_clips(cached_phantom(**CHEST).volume, cached_airways(**CHEST), route(), found, **options)


@cache
def clips() -> tuple[TurnClip | None, ...]:
    return clips_of(turns())


def test_video_of_a_turn_begins_at_the_previous_turn_and_ends_in_the_picture_of_its_turn() -> None:
    stills = turn_pictures(
        cached_phantom(**CHEST).volume,
        cached_airways(**CHEST),
        turns(),
        size_px=2 * SIZE,
        marked=False,
        renderer=renderer(),
    )
    large = clips_of(turns(), size_px=2 * SIZE, num_frames=2)
    assert len(clips()) == len(large) == len(stills) >= 3
    for index, (clip, end, still) in enumerate(zip(clips(), large, stills, strict=True)):
        assert clip is not None and end is not None
        assert len(clip.frames) == len(clip.cameras) == FRAMES and clip.size_px == SIZE
        times, poses = turn_flight(cached_airways(**CHEST).tree, route(), turns(), index)
        assert clip.cameras[0] is not clip.cameras[-1]
        for camera, pose in ((clip.cameras[0], poses[0]), (clip.cameras[-1], poses[-1])):
            assert np.array_equal(camera.lps_from_camera, pose.lps_from_camera)
        assert 0.0 < clip.duration_s <= min(times[-1], 4.0)
        # Still and clip are rendered without mottling and relief, which do not come from the patient. The flight ends
        # at the camera of the still to within rounding.
        off = np.abs(end.frames[-1].astype(int) - letter_edges(still.picture).rgb.astype(int))
        assert np.mean(off.max(axis=2) > 1) < 0.001, clip.turn


def test_frames_of_a_turn_video_are_evenly_spaced_along_the_flight() -> None:
    for clip in clips():
        assert clip is not None
        steps = np.linalg.norm(np.diff([camera.position_lps for camera in clip.cameras], axis=0), axis=1)
        assert steps.min() > 0.0
        # The largest step between frames is not at the start or the end, because the flight accelerates and slows down
        # there.
        assert steps.max() == steps[1:-1].max()


def test_turn_video_for_an_operator_facing_the_patient_is_rotated_by_180_degrees() -> None:
    first = dataclasses.replace(turns(), turns=turns().turns[:2])
    for head, facing in zip(clips(), clips_of(first, operator="facing"), strict=False):
        assert head is not None and facing is not None
        for one, two in zip(head.cameras, facing.cameras, strict=True):
            assert np.allclose(one.right_lps, -two.right_lps, atol=1e-5)


def test_image_strip_of_a_turn_video_has_all_frames_below_each_other_in_order() -> None:
    clip = clips()[0]
    assert clip is not None
    strip = simplejpeg.decode_jpeg(clip.strip())
    assert strip.shape == (FRAMES * SIZE, SIZE, 3)
    for n, frame in enumerate(clip.frames):
        off = strip[n * SIZE : (n + 1) * SIZE].astype(float) - frame
        # The limit covers the error of JPEG; the difference from another frame is three times as large.
        assert np.abs(off).mean() < 8.0, n


def test_turn_at_distance_zero_from_the_previous_turn_has_no_video() -> None:
    first = turns().turns[0]
    doubled = dataclasses.replace(turns(), turns=(first, dataclasses.replace(first, from_fork_mm=0.0)))
    made, none = clips_of(doubled)
    assert made is not None and none is None


def test_turn_video_with_invalid_arguments_is_refused() -> None:
    with pytest.raises(UsageError, match="size_px: expected 64 to 512; found 10"):
        clips_of(turns(), size_px=10)
    for num in (1, 25):
        with pytest.raises(UsageError, match=f"num_frames: expected 2 to 24; found {num}"):
            clips_of(turns(), num_frames=num)
    blind = dataclasses.replace(turns().turns[0], seen_from_lps=None)
    with pytest.raises(NoResultError, match="does not say where it is seen from"):
        clips_of(dataclasses.replace(turns(), turns=(blind,)))
    with pytest.raises(CancelledError):
        clips_of(turns(), cancel=lambda: True)
    assert clips_of(dataclasses.replace(turns(), turns=())) == ()
    shares: list[float] = []
    clips_of(
        dataclasses.replace(turns(), turns=turns().turns[:2]),
        num_frames=2,
        progress=lambda _what, share: shares.append(share),
    )
    assert shares == [0.25, 0.5, 0.75, 1.0]
