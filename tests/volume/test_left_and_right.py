"""Tests of headers whose signs are ambiguous: some programs would mirror the patient."""

from __future__ import annotations

import struct

import grid_writers as grids
import nifti_qform_writer
import numpy as np
import pytest

from carina.errors import VolumeImportError
from carina.volume import open_mask, open_volume

REMEDY = "open the DICOM series that it was made from, or convert that series again"


def patched(path, *floats: tuple[int, float]):
    """Write float32 values at byte offsets of a NIfTI header; pixdim[n] is at 76 + 4 n."""
    data = bytearray(path.read_bytes())
    for offset, value in floats:
        struct.pack_into("<f", data, offset, value)
    path.write_bytes(bytes(data))
    return path


def refusal(path) -> str:
    with pytest.raises(VolumeImportError) as caught:
        open_volume(path)
    assert caught.value.code == "import.geometry.ambiguous"
    assert caught.value.exit_code == 3
    assert REMEDY in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("axis", [1, 2, 3])
@pytest.mark.parametrize("forms", [(1, 0), (0, 1), (1, 1)])
def test_negative_voxel_spacing_is_refused_with_each_nifti_transform(tmp_path, axis, forms):
    path = nifti_qform_writer.with_both_forms(tmp_path, grids.LPS_FROM_IJK, grids.LPS_FROM_IJK)
    data = bytearray(path.read_bytes())
    struct.pack_into("<2h", data, 252, *forms)
    path.write_bytes(bytes(data))
    open_volume(path)
    text = refusal(patched(path, (76 + 4 * axis, -grids.SPACING_MM[axis - 1])))
    assert f"its pixdim[{axis}] is -{grids.SPACING_MM[axis - 1]:g}, but a voxel spacing should be positive" in text


@pytest.mark.parametrize("qfac", [-2.0, -0.5, float("nan"), float("-inf")])
def test_nifti_file_with_an_ambiguous_qfac_is_refused(tmp_path, qfac):
    path = nifti_qform_writer.with_qform(tmp_path, grids.LPS_FROM_IJK)
    assert f"its pixdim[0] (qfac) is {qfac:g}, but it should be 1 or -1" in refusal(patched(path, (76, qfac)))


@pytest.mark.parametrize("qfac", [1.0, 0.0, 2.0])
def test_nifti_file_with_an_unambiguous_qfac_opens(tmp_path, qfac):
    path = nifti_qform_writer.with_qform(tmp_path, grids.LPS_FROM_IJK)
    volume = open_volume(patched(path, (76, qfac)))
    np.testing.assert_allclose(volume.lps_from_ijk, grids.LPS_FROM_IJK, rtol=0, atol=2e-5)


def test_nifti_qfac_of_minus_one_mirrors_the_third_axis(tmp_path):
    mirrored = grids.LPS_FROM_IJK.copy()
    mirrored[:3, 2] *= -1
    volume = open_volume(nifti_qform_writer.with_qform(tmp_path, mirrored))
    np.testing.assert_allclose(volume.lps_from_ijk, mirrored, rtol=0, atol=2e-5)


def test_nifti_file_with_an_sform_opens_with_any_qfac(tmp_path):
    volume = open_volume(patched(grids.nifti(tmp_path, grids.chest()), (76, -2.0)))
    np.testing.assert_allclose(volume.lps_from_ijk, grids.LPS_FROM_IJK, rtol=0, atol=2e-5)


@pytest.mark.parametrize("axis", [1, 2, 3])
def test_mask_with_a_negative_voxel_spacing_is_refused(tmp_path, axis):
    scan = open_volume(grids.nifti(tmp_path, grids.chest()))
    labels = (grids.chest() == -860).astype(np.int16)
    path = nifti_qform_writer.with_qform(tmp_path, grids.LPS_FROM_IJK, labels, name="mask.nii")
    np.testing.assert_array_equal(open_mask(path, scan).inside_zyx, labels)
    with pytest.raises(VolumeImportError, match=r"left and right are unknown") as caught:
        open_mask(patched(path, (76 + 4 * axis, -1.0)), scan)
    assert caught.value.code == "import.geometry.ambiguous"


@pytest.mark.parametrize("text", ["-0.7 0.9 1.25", "0.7 -0.9 1.25", "0.7 0.9 -1.25", "0.7 0.9 0", "nan 0.9 1.25"])
@pytest.mark.parametrize("name", ["ElementSpacing", "ElementSize"])
def test_metaimage_spacing_that_is_not_positive_is_refused_with_its_value(tmp_path, text, name):
    def edit(lines):
        lines[7] = f"{name} = {text}"

    with pytest.raises(VolumeImportError, match=f"its {name} should be positive") as caught:
        open_volume(grids.metaimage(tmp_path, grids.chest(), edit=edit))
    assert text in str(caught.value)
    assert caught.value.code == "import.geometry.spacing"


def test_nrrd_with_negative_spacings_and_no_directions_is_refused(tmp_path):
    def edit(lines):
        lines[6] = "spacings: -0.7 0.9 1.25"

    with pytest.raises(VolumeImportError) as caught:
        open_volume(grids.nrrd(tmp_path, grids.chest(), edit=edit))
    assert caught.value.code == "import.geometry.orientation-unknown"


def test_nrrd_with_directions_and_negative_spacings_is_refused(tmp_path):
    with pytest.raises(VolumeImportError):
        open_volume(grids.nrrd(tmp_path, grids.chest(), edit=lambda lines: lines.append("spacings: -0.7 0.9 1.25")))
