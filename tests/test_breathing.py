"""Tests of breathing and cough: picture, wall, tree and contact of a moved chest, and no change at rest."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from numpy.typing import NDArray

import carina
from cached_test_data import cached_phantom, found_airways
from carina.breathing import Breathing, ChestDeformation, ChestFrame
from carina.errors import GeometryError, UsageError
from carina.plan.cubic_box import trilinear
from carina.render import AirwayView, Appearance
from carina.track import lumen_mesh

CHEST = ChestFrame(110.0, -130.0)
EXHALED = Breathing().at(1.8, CHEST)
COUGH = Breathing(coughs_s=(1.0,)).at(1.25, CHEST)
MOVED = [pytest.param(EXHALED, id="exhaled"), pytest.param(COUGH, id="cough")]
SPACING_MM = 1.2


@functools.cache
def central_airways() -> tuple[carina.Volume, carina.Airways]:
    """Return the CT of a phantom's central airways without noise, and its airways."""
    made = cached_phantom(seed=4, spacing_mm=SPACING_MM, generations=5, noise_hu=0.0)
    return made.volume, found_airways(made.volume)


@functools.cache
def wall_at_rest() -> carina.WallField:
    """Return the wall of the central airways at rest."""
    return carina.wall_field(*central_airways())


@functools.cache
def deformed_ct(name: str) -> carina.Volume:
    """Return the CT of the moved chest on its own straight grid, by interpolation in the CT at rest."""
    rest, _ = central_airways()
    deformation = {"exhaled": EXHALED, "cough": COUGH}[name]
    found = np.empty(rest.shape_zyx, dtype=np.int16)
    top = np.array(rest.shape_zyx[::-1])[:, None] - 1.0
    rows, columns = rest.shape_zyx[1:]
    y, x = np.mgrid[0:rows, 0:columns].reshape(2, -1).astype(np.float64)
    to_rest = rest.ijk_from_lps @ deformation.rest_from_lps @ rest.lps_from_ijk
    for z in range(len(found)):
        ijk = to_rest[:3, :3] @ np.stack([x, y, np.full(len(x), float(z))]) + to_rest[:3, 3:]
        values = trilinear(rest.hu_zyx, np.clip(ijk, 0.0, top))
        found[z] = np.round(values).astype(np.int16).reshape(rows, columns)
    return carina.Volume(found, rest.lps_from_ijk)


def renderer_of(volume: carina.Volume) -> carina.Renderer:
    renderer = carina.Renderer(volume)
    renderer.prepare()
    return renderer


def views(tree: carina.AirwayTree, *, size: int = 160) -> list[AirwayView]:
    """Return views at rest in the trachea and in central bronchi, along their centrelines."""
    found = []
    for name, share in (("Trachea", 0.6), ("Trachea", 0.9), ("BI", 0.5), ("LMB", 0.5), ("RLL", 0.4)):
        points = tree.named(name).points
        n = int(share * (len(points) - 2))
        pose = carina.Pose.looking(points[n], points[n + 1] - points[n])
        found.append(AirwayView(pose, fov_deg=90.0, width=size, height=size))
    return found


def moved_view(view: AirwayView, deformation: ChestDeformation) -> AirwayView:
    return dataclasses.replace(view, pose=view.pose.carried_by(deformation), deformation=deformation)


def test_chest_at_rest_has_the_same_pictures_walls_and_trees_bit_for_bit():
    volume, airways = central_airways()
    renderer = renderer_of(volume)
    renderer.set_lumen(airways.lumen_zyx, airways.tree)
    wall = wall_at_rest()
    still = Breathing(craniocaudal_mm=0.0, anteroposterior_mm=0.0)
    for deformation in (ChestDeformation(np.eye(4)), still.at(1.7, CHEST), Breathing().at(0.0, CHEST)):
        assert deformation.is_rest
        assert airways.tree.deformed(deformation) is airways.tree
        assert wall.deformed(deformation) is wall
        for view in views(airways.tree, size=96):
            moved = moved_view(view, deformation)
            assert moved.pose is view.pose
            assert np.array_equal(renderer.render(moved).rgb, renderer.render(view).rgb)
            assert np.array_equal(renderer.surface(moved).depth_mm, renderer.surface(view).depth_mm, equal_nan=True)


