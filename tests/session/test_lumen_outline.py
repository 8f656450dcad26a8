"""Tests of the lumen's outline in slices: it is always that of the session's present lumen."""

from __future__ import annotations

import numpy as np
import pytest
import simplejpeg
from edit_case import edit_case

from carina.commands import EditTree, ShowPlace, Steer
from carina.render import Renderer
from carina.scopes import Pose
from carina.server.frames.pump import FramePump
from carina.server.wire.messages import parse_picture, split_outline
from carina.session.flights.tip_commands import place_pose
from carina.track import LumenOutline, PaintLumen, RenameBranch
from small_case import edit_session_fixture

PLANES = ("axial", "coronal", "sagittal", "cut-plane")


@pytest.fixture(scope="module")
def case():
    return edit_case()


@pytest.fixture
def fixture(case):
    """Return a session with the small drawn tree, real airways and real edits, whose background the test runs."""
    return edit_session_fixture(case.volume, case.airways)


def lines_of(session, view, case):
    """Return the outline that is shown over the present picture of a view."""
    scene = session.scene()
    picture = Renderer(case.volume).render(scene.spec(view, 200, 160, 0.5))
    outline = scene.outline_of(view, picture)
    assert outline is None or outline.complete
    return None if outline is None else outline.data


def expected(session, view, case):
    airways = session.snapshot().document.airways
    picture = Renderer(case.volume).render(session.scene().spec(view, 200, 160, 0.5))
    return LumenOutline(case.volume, airways).encoded(picture.lps_from_pixel, 200, 160)


def painted_at_tip(session):
    at = tuple(float(v) for v in session.pose_info().pose.position_lps)
    return PaintLumen((at,), 6.0, "ball", erase=False)


def test_only_slices_and_the_cut_plane_show_the_lumen_outline(fixture, case):
    session = fixture.session
    for view in PLANES:
        assert len(lines_of(session, view, case)) > 0, view
    scene = session.scene()
    for view in ("xray-axial", "tri-plane"):
        picture = Renderer(case.volume).render(scene.spec(view, 60, 50, 0.5))
        assert scene.outline_of(view, picture) is None


def test_edit_undo_and_redo_request_slices_with_the_current_lumen_outline(fixture, case):
    session = fixture.session
    keys = [{view: session.scene().key(view) for view in PLANES}]
    outlines = [{view: lines_of(session, view, case) for view in PLANES}]

    def changed():
        for view in PLANES:
            assert session.scene().key(view) != keys[-1][view], view
            assert lines_of(session, view, case) == expected(session, view, case)
        keys.append({view: session.scene().key(view) for view in PLANES})
        outlines.append({view: lines_of(session, view, case) for view in PLANES})

    session.do(EditTree(painted_at_tip(session)))
    # Only the edit runs; the outline does not wait for the job that updates the wall in the renderer.
    while session.snapshot().document.airways is case.airways:
        fixture.background.run_next()
    changed()
    assert all(outlines[1][view] != outlines[0][view] for view in PLANES)
    session.undo()
    changed()
    assert outlines[2] == outlines[0]
    session.redo()
    changed()
    assert outlines[3] == outlines[1]


def test_edit_that_leaves_the_lumen_unchanged_requests_no_new_slices(fixture, case):
    session = fixture.session
    slices = ("axial", "coronal", "sagittal")
    before = {view: session.scene().key(view) for view in slices}
    lumen = session.scene().lumen
    leaf = case.airways.tree.tips()[-1].id
    session.do(EditTree(RenameBranch(leaf, "mine")))
    fixture.background.run_all()
    assert session.snapshot().document.airways is not case.airways
    assert session.scene().lumen is lumen
    assert {view: session.scene().key(view) for view in slices} == before


def test_lumen_outline_of_a_picture_is_computed_with_the_matrix_of_that_picture(fixture, case):
    session = fixture.session
    sent = []
    renderer = Renderer(case.volume)
    session.scene().renderer.render = lambda view, stop=None: renderer.render(view, stop=stop)
    pump = FramePump(session.scene, sent.append, lambda _message: None, clock=fixture.clock)
    pump.set_layout({"axial": (120, 100), "cut-plane": (110, 90), "xray-axial": (80, 80)})
    # The poses are steps of a flight, and the sizes are those that the pump chooses during a movement.
    for _ in range(4):
        session.do(Steer(1.0, 0.05, 0.0, 0.1))
        fixture.clock.advance(1 / 60)
        while pump.step():
            pump.acknowledge(parse_picture(sent[-1])[0].frame_id)
    num_points = 0
    for data in sent:
        header, payload = parse_picture(data)
        image, lines = split_outline(header, payload)
        assert simplejpeg.decode_jpeg(image).shape[:2] == (header.height, header.width)
        if header.view == "xray-axial":
            assert header.outline is None
            continue
        num_points += sum(map(len, lines))
        matrix = np.reshape(header.lps_from_pixel, (4, 4))
        outline = LumenOutline(case.volume, case.airways)
        assert payload == image + outline.encoded(matrix, header.width, header.height), header.view
    assert num_points > 50


def test_show_place_command_looks_at_the_point_from_the_lumen_in_front_of_it(fixture, case):
    session = fixture.session
    leaf = max(case.airways.tree.tips(), key=lambda branch: branch.length_mm)
    place = tuple(float(v) for v in leaf.tip_lps)
    session.do(ShowPlace(place, leaf.id))
    scene, info = session.scene(), session.pose_info()
    assert scene.sight.crosshair_lps == place
    assert session.snapshot().mode == "free"
    to_place = np.asarray(place) - info.pose.position_lps
    away = float(np.linalg.norm(to_place))
    assert 1.5 < away < 13.0
    forward = info.pose.lps_from_camera[:3, 2]
    assert float(forward @ to_place) / away > 0.999, "the camera looks at the position"
    i, j, k = np.rint(case.volume.to_ijk(info.pose.position_lps)).astype(int)
    assert case.airways.lumen_zyx[k, j, i], "the camera is in the lumen"
    # All slices contain the crosshair, so each of them shows the place.
    assert scene.shown_lps == place
    # If the branch no longer exists, the nearest branch is used.
    session.do(place_pose(Pose.looking(info.pose.position_lps, (0.0, 0.0, -1.0))))
    session.do(ShowPlace(place, 10_000))
    np.testing.assert_allclose(session.pose_info().pose.position_lps, info.pose.position_lps, atol=1e-9)
