"""Tests of tree, lumen and surface in the formats of other programs, read back by independent readers."""

from __future__ import annotations

import base64
import dataclasses
import json
import struct
import xml.etree.ElementTree as ET

import numpy as np
import pytest
import SimpleITK as sitk

import carina
from cached_test_data import SMALL_CHEST, cached_airways, cached_phantom
from carina.errors import GeometryError, UsageError
from carina.export import (
    EXPORT_FORMATS,
    EXPORT_SUFFIXES,
    EXPORT_TITLES,
    check_export,
    export_airways,
    export_format,
    export_tree,
    write_mask,
    write_mesh,
)
from carina.export.mask_file import MASK_SUFFIXES
from carina.export.mesh_file import MESH_SUFFIXES
from carina.track import AirwayTree, Branch, Mesh, lumen_mask, lumen_mesh
from carina.volume import Volume, inspect_path, open_mask


@pytest.fixture(scope="module")
def case():
    return cached_phantom(**SMALL_CHEST).volume, cached_airways(**SMALL_CHEST)


@pytest.fixture
def tree() -> AirwayTree:
    fork = np.array([1.0 / 3.0, 0.0, -9.0])
    trunk = np.array([[0.1, 0.2, 0.3], fork])
    right = np.array([fork, [-4.0, 0.0, -15.0], [-9.0, 1.0, -20.0]])
    return AirwayTree(
        (
            Branch(3, None, (7, 5), 0, "Trachea", "tracked", trunk, np.array([8.0, 7.5])),
            Branch(7, 3, (), 1, "RMB", "bridge", right, np.array([7.5, 5.0, 4.5])),
            Branch(5, 3, (), 1, None, "tracked", np.array([fork, [8.0, 0.0, -16.0]]), np.array([7.5, 5.5])),
        )
    )


@pytest.fixture
def drawn_tree(tree) -> AirwayTree:
    """Return the tree with its last branch marked as drawn by hand."""
    *found, last = tree.branches
    return AirwayTree((*found, dataclasses.replace(last, kind="manual")))


def test_every_tree_format_labels_branches_drawn_by_hand(drawn_tree, tmp_path):
    length_mm = sum(branch.length_mm for branch in drawn_tree.branches)
    words = f"{drawn_tree.branches[-1].length_mm:.0f} of {length_mm:.0f} mm drawn by hand"
    root = ET.parse(export_tree(tmp_path / "t.vtp", drawn_tree)).getroot()
    assert vtp_array(root, ".//CellData/DataArray[@Name='DrawnByHand']").tolist() == [0, 0, 1]
    assert words.encode() in bytes(int(c) for c in root.find(".//FieldData/Array[@Name='Note']").text.split())
    assert words in export_tree(tmp_path / "t.swc", drawn_tree).read_text()
    curve = json.loads(export_tree(tmp_path / "t.mrk.json", drawn_tree).read_text())["markups"][-1]
    assert curve["name"] == "branch 5 (drawn by hand)"
    assert curve["description"] == "drawn by hand: the CT shows no airway here"
    assert carina.export.read_tree(export_tree(tmp_path / "t.json", drawn_tree)).branches[-1].kind == "manual"


def test_lumen_and_surface_formats_label_parts_drawn_by_hand(case, tmp_path):
    volume, airways = case
    *found, last = airways.tree.branches
    tree = dataclasses.replace(airways.tree, branches=(*found, dataclasses.replace(last, kind="manual")))
    drawn = dataclasses.replace(airways, tree=tree)
    for suffix in (".stl", ".ply", ".obj", ".glb", ".nii.gz", ".nrrd"):
        for airway, is_drawn in ((airways, False), (drawn, True)):
            path = export_airways(tmp_path / f"lumen{suffix}", volume, airway)
            if suffix in (".nii.gz", ".nrrd"):
                image = sitk.ReadImage(str(path))
                text = " ".join(image.GetMetaData(key) for key in image.GetMetaDataKeys())
            else:
                text = path.read_bytes()[:4000].decode("latin-1")
            assert ("drawn by hand" in text or "PART IS NOT FROM THE CT" in text) == is_drawn, suffix


def vtp_array(root, path):
    element = root.find(path)
    assert element is not None
    raw = base64.b64decode(element.text)
    size = int.from_bytes(raw[:8], "little")
    assert len(raw) == 8 + size
    return np.frombuffer(raw[8:], {"Float64": "<f8", "Int64": "<i8", "Int32": "<i4"}[element.get("type")])


