"""Test of the time of the lumen's outline in a slice, compared with rendering and encoding in the same run."""

from __future__ import annotations

import time

import pytest

import carina
from cached_test_data import patient
from carina.render import CutPlaneView, Renderer, SliceView
from carina.server.frames.pump import encode_jpeg
from carina.track import LumenOutline

SIZE = (768, 620)
ROUNDS = 40


def least_s(work, rounds=ROUNDS):
    """Return the least time of ``rounds`` calls, seconds, which is the time without other load."""
    took = []
    for _ in range(rounds):
        began = time.perf_counter()
        work()
        took.append(time.perf_counter() - began)
    return min(took)


@pytest.mark.soak
def test_large_slice_with_the_lumen_outline_takes_at_most_ten_percent_longer():
    volume, airways = patient()
    outline, renderer = LumenOutline(volume, airways), Renderer(volume)
    branch = max((b for b in airways.tree.branches if b.generation > 2), key=lambda b: b.length_mm)
    middle = len(branch.points) // 2
    at = branch.points[middle]
    pose = carina.Pose.looking(at, branch.points[middle + 2] - at)
    size = {"width": SIZE[0], "height": SIZE[1]}
    planes = [SliceView(plane, tuple(at), mm_per_px=mm, **size) for plane in ("axial", "coronal") for mm in (None, 0.1)]
    views = [*planes, CutPlaneView(pose, **size), CutPlaneView(pose, extent_mm=15.0, **size)]
    shares = []
    for view in views:
        picture = renderer.render(view)
        plain_s = least_s(lambda view=view: encode_jpeg(renderer.render(view).rgb, full=False))
        more_s = least_s(lambda picture=picture: outline.encoded(picture.lps_from_pixel, *SIZE))
        shares.append(more_s / plain_s)
        assert outline.encoded(picture.lps_from_pixel, *SIZE), "the plane cuts the lumen"
    assert max(shares) < 0.1, [f"{share:.1%}" for share in shares]
