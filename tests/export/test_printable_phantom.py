"""Tests of the printable phantom: watertight mesh, thickness of the wall, open ends, names, limits of a printer."""

from __future__ import annotations

import dataclasses
import struct

import numpy as np
import pytest

import carina
from cached_test_data import SMALL_CHEST, cached_airways, cached_phantom
from carina.errors import UsageError
from carina.export import printable_phantom, write_mesh
from carina.export.printable_phantom import CUT_MM, EndCut, PrintablePhantom, PrintedLumen
from carina_bench.printed_walls import distances_to_triangles, wall_thickness

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("shared_lumen")]
WALL_MM = 2.0


@pytest.fixture(scope="module")
def chest():
    return cached_phantom(**SMALL_CHEST).volume, cached_airways(**SMALL_CHEST)


@pytest.fixture(scope="module")
def wall(chest):
    return carina.wall_field(*chest, progress=False)


@pytest.fixture(scope="module")
def made(chest) -> PrintablePhantom:
    return printable_phantom(*chest, wall_mm=WALL_MM, progress=False)


@pytest.fixture(scope="module")
def plain(chest) -> PrintablePhantom:
    return printable_phantom(*chest, wall_mm=WALL_MM, names=False, progress=False)


@pytest.fixture(scope="module")
def open_ended(chest) -> PrintablePhantom:
    return printable_phantom(*chest, wall_mm=1.2, open_tips=True, names=False, progress=False)


def directed_edges(triangles):
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).astype(np.int64)


def assert_watertight(triangles):
    """Assert that each edge belongs to two triangles with opposite directions, so that the surface is closed."""
    edges = directed_edges(triangles)
    base = int(edges.max()) + 1
    forward, backward = np.sort(edges[:, 0] * base + edges[:, 1]), np.sort(edges[:, 1] * base + edges[:, 0])
    assert len(np.unique(forward)) == len(forward)
    assert np.array_equal(forward, backward)


def euler_characteristic(mesh):
    """Return vertices less edges plus triangles: 2 for each closed piece, less 2 for each handle."""
    return len(mesh.vertices_lps) - len(directed_edges(mesh.triangles)) // 2 + len(mesh.triangles)


def stl_triangles(path):
    """Return the triangles of an STL as indices of equal corners, as other software joins them."""
    data = path.read_bytes()
    (count,) = struct.unpack_from("<I", data, 80)
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    # Adding 0 makes -0 equal to 0. Two sorts of integers are ten times as fast as np.unique along an axis.
    x, y, z = (np.frombuffer(data, record, count, 84)["corners"].reshape(-1, 3) + np.float32(0)).view(np.uint32).T
    _, number = np.unique(x.astype(np.uint64) << np.uint64(32) | y, return_inverse=True)
    _, number = np.unique(number.astype(np.uint64) << np.uint64(32) | z, return_inverse=True)
    return number.reshape(-1, 3)


@pytest.mark.parametrize("name", ["made", "open_ended"])
def test_stl_is_watertight_with_outward_normals(tmp_path, request, name):
    found = request.getfixturevalue(name)
    assert_watertight(found.mesh.triangles)
    assert found.mesh.volume_mm3 > 0.0
    path = write_mesh(tmp_path / "phantom.stl", found.mesh, contents="printable airway wall")
    triangles = stl_triangles(path)
    assert_watertight(triangles)
    a, b, c = np.sort(triangles, axis=1).astype(np.int64).T
    num = int(triangles.max()) + 1
    assert num < 2**21  # three vertex numbers in one integer
    assert len(np.unique((a * num + b) * num + c)) == len(triangles)
    assert path.read_bytes()[:80].startswith(b"Carina printable airway wall")


def test_lumen_that_reaches_beyond_the_radii_of_its_branches_is_printed_whole(monkeypatch):
    """A bulge was cut flat where no ball of the centreline reached."""
    monkeypatch.setattr("carina.export.sampled_solid.SAMPLE_MM", 0.8)
    volume = carina.generate_phantom(spacing_mm=3.0, generations=3).volume
    airways = carina.find_airways(volume)
    thin = [dataclasses.replace(one, radius=0.3 * one.radius) for one in airways.tree.branches]
    bulging = dataclasses.replace(airways, tree=dataclasses.replace(airways.tree, branches=tuple(thin)))
    whole, found = (PrintedLumen.of(volume, one, None).mesh for one in (airways, bulging))
    assert found.volume_mm3 == pytest.approx(whole.volume_mm3, rel=1e-3)


