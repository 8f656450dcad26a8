"""Tests of the DICOM import beside the corpus: permissions, threads, intact pictures, lists and texts."""

from __future__ import annotations

import io
import os
import threading
from pathlib import Path

import numpy as np
import pytest
from dicom_writer import chest, packed, repack, series

from carina import _core
from carina.cli.info import report
from carina.errors import VolumeImportError
from carina.volume import dicom_slice_batches, inspect_path, open_volume
from carina.volume.dicom_checks import odd_slices
from carina.volume.dicom_pixels import _byte_order_doubts
from carina.volume.dicom_streams import decoder_words, rle_problem

SECRETS = ("Secret", "SECRET", "1.2.3.98", "1.2.3.4.5")


def _deny(monkeypatch, *names: str) -> None:
    """Simulate that the files with these names may not be read; the user root could read every file."""
    whole = Path.open

    def refuse(path: Path, *args, **kwargs):
        if path.name in names:
            raise PermissionError(13, "Permission denied", str(path))
        return whole(path, *args, **kwargs)

    monkeypatch.setattr(Path, "open", refuse)
    # The compiled reader opens files itself.
    monkeypatch.setattr(_core, "scan_dicom_headers", lambda paths, **_: [None] * len(paths))


def test_slice_files_without_read_permission_are_counted_and_named(tmp_path, monkeypatch):
    series(tmp_path)
    (tmp_path / "notes.txt").write_text("not a slice")
    _deny(monkeypatch, "IM018", "IM019", "notes.txt")
    volume = open_volume(tmp_path)
    assert volume.shape_zyx[0] == 18
    (note,) = volume.source.notes
    assert (note.code, note.badge) == ("import.files-unread", True)
    assert note.words.startswith("2 files")
    assert "IM018 (no permission to read it), IM019" in note.words


def test_slice_file_on_a_broken_disk_is_counted_as_unreadable(tmp_path, monkeypatch):
    series(tmp_path)
    whole = Path.open

    def fail(path: Path, *args, **kwargs):
        file = whole(path, *args, **kwargs)
        if path.name != "IM019":
            return file
        file.close()

        class Broken(io.BytesIO):
            def read(self, *_args):
                raise OSError(5, "Input/output error")

        return Broken()

    monkeypatch.setattr(Path, "open", fail)
    monkeypatch.setattr(_core, "scan_dicom_headers", lambda paths, **_: [None] * len(paths))  # opens files itself
    assert "IM019 (the disk reported an error" in open_volume(tmp_path).source.warnings[0]


def test_subfolder_that_cannot_be_opened_is_counted(tmp_path, monkeypatch):
    series(tmp_path / "a", name=lambda i: f"{i // 10}/IM{i:03d}")
    whole = os.scandir

    def refuse(path):
        if Path(path).name == "1":
            raise PermissionError(13, "Permission denied", str(path))
        return whole(path)

    monkeypatch.setattr(os, "scandir", refuse)
    volume = open_volume(tmp_path / "a")
    assert volume.shape_zyx[0] == 10
    assert "1 (a folder that cannot be opened)" in volume.source.warnings[0]


def test_info_command_lists_unusable_files_and_strict_exits_with_code_3(tmp_path, capsys):
    series(tmp_path)
    (tmp_path / "IM019").write_bytes(b"")
    assert [note.code for note in inspect_path(tmp_path).notes] == ["import.files-unread"]
    assert report(tmp_path, strict=True, series=None, as_json=False) == 3
    assert "IM019 (empty)" in capsys.readouterr().out


def test_import_notes_and_labels_contain_no_patient_name_and_no_uid(tmp_path):
    def two_patients(dataset, index):
        if index >= 12:
            dataset.PatientID, dataset.PatientName = "SECRET-2", "Secret^Two"

    series(tmp_path, two_patients, uid="1.2.3.98", name=lambda i: f"CT.1.2.840.113.{1000 + i}.99.7")
    (tmp_path / "CT.1.2.840.113.1000.99.7").write_bytes(b"")
    volume = open_volume(tmp_path)
    assert [info.description for info in volume.source.other_series] == ["Thorax, patient 2"]
    text = repr(volume.source) + str(inspect_path(tmp_path).to_json())
    for secret in (*SECRETS, "1.2.840.113"):
        assert secret not in text
    assert "00.99.7 (empty)" in text


