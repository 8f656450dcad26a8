"""Tests of the second reader of grid headers against SimpleITK, with random oblique grids and real headers."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk
from hypothesis import given, settings
from hypothesis import strategies as st

from carina.volume.grid_headers import read_grid_header, sniff_format
from carina.volume.grid_second_reader import read_geometry

IMAGE_IO = {"nifti": "NiftiImageIO", "nrrd": "NrrdImageIO", "metaimage": "MetaImageIO"}
SUFFIXES = {"nifti": "nii", "nrrd": "nrrd", "metaimage": "mha"}
RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def rotation(axis: np.ndarray, angle: float) -> np.ndarray:
    """Return a rotation as the product of two reflections."""
    axis = axis / np.linalg.norm(axis)
    other = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    other /= np.linalg.norm(other)
    half = np.cos(angle / 2) * other + np.sin(angle / 2) * np.cross(axis, other)
    one, two = (np.eye(3) - 2 * np.outer(normal, normal) for normal in (other, half))
    return two @ one


def by_itk(path: Path, form: str) -> np.ndarray:
    reader = sitk.ImageFileReader()
    reader.SetImageIO(IMAGE_IO[form])
    reader.SetFileName(str(path))
    reader.ReadImageInformation()
    found = np.eye(4)
    found[:3, :3] = np.reshape(reader.GetDirection(), (3, 3)) * reader.GetSpacing()
    found[:3, 3] = reader.GetOrigin()
    return found


@pytest.mark.parametrize("form", IMAGE_IO)
@settings(max_examples=60, deadline=None)
@given(
    axis=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda vector: np.linalg.norm(vector) > 0.1),
    angle=st.one_of(st.sampled_from([0.0, np.pi / 2, np.pi]), st.floats(-np.pi, np.pi)),
    # A negative spacing stands for a mirrored axis.
    spacing=st.tuples(*[st.floats(0.3, 5.0)] * 2, st.floats(0.3, 5.0).flatmap(lambda mm: st.sampled_from([mm, -mm]))),
)
def test_geometry_of_any_grid_equals_that_of_simpleitk(tmp_path_factory, form, axis, angle, spacing):
    direction = rotation(np.array(axis), angle) @ np.diag(np.sign([1.0, 1.0, spacing[2]]))
    image = sitk.GetImageFromArray(np.zeros((2, 3, 4), dtype=np.int16))
    image.SetDirection(direction.ravel())
    image.SetSpacing(np.abs(spacing).tolist())
    image.SetOrigin((-31.5, 12.25, 140.0))
    path = tmp_path_factory.mktemp("grid") / f"grid.{SUFFIXES[form]}"
    sitk.WriteImage(image, str(path))
    shape_ijk, lps_from_ijk = read_geometry(read_grid_header(path, form).head, form)
    assert shape_ijk == (4, 3, 2)
    # NIfTI stores float32 numbers.
    np.testing.assert_allclose(lps_from_ijk, by_itk(path, form), rtol=0, atol=2e-5 if form == "nifti" else 1e-9)


@settings(max_examples=60, deadline=None)
@given(
    axis=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda vector: np.linalg.norm(vector) > 0.1),
    angle=st.one_of(st.sampled_from([0.0, np.pi]), st.floats(0, np.pi)),
    qfac=st.sampled_from([-1.0, 0.0, 1.0]),
    order=st.sampled_from("<>"),
)
def test_qform_alone_in_either_byte_order_gives_the_rotation(axis, angle, qfac, order):
    axis = np.array(axis) / np.linalg.norm(axis)
    head = bytearray(348)
    struct.pack_into(f"{order}i", head, 0, 348)
    struct.pack_into(f"{order}8h", head, 40, 3, 4, 5, 6, 1, 1, 1, 1)
    struct.pack_into(f"{order}4f", head, 76, qfac, 0.7, 0.9, 1.25)
    head[123] = 2
    struct.pack_into(f"{order}2h6f", head, 252, 1, 0, *(np.sin(angle / 2) * axis), 5.0, 6.0, 7.0)
    shape_ijk, lps_from_ijk = read_geometry(bytes(head), "nifti")
    assert shape_ijk == (4, 5, 6)
    expected = np.eye(4)
    expected[:3, :3] = rotation(axis, angle) * [0.7, 0.9, 1.25 * (-1 if qfac < 0 else 1)]
    expected[:3, 3] = 5.0, 6.0, 7.0
    # A float32 sine near 1 determines a half turn to about 5e-4 rad.
    np.testing.assert_allclose(lps_from_ijk, RAS_TO_LPS @ expected, rtol=0, atol=1e-3)


@pytest.mark.parametrize("form", IMAGE_IO)
def test_header_without_a_geometry_is_refused_with_a_value_error(form):
    for head in (b"", b"NRRD0004\n", bytes(348), b"NDims = 3\nDimSize = 1\n"):
        with pytest.raises(ValueError):  # noqa: PT011 - the caller converts every ValueError to one message
            read_geometry(head, form)


@pytest.mark.data
def test_real_headers_have_the_same_geometry_in_both_readers(data_dir):
    files = [path for path in sorted((data_dir / "odd").rglob("*")) if path.is_file() and ".nii" in path.name]
    compared = 0
    for path in files:
        try:
            header = read_grid_header(path, sniff_format(path) or "")
        except (ValueError, OSError):
            continue
        shape_ijk, lps_from_ijk = read_geometry(header.head, header.format)
        assert shape_ijk == header.shape_ijk
        np.testing.assert_allclose(lps_from_ijk, header.lps_from_ijk, rtol=0, atol=1e-3)
        compared += 1
    assert compared > 0
