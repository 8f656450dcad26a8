"""Tests of VTI files: every coding against an own writer and VTK, geometry, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from dicom_writer import chest
from vti_writer import CODINGS, write_vti

from carina.errors import CancelledError, VolumeImportError
from carina.volume import inspect_path, open_volume

ORIGIN, SPACING = np.array([-11.25, -14.5, 30.0]), np.array([0.7, 0.9, 2.5])


@pytest.mark.parametrize("coding", CODINGS)
@pytest.mark.parametrize(("order", "word"), [("<", "I"), (">", "Q")])
def test_every_coding_opens_with_the_right_voxels_and_positions(tmp_path, coding, order, word):
    volume = open_volume(write_vti(tmp_path / "ct.vti", chest(), coding, order=order, word=word))
    np.testing.assert_array_equal(volume.hu_zyx, chest())
    np.testing.assert_allclose(volume.lps_from_ijk[:3, 3], ORIGIN)
    np.testing.assert_allclose(volume.lps_from_ijk[:3, :3], np.diag(SPACING))
    assert volume.is_hu
    assert [note.code for note in volume.source.notes] == ["import.orientation-doubted"]


@pytest.mark.parametrize("kind", ["i2", "i4", "f4", "f8"])
def test_number_types_give_the_same_hu(tmp_path, kind):
    for coding in ("raw-zlib", "ascii"):
        path = write_vti(tmp_path / "ct.vti", chest().astype(kind), coding)
        np.testing.assert_array_equal(open_volume(path).hu_zyx, chest())


def test_base64_with_line_breaks_and_blocks_that_fit_exactly_open(tmp_path):
    for coding in ("binary", "binary-zlib", "base64", "base64-zlib"):
        path = write_vti(tmp_path / "ct.vti", chest(), coding, wrap=True, block=2048 * 20)
        np.testing.assert_array_equal(open_volume(path).hu_zyx, chest())


def test_oblique_directions_and_an_extent_that_does_not_begin_at_zero(tmp_path):
    turn = np.array([[0.8, -0.36, 0.48], [0.6, 0.48, -0.64], [0.0, 0.8, 0.6]])
    path = write_vti(
        tmp_path / "ct.vti", chest(), "raw", first=(3, -2, 5), direction=" ".join(f"{v:.12g}" for v in turn.ravel())
    )
    volume = open_volume(path)
    np.testing.assert_allclose(volume.lps_from_ijk[:3, :3], turn * SPACING, atol=1e-9)
    np.testing.assert_allclose(volume.lps_from_ijk[:3, 3], ORIGIN + turn @ (SPACING * [3, -2, 5]), atol=1e-9)


def test_values_of_cells_are_at_the_centres_of_the_cells(tmp_path):
    volume = open_volume(write_vti(tmp_path / "ct.vti", chest(), "raw", data="CellData"))
    np.testing.assert_array_equal(volume.hu_zyx, chest())
    np.testing.assert_allclose(volume.lps_from_ijk[:3, 3], ORIGIN + 0.5 * SPACING)


@pytest.mark.parametrize(("mode", "compress"), [("ascii", False), ("binary", True), ("appended", True), ("raw", False)])
def test_files_written_by_vtk_open_with_vtk_s_voxels_and_positions(tmp_path, mode, compress):
    pytest.importorskip("vtkmodules", reason="needs VTK (extra bench)")
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkImageData
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

    image = vtkImageData()
    image.SetExtent(2, 33, 1, 32, 0, 19)
    image.SetSpacing(*SPACING)
    image.SetOrigin(*ORIGIN)
    image.SetDirectionMatrix(0.8, -0.36, 0.48, 0.6, 0.48, -0.64, 0.0, 0.8, 0.6)
    array = numpy_to_vtk(np.ascontiguousarray(chest()).ravel())
    array.SetName("ct")
    image.GetPointData().SetScalars(array)
    writer = vtkXMLImageDataWriter()
    writer.SetFileName(str(tmp_path / "ct.vti"))
    writer.SetInputData(image)
    {"ascii": writer.SetDataModeToAscii, "binary": writer.SetDataModeToBinary}.get(mode, writer.SetDataModeToAppended)()
    writer.SetEncodeAppendedData(mode == "appended")
    writer.SetCompressorTypeToZLib() if compress else writer.SetCompressorTypeToNone()
    writer.Write()
    volume = open_volume(tmp_path / "ct.vti")
    np.testing.assert_array_equal(volume.hu_zyx, chest())
    for ijk in ((0, 0, 0), (31, 0, 0), (4, 30, 19)):
        expected = [0.0] * 3
        image.TransformIndexToPhysicalPoint([ijk[0] + 2, ijk[1] + 1, ijk[2]], expected)
        np.testing.assert_allclose(volume.lps_from_ijk @ [*ijk, 1.0], [*expected, 1.0], atol=1e-6)


def test_header_is_read_without_the_values(tmp_path):
    found = inspect_path(write_vti(tmp_path / "ct.vti", chest(), "raw-zlib"))
    assert (found.format, found.shape_zyx, found.refused) == ("vti", chest().shape, None)


def changed(tmp_path, old: bytes, new: bytes, coding: str = "raw-zlib"):
    path = write_vti(tmp_path / "ct.vti", chest(), coding)
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        (b'type="ImageData"', b'type="PolyData" ', "import.not-supported"),
        (b"vtkZLib", b"vtkLZ4_", "import.not-supported"),
        (b'"0.7 0.9 2.5"', b'"0.7 0.9 -25"', "import.header"),
        (b'"0.7 0.9 2.5"', b'"0.7 0.9 nan"', "import.header"),
        (b'<Piece Extent="0', b'<Piece Extent="1', "import.not-supported"),
        (b"0 31 0 31 0 19", b"0 31 0 31 0 18", "import.not-supported"),
        (b'type="Int16"', b'type="String"', "import.not-supported"),
        (b'type="Int16"', b'type="Int32"', "import.truncated"),
        (b"<?xml", b"<!DOCTYPE x><?xml", "import.header"),
        (b'Name="ct"', b'NumberOfComponents="3" Name="ct"', "import.not-3d"),
        (b'offset="0"', b'offset="-99999"', "import.header"),
        (b'Origin="-11.25', b'Origin="x11.25', "import.header"),
    ],
)
def test_file_with_a_wrong_header_is_refused(tmp_path, old, new, code):
    with pytest.raises(VolumeImportError) as found:
        open_volume(changed(tmp_path, old, new))
    assert found.value.code == code


@pytest.mark.parametrize("coding", CODINGS)
def test_truncated_values_are_refused(tmp_path, coding):
    path = write_vti(tmp_path / "ct.vti", chest(), coding)
    data = path.read_bytes()
    path.write_bytes(data[: int(0.8 * len(data))])
    with pytest.raises(VolumeImportError) as found:
        open_volume(path)
    assert found.value.code in ("import.truncated", "import.header")


def test_claim_of_a_huge_image_is_refused_without_memory(tmp_path):
    for coding in ("raw", "raw-zlib", "ascii", "binary-zlib"):
        path = write_vti(tmp_path / "ct.vti", chest(), coding)
        path.write_bytes(path.read_bytes().replace(b"0 31 0 31 0 19", b"0 1023 0 1023 0 1023"))
        with pytest.raises(VolumeImportError) as found:
            open_volume(path)
        assert found.value.code in ("import.truncated", "import.too-large")


@pytest.mark.parametrize("text", [b"<!--", b"<!-- <!-- ", b'<a b="', b"<"], ids=["comment", "text", "quote", "tag"])
def test_time_for_repeated_beginnings_of_tags_is_limited(tmp_path, text):
    """A search from each of the beginnings to the end would not finish within the time limit of the tests."""
    path = tmp_path / "scan.vti"
    path.write_bytes(b'<VTKFile type="ImageData">' + text * ((8 << 20) // len(text)))
    with pytest.raises(VolumeImportError) as found:
        inspect_path(path)
    assert found.value.code in ("import.header", "import.tags")


def test_tags_in_a_comment_are_not_read(tmp_path):
    path = tmp_path / "scan.vti"
    write_vti(path, chest(), "raw-zlib")
    text = path.read_bytes()
    comment = b"<!-- " + b"x" * 100_000 + b' <ImageData WholeExtent="0 1 0 1 0 1"> -->'
    at = text.index(b"<PointData")
    path.write_bytes(text[:at] + comment + text[at:])
    np.testing.assert_array_equal(open_volume(path).hu_zyx, chest())


def test_several_arrays_without_a_named_one_are_refused(tmp_path):
    more = '<DataArray type="Int8" Name="b" format="ascii">0</DataArray>\n'
    path = write_vti(tmp_path / "ct.vti", chest(), "ascii", more=more)
    np.testing.assert_array_equal(open_volume(path).hu_zyx, chest())
    path.write_bytes(path.read_bytes().replace(b'Scalars="ct"', b""))
    with pytest.raises(VolumeImportError, match="2 arrays"):
        open_volume(path)


def test_cancel_stops_the_reading(tmp_path):
    with pytest.raises(CancelledError):
        open_volume(write_vti(tmp_path / "ct.vti", chest(), "raw-zlib"), cancel=lambda: True)
