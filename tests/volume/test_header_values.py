"""Tests of gzip files under any name, and of text headers whose values violate the format."""

from __future__ import annotations

import bz2
import gzip
import lzma
import tarfile

import grid_writers as grids
import numpy as np
import pytest

from carina.errors import VolumeImportError
from carina.volume import inspect_path, open_volume

MAX_CHARS = 600


def refusal(path) -> VolumeImportError:
    with pytest.raises(VolumeImportError) as caught:
        open_volume(path)
    assert len(str(caught.value)) < MAX_CHARS
    assert str(caught.value).isprintable()
    return caught.value


@pytest.mark.parametrize("form", ["nifti", "nrrd", "nrrd gzip", "metaimage", "metaimage compressed"])
@pytest.mark.parametrize("same_name", [True, False])
def test_gzip_file_opens_without_the_gz_suffix(tmp_path, form, same_name):
    path = grids.FORMS[form](tmp_path, grids.chest())
    packed = path if same_name else path.with_name(f"{path.name}.gz")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    volume = open_volume(packed)
    np.testing.assert_array_equal(volume.hu_zyx, grids.chest())
    np.testing.assert_allclose(volume.lps_from_ijk, grids.LPS_FROM_IJK, rtol=0, atol=2e-5)
    assert volume.source.notes == ()
    assert inspect_path(packed).refused is None


@pytest.mark.parametrize("packed", [True, False])
def test_compressed_values_of_a_header_pair_open_without_the_gz_suffix(tmp_path, packed):
    path = grids.FORMS["nifti pair"](tmp_path, grids.chest())
    values = path.with_suffix(".img")
    if packed:
        values.write_bytes(gzip.compress(values.read_bytes()))
    np.testing.assert_array_equal(open_volume(path).hu_zyx, grids.chest())


def test_values_that_begin_like_gzip_data_are_not_decompressed(tmp_path):
    values = grids.chest()
    values[0, 0, :2] = np.frombuffer(b"\x1f\x8b\x08\x00", "<i2")
    np.testing.assert_array_equal(open_volume(grids.FORMS["nifti pair"](tmp_path, values)).hu_zyx, values)


@pytest.mark.parametrize("form", ["nrrd gzip", "metaimage compressed", "nrrd", "metaimage"])
def test_truncated_gzip_file_with_any_name_is_refused(tmp_path, form):
    path = grids.FORMS[form](tmp_path, grids.chest())
    packed = gzip.compress(path.read_bytes())
    path.write_bytes(packed[:-20])
    assert refusal(path).code == "import.truncated"


def test_gzip_values_declared_as_raw_are_refused_with_the_reason(tmp_path):
    path = grids.FORMS["nrrd detached"](tmp_path, grids.chest())
    raw = tmp_path / "ct.raw"
    raw.write_bytes(gzip.compress(raw.read_bytes()))
    assert "look compressed by gzip although the header does not state it" in str(refusal(path))


def test_data_after_a_compressed_gzip_stream_are_refused_with_a_remedy(tmp_path):
    path = grids.nrrd(tmp_path, grids.chest(), edit=lambda lines: lines.append("byte skip: -1"))
    path.write_bytes(gzip.compress(path.read_bytes()))
    error = refusal(path)
    assert error.code == "import.not-supported"
    assert "gunzip" in str(error)


@pytest.mark.parametrize(
    ("pack", "text"),
    [
        (bz2.compress, "packed by bzip2"),
        (lzma.compress, "packed by xz"),
        (lambda data: b"\x28\xb5\x2f\xfd" + data, "packed by zstd"),
        (lambda data: gzip.compress(gzip.compress(data)), "packed twice by gzip"),
        (lambda _: gzip.compress(bytes(128) + b"DICM" + bytes(200)), "a DICOM file packed by gzip"),
        (lambda _: gzip.compress(b"text, not an image"), "not an image volume"),
    ],
)
def test_file_of_an_unsupported_compression_is_refused_with_its_name_and_a_remedy(tmp_path, pack, text):
    path = grids.nifti(tmp_path, grids.chest())
    path.write_bytes(pack(path.read_bytes()))
    error = refusal(path)
    assert error.code == "import.not-an-image"
    assert text in str(error)


def test_grid_in_a_compressed_archive_is_opened(tmp_path):
    path = tmp_path / "scan.tar.gz"
    with tarfile.open(path, "w:gz") as archive:
        archive.add(grids.nifti(tmp_path, grids.chest()), "ct.nii")
    assert np.array_equal(open_volume(path).hu_zyx, grids.chest())


