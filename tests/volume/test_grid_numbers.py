"""Tests of the voxel values of grid files: equal in every format, with one rule for values that are not finite."""

from __future__ import annotations

import gzip
import itertools

import grid_writers as grids
import numpy as np
import pytest

from carina.errors import VolumeImportError
from carina.volume import open_mask, open_volume
from carina.volume.hu import MAX_DOUBTFUL_SHARE, to_int16

FORMS = sorted(grids.FORMS)
KINDS = ["<f4", ">f4", "<f8", ">f8"]


def with_gaps(rng: np.random.Generator, num: int) -> np.ndarray:
    """Return a small chest of floats with ``num`` voxels each of NaN, +infinity and -infinity."""
    values = grids.chest().astype(np.float64)
    at = rng.choice(values.size, 3 * num, replace=False)
    values.reshape(-1)[at] = np.repeat([np.nan, np.inf, -np.inf], num)
    return values


def ruled(values: np.ndarray) -> np.ndarray:
    """Return the expected int16: +infinity becomes the highest finite value, NaN and -infinity the lowest."""
    finite = values[np.isfinite(values)]
    out = np.where(values == np.inf, finite.max(), values)
    return np.where(np.isfinite(out), out, finite.min()).astype(np.int16)


@pytest.mark.parametrize("form", FORMS)
def test_array_with_nan_and_infinite_values_gives_equal_voxels_in_every_format(tmp_path, rng, form):
    for number, (kind, num) in enumerate(itertools.product(KINDS, (1, 5))):
        values = with_gaps(rng, num)
        folder = tmp_path / str(number)
        folder.mkdir()
        volume = open_volume(grids.FORMS[form](folder, values.astype(kind)))
        np.testing.assert_array_equal(volume.hu_zyx, ruled(values), err_msg=f"{form} {kind}")
        (note,) = volume.source.notes
        assert (note.code, note.badge) == ("import.not-numbers", True)
        assert note.words.startswith(f"{3 * num} voxels are not finite (NaN or infinite)")
        assert f"{2 * num} became the lowest value (-1000) and {num} the highest (1200)" in note.words
        assert volume.is_hu


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["<i2", ">i2", "<i4", "<f4", ">f8", "<i8"])
def test_integer_array_gives_equal_voxels_in_every_format(tmp_path, form, kind):
    volume = open_volume(grids.FORMS[form](tmp_path, grids.chest().astype(kind)))
    np.testing.assert_array_equal(volume.hu_zyx, grids.chest())
    np.testing.assert_allclose(volume.lps_from_ijk, grids.LPS_FROM_IJK, rtol=0, atol=2e-5)
    assert volume.is_hu
    assert volume.source.notes == ()


def lost(num: int) -> np.ndarray:
    """Return a chest in which the given number of lung voxels is NaN."""
    values = grids.chest().astype(np.float32)
    lung = np.flatnonzero(values == -860)
    values.reshape(-1)[lung[:num]] = np.nan
    return values


def num_body() -> int:
    """Return the number of voxels in the box of the body."""
    return int(np.prod([n - 2 * grids.AIR for n in grids.SHAPE_ZYX[1:]])) * grids.SHAPE_ZYX[0]


def test_hu_status_is_lost_above_one_percent_of_nan_in_the_body():
    border = int(MAX_DOUBTFUL_SHARE * num_body())
    assert to_int16(lost(border)).doubt is None
    assert "1.0 % of the voxels in the body are not finite" in (to_int16(lost(border + 1)).doubt or "")


def test_nan_padding_around_the_patient_does_not_remove_the_hu_status(tmp_path):
    values = grids.chest().astype(np.float32)
    values[:, : grids.AIR] = np.nan
    values[:, :, -grids.AIR :] = np.nan
    volume = open_volume(grids.FORMS["nifti"](tmp_path, values))
    assert volume.is_hu
    assert volume.source.notes[0].badge


def test_nan_slices_inside_the_body_count_as_voxels_of_the_body():
    values = grids.chest().astype(np.float32)
    values[5] = np.nan
    assert "of the voxels in the body" in (to_int16(values).doubt or "")


def test_hu_status_is_lost_above_one_percent_of_clipped_voxels():
    values = grids.chest().astype(np.int32)
    values[0, 0, :3] = 70_000
    assert to_int16(values).doubt is None
    values[:2, 0] = 70_000
    values[2, 0] = -70_000
    assert "outside -32768 to 32767" in (to_int16(values).doubt or "")
    assert to_int16(values).notes[0].code == "import.clipped"