def test_each_part_of_a_divided_series_can_be_selected_by_its_key(tmp_path):
    series(tmp_path, uid="1.2.3.98")
    second = chest(seed=6)[:15]
    series(
        tmp_path,
        lambda dataset, index: setattr(dataset, "ConvolutionKernel", "B70f"),
        hu=second,
        uid="1.2.3.98",
        name=lambda i: f"J{i}",
    )
    listed = {info.description: info.key for info in inspect_path(tmp_path).series}
    assert listed == {
        "Thorax, reconstruction kernel b41f": "3",
        "Thorax, reconstruction kernel b70f": "3-2",
    }
    np.testing.assert_array_equal(open_volume(tmp_path, series="3-2").hu_zyx, second)
    np.testing.assert_array_equal(open_volume(tmp_path / "J4").hu_zyx, second)


def test_opening_one_file_of_a_damaged_series_reports_its_unusable_files(tmp_path):
    series(tmp_path)
    (tmp_path / "IM000").write_bytes(b"")
    assert [note.code for note in open_volume(tmp_path / "IM007").source.notes] == ["import.files-unread"]


def test_series_with_mixed_rescale_is_refused_and_another_ct_is_opened(tmp_path):
    def drop(dataset, index):
        if index == 3:
            del dataset.RescaleIntercept

    series(tmp_path, drop)
    series(tmp_path, hu=chest()[:15], number=4, name=lambda i: f"J{i}")
    volume = open_volume(tmp_path)
    assert volume.shape_zyx[0] == 15
    assert "import.series-replaced" in [note.code for note in volume.source.notes]
    with pytest.raises(VolumeImportError) as caught:
        open_volume(tmp_path, series="3")
    assert caught.value.code == "import.rescale-mixed"


def test_terminal_output_of_another_thread_during_decoding_is_not_lost(capfd):
    with decoder_words() as heard:
        os.write(2, b"Corrupt JPEG data: premature end of data segment\n")
        other = threading.Thread(target=lambda: os.write(2, b"server: a line of the log\n"))
        other.start()
        other.join()
        os.write(2, b"Unsupported JPEG data precision 12\n")
    assert heard == ["Corrupt JPEG data: premature end of data segment"]
    assert capfd.readouterr().err == "server: a line of the log\n"


def test_decoder_warning_for_a_slice_removes_the_hu_status(tmp_path, monkeypatch):
    """Check that a warning of the decoder is sufficient even if the stream seems complete."""
    series(tmp_path, lambda dataset, index: packed(dataset, tmp_path, "JPEG2000"))
    import carina.volume.dicom_pixels as pixels

    monkeypatch.setattr(dicom_slice_batches, "has_second_decoder", lambda: False)  # so that GDCM decodes
    whole = pixels.decode

    def mutter(path):
        os.write(2, b"[WARNING] tile 0: segment too long\n")
        return whole(path)

    monkeypatch.setattr(pixels, "decode", mutter)
    volume = open_volume(tmp_path)
    assert not volume.is_hu
    assert [note.code for note in volume.source.notes] == ["import.pixels-damaged"]
    np.testing.assert_array_equal(volume.hu_zyx, chest())


@pytest.mark.parametrize("noise_hu", [0, 5, 25, 90, 200])
@pytest.mark.parametrize("offset", [0, 1024, 8192])
def test_intact_slices_of_any_noise_level_are_not_reported_as_damaged(rng, noise_hu, offset):
    hu = chest(noise_hu=float(noise_hu)) if noise_hu else chest(noise_hu=1e-9)
    signed = (hu.astype(np.int32) + offset).astype(np.int16)
    assert _byte_order_doubts(signed[5].view(np.uint16), lambda some: some.view(np.int16).astype(np.int32)) == ()
    swapped = signed[5].view(np.uint16).byteswap()
    assert _byte_order_doubts(swapped, lambda some: some.view(np.int16).astype(np.int32))
    assert odd_slices(hu, compressed=False, slice_mm=1.0) == []
    assert odd_slices(hu, compressed=True, slice_mm=1.0) == []
    finer = np.kron(chest(noise_hu=1e-9), np.ones((1, 4, 4))) + rng.normal(0, noise_hu, (20, 128, 128))
    assert odd_slices(finer.astype(np.int16), compressed=True, slice_mm=1.0) == []