def test_vtp_contains_every_branch_as_a_line(tree, tmp_path):
    root = ET.parse(export_tree(tmp_path / "t.vtp", tree)).getroot()
    points = vtp_array(root, ".//Points/DataArray").reshape(-1, 3)
    ends = vtp_array(root, ".//Lines/DataArray[@Name='offsets']")
    order = vtp_array(root, ".//Lines/DataArray[@Name='connectivity']")
    assert order.tolist() == list(range(len(points)))
    for branch, piece in zip(tree.branches, np.split(points, ends[:-1]), strict=True):
        assert piece.tobytes() == branch.points.tobytes()
    assert vtp_array(root, ".//CellData/DataArray[@Name='BranchId']").tolist() == [3, 7, 5]
    assert vtp_array(root, ".//CellData/DataArray[@Name='ParentId']").tolist() == [-1, 3, 3]
    assert vtp_array(root, ".//CellData/DataArray[@Name='Bridge']").tolist() == [0, 1, 0]
    codes = root.find(".//CellData/Array[@Name='Name']").text.split()
    assert bytes(int(code) for code in codes) == b"Trachea\0RMB\0\0"
    assert bytes(int(code) for code in root.find(".//FieldData/Array[@Name='Space']").text.split()) == b"LPS\0"


def test_swc_file_is_one_tree_with_one_node_at_each_bifurcation(tree, tmp_path):
    lines = export_tree(tmp_path / "t.swc", tree).read_text().splitlines()
    assert any("LPS" in line for line in lines if line.startswith("#"))
    nodes = [line.split() for line in lines if not line.startswith("#")]
    assert [int(node[0]) for node in nodes] == [1, 2, 3, 4, 5]
    assert [int(node[6]) for node in nodes] == [-1, 1, 2, 3, 2]
    places = np.array([[float(v) for v in node[2:5]] for node in nodes])
    expected = np.concatenate([tree.branches[0].points, tree.branches[1].points[1:], tree.branches[2].points[1:]])
    assert places.tobytes() == expected.tobytes()


def test_markups_file_has_a_curve_in_lps_for_each_branch(tree, tmp_path):
    document = json.loads(export_tree(tmp_path / "t.mrk.json", tree).read_text())
    curves = document["markups"]
    assert [curve["name"] for curve in curves] == ["Trachea", "RMB (bridge)", "branch 5"]
    assert {curve["coordinateSystem"] for curve in curves} == {"LPS"}
    assert {curve["coordinateUnits"] for curve in curves} == {"mm"}
    for branch, curve in zip(tree.branches, curves, strict=True):
        assert [p["position"] for p in curve["controlPoints"]] == branch.points.tolist()


def test_exported_surface_is_closed_and_has_the_volume_of_the_lumen(case):
    volume, airways = case
    mesh = lumen_mesh(volume, airways)
    edges = np.concatenate([mesh.triangles[:, [a, (a + 1) % 3]] for a in range(3)]).astype(np.int64)
    forward = edges[:, 0] * len(mesh.vertices_lps) + edges[:, 1]
    back = edges[:, 1] * len(mesh.vertices_lps) + edges[:, 0]
    assert len(np.unique(forward)) == len(forward)
    assert np.array_equal(np.sort(forward), np.sort(back))
    lumen_mm3 = np.count_nonzero(lumen_mask(volume, airways)) * np.prod(volume.spacing_mm)
    assert mesh.volume_mm3 == pytest.approx(lumen_mm3, rel=0.05)


def test_surface_of_a_known_tube_has_its_volume():
    phantom, airways = cached_phantom(**SMALL_CHEST), cached_airways(**SMALL_CHEST)
    truth_mm3 = np.count_nonzero(phantom.lumen_zyx) * np.prod(phantom.volume.spacing_mm)
    assert lumen_mesh(phantom.volume, airways).volume_mm3 == pytest.approx(truth_mm3, rel=0.06)


