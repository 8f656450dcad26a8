"""Tests of padding around the picture: its detection, its distinction from tissue, and its replacement."""

from __future__ import annotations

import numpy as np
import pytest
from corpus_dicom_values import OUTSIDE, ringed, with_lut
from dicom_writer import chest, series
from grid_writers import nifti
from pydicom.dataset import Dataset

from carina.volume import Volume, open_volume
from carina.volume.dicom_headers import read_image_headers
from carina.volume.dicom_modality_lut import read_modality_lut
from carina.volume.dicom_pixels import decode_slice
from carina.volume.padding import find_padding, padding_ranges, without_corner_padding

BITS = {"bits_allocated": 16, "bits_stored": 16, "high_bit": 15}


@pytest.mark.parametrize(
    ("value", "limit", "signed", "expected"),
    [
        (63536, None, False, ((63536, 63536),)),
        (-2000, None, False, ((63536, 63536),)),
        (63536, None, True, ((-2000, -2000),)),
        (-2000, None, True, ((-2000, -2000),)),
        (63536, 60000, False, ((60000, 63536),)),
        (-2000, -3000, True, ((-3000, -2000),)),
    ],
)
def test_bits_of_the_padding_tag_are_read_in_the_pixel_representation(value, limit, signed, expected):
    assert padding_ranges(value, limit, signed=signed, **BITS) == expected


def test_padding_tag_beyond_bits_stored_is_reduced_to_the_stored_bits():
    bits = {"bits_allocated": 16, "bits_stored": 12, "high_bit": 11}
    assert padding_ranges(63536, None, signed=False, **bits) == ((63536, 63536), (2096, 2096))
    # Both ends of this range are reduced differently, so the range cannot be represented in 12 bits.
    assert padding_ranges(63536, 60000, signed=False, **bits) == ((60000, 63536),)


def _plane() -> np.ndarray:
    return chest()[5].astype(np.int32)


def test_padding_value_in_the_tissue_range_counts_only_at_the_edge_of_the_slice():
    plane = _plane()
    plane[OUTSIDE] = 40
    plane[12:17, 2:6] = 40  # The block is 20 equal pixels of muscle that do not touch the edge.
    found = find_padding(plane, plane, ((40, 40),))
    assert found is not None
    np.testing.assert_array_equal(found.inside, OUTSIDE)
    assert (found.value, found.fill, found.is_marked) == (40, float(plane[~OUTSIDE].min()), True)
    assert found.num_unchanged >= 20


def test_small_regions_at_the_edge_are_not_padding():
    plane = _plane()
    plane[0, 3:18] = 40  # 15 pixels
    assert find_padding(plane, plane, ((40, 40),)) is None
    plane[0, 3:19] = 40  # 16 pixels
    found = find_padding(plane, plane, ((40, 40),))
    assert found is not None
    assert np.count_nonzero(found.inside) == 16


def test_padding_value_above_the_hu_scale_counts_everywhere_and_a_lower_value_only_at_the_edge():
    for value, count in ((30_710, 0), (30_711, 4)):
        plane = _plane()
        plane[14:16, 14:16] = value
        found = find_padding(plane, plane, ((value, value),))
        assert (0 if found is None else np.count_nonzero(found.inside)) == count


@pytest.mark.parametrize(("value", "is_padding"), [(-1000, False), (-999, True)])
def test_padding_with_the_value_of_air_is_unchanged(value, is_padding):
    plane = np.maximum(_plane(), -1020)
    plane[OUTSIDE] = value
    assert (find_padding(plane, plane, ((value, value),)) is not None) == is_padding


@pytest.mark.parametrize(("value", "is_padding"), [(1999, False), (2000, True)])
def test_equal_high_values_in_all_corners_count_as_padding_without_a_tag(value, is_padding):
    plane = _plane()
    plane[OUTSIDE] = value
    assert (find_padding(plane, plane, ()) is not None) == is_padding
    plane[0, 0] = 30  # one corner differs
    assert find_padding(plane, plane, ()) is None


def test_values_without_their_rescale_offset_are_recognised_as_not_hu_despite_padding(tmp_path):
    """Check that values which are 1024 too high stay recognisable: padding becomes their lowest value, not -1024."""
    make = ringed(63536, tag=63536, RescaleIntercept=0)
    volume = open_volume(make(tmp_path))
    assert not volume.is_hu
    assert volume.value_range[0] == 0


