"""Tests of the import of NIfTI, NRRD and MetaImage: positions, false headers, files without patient orientation."""

from __future__ import annotations

import gzip
import os
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

from carina.errors import CancelledError, UsageError, VolumeImportError
from carina.volume import inspect_path, open_volume
from carina.volume.demo import CASE_PATH
from carina.volume.grid_second_reader import read_geometry

SIZE_IJK = (13, 11, 9)
SPACING_MM = (0.7, 0.9, 1.25)
DIRECTION = (0.8, -0.36, -0.48, 0.6, 0.48, 0.64, 0.0, -0.8, 0.6)  # row-major; the columns are the axes
ORIGIN_LPS = (-31.5, 12.25, 140.0)
SUFFIXES = ["nii", "nii.gz", "nrrd", "nhdr", "mha", "mhd"]


def hu_like() -> np.ndarray:
    """Return values with air outside and tissue inside, different in every voxel."""
    values = np.arange(np.prod(SIZE_IJK)).reshape(SIZE_IJK[::-1]) % 100 - 1000
    values[3:6, 3:8, 3:10] = np.arange(3 * 5 * 7).reshape(3, 5, 7) - 20
    return values.astype(np.int16)


def oblique(values: np.ndarray) -> sitk.Image:
    image = sitk.GetImageFromArray(values)
    image.SetSpacing(SPACING_MM)
    image.SetDirection(DIRECTION)
    image.SetOrigin(ORIGIN_LPS)
    return image


def write(path: Path, values: np.ndarray | None = None, *, compress: bool = False) -> Path:
    sitk.WriteImage(oblique(hu_like() if values is None else values), str(path), useCompression=compress)
    return path


def refusal(path: Path) -> VolumeImportError:
    with pytest.raises(VolumeImportError) as caught:
        open_volume(path)
    assert caught.value.exit_code == 3
    assert path.name in str(caught.value)
    assert "itk" not in str(caught.value).lower()
    return caught.value


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_oblique_anisotropic_grid_file_has_its_stated_positions_and_values(tmp_path, suffix, compress):
    volume = open_volume(write(tmp_path / f"ct.{suffix}", compress=compress))
    expected = np.eye(4)
    expected[:3, :3] = np.reshape(DIRECTION, (3, 3)) * SPACING_MM
    expected[:3, 3] = ORIGIN_LPS
    # NIfTI stores its transform as float32: the rounding error of 140 mm is 1e-5 mm.
    np.testing.assert_allclose(volume.lps_from_ijk, expected, rtol=0, atol=2e-5)
    np.testing.assert_array_equal(volume.hu_zyx, hu_like())
    assert volume.is_hu, volume.not_hu_reason
    np.testing.assert_array_equal(inspect_path(tmp_path / f"ct.{suffix}").lps_from_ijk, volume.lps_from_ijk)


def test_selecting_a_series_in_a_single_volume_file_is_refused():
    for look in (open_volume, inspect_path):
        with pytest.raises(UsageError, match="no series 'lung'"):
            look(CASE_PATH, series="lung")


def test_grid_file_format_is_detected_from_the_bytes_and_not_from_the_name(tmp_path):
    path = write(tmp_path / "ct.nii.gz")
    renamed = path.rename(tmp_path / "airways.gz")
    np.testing.assert_array_equal(open_volume(renamed).hu_zyx, hu_like())
    bare = write(tmp_path / "ct.nrrd").rename(tmp_path / "scan")
    np.testing.assert_array_equal(open_volume(bare).hu_zyx, hu_like())


def test_right_anterior_superior_nrrd_is_converted_to_lps(tmp_path):
    write(tmp_path / "ct.nrrd")
    data = (tmp_path / "ct.nrrd").read_bytes().replace(b"left-posterior-superior", b"right-anterior-superior")
    (tmp_path / "ras.nrrd").write_bytes(data)
    lps, ras = open_volume(tmp_path / "ct.nrrd").lps_from_ijk, open_volume(tmp_path / "ras.nrrd").lps_from_ijk
    np.testing.assert_allclose(ras, np.diag([-1, -1, 1, 1]) @ lps, rtol=0, atol=1e-12)