def test_slices_of_random_or_8_bit_values_are_not_reported_as_damaged(rng):
    for words in (
        rng.integers(0, 1 << 16, (64, 64)).astype(np.uint16),
        rng.integers(0, 256, (64, 64)).astype(np.uint16),
        (rng.integers(0, 256, (64, 64)) * 256).astype(np.uint16),
        np.full((64, 64), 77, dtype=np.uint16),
    ):
        assert _byte_order_doubts(words, lambda some: some.astype(np.int32)) == ()


@pytest.mark.parametrize("at", [0, 9, 19])
def test_slice_with_offset_values_is_reported_only_between_two_other_slices(at):
    values = chest().copy()
    values[at] += 1024
    # The first and the last slice have only one neighbour and may differ from it.
    assert odd_slices(values, compressed=False, slice_mm=1.0) == ([at] if 0 < at < 19 else [])


@pytest.mark.parametrize(("slice_mm", "odd"), [(2.0, [9]), (10.0, [])])
def test_structure_in_one_thick_slice_is_not_reported_as_damage(slice_mm, odd):
    values = np.full((20, 128, 128), -850, dtype=np.int16)
    values[9, 40:46, :40] = 30  # The values are those of a vessel of 5 mm width within the slice.
    assert odd_slices(values, compressed=True, slice_mm=slice_mm) == odd
    assert odd_slices(values, compressed=False, slice_mm=slice_mm) == []


def test_rle_compressed_slice_must_have_the_exact_number_of_pixels():
    header = (1).to_bytes(4, "little") + (64).to_bytes(4, "little") + bytes(56)
    assert rle_problem(header + b"\x03\x01\x02\x03\x04\xfd\x09", 8) is None
    # The frame is padded to an even length.
    assert rle_problem(header + b"\x03\x01\x02\x03\x04\xfd\x09\x00", 8) is None
    for frame in (header[:60], header + b"\x03\x01\x02\x03\x04", header + b"\x03\x01\x02\x03\x04\xf0\x09", bytes(64)):
        assert rle_problem(frame, 8) is not None
    assert rle_problem(header + b"\x03\x01\x02\x03\x04\xfd\x09" + bytes(40), 8) is not None


def _outcome(path: Path) -> str:
    try:
        return repr(open_volume(path))
    except VolumeImportError as error:
        return error.code


def test_randomly_damaged_series_gives_a_volume_or_a_refusal(tmp_path, rng):
    series(tmp_path, lambda dataset, index: packed(dataset, tmp_path, "JPEG2000"), hu=chest()[:3])
    path = tmp_path / "IM001"
    whole = path.read_bytes()
    for _ in range(40):
        data = bytearray(whole)
        for at in rng.integers(len(data) // 2, len(data), 4):
            data[at] = rng.integers(0, 256)
        path.write_bytes(data)
        assert _outcome(tmp_path).startswith(("Volume(", "import."))


def test_recompressed_jpeg_slice_decodes_to_the_same_picture(tmp_path):
    def both(dataset, index):
        packed(dataset, tmp_path, "JPEG")
        repack(dataset, lambda frame: frame)

    np.testing.assert_array_equal(open_volume(series(tmp_path, both)).hu_zyx, chest())


def test_intact_lossless_jpeg_slice_is_not_reported_as_damaged(tmp_path):
    frames: list[bytes] = []

    def pack(dataset, index):
        packed(dataset, tmp_path, "JPEG")
        repack(dataset, lambda frame: frames.append(frame) or frame)

    series(tmp_path, pack, hu=chest()[:3])
    assert [_core.lossless_jpeg_problem(frame, start=0) for frame in frames] == [None, None, None]
    frame = frames[0]
    start, end = frame.index(b"\xff\xda") + 10, frame.rindex(b"\xff\xd9")
    assert _core.lossless_jpeg_problem(frame[:start] + frame[start + 40 :], start=0) is not None
    assert _core.lossless_jpeg_problem(frame[:end] + frame[start : start + 40] + frame[end:], start=0) is not None
    found = sum(
        _core.lossless_jpeg_problem(frame[:at] + bytes([frame[at] ^ 0x5A]) + frame[at + 1 :], start=0) is not None
        for at in range(start, end - 20, 7)
    )
    # A wrong byte is detected only if it changes the number of codes, as at about a third of all positions.
    assert found > 0.2 * len(range(start, end - 20, 7))