def test_map_of_the_identity_passed_to_the_caster_changes_no_pixel():
    """The caster itself adds no rounding: the core with the identity gives the picture without a deformation."""
    volume, airways = central_airways()
    renderer = renderer_of(volume)
    renderer.set_lumen(airways.lumen_zyx, airways.tree)
    tiny = np.eye(4)
    tiny[0, 3] = 1e-300
    for view in views(airways.tree, size=96):
        moved = dataclasses.replace(view, deformation=ChestDeformation(tiny))
        assert moved.lps_from_rest is not None
        assert np.array_equal(renderer.render(moved).rgb, renderer.render(view).rgb)


@pytest.mark.parametrize("name", ["exhaled", "cough"])
def test_picture_of_a_moved_chest_equals_that_of_the_deformed_ct_within_a_voxel(name):
    deformation = {"exhaled": EXHALED, "cough": COUGH}[name]
    volume, airways = central_airways()
    renderer, explicit = renderer_of(volume), renderer_of(deformed_ct(name))
    offsets: list[NDArray[np.float64]] = []
    for view in views(airways.tree):
        moved = moved_view(view, deformation)
        shown = renderer.surface(moved)
        true = explicit.surface(dataclasses.replace(moved, deformation=None))
        # The distance between the walls is that across the wall; along a grazing ray it has no limit.
        off = np.sum((shown.position_lps - true.position_lps) * true.normal_lps, axis=2)
        edges = np.abs(shown.depth_mm - true.depth_mm) > 5.0
        assert np.mean(edges) < 0.01, "pixels at the edge of a nearer wall"
        offsets.append(np.abs(off[~edges & np.isfinite(off)]))
        # Without the deformation the wall is elsewhere, so that this test can fail.
        still = renderer.surface(dataclasses.replace(moved, deformation=None))
        away = np.sum((still.position_lps - true.position_lps) * true.normal_lps, axis=2)
        assert np.nanpercentile(np.abs(away), 99.0) > 2.0 * SPACING_MM
    every = np.concatenate(offsets)
    assert len(every) > 50_000
    assert np.percentile(every, 99.5) < SPACING_MM
    # The explicit CT was interpolated once more, which moves the wall of a small airway by a part of a voxel.
    assert np.median(every) < 0.1 * SPACING_MM


@pytest.mark.parametrize("deformation", MOVED)
def test_colours_of_a_moved_chest_are_those_of_the_deformed_ct(deformation):
    name = "exhaled" if deformation is EXHALED else "cough"
    volume, airways = central_airways()
    renderer, explicit = renderer_of(volume), renderer_of(deformed_ct(name))
    off = without = 0.0
    for view in views(airways.tree):
        moved = dataclasses.replace(moved_view(view, deformation), texture=False)
        still = dataclasses.replace(moved, deformation=None)
        true = explicit.render(still).rgb.astype(int)
        off += np.mean(np.abs(renderer.render(moved).rgb.astype(int) - true))
        without += np.mean(np.abs(renderer.render(still).rgb.astype(int) - true))
    # The explicit CT was interpolated once more, which changes the normals of the walls.
    assert off < 0.5 * without


@pytest.mark.parametrize("deformation", MOVED)
def test_wall_of_a_moved_chest_equals_the_wall_of_the_deformed_mesh_within_a_voxel(deformation):
    volume, airways = central_airways()
    mesh = lumen_mesh(volume, airways)
    rest = carina.WallField.from_mesh(mesh.vertices_lps, mesh.triangles)
    true = carina.WallField.from_mesh(deformation.points(mesh.vertices_lps), mesh.triangles)
    moved = rest.deformed(deformation)
    rng = np.random.default_rng(3)
    vertices = deformation.points(mesh.vertices_lps)
    points = vertices[rng.integers(len(vertices), size=20_000)] + rng.normal(0.0, 1.2, (20_000, 3))
    off = np.abs(moved.distance_mm(points) - np.clip(true.distance_mm(points), -2.5 * 0.6, 4.5 * 0.6))
    near = np.abs(true.distance_mm(points)) < 2.5 * 0.6
    assert near.sum() > 10_000
    assert np.percentile(off[near], 99.0) < 0.25 * SPACING_MM
    assert off[near].max() < SPACING_MM
    # On the wall itself, where the contact of the scope is found, the deformation adds no error to that at rest.
    at_rest = np.abs(rest.distance_mm(mesh.vertices_lps))
    assert (np.abs(moved.distance_mm(vertices)) <= 1.05 * at_rest + 1e-9).all()