def nifti(
    *, shape=(4, 5, 6), sform=1, qform=0, rows=None, dim0=3, magic=b"n+1\0", units=2, datatype=4, pixdim=None
) -> bytes:
    header = bytearray(352)
    struct.pack_into("<i", header, 0, 348)
    struct.pack_into("<8h", header, 40, dim0, *shape, *([1] * (7 - len(shape))))
    struct.pack_into("<2h", header, 70, datatype, 16)
    struct.pack_into("<8f", header, 76, *(pixdim or (1, 0.7, 0.9, 1.25, 1, 1, 1, 1)))
    struct.pack_into("<f", header, 108, 352)
    header[123] = units
    struct.pack_into("<2h", header, 252, qform, sform)
    rows = [[-0.7, 0, 0, 5], [0, -0.9, 0, 6], [0, 0, 1.25, 7]] if rows is None else rows
    struct.pack_into("<12f", header, 280, *np.ravel(rows))
    header[344:348] = magic
    return bytes(header)


def test_nifti_in_metres_is_read_in_millimetres(tmp_path):
    rows = np.array([[-0.7, 0, 0, 5], [0, -0.9, 0, 6], [0, 0, 1.25, 7]]) / 1000
    values = (np.arange(120) - 60).astype("<i2").tobytes()
    path = tmp_path / "metres.nii"
    path.write_bytes(nifti(rows=rows, units=1, pixdim=(1, 0.0007, 0.0009, 0.00125, 1, 1, 1, 1)) + values)
    volume = open_volume(path)
    # float32 with steps of 0.001 mm: the rounding error is 1e-5 mm.
    np.testing.assert_allclose(volume.to_lps(np.zeros(3)), [-5, -6, 7], rtol=0, atol=1e-5)
    np.testing.assert_allclose(volume.spacing_mm, (0.7, 0.9, 1.25), rtol=0, atol=1e-5)


SHEARED = [[-0.7, 0, 0, 5], [0, -0.9, 0, 6], [0, 0.4, 1.25, 7]]


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"rows": SHEARED}, "import.geometry.sheared"),
        ({"rows": SHEARED, "qform": 1}, "import.geometry.sheared"),
        ({"sform": 0, "qform": 0}, "import.geometry.orientation-unknown"),
        ({"magic": b"\0\0\0\0"}, "import.geometry.orientation-unknown"),
        # the quaternion is zero: the identity, which differs from the sform
        ({"qform": 1}, "import.geometry.ambiguous"),
        ({"rows": np.zeros((3, 4))}, "import.geometry.spacing"),
        ({"rows": np.full((3, 4), np.nan)}, "import.geometry.spacing"),
        ({"shape": (4, 5, 6, 7), "dim0": 4}, "import.not-3d"),
        ({"shape": (4, 5), "dim0": 2}, "import.not-3d"),
        ({"shape": (4, 5, 1)}, "import.single-slice"),
        ({"shape": (4, -5, 6)}, "import.header"),
        ({"dim0": 9}, "import.header"),
        ({"units": 7}, "import.header"),
        ({"datatype": 128}, "import.not-supported"),
        ({"shape": (400, 500, 600)}, "import.truncated"),
        ({"shape": (32000, 32000, 32000)}, "import.too-large"),
    ],
)
def test_invalid_nifti_headers_are_refused(tmp_path, options, code):
    path = tmp_path / "odd.nii"
    path.write_bytes(nifti(**options) + (np.arange(120) * 30).astype("<i2").tobytes())
    assert refusal(path).code == code


def _edit_text(path: Path, old: bytes, new: bytes) -> Path:
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    return path