def test_import_does_not_change_the_array_of_its_caller():
    values = lost(7)
    before = values.copy()
    to_int16(values)
    np.testing.assert_array_equal(values, before)


def test_any_byte_missing_in_a_file_of_several_gzip_members_is_detected(tmp_path):
    whole = grids.nifti(tmp_path, grids.chest()).read_bytes()
    packed = b"".join(gzip.compress(whole[at : at + 700]) for at in range(0, len(whole), 700))
    path = tmp_path / "many.nii.gz"
    path.write_bytes(packed)
    np.testing.assert_array_equal(open_volume(path).hu_zyx, grids.chest())
    for cut in range(1, 120, 7):
        path.write_bytes(packed[:-cut])
        with pytest.raises(VolumeImportError) as caught:
            open_volume(path)
        assert caught.value.code == "import.truncated"


def test_mask_with_nonfinite_values_is_refused_in_every_format(tmp_path):
    values = (grids.chest() == -860).astype(np.float32)
    values[2, 9, 9] = np.nan
    scan = open_volume(grids.nifti(tmp_path, grids.chest()))
    for form in FORMS:
        folder = tmp_path / form
        folder.mkdir()
        with pytest.raises(VolumeImportError, match="expected whole numbers"):
            open_mask(grids.FORMS[form](folder, values), scan)


@pytest.mark.parametrize(
    ("form", "names"),
    [
        ("nifti", ("CT.NII", "\u00fcber ct (1).nii", "scan", "ct.dcm")),
        ("nifti gzip", ("CT.NII.GZ", "ct.gz", "CT.nii.Gz")),
        ("nifti pair", ("ct.hdr", "Ct.Hdr")),
        ("nrrd", ("CT.NRRD", "ct", "x.nhdr")),
        ("nrrd detached", ("CT.NHDR", "head.txt")),
        ("metaimage", ("CT.MHA", "ct.mhd", "foo")),
        ("metaimage detached", ("CT.MHD", "head")),
    ],
)
def test_format_of_a_grid_file_is_recognised_with_any_file_name(tmp_path, form, names):
    for number, name in enumerate(names):
        folder = tmp_path / str(number)
        folder.mkdir()
        path = grids.FORMS[form](folder, grids.chest())
        named = path.rename(folder / name)
        if name == "Ct.Hdr":
            (folder / "ct.img").rename(folder / "Ct.IMG")
        volume = open_volume(named)
        np.testing.assert_array_equal(volume.hu_zyx, grids.chest(), err_msg=name)
        np.testing.assert_allclose(volume.lps_from_ijk, grids.LPS_FROM_IJK, rtol=0, atol=2e-5)


@pytest.mark.parametrize("form", ["nifti", "nrrd", "metaimage", "nifti gzip"])
def test_changed_byte_of_a_grid_header_causes_no_crash_and_no_library_message(tmp_path, capfd, rng, form):
    path = grids.FORMS[form](tmp_path, grids.chest())
    whole = path.read_bytes()
    ends = {"nifti": lambda: 348, "nrrd": lambda: whole.index(b"\n\n"), "metaimage": lambda: whole.index(b"LOCAL")}
    end = ends.get(form, lambda: len(whole))()
    opened, refusals = 0, []
    for _ in range(250):
        data = bytearray(whole)
        at = int(rng.integers(end))
        if rng.random() < 0.7:
            data[at] = int(rng.integers(256))
        else:
            del data[at : at + int(rng.integers(1, 9))]
        path.write_bytes(bytes(data))
        try:
            open_volume(path)
            opened += 1
        except VolumeImportError as error:
            refusals.append(str(error))
    assert all(path.name in text for text in refusals)
    assert len(refusals) + opened == 250
    assert refusals
    assert capfd.readouterr().err == ""


def test_imported_mask_reports_the_doubts_about_its_file(tmp_path):
    scan = open_volume(grids.nifti(tmp_path, grids.chest(), lps_from_ijk=np.eye(4)))
    values = (grids.chest() == -860).astype(np.int16)
    path = grids.nifti(tmp_path, values, lps_from_ijk=np.eye(4), name="mask.nii", behind=values.tobytes())
    mask = open_mask(path, scan)
    np.testing.assert_array_equal(mask.inside_zyx, values)
    assert mask.notes == (
        "the segmentation: the file contains 11520 bytes more than its header states; they were ignored",
    )