def test_tree_of_a_moved_chest_equals_that_found_in_the_deformed_ct_within_a_voxel():
    _, airways = central_airways()
    ct = deformed_ct("exhaled")
    moved, found = airways.tree.deformed(EXHALED), carina.find_airways(ct).tree
    for name in ("Trachea", "RMB", "LMB", "BI", "RUL", "LUL", "RLL"):
        at = moved.named(name).points[2:-2]
        every = np.concatenate([branch.points for branch in found.branches])
        off = np.linalg.norm(at[:, None] - every[None], axis=2).min(axis=1)
        # The points of the found tree are up to a voxel apart.
        assert np.median(off) < SPACING_MM, name
    still = airways.tree.named("RLL").points
    assert np.linalg.norm(still[:, None] - every[None], axis=2).min(axis=1).mean() > SPACING_MM
    assert moved.named("Trachea").length_mm == pytest.approx(airways.tree.named("Trachea").length_mm * 0.95, rel=0.01)


def test_scope_is_not_driven_in_a_deformed_wall():
    _, airways = central_airways()
    moved = wall_at_rest().deformed(EXHALED)
    with pytest.raises(UsageError, match="deformed wall") as caught:
        carina.ScopeDrive(moved, "standard", EXHALED.points(airways.tree.root.points))
    assert caught.value.code == "scope.wall"


def test_scope_that_the_tissue_carries_touches_the_wall_where_the_deformed_mesh_has_it():
    volume, airways = central_airways()
    wall = wall_at_rest()
    drive = carina.ScopeDrive(wall, "standard", airways.tree.root.points)
    for _ in range(40):
        state = drive.drive(drive.state.insertion_mm + 2.0, 0.0, 1.2, 0.1)
        if state.contact is not None:
            break
    assert state.contact is not None
    tip_mm = drive.scope.tip_mm
    assert carina.scopes.scope_in_moved_patient(state, wall, ChestDeformation(np.eye(4)), tip_mm) is state
    moved = carina.scopes.scope_in_moved_patient(state, wall, EXHALED, tip_mm)
    assert moved.contact is not None
    assert np.array_equal(moved.pose.lps_from_camera, state.pose.carried_by(EXHALED).lps_from_camera)
    mesh = lumen_mesh(volume, airways)
    true = carina.WallField.from_mesh(EXHALED.points(mesh.vertices_lps), mesh.triangles)
    assert abs(float(true.distance_mm(moved.contact.point_lps)[0])) < SPACING_MM
    at_rest = abs(float(wall.distance_mm(state.contact.point_lps)[0]))
    assert abs(float(wall.deformed(EXHALED).distance_mm(moved.contact.point_lps)[0])) <= at_rest + 1e-6


def test_cough_touches_a_tip_that_has_space_at_rest():
    _, airways = central_airways()
    wall = wall_at_rest()
    drive = carina.ScopeDrive(wall, "standard", airways.tree.root.points)
    tip_mm = drive.scope.tip_mm
    state = drive.drive(drive.entry_mm + 40.0, 0.0, 0.0, 0.1)
    assert state.contact is None
    # The tip is moved beside the middle of the trachea, 0.4 mm from a contact.
    pose = state.pose.lps_from_camera.copy()
    reach = np.arange(0.0, 12.0, 0.05)
    space = wall.ball_mm(pose[:3, 3] + reach[:, None] * pose[:3, 0])
    pose[:3, 3] += reach[int(np.argmax(space < tip_mm / 2.0 + 0.4))] * pose[:3, 0]
    beside = dataclasses.replace(state, pose=carina.Pose(pose))
    chest = ChestFrame.of_tree(airways.tree)
    cough = Breathing(craniocaudal_mm=0.0, anteroposterior_mm=0.0, coughs_s=(1.0,)).at(1.25, chest)
    touched = carina.scopes.scope_in_moved_patient(beside, wall, cough, tip_mm)
    assert touched.contact is not None
    assert 0.0 < touched.contact.depth_mm < 3.0
    assert abs(float(wall.deformed(cough).distance_mm(touched.contact.point_lps)[0])) < 0.5
    # The wall that the tip touches is on its right, so the normal points to the left.
    assert float(np.dot(touched.contact.normal_lps, pose[:3, 0])) < -0.8
    quiet = Breathing().at(0.9, chest)
    assert carina.scopes.scope_in_moved_patient(beside, wall, quiet, tip_mm).contact is None