@pytest.mark.parametrize(
    ("suffix", "old", "new", "code"),
    [
        ("nrrd", b"sizes: 13 11 9", b"sizes: 130 11 9", "import.truncated"),
        ("nrrd", b"sizes: 13 11 9", b"sizes: 999999 99999 99999", "import.too-large"),
        ("nrrd", b"sizes: 13 11 9", b"sizes: 13 11", "import.header"),
        ("nrrd", b"sizes: 13 11 9", b"sizes: 13 eleven 9", "import.header"),
        ("nrrd", b"space: left-posterior-superior", b"#", "import.geometry.orientation-unknown"),
        ("nrrd", b"left-posterior-superior", b"scanner-xyz", "import.geometry.orientation-unknown"),
        ("nrrd", b"dimension: 3", b"dimension: 4", "import.header"),
        ("nrrd", b"encoding: raw", b"encoding: hex", "import.not-supported"),
        ("nhdr", b"data file: ct.raw", b"data file: ../ct.raw", "import.elsewhere"),
        ("nhdr", b"data file: ct.raw", b"data file: gone.raw", "import.not-found"),
        ("mha", b"DimSize = 13 11 9", b"DimSize = 1300 11 9", "import.truncated"),
        ("mha", b"DimSize = 13 11 9", b"DimSize = 99999 99999 99", "import.too-large"),
        ("mha", b"ElementSpacing", b"ElementSpacing = 0.7 -0.9 1.25\nComment", "import.geometry.spacing"),
        ("mha", b"ElementSpacing", b"ElementSpacing = 0.7 nan 1.25\nComment", "import.geometry.spacing"),
        ("mha", b"ElementType = MET_SHORT", b"ElementType = MET_SHORTS", "import.not-supported"),
        ("mha", b"NDims = 3", b"NDims = 4", "import.header"),
        ("mhd", b"ElementDataFile = ct.raw", b"ElementDataFile = /etc/hostname", "import.elsewhere"),
        ("mhd", b"ElementDataFile = ct.raw", b"ElementDataFile = LIST", "import.not-supported"),
    ],
)
def test_invalid_text_headers_are_refused(tmp_path, suffix, old, new, code):
    assert refusal(_edit_text(write(tmp_path / f"ct.{suffix}"), old, new)).code == code


def test_sheared_metaimage_is_refused(tmp_path):
    path = write(tmp_path / "ct.mha")
    line = next(line for line in path.read_bytes().split(b"\n") if line.startswith(b"TransformMatrix"))
    assert (
        refusal(_edit_text(path, line, b"TransformMatrix = 1 0 0 0 1 0 0 0.3 0.954")).code == "import.geometry.sheared"
    )


