"""Tests on real scans and unusual files from public collections: each is read correctly or refused with a reason."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk

from carina.errors import VolumeImportError
from carina.volume import demo_patient, inspect_path, open_volume, quality_gate
from carina.volume.dicom_files import read_headers
from carina.volume.dicom_pixels import read_slice
from carina.volume.progress import Watch

pytestmark = pytest.mark.data


def test_patient_ct_has_the_values_of_the_reference_library(patient_dicom):
    started = time.process_time()
    volume = open_volume(patient_dicom)
    seconds = time.process_time() - started
    assert seconds < 6  # The limit is CPU time; 0.4 to 0.8 s were measured.
    reader = sitk.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(patient_dicom)))
    image = reader.Execute()
    np.testing.assert_array_equal(volume.hu_zyx, sitk.GetArrayFromImage(image))
    np.testing.assert_allclose(volume.lps_from_ijk[:3, 3], image.GetOrigin(), rtol=0, atol=1e-6)
    np.testing.assert_allclose(volume.spacing_mm, image.GetSpacing(), rtol=0, atol=1e-6)
    assert volume.is_hu
    text = [finding.words for finding in quality_gate(volume).findings]
    assert "slices are 3.0 mm apart: beyond about generation 5, airways may be missed or measured inaccurately" in text


def test_bundled_patient_is_a_lossless_crop_at_the_same_position(patient_dicom):
    whole, crop = open_volume(patient_dicom), demo_patient()
    # The corner is computed only from positions, so a moved crop fails the test.
    corner = whole.to_ijk(crop.to_lps(np.zeros(3)))
    i, j, k = np.rint(corner).astype(int)
    np.testing.assert_allclose(corner, [i, j, k], rtol=0, atol=1e-9)
    nz, ny, nx = crop.shape_zyx
    np.testing.assert_array_equal(crop.hu_zyx, whole.hu_zyx[k : k + nz, j : j + ny, i : i + nx])
    np.testing.assert_array_equal(crop.lps_from_ijk[:3, :3], whole.lps_from_ijk[:3, :3])


def test_bundled_patient_contains_all_airways_of_the_reference(patient_dicom):
    mask = sitk.ReadImage(str(patient_dicom.parent / "airway_ground_truth" / "github_demo_seg.nii.gz"))
    inside = np.argwhere(sitk.GetArrayFromImage(mask) > 0)[:, ::-1].astype(np.float64)
    lps = inside * mask.GetSpacing() + mask.GetOrigin()  # the axes of the mask are parallel to the axes of LPS
    crop = demo_patient()
    ijk = crop.to_ijk(lps)
    assert (ijk > 4).all(axis=0)[:2].all()
    assert (ijk[:, 2] >= 0).all()
    assert (ijk < np.array(crop.shape_zyx[::-1])).all()


def test_ct_of_the_second_patient_opens_with_its_geometry(data_dir, tmp_path):
    import tarfile

    with tarfile.open(data_dir / "ct" / "QIN-LSC-0064.tar.xz") as archive:
        for member in archive:
            # Files are selected by their names, because early releases of Python 3.11 lack the "data" filter of
            # tarfile.
            if member.isfile():
                (tmp_path / member.name.replace("/", "_")).write_bytes(archive.extractfile(member).read())
    volume = open_volume(tmp_path)
    assert volume.shape_zyx == (103, 512, 512)
    assert volume.spacing_mm == pytest.approx((0.598, 0.598, 3.0), abs=1e-3)
    assert quality_gate(volume).lung_litres == pytest.approx(4.3, abs=0.3)


@pytest.mark.parametrize(
    ("path", "code", "text"),
    [
        ("cornerstone3D_transfer_syntaxes", "import.geometry.duplicate", "10 of its 10 slices"),
        ("cornerstone3D_transfer_syntaxes/TestPattern_RGB.dcm", "import.not-a-scan", "colour"),
        ("cornerstone3D_transfer_syntaxes/TestPattern_Palette.dcm", "import.not-a-scan", "colour"),
        ("cornerstone3D_transfer_syntaxes/US-YBR_FULL_422-EVRLE.dcm", "import.not-a-scan", "colour"),
        ("pydicom", "import.single-slice", "also contains"),
        ("pydicom/CT_small.dcm", "import.single-slice", "CT_small.dcm"),
        ("pydicom/J2K_pixelrep_mismatch.dcm", "import.single-slice", "only one image"),
        ("pydicom/MR_small_RLE.dcm", "import.geometry.duplicate", "8 of its 8"),
        ("pydicom/JPEG2000.dcm", "import.tags", "ImagePositionPatient is missing"),
        ("pydicom/JPEGLSNearLossless_16.dcm", "import.tags", "PixelSpacing is missing"),
        ("pydicom/image_dfl.dcm", "import.tags", "PixelSpacing is missing"),
        ("pydicom/badVR.dcm", "import.pixels", "32 bits"),
        ("pydicom/liver_1frame.dcm", "import.multi-frame", "liver_1frame.dcm"),
        ("pydicom/rtstruct.dcm", "import.no-images", "without an image"),
        ("pydicom/test-SR.dcm", "import.no-images", "without an image"),
        ("pydicom/empty_charset_LEI.dcm", "import.no-images", "without an image"),
        ("pydicom/meta_missing_tsyntax.dcm", "import.no-images", "without an image"),
        ("pydicom/no_meta_group_length.dcm", "import.no-images", "without an image"),
        ("pydicom/no_meta.dcm", "import.not-an-image", "no_meta.dcm"),
        ("PROVENANCE.txt", "import.not-an-image", "PROVENANCE.txt"),
    ],
)
def test_unusual_dicom_file_is_refused_with_its_reason(data_dir, capfd, path, code, text):
    with pytest.raises(VolumeImportError) as caught:
        open_volume(data_dir / "odd" / "dicom" / path)
    assert caught.value.code == code
    assert text in str(caught.value)
    assert capfd.readouterr().err == ""


def _outcome(path: Path) -> str:
    try:
        return repr(open_volume(path))
    except VolumeImportError as error:
        return error.code


# Each file of the JPEG 2000 series leads to the whole series, which is decoded; `make soak` opens all 20.
@pytest.mark.parametrize("every", [10, pytest.param(1, marks=pytest.mark.soak)])
def test_each_unusual_dicom_file_gives_a_volume_or_a_refusal(data_dir, every):
    series = sorted((data_dir / "odd" / "dicom" / "totalseg_example_ct_dicom_j2k").iterdir())
    left_out = {path for n, path in enumerate(series) if n % every}
    paths = [path for path in sorted((data_dir / "odd" / "dicom").rglob("*")) if path not in left_out]
    outcomes = {path: _outcome(path) for path in paths}
    assert all(outcome.startswith(("Volume(", "import.")) for outcome in outcomes.values())
    assert len(series) == 20
    # Paths that give a volume: the folder of the JPEG 2000 series (1) and its files (20 // every), the paths of the
    # tilted series (28), and an enhanced CT with two frames (1).
    assert sum(outcome.startswith("Volume(") for outcome in outcomes.values()) == 1 + 20 // every + 28 + 1


def test_enhanced_file_with_fragmented_frames_and_no_offset_table_opens(data_dir):
    name = "CT0012.fragmented_no_bot_jpeg_baseline.51.dcm"
    volume = open_volume(data_dir / "odd" / "dicom" / "cornerstone3D_transfer_syntaxes" / name)
    assert volume.shape_zyx == (2, 512, 512)
    assert "import.lossy" in [note.code for note in volume.source.notes]
    assert not volume.is_hu  # its tags state the unit US


def test_tilted_series_of_a_real_scanner_is_corrected(data_dir):
    volume = open_volume(data_dir / "odd" / "dicom" / "gantry_tilt")
    assert [note.code for note in volume.source.notes if note.badge] == ["import.tilt-corrected"]
    assert volume.source.tilt_deg == pytest.approx(16.5, abs=0.05)
    columns = volume.lps_from_ijk[:3, :3]
    assert np.abs(np.triu(columns.T @ columns, 1)).max() < 0.01


def test_jpeg2000_series_with_overlapping_slices_opens(data_dir):
    volume = open_volume(data_dir / "odd" / "dicom" / "totalseg_example_ct_dicom_j2k")
    assert volume.shape_zyx == (20, 512, 512)
    # The slices are 3 mm thick and 2 mm apart; the distance is the spacing.
    assert volume.spacing_mm == pytest.approx((0.9766, 0.9766, 2.0), abs=1e-4)
    assert volume.is_hu
    assert int(volume.hu_zyx.min()) == -1024


LOSSLESS = (
    "ImplicitTransferSyntax ExplicitTransferSyntax BigEndian Deflated RLE 14Transfer 14SV1 LSLossless 2000LosslessOnly"
)


@pytest.mark.parametrize("syntax", LOSSLESS.split())
def test_slices_in_every_lossless_transfer_syntax_are_equal(data_dir, syntax):
    headers = read_headers(
        data_dir / "odd" / "dicom" / "cornerstone3D_transfer_syntaxes", recursive=False, watch=Watch()
    )
    plain = next(header for header in headers if header.path.name == "CTImage.dcm")
    packed = next(header for header in headers if f"{syntax}" in header.path.name)
    np.testing.assert_array_equal(read_slice(packed), read_slice(plain))


@pytest.mark.parametrize(
    ("syntax", "mean_hu"), [("JPEG2000Transfer", 3), ("LSLossy", 3), ("Process2_4", 6), ("Process1Tr", 25)]
)
def test_slices_in_lossy_transfer_syntaxes_are_within_tolerance(data_dir, syntax, mean_hu):
    # The error is 0.5 to 4 HU where 12 bits cover 8000 values in steps of 2; Process1 has 8 bits, steps of 32 HU.
    headers = read_headers(
        data_dir / "odd" / "dicom" / "cornerstone3D_transfer_syntaxes", recursive=False, watch=Watch()
    )
    plain = next(header for header in headers if header.path.name == "CTImage.dcm")
    packed = next(header for header in headers if f"{syntax}" in header.path.name)
    assert float(np.abs(read_slice(packed) - read_slice(plain)).mean()) < mean_hu


def _orientations(folder: Path) -> list[Path]:
    return sorted((folder / "odd" / "nifti" / "niivue_orientations").glob("*.nii.gz"))


def test_all_48_orientations_give_equal_values_at_equal_positions(data_dir, rng):
    paths = _orientations(data_dir)
    assert len(paths) == 48
    reference = open_volume(paths[0])
    nz, ny, nx = reference.shape_zyx
    ijk = np.stack([rng.integers(0, n, 500) for n in (nx, ny, nz)], axis=1)
    expected = reference.hu_zyx[ijk[:, 2], ijk[:, 1], ijk[:, 0]]
    lps = reference.to_lps(ijk.astype(np.float64))
    for path in paths:
        volume = open_volume(path)
        there = volume.to_ijk(lps)
        nearest = np.rint(there).astype(int)
        np.testing.assert_allclose(there, nearest, rtol=0, atol=1e-3, err_msg=path.name)  # the headers are float32
        np.testing.assert_array_equal(
            volume.hu_zyx[nearest[:, 2], nearest[:, 1], nearest[:, 0]], expected, err_msg=path.name
        )
        # The file names state where the axes point, in RAS letters; Carina uses L and P for the same letters.
        assert inspect_path(path).axes == path.name[:3]


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("niivue_shear.nii.gz", "import.geometry.sheared"),
        ("niivue_minimal.nii.gz", "import.geometry.orientation-unknown"),
        ("PROVENANCE.txt", "import.not-an-image"),
    ],
)
def test_public_grid_files_with_unusual_geometry_are_refused(data_dir, name, code):
    with pytest.raises(VolumeImportError) as caught:
        open_volume(data_dir / "odd" / "nifti" / name)
    assert caught.value.code == code


@pytest.mark.parametrize(
    ("path", "is_hu"),
    [
        ("ct/lung_cropped_mha/3DCT_lung.mha", True),
        ("ct/coarse_3mm_nifti/example_ct.nii.gz", True),
        ("ct/head_and_lidc2_8bit/headsq_64x64x93_int16.mha", False),
        ("ct/head_and_lidc2_8bit/LIDC2_256x256x133_uint8.mha", False),
        ("odd/nifti/niivue_mha.mha", False),
    ],
)
def test_hu_status_of_public_grid_files_is_as_expected(data_dir, path, is_hu):
    volume = open_volume(data_dir / path)
    assert volume.is_hu is is_hu
    assert (volume.not_hu_reason is None) is is_hu


def test_orientation_of_an_oblique_head_ct_at_thirty_degrees_is_preserved(data_dir):
    volume = open_volume(data_dir / "ct" / "head_and_lidc2_8bit" / "headsq_64x64x93_int16.mha")
    i_lps = volume.lps_from_ijk[:3, 0] / 3.2
    np.testing.assert_allclose(
        i_lps, [np.cos(np.pi / 6), np.sin(np.pi / 6), 0], rtol=0, atol=5e-5
    )  # the header has three digits


def test_quality_check_reports_a_ct_with_coarse_voxels(data_dir):
    volume = open_volume(data_dir / "ct" / "coarse_3mm_nifti" / "example_ct.nii.gz")
    assert any(
        finding.code == "spacing" and "generation 5" in finding.words for finding in quality_gate(volume).findings
    )


def test_nifti_with_the_suffix_gz_opens(data_dir):
    volume = open_volume(data_dir / "masks" / "thin_slice_lobes" / "Patient1" / "BronchialTree.gz")
    assert volume.shape_zyx == (587, 512, 512)


@pytest.mark.parametrize("value", ["absent", "empty"])
def test_three_slices_without_rescale_are_refused_by_name(patient_dicom, tmp_path, value):
    import pydicom

    for path in patient_dicom.iterdir():
        (tmp_path / path.name).symlink_to(path)
    for number in (40, 41, 77):
        name = f"{number:06d}.dcm"
        dataset = pydicom.dcmread(patient_dicom / name)
        if value == "absent":
            del dataset.RescaleIntercept, dataset.RescaleSlope
        else:
            dataset.RescaleIntercept = dataset.RescaleSlope = None
        (tmp_path / name).unlink()
        dataset.save_as(tmp_path / name)
    with pytest.raises(VolumeImportError) as caught:
        open_volume(tmp_path)
    assert caught.value.code == "import.rescale-mixed"
    assert "3 of its 130 slices" in str(caught.value)
    assert "000040.dcm, 000041.dcm, 000077.dcm" in str(caught.value)
