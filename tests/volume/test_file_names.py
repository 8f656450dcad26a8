"""Tests of files whose names are not UTF-8 or contain control characters."""

from __future__ import annotations

import ast
import io
import os
import sys
from pathlib import Path

import grid_writers as grids
import numpy as np
import pytest

import carina
from carina.cli import console
from carina.disk import library_path
from carina.errors import DiskError, VolumeImportError
from carina.export import write_mask
from carina.volume import inspect_path, open_mask, open_volume

pytestmark = pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="file names are Unicode there")
NAMES = [b"l\xe9.nii", b"\xff\xfe", b"a\nb\x1b[2J.nii", b"\xe2\x80\xaetxt.nii"]
PACKAGE = Path(carina.__file__).parent


@pytest.fixture(params=NAMES, ids=repr)
def name(request) -> str:
    return os.fsdecode(request.param)


@pytest.mark.parametrize("form", ["nifti", "nifti gzip", "nrrd", "metaimage", "nrrd detached", "nifti pair"])
def test_grid_file_in_a_folder_with_an_unusual_name_opens(tmp_path, name, form):
    folder = tmp_path / name
    folder.mkdir()
    volume = open_volume(grids.FORMS[form](folder, grids.chest()))
    np.testing.assert_array_equal(volume.hu_zyx, grids.chest())


@pytest.mark.parametrize("form", ["nifti", "nifti gzip", "nrrd", "metaimage"])
def test_grid_file_with_an_unusual_name_opens_and_its_title_can_be_printed(tmp_path, name, form):
    path = grids.FORMS[form](tmp_path, grids.chest()).rename(tmp_path / name)
    volume = open_volume(path)
    np.testing.assert_array_equal(volume.hu_zyx, grids.chest())
    assert volume.source.title.isprintable()
    volume.source.title.encode("utf-8")
    assert inspect_path(path).refused is None
    mask = open_mask(path, volume, label=1200)
    np.testing.assert_array_equal(mask.inside_zyx, grids.chest() == 1200)


def test_dicom_folder_with_an_unusual_name_opens(write_series, name, expected_hu_zyx):
    path = write_series(name)
    np.testing.assert_array_equal(open_volume(path).hu_zyx, expected_hu_zyx)


def test_refusal_of_a_file_with_an_unusual_name_can_be_printed(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"text")
    with pytest.raises(VolumeImportError) as caught:
        open_volume(path)
    assert str(caught.value).isprintable()
    str(caught.value).encode("utf-8")


@pytest.mark.parametrize("suffix", [".nii.gz", ".nrrd", ".mha"])
def test_mask_is_written_to_a_file_with_an_unusual_name_and_read_again(tmp_path, name, suffix):
    volume = open_volume(grids.nifti(tmp_path, grids.chest()))
    mask = (grids.chest() == -860).astype(np.uint8)
    path = write_mask(tmp_path / f"{name}{suffix}", mask, volume)
    np.testing.assert_array_equal(open_mask(path, volume).inside_zyx, mask)


def test_library_receives_a_utf8_name_for_a_file_with_an_unusual_name(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"content")
    with library_path(path) as given:
        given.encode("utf-8")
        assert Path(given).read_bytes() == b"content"
    assert path.read_bytes() == b"content"


def test_utf8_file_name_is_passed_to_a_library_unchanged(tmp_path):
    path = tmp_path / "Sättiger 患者.nii"
    with library_path(path) as given:
        assert given == str(path)


def test_non_utf8_temporary_folder_is_refused_with_a_remedy(tmp_path, monkeypatch):
    odd = tmp_path / os.fsdecode(b"\xe9") / "carina-scratch"
    odd.mkdir(parents=True)

    class Scratch:
        def __enter__(self):
            return odd

        def __exit__(self, *_trouble):
            return None

    monkeypatch.setattr("carina.disk.library_paths.scratch_folder", Scratch)
    with pytest.raises(DiskError, match=r"xe9, is not valid UTF-8; set TMPDIR"), library_path(odd / "file.png"):
        pass


def test_every_path_for_a_cpp_library_passes_through_the_conversion():
    readers = {"SetFileName", "SetFileNames", "ReadImage", "WriteImage"}
    found = []
    for file in PACKAGE.rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        allowed = {
            item.optional_vars.id
            for node in ast.walk(tree)
            if isinstance(node, ast.With)
            for item in node.items
            if isinstance(item.optional_vars, ast.Name)
            and isinstance(item.context_expr, ast.Call)
            and ast.unparse(item.context_expr.func) == "library_path"
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in readers:
                argument = node.args[-1] if node.func.attr == "WriteImage" else node.args[0]
                assert ast.unparse(argument) in allowed, f"{file}:{node.lineno}"
                found.append(file.name)
    assert sorted(found) == ["gdcm_decoder.py"]


def test_commands_print_an_unusual_file_name_to_a_strict_terminal(tmp_path, monkeypatch, name):
    output, errors = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", errors="strict") for _ in range(2))
    monkeypatch.setattr(sys, "stdout", output)
    monkeypatch.setattr(sys, "stderr", errors)
    console.accept_any_text()
    console.print_note(f"wrote {name}")
    print(name)
    console.print_json({"output": name})
    output.flush()
    assert errors.buffer.getvalue().decode().rstrip("\n").isprintable()
    assert b'"output"' in output.buffer.getvalue()


def test_json_output_contains_the_exact_unusual_file_name(capsys, name):
    import json

    console.print_json({"output": name})
    assert json.loads(capsys.readouterr().out)["output"] == name