def line(begin: str, new: str):
    """Return an edit that replaces the header line with the given beginning."""

    def edit(lines):
        lines[next(n for n, text in enumerate(lines) if text.startswith(begin))] = new

    return edit


@pytest.mark.parametrize(
    ("write", "begin", "new", "text"),
    [
        (grids.metaimage, "ElementSpacing", "ElementSpacing = 0,7 0,9 1,25",
         "its ElementSpacing should be 3 numbers, with a decimal point (a comma is not accepted); found "
         "'0,7 0,9 1,25'"),
        (grids.metaimage, "Offset", "Offset = -31,5 12,25 140", "its Offset should be"),
        (grids.metaimage, "TransformMatrix", "TransformMatrix = 1 0 0 0 1 0 0 0", "its TransformMatrix should be 9"),
        (grids.metaimage, "DimSize", "DimSize = 24 20 12.5", "its DimSize should be whole numbers; found '24 20 12.5'"),
        (grids.metaimage, "NDims", "NDims = three", "its NDims should be a whole number; found 'three'"),
        (grids.metaimage, "CompressedData", "CompressedData = maybe", "should be True or False; found 'maybe'"),
        (grids.metaimage, "ElementType", "X = 1", "its metaimage header has no field 'ElementType'"),
        (grids.nrrd, "space directions", "space directions: (0,7,0,0) (0,0,9,0) (0,0,1,25)",
         "its space directions field should be 3 vectors of three numbers, with a decimal point (a comma is not "
         "accepted); found '(0,7,0,0) (0,0,9,0) (0,0,1,25)'"),
        (grids.nrrd, "space origin", "space origin: (-31,5;12,25;140)", "its space origin field should be a vector"),
        (grids.nrrd, "space origin", "space origin: (1,2)", "found '(1,2)'"),
        (grids.nrrd, "sizes", "sizes: 24 20 twelve", "its sizes field should be whole numbers; found '24 20 twelve'"),
        (grids.nrrd, "sizes", "sizes: 24 20", "its sizes field should be 3 whole numbers; found '24 20'"),
        (grids.nrrd, "type", "xtype: short", "its nrrd header has no field 'type'"),
    ],
)  # fmt: skip
def test_grid_header_value_that_violates_the_format_is_shown_in_the_message(tmp_path, write, begin, new, text):
    error = refusal(write(tmp_path, grids.chest(), edit=line(begin, new)))
    assert error.code == "import.header"
    assert text in str(error)
    assert "correct the header, or export it again" in str(error)


LONG = "x\x1b" * 5_000


@pytest.mark.parametrize(
    ("write", "begin", "new"),
    [
        (grids.nrrd, "space: ", f"space: {LONG}"),
        (grids.nrrd, "type", f"type: {LONG}"),
        (grids.nrrd, "encoding", f"encoding: {LONG}"),
        (grids.nrrd, "endian", f"endian: {LONG}"),
        (grids.nrrd, "kinds", f"space units: {LONG}"),
        (grids.nrrd, "space origin", f"space origin: {LONG}"),
        (grids.nrrd, "sizes", f"sizes: {'1' * 10_000}"),
        (grids.nrrd, "sizes", f"sizes: {'12 ' * 5_000}"),
        (grids.nrrd, "encoding", f"encoding: raw\ndata file: {LONG}.raw"),
        (grids.nrrd, "sizes", f"sizes: 24 20 12\nsizes: {LONG}"),
        (grids.metaimage, "ElementSpacing", f"ElementSpacing = {LONG}"),
        (grids.metaimage, "ElementType", f"ElementType = {LONG}"),
        (grids.metaimage, "DimSize", f"DimSize = {LONG}"),
        (grids.metaimage, "CompressedData", f"DistanceUnits = {LONG}"),
    ],
)
def test_grid_header_value_of_ten_thousand_characters_is_shortened_in_the_message(tmp_path, write, begin, new):
    text = str(refusal(write(tmp_path, grids.chest(), edit=line(begin, new))))
    assert "x\\x1b" in text or "1" in text


@pytest.mark.parametrize("form", ["nrrd", "metaimage"])
def test_long_comment_of_another_program_in_a_grid_header_is_accepted(tmp_path, form):
    new = {"nrrd": f"note:={'word ' * 2_000}", "metaimage": f"Comment = {'word ' * 2_000}"}[form]
    write = {"nrrd": grids.nrrd, "metaimage": grids.metaimage}[form]
    path = write(tmp_path, grids.chest(), edit=lambda lines: lines.insert(5, new))
    np.testing.assert_array_equal(open_volume(path).hu_zyx, grids.chest())