def test_padding_value_that_may_be_tissue_gives_a_badge(tmp_path):
    notes = open_volume(ringed(1024, tag=1024)(tmp_path / "tissue")).source.notes
    assert [(note.code, note.badge) for note in notes] == [("import.padding", True)]
    notes = open_volume(ringed(63536, tag=63536)(tmp_path / "impossible")).source.notes
    assert [(note.code, note.badge) for note in notes] == [("import.padding", False)]
    share = 100 * OUTSIDE.mean()
    assert notes[0].words.startswith(f"{share:.2g} % of the voxels are marked as padding")


def test_padding_tag_of_text_or_bytes_is_read(tmp_path):
    """Use a PixelPaddingValue with the value representation OW or DS, as some programs write it."""
    for vr, value in (("OW", np.array([63536], "<u2").tobytes()), ("DS", "63536")):
        folder = tmp_path / vr
        make = ringed(63536)
        make(folder)
        series(
            folder,
            lambda dataset, index, vr=vr, value=value: _marked(dataset, index, vr, value),
        )
        notes = open_volume(folder).source.notes
        assert "are marked as padding" in notes[0].words


def _marked(dataset: Dataset, index: int, vr: str, value: object) -> None:
    words = (chest()[index] + 1024).astype(np.uint16)
    words[OUTSIDE] = 63536
    dataset.PixelData = words.tobytes()
    dataset.add_new(0x00280120, vr, value)


@pytest.mark.parametrize(("ring", "becomes"), [(32767, None), (3071, None), (-3024, -3024), (-2000, -2000)])
def test_padding_of_a_nifti_file_is_detected_by_its_corners(tmp_path, ring, becomes):
    """Use NIfTI, which has no padding tag: a high value in all eight corners is padding, a low value is not."""
    values = chest().copy()
    values[:, OUTSIDE] = ring
    volume = open_volume(nifti(tmp_path, values))
    expected = values.copy()
    expected[:, OUTSIDE] = values[:, ~OUTSIDE].min() if becomes is None else becomes
    np.testing.assert_array_equal(volume.hu_zyx, expected)
    assert volume.is_hu
    assert [note.code for note in volume.source.notes] == (["import.padding"] if becomes is None else [])


def test_metal_inside_a_padded_volume_without_tags_is_unchanged():
    values = chest().copy()
    values[:, OUTSIDE] = 3071
    values[9, 14:16, 14:16] = 3071
    hu, notes = without_corner_padding(values)
    assert (hu[9, 14:16, 14:16] == 3071).all()
    assert "4 voxels" in notes[0].words
    assert without_corner_padding(chest())[0] is chest()


def test_radiograph_of_a_padded_ct_is_not_black(tmp_path):
    """Check the brightest voxel along each ray, which is bone or metal and not padding."""
    volume = open_volume(ringed(63536, tag=63536)(tmp_path))
    assert isinstance(volume, Volume)
    assert volume.hu_zyx.max() == chest()[:, ~OUTSIDE].max()


def _lut_item(descriptor: list[int], data: bytes) -> Dataset:
    item = Dataset()
    item.add_new(0x00283002, "US", descriptor)
    item.add_new(0x00283006, "OW", data)
    return item


def test_values_outside_a_lookup_table_get_its_first_and_last_entry():
    lut = read_modality_lut(
        _lut_item([3, 0xFFFE, 16], np.array([7, 8, 9], "<u2").tobytes()), signed=True, little_endian=True
    )
    np.testing.assert_array_equal(lut.values(np.array([-9, -2, -1, 0, 50], np.int32)), [7, 7, 8, 9, 9])


def test_lookup_table_of_bytes_and_lookup_table_of_all_values_are_read():
    lut = read_modality_lut(_lut_item([4, 0, 8], bytes([1, 2, 3, 4])), signed=False, little_endian=True)
    np.testing.assert_array_equal(lut.values(np.array([0, 3], np.int32)), [1, 4])
    every = np.arange(1 << 16)[::-1].astype(">u2")
    lut = read_modality_lut(_lut_item([0, 0, 16], every.tobytes()), signed=False, little_endian=False)
    np.testing.assert_array_equal(lut.values(np.array([0, 65535], np.int32)), [65535, 0])


def test_lookup_table_that_repeats_the_rescale_is_accepted(tmp_path):
    def edit(dataset: Dataset, index: int) -> None:
        item = _lut_item([4096, 0, 16], np.arange(4096).astype("<u2").tobytes())
        dataset.ModalityLUTSequence, dataset.RescaleIntercept = [item], 0

    series(tmp_path, edit)
    (header,), _ = read_image_headers(tmp_path / "IM003")
    assert header is not None
    assert decode_slice(header).doubts == ()
    (doubt,) = decode_slice(read_image_headers(with_lut(rescale=True)(tmp_path / "b") / "IM003")[0][0]).doubts
    assert doubt.code == "import.modality-lut"