def read_stl(raw):
    count = struct.unpack("<I", raw[80:84])[0]
    rows = np.frombuffer(raw[84:], np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")]))
    assert len(rows) == count
    return rows["corners"], rows["normal"]


def read_ply(raw):
    head, _, body = raw.partition(b"end_header\n")
    words = head.decode().split()
    num_points, num_faces = int(words[words.index("vertex") + 1]), int(words[words.index("face") + 1])
    points = np.frombuffer(body, "<f4", 3 * num_points).reshape(-1, 3)
    faces = np.frombuffer(body[12 * num_points :], np.dtype([("count", "u1"), ("corners", "<u4", 3)]))
    assert len(faces) == num_faces
    assert (faces["count"] == 3).all()
    return points[faces["corners"]]


def read_obj(raw):
    rows = [line.split() for line in raw.decode().splitlines()]
    points = np.array([[float(v) for v in row[1:]] for row in rows if row[0] == "v"])
    return points[np.array([[int(v) for v in row[1:]] for row in rows if row[0] == "f"]) - 1]


def read_glb(raw):
    magic, version, total = struct.unpack("<4sII", raw[:12])
    assert (magic, version, total) == (b"glTF", 2, len(raw))
    size, kind = struct.unpack("<I4s", raw[12:20])
    assert kind == b"JSON"
    document = json.loads(raw[20 : 20 + size])
    payload_size, kind = struct.unpack("<I4s", raw[20 + size : 28 + size])
    payload = raw[28 + size :]
    assert kind == b"BIN\0"
    assert len(payload) == payload_size == document["buffers"][0]["byteLength"]
    matrix = np.array(document["nodes"][0]["matrix"]).reshape(4, 4).T
    num_points = document["accessors"][0]["count"]
    points = np.frombuffer(payload, "<f4", 3 * num_points).reshape(-1, 3)
    assert document["accessors"][0]["min"] == points.min(axis=0).tolist()
    corners = np.frombuffer(payload[12 * num_points :], "<u4").reshape(-1, 3)
    return points[corners], matrix


def test_surface_written_in_every_format_is_read_back_with_equal_points_and_triangles(case, tmp_path):
    mesh = lumen_mesh(*case)
    expected = mesh.vertices_lps[mesh.triangles]
    raw = {suffix: write_mesh(tmp_path / f"s{suffix}", mesh).read_bytes() for suffix in (".stl", ".ply", ".obj")}
    corners, normals = read_stl(raw[".stl"])
    assert not raw[".stl"].startswith(b"solid")
    assert b"LPS" in raw[".stl"][:80]
    for found in (corners, read_ply(raw[".ply"]), read_obj(raw[".obj"])):
        assert np.abs(found - expected).max() < 1e-3
    # Normals point away from the middle of a convex piece, in agreement with the order of the corners.
    across = np.cross(expected[:, 1] - expected[:, 0], expected[:, 2] - expected[:, 0])
    assert (np.einsum("na,na->n", across, normals) > 0.0).mean() > 0.999
    triangles, matrix = read_glb(write_mesh(tmp_path / "s.glb", mesh).read_bytes())
    assert np.abs(triangles - expected).max() < 1e-3
    # The expected axes: left, posterior and superior of the patient in glTF (+y up, anterior along +z), in metres.
    assert matrix[:3, :3] @ (1.0, 0.0, 0.0) == pytest.approx([0.001, 0.0, 0.0])
    assert matrix[:3, :3] @ (0.0, 1.0, 0.0) == pytest.approx([0.0, 0.0, -0.001])
    assert matrix[:3, :3] @ (0.0, 0.0, 1.0) == pytest.approx([0.0, 0.001, 0.0])


@pytest.mark.parametrize("name", ["m.nii.gz", "m.nii", "m.nrrd", "m.mha"])
def test_mask_is_read_back_on_the_same_grid(case, tmp_path, name):
    volume, airways = case
    path = write_mask(tmp_path / name, airways.lumen_zyx, volume)
    assert np.array_equal(open_mask(path, volume).inside_zyx, airways.lumen_zyx)
    image = sitk.ReadImage(str(path))
    assert image.TransformIndexToPhysicalPoint((1, 2, 3)) == pytest.approx(
        volume.to_lps(np.array([1.0, 2.0, 3.0])).tolist(), abs=1e-3
    )
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_airways_opened_from_the_written_mask_are_at_the_same_positions(case, tmp_path):
    volume, airways = case
    path = export_airways(tmp_path / "lumen.nrrd", volume, airways)
    inside = open_mask(path, volume).inside_zyx
    # The mask ends at the half-maximum, like the surface.
    assert np.array_equal(inside, lumen_mask(volume, airways))
    again = carina.find_airways(volume, lumen_zyx=inside)
    assert again.tree.root.name == "Trachea"
    assert len(again.tree) > 3


def leaning(degrees: float, shape=(40, 3, 40)) -> Volume:
    """Return a volume of voxels of 1 mm whose slices are sheared by an angle."""
    matrix = np.eye(4)
    matrix[0, 2], matrix[2, 2] = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    return Volume(np.zeros(shape, np.int16), matrix)


@pytest.mark.parametrize("suffix", [".nii.gz", ".nii", ".mha", ".nrrd"])
@pytest.mark.parametrize("degrees", [0.02, 0.1, 0.199])
def test_grid_that_opens_as_a_ct_can_be_written_and_read_in_every_format(tmp_path, suffix, degrees):
    volume = leaning(degrees)
    mask = np.zeros(volume.shape_zyx, np.uint8)
    mask[5:30, 1, 2:9] = 1
    check_export(tmp_path / f"m{suffix}", volume)
    path = write_mask(tmp_path / f"m{suffix}", mask, volume)
    assert np.array_equal(open_mask(path, volume).inside_zyx, mask)
    np.testing.assert_allclose(inspect_path(path).lps_from_ijk, volume.lps_from_ijk, rtol=0, atol=1e-5)


@pytest.mark.parametrize("suffix", [".nii.gz", ".nii", ".mha"])
def test_grid_that_deviates_from_a_format_by_more_than_its_tolerance_is_refused_with_a_suitable_format(
    tmp_path, suffix
):
    volume = leaning(0.3)
    for write in (check_export, lambda path, volume: write_mask(path, np.ones(volume.shape_zyx, np.uint8), volume)):
        with pytest.raises(GeometryError, match=r"meet at 89\.7 instead of 90 degrees.*write it as \.nrrd") as caught:
            write(tmp_path / f"m{suffix}", volume)
        assert caught.value.code == "geometry.sheared"
    assert not list(tmp_path.iterdir())


def test_nrrd_of_an_oblique_grid_stores_its_directions_exactly(tmp_path):
    volume = leaning(20)
    path = write_mask(tmp_path / "m.nrrd", np.ones(volume.shape_zyx, np.uint8), volume)
    header = path.read_bytes().partition(b"\n\n")[0].decode()
    line = next(line for line in header.splitlines() if line.startswith("space directions: "))
    vectors = [[float(v) for v in part.strip("()").split(",")] for part in line.split(": ")[1].split()]
    np.testing.assert_array_equal(np.array(vectors).T, volume.lps_from_ijk[:3, :3])


@pytest.mark.parametrize("suffix", [".nii.gz", ".nii"])
def test_axis_longer_than_nifti_can_store_is_refused_before_the_computation(tmp_path, suffix):
    longest = Volume(np.zeros((32767, 2, 2), np.int16), np.eye(4))
    check_export(tmp_path / f"m{suffix}", longest)
    longer = Volume(np.zeros((32768, 2, 2), np.int16), np.eye(4))
    with pytest.raises(GeometryError, match=r"32768 voxels, and NIfTI stores at most 32767; write it as \.nrrd"):
        check_export(tmp_path / f"m{suffix}", longer)
    for other in (".nrrd", ".mha", ".stl", ".json"):
        check_export(tmp_path / f"m{other}", longer)


def test_grid_that_the_format_cannot_store_is_refused_before_the_lumen_is_computed(case, tmp_path, monkeypatch):
    volume, airways = case
    matrix = np.array(volume.lps_from_ijk)
    matrix[:3, 2] += 0.2 * matrix[:3, 0]
    monkeypatch.setattr("carina.export.airways_file.lumen_mask", None)
    with pytest.raises(GeometryError, match="write it as"):
        export_airways(tmp_path / "lumen.nii.gz", Volume(volume.hu_zyx, matrix), airways)


def test_table_of_export_formats_has_each_writer_and_matches_the_longest_suffix():
    assert {row.suffix for row in EXPORT_FORMATS if row.kind == "surface"} == set(MESH_SUFFIXES)
    assert {row.suffix for row in EXPORT_FORMATS if row.kind == "lumen"} == set(MASK_SUFFIXES)
    assert len(set(EXPORT_SUFFIXES)) == len(EXPORT_SUFFIXES)
    assert {row.kind for row in EXPORT_FORMATS} == set(EXPORT_TITLES)
    assert [export_format(f"T{suffix.upper()}").suffix for suffix in EXPORT_SUFFIXES] == list(EXPORT_SUFFIXES)


def test_export_with_an_unknown_suffix_is_refused(tree, case, tmp_path):
    with pytest.raises(UsageError, match=r"\.vtp"):
        export_tree(tmp_path / "t.txt", tree)
    with pytest.raises(UsageError, match=r"\.glb"):
        write_mesh(tmp_path / "t.fbx", Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.uint32)))
    with pytest.raises(UsageError, match=r"\.nrrd"):
        export_airways(tmp_path / "t.dcm", *case)
    assert not list(tmp_path.iterdir())
