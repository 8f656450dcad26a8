"""Tests of the printable phantom: watertight mesh, thickness of the wall, open ends, names, limits of a printer."""

from __future__ import annotations

import struct

import numpy as np
import pytest

import carina
from cached_test_data import SMALL_CHEST, cached_airways, cached_phantom
from carina.errors import UsageError
from carina.export import printable_phantom, write_mesh
from carina.export.printable_phantom import CUT_MM, PrintablePhantom

pytestmark = pytest.mark.slow
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
    corners = np.frombuffer(data, record, count, 84)["corners"].reshape(-1, 3)
    _, number = np.unique(corners, axis=0, return_inverse=True)
    return number.reshape(-1, 3)


@pytest.mark.parametrize("name", ["made", "open_ended"])
def test_stl_is_watertight_with_outward_normals(tmp_path, request, name):
    found = request.getfixturevalue(name)
    assert_watertight(found.mesh.triangles)
    assert found.mesh.volume_mm3 > 0.0
    path = write_mesh(tmp_path / "phantom.stl", found.mesh, contents="printable airway wall")
    triangles = stl_triangles(path)
    assert_watertight(triangles)
    assert len({tuple(sorted(one)) for one in triangles.tolist()}) == len(triangles)
    assert path.read_bytes()[:80].startswith(b"Carina printable airway wall")


def test_wall_has_its_thickness_within_a_fifth_of_a_millimetre(chest, wall, plain):
    vertices = plain.mesh.vertices_lps
    away = -wall.distance_mm(vertices)
    root = chest[1].tree.root.points
    far = np.linalg.norm(vertices - root[0], axis=1) > 25.0
    inner, outer = vertices[away < 0.5], vertices[far & (away > WALL_MM - 0.5)]
    # All vertices are on the inner or on the outer surface.
    assert (far & (away < 0.5)).sum() + len(outer) > 0.999 * far.sum()
    # The outer surface keeps its distance from the lumen of the export, whose triangles are about 1 mm wide.
    lumen = carina.track.lumen_mesh(*chest, progress=False)
    corners = lumen.vertices_lps[lumen.triangles]
    points = np.concatenate([lumen.vertices_lps, corners.mean(axis=1), 0.5 * (corners[:, 0] + corners[:, 1])])
    some = outer[np.random.default_rng(1).permutation(len(outer))[:400]]
    offset = np.array([np.linalg.norm(points - one, axis=1).min() for one in some])
    assert np.abs(offset - WALL_MM).max() < 0.2
    # The printed wall equals this offset except at ends of a lumen that are narrower than the distance of the samples.
    thick = np.array([np.linalg.norm(inner - one, axis=1).min() for one in some])
    assert (np.abs(thick - WALL_MM) < 0.2).mean() > 0.97
    assert thick.min() > WALL_MM - 0.2
    assert np.abs(wall.distance_mm(inner[np.linalg.norm(inner - root[0], axis=1) > 25.0])).max() < 0.2


def test_trachea_is_open_and_tips_only_on_request(chest, made, plain, open_ended):
    tree = chest[1].tree
    # An open tube is a sphere; each further open end adds a handle between the inner and the outer surface.
    assert made.num_open_tips == 0
    assert open_ended.num_open_tips == len(tree.tips())
    # Some narrow tips are cavities, whose opening removes a piece instead of adding a handle: both change it by 2.
    change = euler_characteristic(plain.mesh) - euler_characteristic(open_ended.mesh)
    assert change >= 2 * 0.9 * len(tree.tips())
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
