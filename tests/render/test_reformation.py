"""Tests of reformations along a path: distances in mm, widths, laterality, and transform between pixels and points."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from render_grids import place, rotation

from carina.errors import RenderError, UsageError
from carina.navigate import FlightPath
from carina.render import PathSpan, PathView, Renderer, Slab, letter_edges, mark_path
from carina.render.picture_text import letters_of
from carina.scopes import PathFrames
from carina.volume import Volume

RADIUS = 5.0
BEND = 35.0


def bent_points(num=400):
    """Return a path in the coronal plane: 40 mm down, a quarter circle of 35 mm to the patient's left, 30 mm."""
    arc = BEND * np.pi / 2
    s = np.linspace(0.0, 40.0 + arc + 30.0, num)
    angle = np.clip((s - 40.0) / BEND, 0.0, np.pi / 2)
    rest = np.clip(s - 40.0 - arc, 0.0, None)
    x = BEND * (1 - np.cos(angle)) + rest
    z = -np.minimum(s, 40.0) - BEND * np.sin(angle)
    return np.stack([x - 30.0, np.full(num, 4.0), z + 50.0], axis=1)


@pytest.fixture(scope="module", params=["straight", "oblique", "mirrored"])
def bent(request):
    """Return a bent tube of air (-1000 HU) of 5 mm radius in tissue (0 HU) on a given grid, and its centreline."""
    axes = {"straight": np.eye(3), "oblique": rotation(0.3, -0.2, 0.25), "mirrored": np.diag([-1.0, 1.0, -1.0])}
    shape = (100, 60, 110)
    matrix = place(axes[request.param], (1.0, 1.2, 1.1), (10.0, 4.0, 5.0), shape)
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)[..., ::-1].astype(float)
    lps = (grid @ matrix[:3, :3].T + matrix[:3, 3]).reshape(-1, 3)
    points = bent_points(150)
    away = np.full(len(lps), np.inf)
    for point in points:
        np.minimum(away, np.linalg.norm(lps - point, axis=1), out=away)
    # The wall is blurred over one voxel.
    hu = np.clip((away - RADIUS) / 1.0, -0.5, 0.5) * 1000.0 - 500.0
    volume = Volume(np.ascontiguousarray(np.rint(hu).astype(np.int16).reshape(shape)), matrix)
    return volume, FlightPath(bent_points())


WINDOW = (1000.0, -500.0)


@pytest.mark.parametrize("turn", [0.0, 35.0, 90.0, -120.0])
def test_bent_tube_is_straightened_with_its_true_width(bent, turn):
    volume, path = bent
    view = PathView("straightened", path.frames(), turn_deg=turn, width=120, height=400, window_hu=WINDOW)
    picture = Renderer(volume).render(view)
    lines = picture.lines
    for row in range(60, 340, 20):
        # Only pixels near the path are compared: farther away the picture leaves the volume, and planes of the bend
        # cross.
        near = np.abs(np.arange(120) + 0.5 - lines.path_column[row]) * lines.mm_per_px < 14.0
        dark = np.flatnonzero((picture.rgb[row, :, 0] < 128) & near)
        assert np.ptp(dark) + 1 == dark.size
        # The tolerance is half a voxel at each wall, and 0.5 mm by which the flight path may leave the centre.
        assert dark.size * lines.mm_per_px == pytest.approx(2 * RADIUS, abs=1.2)
        assert (dark.mean() + 0.5 - lines.path_column[row]) * lines.mm_per_px == pytest.approx(0.0, abs=0.8)


def test_rows_of_a_reformation_are_evenly_spaced_in_mm_along_the_route(bent):
    volume, path = bent
    picture = Renderer(volume).render(PathView("straightened", path.frames(), width=100, height=300))
    lines = picture.lines
    inside = np.isfinite(lines.path_mm)
    assert np.allclose(np.diff(lines.path_mm[inside]), lines.mm_per_px)
    for place_mm in (0.5, 33.0, 80.0, path.length_mm - 0.5):
        column, row = picture.pixel_of(path.frames().at(np.array([place_mm]))[0][0])
        assert column == pytest.approx(50.0, abs=0.01)
        assert np.interp(row, np.arange(300)[inside] + 0.5, lines.path_mm[inside]) == pytest.approx(place_mm, abs=0.05)


