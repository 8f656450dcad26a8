"""Tests of folders with several series: choice of the CT, HU status, progress, cancellation and privacy."""

from __future__ import annotations

import json
import logging

import numpy as np
import pytest
from dicom_writer import chest, series
from pydicom.uid import generate_uid

from carina.errors import CancelledError, UsageError, VolumeImportError
from carina.volume import inspect_path, open_volume
from carina.volume.message_limits import MAX_MESSAGE_CHARS, bounded_list, bounded_message, bounded_name

SLICES = 9


def _scout(dataset, index):
    dataset.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]
    dataset.ImageOrientationPatient = [1, 0, 0, 0, 0, -1]


def test_scout_series_is_skipped_and_named(write_series, expected_hu_zyx):
    folder = write_series()
    write_series("scan", edit=_scout, num_slices=1, number=1, description="Topogram", name=lambda i: "scout")
    volume = open_volume(folder)
    np.testing.assert_array_equal(volume.hu_zyx, expected_hu_zyx)
    assert [info.description for info in volume.source.other_series] == ["Topogram"]
    assert any("several series" in text and "Topogram" in text for text in volume.source.warnings)


def test_scout_in_the_same_series_is_skipped(write_series, expected_hu_zyx):
    uid = generate_uid()
    folder = write_series(series_uid=uid)
    write_series("scan", edit=_scout, num_slices=1, series_uid=uid, name=lambda i: "scout")
    np.testing.assert_array_equal(open_volume(folder).hu_zyx, expected_hu_zyx)


def test_largest_chest_ct_is_opened_and_other_series_can_be_selected(write_series):
    folder = write_series(number=2, num_slices=5)
    write_series("scan", number=7, name=lambda i: f"B{i}")
    write_series(
        "scan", number=7, num_slices=12, name=lambda i: f"C{i}", edit=lambda d, i: setattr(d, "Modality", "MR")
    )
    volume = open_volume(folder)
    assert volume.source.series is not None
    assert (volume.source.series.key, volume.shape_zyx[0]) == ("7", SLICES)
    assert {info.key for info in volume.source.other_series} == {"2", "7-2"}
    assert open_volume(folder, series="2").shape_zyx[0] == 5
    assert not open_volume(folder, series="7-2").is_hu
    with pytest.raises(UsageError, match="no series '9'"):
        open_volume(folder, series="9")


def test_series_described_as_chest_is_opened_before_one_with_a_few_more_slices(write_series):
    folder = write_series(number=1, description="Lung 1.0", num_slices=7)
    write_series("scan", number=2, description="Abdomen", name=lambda i: f"B{i}")
    assert open_volume(folder).source.title == "Lung 1.0"


def test_another_series_replaces_a_refused_one_only_if_half_as_long(write_series):
    def gap(dataset, index):
        if index >= 5:
            dataset.ImagePositionPatient = [-31.5 - 3.0 * index, 12.25, 140.0]

    folder = write_series(number=1, edit=gap)
    write_series("scan", number=2, num_slices=2, name=lambda i: f"B{i}")
    with pytest.raises(VolumeImportError, match="also contains series 2") as caught:
        open_volume(folder)
    assert caught.value.code.startswith("import.geometry.")
    write_series(
        "scan", number=3, num_slices=25, name=lambda i: f"C{i}", edit=lambda d, i: setattr(d, "Modality", "MR")
    )
    with pytest.raises(VolumeImportError):
        open_volume(folder)  # an MR series does not replace a CT
    assert open_volume(folder, series="2").shape_zyx[0] == 2


def test_complete_series_replaces_a_refused_one_with_a_warning(write_series):
    folder = write_series(number=1)
    (folder / "IM004").unlink()
    write_series("scan", number=2, num_slices=6, name=lambda i: f"B{i}")
    volume = open_volume(folder)
    assert volume.source.series is not None
    assert volume.source.series.key == "2"
    assert any("the largest series was refused" in text and "irregular" in text for text in volume.source.warnings)


def test_info_about_a_folder_states_what_would_be_refused(write_series):
    folder = write_series()
    (folder / "IM004").unlink()
    found = inspect_path(folder)
    assert found.refused_code == "import.geometry.irregular"
    assert found.to_json()["series"][0]["num_slices"] == SLICES - 1


def test_info_about_a_folder_gives_the_geometry_without_reading_pixels(write_series, expected_lps_from_ijk):
    folder = write_series(edit=lambda d, i: setattr(d, "PixelData", b""))
    found = inspect_path(folder)
    np.testing.assert_allclose(found.lps_from_ijk, expected_lps_from_ijk, rtol=0, atol=1e-8)
    # The axes point to left, inferior and posterior; all of them are more than 1 degree oblique.
    assert found.axes == "lip"


def test_values_of_an_mr_series_are_not_hu(write_series):
    volume = open_volume(write_series(edit=lambda d, i: setattr(d, "Modality", "MR")))
    assert not volume.is_hu
    assert "MR" in (volume.not_hu_reason or "")


