"""Tests of the command ``carina deidentify``."""

from __future__ import annotations

from dicom_writer import chest, series


def test_deidentify_command_writes_copies_and_states_their_number(carina, tmp_path):
    series(tmp_path / "scan", hu=chest()[:3])
    found = carina("deidentify", tmp_path / "scan", tmp_path / "copy", "--json").json()
    assert (found["num_images"], found["num_series"], found["refused"]) == (3, 1, [])
    assert len(list((tmp_path / "copy").rglob("*.dcm"))) == 3


def test_deidentify_command_names_images_with_text_and_the_option(carina, tmp_path):
    series(tmp_path / "scan" / "ct", hu=chest()[:3])
    series(tmp_path / "scan" / "b", lambda d, _: setattr(d, "BurnedInAnnotation", "YES"), hu=chest()[:2], number=9)
    found = carina("deidentify", tmp_path / "scan", tmp_path / "copy")
    assert "3 images of 1 series and 1 patient written" in found.out
    assert "2 images not copied: its header states burned-in annotation; blacken the text with --mask" in found.err
    masked = carina("deidentify", tmp_path / "scan", tmp_path / "masked", "--mask", "0,0,32,8", "--json").json()
    assert (masked["num_images"], masked["num_masked"]) == (5, 2)


def test_deidentify_command_refuses_an_invalid_mask(carina, tmp_path):
    series(tmp_path / "scan", hu=chest()[:3])
    found = carina("deidentify", tmp_path / "scan", tmp_path / "copy", "--mask", "top")
    assert found.code == 2 and "x,y,width,height" in found.err
