"""Tests of which views of a session are rendered again after a movement or a change of a setting."""

from __future__ import annotations

import numpy as np
import pytest

from carina import _core
from carina.commands import ChooseRoute, GoTo, SetCarm, SetCrosshair, SetMode, SetReformation, SetSlab, SetZoom, Steer
from carina.render import Carm, Renderer, Slab, XrayView
from carina.server.to_wire.session import picture_lines
from carina.server.wire.codec import MAX_HEADER_BYTES, encode
from small_case import session_fixture, small_volume

OVERVIEWS = ("xray-axial", "xray-coronal", "xray-sagittal", "drr", "straightened", "curved")


def opened():
    fixture = session_fixture()
    fixture.open()
    return fixture.session


def keys(session, views):
    scene = session.scene()
    return {view: scene.key(view) for view in views}


def test_overview_pictures_are_not_rendered_again_when_the_tip_moves():
    session = opened()
    before = keys(session, OVERVIEWS)
    assert None not in before.values()
    session.do(GoTo(4.0))
    session.do(Steer(1.0, 0.1, 0.1, 0.2))
    session.do(SetMode("free"))
    session.do(Steer(2.0, 0.3, 0.0, 0.0))
    assert keys(session, OVERVIEWS) == before


def test_projections_are_rendered_once_for_each_volume(monkeypatch):
    calls = []
    real = _core.project_maximum
    monkeypatch.setattr(_core, "project_maximum", lambda hu: calls.append(1) or real(hu))
    renderer = Renderer(small_volume())
    for axis in ("axial", "coronal", "sagittal", "axial"):
        renderer.render(XrayView(axis=axis, width=30, height=30))
    assert len(calls) == 1


def test_rotating_the_c_arm_requests_only_the_radiograph():
    session = opened()
    before = keys(session, OVERVIEWS)
    session.do(SetCarm(-30.0, 15.0, 0.5, "fluoroscopy"))
    after = keys(session, OVERVIEWS)
    assert [view for view in OVERVIEWS if after[view] != before[view]] == ["drr"]
    view = session.scene().spec("drr", 100, 80, 0.5, full_width=200)
    assert (view.primary_deg, view.secondary_deg, view.tone, view.mm_per_px) == (-30.0, 15.0, "fluoroscopy", 1.0)
    assert session.snapshot().sight.carm == Carm(-30.0, 15.0, 0.5, "fluoroscopy")
    assert session.snapshot().undo_label is None


def test_views_along_the_route_exist_only_with_a_route_and_change_with_it():
    session = opened()
    before = keys(session, ("straightened", "curved"))
    session.do(ChooseRoute(branch_id=2))
    assert all(session.scene().key(view) not in {None, before[view]} for view in before)
    session.do(ChooseRoute())
    assert keys(session, before) == {"straightened": None, "curved": None}


def test_zoomed_view_along_the_route_follows_the_tip_on_and_beside_it():
    session = opened()
    session.do(SetReformation(40.0, 0.25))
    session.do(GoTo(5.0))
    scene = session.scene()
    before = scene.key("straightened")
    view = scene.spec("straightened", 60, 90, 0.5, full_width=120)
    assert (view.turn_deg, view.mm_per_px, view.centre_mm) == (40.0, 0.5, 5.0)
    session.do(SetMode("free"))
    session.do(Steer(3.0, 0.0, 0.0, 0.0))
    scene = session.scene()
    assert scene.key("straightened") != before
    assert scene.spec("straightened", 60, 90, 0.5).centre_mm == pytest.approx(8.0, abs=0.5)