@pytest.mark.parametrize("suffix", ["nii", "nii.gz", "nrrd", "mha"])
@pytest.mark.parametrize("compress", [False, True])
def test_grid_file_truncated_at_any_length_is_refused(tmp_path, suffix, compress):
    whole = write(tmp_path / f"whole.{suffix}", compress=compress).read_bytes()
    path = tmp_path / f"cut.{suffix}"
    for keep in (10, 200, len(whole) // 2, len(whole) - 40, len(whole) - 1):
        path.write_bytes(whole[:keep])
        # A gzip stream without its last byte has all voxels but an incomplete check sum, so it counts as damaged.
        assert refusal(path).code in ("import.truncated", "import.header", "import.not-an-image")


def test_grid_file_with_a_damaged_compressed_stream_is_refused(tmp_path):
    whole = bytearray(write(tmp_path / "ct.nii.gz").read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    (tmp_path / "ct.nii.gz").write_bytes(bytes(whole))
    assert refusal(tmp_path / "ct.nii.gz").code == "import.truncated"


def test_compressed_grid_header_that_claims_an_enormous_size_allocates_no_memory(tmp_path):
    import resource

    # The header claims 1 GB and the file has 200 kB of incompressible data, whose ratio alone would be accepted.
    noise = os.urandom(1_000_000)
    path = tmp_path / "bomb.nii.gz"
    path.write_bytes(gzip.compress(nifti(shape=(800, 800, 800)) + noise))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert refusal(path).code == "import.truncated"
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000  # kB; the header claims 1,000,000 kB


def test_grid_file_that_decompresses_to_more_than_the_header_claims_is_refused(tmp_path):
    packer = zlib.compressobj(9, zlib.DEFLATED, zlib.MAX_WBITS | 16)
    packed = packer.compress(nifti() + bytes(240))
    packed += b"".join(packer.compress(bytes(1 << 20)) for _ in range(100)) + packer.flush()
    path = tmp_path / "bomb.nii.gz"
    path.write_bytes(packed)
    assert refusal(path).code == "import.truncated"


def test_grid_files_with_four_dimensions_or_with_colours_are_refused(tmp_path):
    four = sitk.GetImageFromArray(np.zeros((2, 9, 11, 13), dtype=np.int16), isVector=False)
    colour = sitk.GetImageFromArray(np.zeros((9, 11, 13, 3), dtype=np.uint8), isVector=True)
    for suffix in ("nii", "nrrd", "mha"):
        sitk.WriteImage(four, str(tmp_path / f"four.{suffix}"))
        assert refusal(tmp_path / f"four.{suffix}").code == "import.not-3d"
        sitk.WriteImage(colour, str(tmp_path / f"colour.{suffix}"))
        assert refusal(tmp_path / f"colour.{suffix}").code in ("import.not-3d", "import.not-supported")


def test_grid_file_with_a_single_value_is_refused(tmp_path):
    assert refusal(write(tmp_path / "empty.nrrd", np.zeros(SIZE_IJK[::-1], dtype=np.int16))).code == "import.values"


def test_nonfinite_voxels_get_the_lowest_value_and_their_number_is_stated(tmp_path):
    values = hu_like().astype(np.float32)
    values[0, 0, :3] = np.nan
    volume = open_volume(write(tmp_path / "ct.nrrd", values))
    assert (volume.hu_zyx[0, 0, :3] == -1000).all()
    assert any("3 voxels are not finite" in warning for warning in volume.source.warnings)
    assert refusal(write(tmp_path / "none.nrrd", np.full_like(values, np.nan))).code == "import.no-numbers"


@pytest.mark.parametrize("suffix", ["nii.gz", "nrrd", "mha"])
def test_import_of_a_grid_file_can_be_cancelled_at_every_step(tmp_path, suffix):
    path = write(tmp_path / f"ct.{suffix}", compress=True)
    seen: list[str] = []
    open_volume(path, progress=lambda what, fraction: seen.append(what))
    assert "Reading the voxels" in seen
    for stop_at in range(len(seen)):
        checks = iter(range(len(seen) + 1))
        with pytest.raises(CancelledError):
            open_volume(path, cancel=lambda checks=checks, stop_at=stop_at: next(checks) >= stop_at)


def test_import_library_writes_nothing_to_the_terminal(tmp_path, capfd):
    path = write(tmp_path / "ct.mha")
    open_volume(path)
    path.write_bytes(path.read_bytes()[:-50])
    refusal(path)
    captured = capfd.readouterr()
    assert captured.out == ""
    assert captured.err == ""


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_header_that_the_second_reader_places_elsewhere_is_refused(tmp_path, monkeypatch, suffix):
    path = write(tmp_path / f"ct.{suffix}")
    mirrored = np.diag([-1.0, 1.0, 1.0, 1.0])
    monkeypatch.setattr(
        "carina.volume.grid_files.read_geometry",
        lambda head, form: (SIZE_IJK, mirrored @ read_geometry(head, form)[1]),
    )
    assert refusal(path).code == "import.geometry.disagree"
    monkeypatch.setattr("carina.volume.grid_files.read_geometry", lambda head, form: ((1, 2, 3), np.eye(4)))
    assert refusal(path).code == "import.header.disagree"