def test_8_bit_series_is_not_hu(write_series):
    def eight_bits(dataset, index):
        dataset.BitsAllocated = dataset.BitsStored = 8
        dataset.HighBit, dataset.PixelRepresentation = 7, 0
        dataset.RescaleSlope = 4
        dataset.PixelData = (np.frombuffer(dataset.PixelData, "<i2") // 8).astype(np.uint8).tobytes() + b"\0"

    volume = open_volume(write_series(edit=eight_bits))
    assert not volume.is_hu
    assert "8 bits" in (volume.not_hu_reason or "")


def test_ct_without_rescale_tags_is_not_hu(write_series):
    def drop(dataset, index):
        del dataset.RescaleSlope, dataset.RescaleIntercept

    volume = open_volume(write_series(edit=drop))
    assert not volume.is_hu
    assert "no rescale tags" in (volume.not_hu_reason or "")


def test_import_result_contains_no_patient_data(write_series, caplog, capfd):
    uid = generate_uid()
    caplog.set_level(logging.DEBUG)

    def odd(dataset, index):
        dataset.add_new("SliceLocation", "DS", "1")
        dataset.SpecificCharacterSet = "ISO_IR 100"

    folder = write_series(series_uid=uid, edit=odd, name=lambda i: f"CT.1.2.840.113.{i}.99.7")
    write_series("scan", number=8, num_slices=1, name=lambda i: "CT.1.2.840.113.77.99.1")
    volume = open_volume(folder)
    assert "(file name)" in (volume.source.other_series[0].refused or "")
    text = repr(volume) + repr(volume.source) + str(inspect_path(folder).to_json())
    text += caplog.text + "".join(capfd.readouterr())
    for secret in ("Secret", "SECRET-ID", uid, "1.2.840.113"):
        assert secret not in text


def test_progress_of_an_import_increases_and_it_can_be_cancelled_at_every_step(write_series):
    folder = write_series()
    seen: list[tuple[str, float | None]] = []
    open_volume(folder, progress=lambda what, fraction: seen.append((what, fraction)))
    slices = [fraction for what, fraction in seen if what == "Reading the slices"]
    assert len(slices) >= 2  # one report for each batch of slices
    assert slices == sorted(slices)
    assert (slices[0], slices[-1]) == (0.0, 1.0)
    # Cancelling at each call in turn raises CancelledError and never gives an incomplete volume.
    for stop_at in range(len(seen)):
        checks = iter(range(len(seen) + 1))
        with pytest.raises(CancelledError):
            open_volume(folder, cancel=lambda checks=checks, stop_at=stop_at: next(checks) >= stop_at)


def test_import_messages_are_limited_in_length_if_every_image_is_a_separate_series(tmp_path, write_series):
    """Use images that all have different studies, so that the folder seems to contain many series of one image."""
    names = [f"{'long-name-' * 18}{index:03d}.dcm" for index in range(40)]
    folder = write_series(
        num_slices=40,
        name=lambda index: names[index],
        description="D" * 64,
        edit=lambda dataset, index: setattr(dataset, "StudyInstanceUID", f"1.2.3.{index + 1}"),
    )
    with pytest.raises(VolumeImportError) as caught:
        open_volume(folder)
    assert len(str(caught.value)) <= 600
    assert caught.value.code == "import.single-slice"
    inspection = inspect_path(folder)
    assert inspection.refused is not None
    assert len(inspection.refused) <= 600
    assert len(inspection.series) == 40  # --json lists all series
    with pytest.raises(UsageError) as usage:
        open_volume(folder, series="99")
    assert len(str(usage.value)) <= 600


def test_shortened_message_contains_its_beginning_and_its_remedy():
    message = f"reading scan: {'x' * 5000}; export the series again"
    short = bounded_message(message)
    assert len(short) == MAX_MESSAGE_CHARS
    assert short.startswith("reading scan: x")
    assert short.endswith("; export the series again")
    assert bounded_message("short") == "short"
    assert bounded_list(["a", "b", "c"], at_most=2) == "a; b and 1 more"
    assert bounded_name("n" * 200).count("n") == 56


def test_slice_thickness_is_stored_if_all_slices_state_the_same_value(write_series, expected_lps_from_ijk):
    volume = open_volume(write_series())
    assert volume.source.slice_thickness_mm == 5.0
    np.testing.assert_allclose(volume.lps_from_ijk, expected_lps_from_ijk)


@pytest.mark.parametrize("thickness", ["", "0", "-2", "500", None])
def test_impossible_or_missing_slice_thickness_is_unknown(write_series, thickness):
    def edit(dataset, _index):
        if thickness is None:
            del dataset.SliceThickness
        else:
            dataset.SliceThickness = thickness

    assert open_volume(write_series(edit=edit)).source.slice_thickness_mm is None


def test_slice_thickness_of_slices_with_two_different_values_is_unknown(write_series):
    def edit(dataset, index):
        dataset.SliceThickness = 5.0 if index else 2.5

    assert open_volume(write_series(edit=edit)).source.slice_thickness_mm is None


def test_listed_series_state_distance_thickness_kernel_and_phase(tmp_path):
    def edit(dataset, index):
        dataset.SliceThickness = 3.0
        dataset.NominalPercentageOfCardiacPhase = 70
        dataset.AcquisitionDate = "20261130"

    folder = series(tmp_path / "scan", edit)
    series(tmp_path / "scan" / "second", number=4, hu=chest(12, seed=6))
    first, second = inspect_path(folder).series
    assert (first.slice_distance_mm, first.height_mm, first.thickness_mm) == (2.5, 47.5, 3.0)
    assert (first.kernel, first.phase, first.acquired_on) == ("b41f", "heart 70 %", "2026-11-30")
    assert (second.thickness_mm, second.phase, second.acquired_on) == (None, "", None)
    assert "2026" not in json.dumps(inspect_path(folder).to_json()) + repr(first)
    (note,) = open_volume(folder).source.notes
    assert "(the likeliest chest CT: 48 mm in slices 2.5 mm apart, named as a chest)" in note.words