def test_breathing_moves_the_bases_by_its_amplitude_and_the_inlet_not_at_all():
    assert EXHALED.points([[0.0, 0.0, 110.0]])[0] == pytest.approx([0.0, 0.0, 110.0])
    assert EXHALED.points([[30.0, 5.0, -130.0]])[0] == pytest.approx([30.0, 7.0, -118.0])
    # Carinas move by 5 (SD 3) mm in 4D CTs of 12 patients (Jan 2015, Radiat Oncol 10:133).
    shift = EXHALED.points([[0.0, 0.0, 0.0]])[0]
    assert 2.0 < np.linalg.norm(shift) < 8.0
    points = np.random.default_rng(0).normal(0.0, 80.0, (50, 3))
    assert EXHALED.rest_points(EXHALED.points(points)) == pytest.approx(points)


def test_cough_closes_the_stated_share_of_the_trachea_and_is_over_after_half_a_second():
    breath = Breathing(craniocaudal_mm=0.0, anteroposterior_mm=0.0, coughs_s=(2.0,), collapse=0.55)
    moved = breath.at(2.25, CHEST)
    radius = moved.radii_mm([[0.0, 0.0, 60.0], [0.0, 0.0, 20.0]], [8.0, 8.0])
    assert (radius / 8.0) ** 2 == pytest.approx([0.45, 0.45], abs=0.03)
    assert breath.at(2.0, CHEST).is_rest
    assert breath.at(2.5, CHEST).is_rest
    assert not breath.at(2.1, CHEST).is_rest


def test_breath_is_periodic_and_starts_at_its_phase():
    breath = Breathing(phase=0.25)
    assert breath.expiration(0.9) == pytest.approx(breath.expiration(0.9 + 3.6))
    assert Breathing().expiration(0.9) == pytest.approx(breath.expiration(0.0))
    assert Breathing().expiration(1.8) == pytest.approx(1.0)


def test_impossible_breathing_and_chests_are_refused():
    with pytest.raises(UsageError, match="craniocaudal_mm"):
        Breathing(craniocaudal_mm=400.0)
    with pytest.raises(UsageError, match="mirror"):
        ChestDeformation(np.diag([-1.0, 1.0, 1.0, 1.0]))
    with pytest.raises(UsageError, match="finite"):
        ChestDeformation(np.full((4, 4), np.nan))
    with pytest.raises(GeometryError, match="60 mm"):
        ChestFrame(10.0, -10.0)
    with pytest.raises(UsageError, match="fields"):
        Breathing.from_json({"craniocaudal_mm": 12.0})
    with pytest.raises(UsageError, match="coughs_s"):
        Breathing.from_json({**Breathing().to_json(), "coughs_s": "2"})


def test_picture_of_a_moved_chest_says_so_in_its_file(tmp_path):
    volume, airways = central_airways()
    renderer = renderer_of(volume)
    (view, *_) = views(airways.tree, size=320)
    moved, still = renderer.render(moved_view(view, EXHALED)), renderer.render(view)
    assert moved.place()["lps_from_rest"] == EXHALED.lps_from_rest.tolist()
    assert "lps_from_rest" not in still.place()
    for picture, name in ((moved, "moved.png"), (still, "still.png")):
        picture.save(tmp_path / name)
    assert carina.render.read_png_pose(tmp_path / "moved.png")["lps_from_rest"] == EXHALED.lps_from_rest.tolist()
    plain = dataclasses.replace(moved, lps_from_rest=None)
    assert moved.png() != plain.png()


def test_texture_stays_on_the_tissue_while_the_chest_moves():
    """A picture from the same place of the tissue has the same texture, so its wall points have the same colours."""
    volume, airways = central_airways()
    transfer = carina.transfer_preset("endoscopic")
    assert isinstance(transfer.appearance, Appearance)
    renderer = carina.Renderer(volume, transfer=transfer)
    shift = np.eye(4)
    shift[:3, 3] = 31.7, -12.3, 8.9
    for view in views(airways.tree, size=96)[:2]:
        moved = renderer.render(moved_view(view, ChestDeformation(shift))).rgb.astype(int)
        off = np.abs(moved - renderer.render(view).rgb.astype(int))
        # The position of a wall is rounded to single precision at another place, which changes single pixels.
        assert np.mean(off > 3) < 0.01
