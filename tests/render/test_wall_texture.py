"""Tests of the decoration of walls by anatomy: position of rings and ridges, fading, unchanged walls, and notes."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
from render_trees import LEFT, RIGHT, TRACHEA, Tree, forked, straight

from carina.errors import GeometryError
from carina.render import AirwayView, Appearance, Renderer, read_png_pose, transfer_preset
from carina.render.wall_texture import CHANNELS, Decoration, decoration_of
from carina.scopes import Pose

ENDOSCOPIC = transfer_preset("endoscopic")
SIZE = {"width": 96, "height": 96}
ALL = ("texture", "vessels", "rings", "membrane", "hue", "spurs", "specks")


def at(decoration: Decoration, point) -> dict[str, float]:
    """Return the channels of the decoration at a point (LPS mm), interpolated between the eight surrounding cells."""
    place = (np.asarray(point, float) - decoration.origin_lps) / decoration.cell_mm
    low = np.floor(place).astype(int)
    part = place - low
    found = np.zeros(len(CHANNELS))
    for corner in np.ndindex(2, 2, 2):
        i, j, k = low + corner
        weight = np.prod(np.where(corner, part, 1.0 - part))
        found += weight * decoration.cells[k, j, i]
    return dict(zip(CHANNELS, found, strict=True))


def rings_along(decoration: Decoration, line) -> np.ndarray:
    """Return the strength of the rings at each mm along the anterior wall of a branch."""
    start, end, radius = line
    points = np.linspace(start, end, int(np.linalg.norm(np.subtract(end, start))) + 1)
    return np.array([at(decoration, point - [0.0, radius, 0.0])["rings"] for point in points])


def test_trachea_has_the_anatomical_number_of_rings_which_continue_into_both_bronchi():
    tree = Tree((straight(0, None, (), "Trachea", ((0.0, 0.0, 104.0), (0.0, 0.0, 0.0), 8.5)),))
    found = decoration_of(tree)
    top, end = (at(found, (0.0, -8.5, z))["phase"] for z in (104.0, 0.0))
    # Gray's Anatomy states sixteen to twenty rings.
    assert 16 <= end - top <= 20
    found = decoration_of(forked())
    for start, end, _ in (TRACHEA, RIGHT, LEFT):
        points = np.linspace(start, end, 30)[1:-1]
        phase = np.array([at(found, point)["phase"] for point in points])
        assert (np.diff(phase) > 0).all()
        step = np.linalg.norm(np.subtract(end, start)) / 29
        assert np.median(np.diff(phase)) == pytest.approx(step / (5.6 if end == (0.0, 0.0, 0.0) else 4.4), rel=0.05)


def test_channels_of_front_back_and_sides_are_those_of_the_patient():
    found = decoration_of(forked())
    for point in ((0.0, 0.0, 30.0), (-11.0, 2.0, -17.0)):
        radius = 7.0 if point[2] > 0 else 5.5
        back, front = (at(found, np.add(point, (0.0, side * radius, 0.0))) for side in (1.0, -1.0))
        assert back["back"] > 0.9
        assert front["back"] < -0.9
        assert abs(back["left"]) < 0.2
    left = at(found, (7.0, 0.0, 30.0))
    assert left["left"] > 0.9
    assert abs(left["back"]) < 0.1


def test_rings_fade_where_the_radius_deviates_from_its_smooth_course():
    trachea = straight(0, None, (), "Trachea", ((0.0, 0.0, 100.0), (0.0, 0.0, 0.0), 8.0))
    narrow = trachea.radius.copy()
    narrow[45:60] = 5.0
    # The top is at 100 mm, so the narrow part is from 55 to 40 mm.
    found = rings_along(decoration_of(Tree((dataclasses.replace(trachea, radius=narrow),))), TRACHEA_LONG)
    assert found[40:65].max() < 0.05, "in the stenosis and right before and behind it"
    assert found[5:30].min() > 0.95
    assert found[75:95].min() > 0.95
    # A trachea that tapers evenly is not a stenosis.
    tapered = dataclasses.replace(trachea, radius=np.linspace(9.5, 6.5, len(narrow)))
    assert rings_along(decoration_of(Tree((tapered,))), TRACHEA_LONG)[5:95].min() > 0.9


TRACHEA_LONG = ((0.0, 0.0, 100.0), (0.0, 0.0, 0.0), 8.0)


@pytest.mark.parametrize("doubt", [{"kind": "bridge"}, {"kind": "manual"}, {"confidence": 0.4}], ids=str)
def test_doubtful_branch_has_no_rings_and_the_next_branches_have_rings(doubt):
    sure, found = decoration_of(forked(confidence=0.95)), decoration_of(forked(**doubt))
    assert rings_along(sure, TRACHEA)[5:50].min() > 0.95
    assert rings_along(found, TRACHEA)[5:50].max() < 0.05
    assert rings_along(found, RIGHT)[15:30].min() > 0.8


def test_ridge_of_a_bifurcation_is_only_between_its_daughters():
    found = decoration_of(forked())
    middle = max(at(found, (0.6, 1.5, z))["spur"] for z in np.arange(-20.0, 0.0, 0.5))
    assert middle > 0.5
    for point in ((0.0, -7.0, 30.0), (-27.0, 4.0, -30.0), (36.0, 6.0, -22.0), (0.0, 9.0, 2.0)):
        assert at(found, point)["spur"] < 0.1


def test_tree_without_a_named_trachea_has_no_decoration():
    assert decoration_of(None) is None
    nameless = straight(0, None, (), None, TRACHEA)
    assert decoration_of(Tree((nameless,))) is None
    assert decoration_of(Tree((straight(0, None, (), "RMB", TRACHEA),))) is None


def test_invalid_cells_are_refused_with_a_message():
    good = decoration_of(forked())
    for cells in (good.cells[..., :7], good.cells[:1], good.cells.astype(np.float64), np.full_like(good.cells, np.nan)):
        with pytest.raises(GeometryError, match="decoration"):
            Decoration(np.ascontiguousarray(cells), good.origin_lps, good.cell_mm)
    with pytest.raises(GeometryError, match="decoration"):
        Decoration(good.cells, good.origin_lps, 0.0)


def shown(airway, tree=None, *, view=None, simd=None, transfer="endoscopic", **changes):
    """Return a picture of the phantom with or without a tree, with changed appearance values."""
    chosen = transfer_preset(transfer)
    if changes:
        chosen = dataclasses.replace(chosen, appearance=dataclasses.replace(chosen.appearance, **changes))
    renderer = Renderer(airway.volume, transfer=chosen, simd=simd)
    renderer.set_lumen(airway.lumen_zyx, tree)
    return renderer.render(AirwayView(airway.pose, fov_deg=100.0, **SIZE) if view is None else view)


def test_decoration_does_not_change_the_walls(airway):
    view = AirwayView(airway.pose, fov_deg=100.0, **SIZE)
    with_tree, without = Renderer(airway.volume), Renderer(airway.volume)
    with_tree.set_lumen(airway.lumen_zyx, forked())
    without.set_lumen(airway.lumen_zyx)
    assert (with_tree.render(view).rgb != without.render(view).rgb).any()
    mine, other = with_tree.surface(view), without.surface(view)
    for name in ("depth_mm", "position_lps", "normal_lps"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(other, name))
    assert str(with_tree.pick(view, 20, 70)) == str(without.pick(view, 20, 70))
    for one, two in ((with_tree.scene.values, without.scene.values), (with_tree.scene.lumen, without.scene.lumen)):
        np.testing.assert_array_equal(one, two)
    # Nothing is drawn without a wall, so the same pixels are not black with and without decoration.
    count_cpu_picture = [
        r.render(AirwayView(airway.pose, fov_deg=100.0, **SIZE)).rgb.max(axis=2) > 0 for r in (with_tree, without)
    ]
    np.testing.assert_array_equal(*count_cpu_picture)


def test_pictures_are_equal_for_every_instruction_set_in_strips_and_by_leaps(airway):
    truth = shown(airway, forked(), simd="portable", view=AirwayView(airway.pose, method="brute", **SIZE)).rgb
    view = AirwayView(airway.pose, **SIZE)
    np.testing.assert_array_equal(shown(airway, forked(), view=view).rgb, truth)
    renderer = Renderer(airway.volume)
    renderer.set_lumen(airway.lumen_zyx, forked())
    renderer.prepare()
    strips = [renderer.render(view, rows=rows).rgb for rows in ((0, 7), (7, 50), (50, 96))]
    np.testing.assert_array_equal(np.concatenate(strips), truth)
    # Restore the renderer's data as another machine receives them.
    other = Renderer(airway.volume)
    other.adopt_scene(pickle.loads(pickle.dumps(renderer.scene)))
    np.testing.assert_array_equal(other.render(view).rgb, truth)


def test_each_part_can_be_switched_off_separately_and_has_an_effect(airway):
    every = shown(airway, forked())
    assert every.decorated == ALL
    for part in ALL:
        found = shown(airway, forked(), **{part: 0.0})
        assert part not in found.decorated
        assert len(found.decorated) == len(ALL) - 1
        assert (found.rgb != every.rgb).any(), part


def test_decoration_is_off_without_texture_or_tree_and_in_ct_grey_with_a_note(airway, tmp_path):
    plain = AirwayView(airway.pose, fov_deg=100.0, texture=False, **SIZE)
    bare = shown(airway, forked(), view=plain)
    assert bare.decorated == ()
    np.testing.assert_array_equal(bare.rgb, shown(airway, view=plain).rgb)
    nothing = dict.fromkeys(ALL, 0.0)
    np.testing.assert_array_equal(bare.rgb, shown(airway, forked(), **nothing).rgb)
    grey = shown(airway, forked(), transfer="ct-grey")
    assert grey.decorated == ()
    np.testing.assert_array_equal(grey.rgb, shown(airway, transfer="ct-grey").rgb)
    assert shown(airway).decorated == ("texture", "vessels", "specks"), "what needs no tree"
    unlit = AirwayView(airway.pose, fov_deg=100.0, shading=False, **SIZE)
    assert shown(airway, forked(), view=unlit).decorated == ()
    for picture in (shown(airway, forked()), bare):
        saved = read_png_pose(picture.save(tmp_path / "picture.png"))
        assert tuple(saved["decorated"]) == picture.decorated


def contrast(picture, base) -> np.ndarray:
    """Return the difference of brightness between two pictures in grey levels."""
    return (picture.rgb.astype(int) - base.rgb)[..., :].mean(axis=2)


def test_anterior_wall_shows_rings_and_posterior_wall_longitudinal_folds(airway):
    # The view from inside the trachea is level, so the lower half of the picture is posterior.
    pose = Pose.looking((0.0, 0.0, 48.0), (0.0, 0.0, -1.0), (0.0, -1.0, 0.0))
    view = AirwayView(pose, fov_deg=110.0, width=160, height=160)
    off = dict.fromkeys(("vessels", "hue", "spurs", "texture", "specks"), 0.0)
    none = shown(airway, forked(), view=view, rings=0.0, membrane=0.0, **off)
    rings = contrast(shown(airway, forked(), view=view, membrane=0.0, **off), none)
    folds = contrast(shown(airway, forked(), view=view, rings=0.0, **off), none)
    front, back = (slice(0, 60), slice(70, 90)), (slice(100, 160), slice(70, 90))
    assert np.abs(rings[front]).mean() > 4 * np.abs(rings[back]).mean()
    assert np.abs(folds[back]).mean() > 4 * np.abs(folds[front]).mean()
    # Rings are transverse: along a column of the picture the brightness alternates, along a row it is almost constant.
    column = rings[0:55, 78:82].mean(axis=1)
    assert (np.diff(np.sign(np.diff(column))) != 0).sum() >= 6


def test_rings_fade_on_a_wall_that_differs_from_the_tree(airway):
    """Let a mass narrow the airway, while the tree has the radius of the airway before the mass."""
    wide = forked()
    too_wide = dataclasses.replace(wide.branches[0], radius=np.full_like(wide.branches[0].radius, 7.0 / 0.55))
    off = dict.fromkeys(("membrane", "vessels", "hue", "spurs", "texture", "specks"), 0.0)
    none = shown(airway, wide, rings=0.0, **off)
    found = contrast(shown(airway, wide, **off), none)
    faded = contrast(shown(airway, Tree((too_wide,)), **off), none)
    assert np.abs(found).mean() > 1.0
    assert np.abs(faded).mean() < 0.05


def test_appearance_files_of_older_versions_have_no_decoration():
    old = Appearance.from_json({"texture": 1.0, "vessels": 0.25})
    assert old.decorations == ("texture", "vessels")
    assert old.undecorated().decorations == ()
    assert ENDOSCOPIC.appearance.decorations == ALL
    assert transfer_preset("ct-grey").appearance is None