@pytest.mark.parametrize("kind", ["straightened", "curved"])
def test_pixels_of_a_curved_reformation_convert_to_points_and_back(bent, kind):
    volume, path = bent
    picture = Renderer(volume).render(PathView(kind, path.frames(), turn_deg=20.0, width=90, height=260))
    for column, row in [(45.0, 20.5), (40.3, 130.5), (52.0, 200.5), (45.0, 250.5)]:
        found = picture.pixel_of(picture.lines.lps_of(column, row))
        assert found == pytest.approx((column, row), abs=0.3)


def test_zoomed_curved_reformation_is_centred_on_its_path_position(bent):
    volume, path = bent
    for kind in ("straightened", "curved"):
        view = PathView(kind, path.frames(), width=101, height=101, mm_per_px=0.5, centre_mm=61.0)
        picture = Renderer(volume).render(view)
        assert picture.lines.mm_per_px == 0.5
        assert picture.lines.path_mm[50] == pytest.approx(61.0, abs=0.3)
        assert picture.pixel_of(path.frames().at(np.array([61.0]))[0][0]) == pytest.approx((50.5, 50.5), abs=0.3)


def test_path_has_its_true_length_in_a_curved_reformation_at_any_rotation(bent):
    """Check a stretched CPR, in which the path has its true length at any rotation."""
    volume, path = bent
    for turn in (0.0, 50.0, 90.0):
        view = PathView("curved", path.frames(), turn_deg=turn, width=300, height=300)
        lines = Renderer(volume).render(view).lines
        rows = np.flatnonzero(np.isfinite(lines.path_mm))
        steps = np.hypot(np.diff(lines.path_column[rows]), 1.0) * lines.mm_per_px
        if turn == 0.0:
            # The last 30 mm are parallel to the direction of the sweep, so they are one row.
            continue
        real = np.linalg.norm(np.diff(path.frames().points_lps, axis=0), axis=1).sum()
        # The tolerance is one row at each end.
        assert steps.sum() == pytest.approx(real, abs=2.5 * lines.mm_per_px)


@pytest.mark.parametrize("kind", ["straightened", "curved"])
def test_curved_reformation_at_0_degrees_is_coronal_and_at_90_degrees_sagittal(bent, kind):
    volume, path = bent

    def letters(turn):
        lines = Renderer(volume).render(PathView(kind, path.frames(), turn_deg=turn, width=60, height=120)).lines
        return letters_of(lines.step_lps[20])

    assert letters(0.0) == "L"
    assert letters(90.0) == "P"
    assert letters(180.0) == "R"


def test_patients_left_is_on_the_right_of_a_curved_reformation():
    """Use reversed and oblique grids with a bright bead on the patient's left of the trachea."""
    for axes in (np.eye(3), np.diag([-1.0, -1.0, 1.0]), rotation(0.3, 0.2, -0.4)):
        shape = (60, 50, 50)
        matrix = place(axes, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0), shape)
        grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)[..., ::-1].astype(float)
        lps = grid @ matrix[:3, :3].T + matrix[:3, 3]
        bead = np.linalg.norm(lps - np.array([10.0, 0.0, 5.0]), axis=-1) < 2.5
        volume = Volume(np.ascontiguousarray(np.where(bead, 800, -900).astype(np.int16)), matrix)
        path = FlightPath([[0.0, 0.0, 20.0], [0.0, 0.0, -20.0]])
        for kind in ("straightened", "curved"):
            rgb = Renderer(volume).render(PathView(kind, path.frames(), width=60, height=60)).rgb
            rows, columns = np.nonzero(rgb[..., 0] > 127)
            scale = (40.0 + 16.0) / 60
            assert (columns.mean() + 0.5 - 30) * scale == pytest.approx(10.0, abs=0.6)
            assert (rows.mean() + 0.5) * scale - 8.0 == pytest.approx(15.0, abs=0.8)