def test_zoomed_slice_does_not_move_until_the_tip_moves():
    session = opened()
    tip = session.pose_info().pose.position_lps
    centre = (float(tip[0]) + 9.0, float(tip[1]) - 4.0, 0.0)
    session.do(SetZoom(view="axial", mm_per_px=0.3, centre_lps=centre))
    view = session.scene().spec("axial", 60, 50, 0.5)
    # The centre of the slice is beside the tip, at the depth of the shown slice.
    assert view.centre_lps == pytest.approx((centre[0], centre[1], tip[2]))
    assert view.mm_per_px == 0.3
    session.do(GoTo(3.0))
    followed = session.scene().spec("axial", 60, 50, 0.5)
    assert followed.centre_lps == pytest.approx(tuple(session.pose_info().pose.position_lps))
    assert followed.mm_per_px == 0.3
    # With a crosshair the slices stay while the tip moves.
    session.do(SetCrosshair(tuple(float(v) for v in tip)))
    session.do(SetZoom(view="axial", mm_per_px=0.3, centre_lps=centre))
    session.do(GoTo(6.0))
    assert session.scene().spec("axial", 60, 50, 0.5).centre_lps[:2] == pytest.approx(centre[:2])
    session.do(SetCrosshair(None))
    assert session.scene().spec("axial", 60, 50, 0.5).centre_lps[:2] != pytest.approx(centre[:2])


def test_panned_cut_plane_does_not_move_until_the_tip_moves():
    session = opened()
    pose = session.pose_info().pose
    right, down, forward = pose.lps_from_camera[:3, :3].T
    before = session.scene().key("cut-plane")
    # The point is beside the tip and slightly off the plane.
    aside = pose.position_lps + 3.0 * right - 2.0 * down + 1.5 * forward
    session.do(SetZoom(view="cut-plane", extent_mm=12.0, centre_lps=tuple(float(v) for v in aside)))
    scene = session.scene()
    assert scene.key("cut-plane") != before
    picture = Renderer(small_volume()).render(scene.spec("cut-plane", 60, 40, 0.5))
    middle = picture.lps_from_pixel @ (30.0, 20.0, 0.0, 1.0)
    np.testing.assert_allclose(middle[:3], pose.position_lps + 3.0 * right - 2.0 * down, atol=1e-9)
    # The plane moves with the tip even if a crosshair fixes the slices.
    session.do(SetCrosshair(tuple(float(v) for v in pose.position_lps)))
    session.do(GoTo(6.0))
    view = session.scene().spec("cut-plane", 60, 40, 0.5)
    assert (view.centre_lps, view.extent_mm) == (None, 12.0)


def test_slab_setting_changes_only_slices_and_views_along_the_route():
    session = opened()
    views = ("airway", "cut-plane", "tri-plane", "axial", "coronal", "sagittal", "tree", *OVERVIEWS)
    before = keys(session, views)
    session.do(SetSlab(10.0, "min"))
    after = keys(session, views)
    changed = {view for view in views if after[view] != before[view]}
    assert changed == {"axial", "coronal", "sagittal", "straightened", "curved"}
    assert session.scene().spec("coronal", 40, 40, 0.5).slab == Slab(10.0, "min")
    session.do(SetSlab(0.0, "min"))
    assert keys(session, views) == before


def test_curved_reformation_is_sent_with_the_path_position_of_each_row():
    session = opened()
    view = session.scene().spec("curved", 70, 100, 0.5)
    lines = Renderer(small_volume()).render(view).lines
    drawn = picture_lines(lines)
    assert drawn.row[0] == 0.5
    assert drawn.row[-1] == 99.5
    assert all(b > a for a, b in zip(drawn.row, drawn.row[1:], strict=False))
    for row in (0.5, 13.5, 50.5, 99.5):
        for column in (0.0, 35.0, 70.0):
            start, step = (
                np.array([np.interp(row, drawn.row, [p[a] for p in points]) for a in range(3)])
                for points in (drawn.start_lps, drawn.step_lps)
            )
            # The tolerance is a tenth of a pixel, because the path bends slightly between two rows with lines.
            np.testing.assert_allclose(start + column * step, lines.lps_of(column, row), atol=0.1 * lines.mm_per_px)
    assert picture_lines(None) is None
    # The lines of the tallest picture that a client may request still fit into a header.
    tall = Renderer(small_volume()).render(session.scene().spec("straightened", 16, 4096, 0.5))
    assert len(encode(picture_lines(tall.lines))) < MAX_HEADER_BYTES / 2