def test_wall_has_its_thickness_within_a_fifth_of_a_millimetre_everywhere(chest, plain):
    found = wall_thickness(plain, *chest)
    assert len(found.outer) == len(found.inner) == 4000
    assert np.abs(found.outer - WALL_MM).max() < 0.2
    # Neighbouring airways share material, so that the way out may be longer, but nowhere shorter.
    assert found.inner.min() > WALL_MM - 0.2
    assert np.median(found.inner) == pytest.approx(WALL_MM, abs=0.1)


def test_distance_to_triangles_is_that_to_face_edge_or_corner():
    corners = np.array([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]])
    points = np.array([[0.5, 0.5, 1.5], [1.0, -1.0, 0.0], [-1.0, -1.0, 1.0], [0.5, 0.5, 9.0]])
    assert distances_to_triangles(points, corners) == pytest.approx([1.5, 1.0, 3.0**0.5, 4.0])


def test_wall_of_a_branch_is_whole_beside_the_open_tip_of_another(chest, open_ended):
    """The cut of a tip once took the walls of neighbours, which left thin places and holes."""
    lumen = PrintedLumen.of(*chest, None)
    tips = [tip for tip in chest[1].tree.tips() if tip.id != chest[1].tree.root.id]
    cuts = [EndCut.of(tip, chest[1], lumen, at_start=False, wall_mm=1.2) for tip in tips]
    cuts = [one for one in cuts if one.is_free(lumen.field) and len(one.others_lps)]
    assert cuts
    vertices = open_ended.mesh.vertices_lps
    inner = -lumen.field.distance_mm(vertices) < 0.6
    outer = vertices[open_ended.mesh.triangles[(~inner)[open_ended.mesh.triangles].all(axis=1)]]
    others = np.concatenate([one.others_lps[np.argsort(np.linalg.norm(one.others_lps - one.middle_lps, axis=1))[:25]]
                             for one in cuts])  # fmt: skip
    # Places that a cut of their own branch removes are no walls.
    own = [EndCut.of(tip, chest[1], lumen, at_start=False, wall_mm=1.2) for tip in tips]
    kept = np.array([max(float(one.inside_mm(place[None])[0]) for one in own) < -1.3 for place in others])
    found = distances_to_triangles(others[kept], outer)
    assert kept.sum() > 50
    assert found.min() > 1.2 - 0.2


def test_trachea_is_open_and_tips_only_on_request(chest, made, plain, open_ended):
    tree = chest[1].tree
    # An open tube is a sphere; each further open end adds a handle between the inner and the outer surface.
    assert made.num_open_tips == 0
    assert open_ended.num_open_tips + open_ended.num_closed_tips == len(tree.tips())
    assert open_ended.num_open_tips > 0.8 * len(tree.tips())
    change = euler_characteristic(plain.mesh) - euler_characteristic(open_ended.mesh)
    assert change == 2 * open_ended.num_open_tips
    axis = tree.root.points
    near_end = np.linalg.norm(made.mesh.vertices_lps - axis[0], axis=1)
    assert near_end.min() > 1.0
    assert CUT_MM > 1.0


def test_names_are_raised_on_the_outer_surface(chest, wall, made, plain):
    assert "Trachea" in made.names
    assert set(made.names) | set(made.names_left_out) == {one.name for one in chest[1].tree.branches if one.name}
    away = -wall.distance_mm(made.mesh.vertices_lps)
    raised = made.mesh.vertices_lps[away > WALL_MM + 0.3]
    assert len(raised) > 100
    assert made.mesh.volume_mm3 > plain.mesh.volume_mm3 + 1.0


def test_limits_of_the_printer_are_checked_with_a_remedy(chest):
    with pytest.raises(UsageError, match="choose a thicker wall") as refused:
        printable_phantom(*chest, wall_mm=0.8)
    assert refused.value.code == "print.wall"
    with pytest.raises(UsageError, match="a larger build volume") as refused:
        printable_phantom(*chest, build_mm=(120.0, 100.0, 80.0))
    assert refused.value.code == "print.too-large"
    with pytest.raises(UsageError):
        printable_phantom(*chest, wall_mm=2.5)