def test_minimum_slab_of_a_reformation_shows_a_lumen_outside_the_plane(bent):
    volume, path = bent
    view = PathView("curved", path.frames(), turn_deg=0.0, width=100, height=100, window_hu=WINDOW)
    # The frames are shifted by 8 mm, through the anterior wall of the tube.
    away = PathFrames(path.frames().path_mm, path.frames().lps_from_frame.copy())
    away.lps_from_frame[:, 1, 3] -= 8.0
    aside = dataclasses.replace(view, path=away)
    thin = Renderer(volume).render(aside)
    thick = Renderer(volume).render(dataclasses.replace(aside, slab=Slab(10.0, "min")))
    # The tube takes 10 mm of 91 mm in width and most of the length; pixels outside the volume are black in both
    # pictures.
    assert ((thick.rgb < 128) & (thin.rgb > 128)).mean() > 0.04
    assert ((thick.rgb > 128) & (thin.rgb < 128)).mean() < 0.01


def test_axis_of_a_reformation_shows_distances_and_names_beside_the_lumen(bent):
    volume, path = bent
    picture = Renderer(volume).render(PathView("straightened", path.frames(), width=300, height=420))
    spans = [PathSpan("Trachea", 0.0, 60.0), PathSpan("LMB (x)", 60.0, path.length_mm)]
    radius = (np.array([0.0, path.length_mm]), np.array([RADIUS, RADIUS]))
    marked = letter_edges(mark_path(picture, spans=spans, radius_mm=radius))
    lines = picture.lines
    changed = (marked.rgb != picture.rgb).any(axis=2)
    edge = int(lines.path_column[200] + RADIUS / lines.mm_per_px)
    assert changed[150:250, edge].sum() > 20
    assert changed[:, 3:60].sum() > 300
    assert changed[:, -60:].sum() > 80
    # The axis does not cover the lumen.
    middle = slice(int(lines.path_column[200]) - 3, int(lines.path_column[200]) + 3)
    assert not changed[60:-60, middle].any()
    with pytest.raises(UsageError):
        mark_path(dataclasses.replace(picture, lines=None))


def test_curved_reformation_of_a_straight_path_along_its_own_direction_of_projection_is_rendered():
    volume = Volume(np.zeros((20, 20, 40), dtype=np.int16), np.eye(4))
    path = FlightPath([[5.0, 10.0, 10.0], [35.0, 10.0, 10.0]])
    picture = Renderer(volume).render(PathView("curved", path.frames(), width=80, height=40))
    assert np.isfinite(picture.lines.start_lps).all()
    assert picture.rgb[20, 40, 0] > 0


@pytest.mark.parametrize(
    "settings",
    [
        {"kind": "bent"},
        {"turn_deg": float("nan")},
        {"centre_mm": float("inf")},
        {"mm_per_px": -1.0},
        {"width": 0},
        {"window_hu": (0.0, 0.0)},
    ],
)
def test_reformation_with_settings_out_of_range_is_refused(settings):
    frames = FlightPath([[0.0, 0.0, 0.0], [0.0, 0.0, -9.0]]).frames()
    with pytest.raises(RenderError):
        PathView(**{"kind": "straightened", "path": frames, **settings})


def test_reformation_with_invalid_path_frames_is_refused():
    frames = FlightPath([[0.0, 0.0, 0.0], [0.0, 0.0, -9.0]]).frames()
    for places, matrices in (
        (frames.path_mm[:1], frames.lps_from_frame[:1]),
        (frames.path_mm[:3], frames.lps_from_frame[:4]),
        (frames.path_mm[::-1], frames.lps_from_frame),
        (frames.path_mm, frames.lps_from_frame * np.nan),
    ):
        with pytest.raises(UsageError):
            PathFrames(places, matrices)
    with pytest.raises(RenderError):
        Slab(-1.0, "min")
    with pytest.raises(RenderError):
        Slab(3.0, "median")
