"""Tests of the output of commands on a full, read-only or missing disk: one message, and an unchanged former file."""

from __future__ import annotations

import errno
import os
import re

import pytest

from carina.disk import atomic_files

RMB = "-25,12,-145"
FAULT = re.compile(r"internal error|Traceback|itk|ITK|nifti|NIfTI_|\*\* ERROR|libpng", re.IGNORECASE)
TREE_FILES = ("a.json", "a.vtp", "a.swc", "a.mrk.json")
GRID_FILES = ("a.nii.gz", "a.nii", "a.nrrd", "a.mha")
MESH_FILES = ("a.stl", "a.ply", "a.obj", "a.glb")
FLIGHT = ("--to", "0", "--tree", "TREE", "--size", "32x32", "--rate", "2", "--speed", "60", "--pause", "0")


class Full:
    """File on a disk that accepts only a limited number of bytes."""

    def __init__(self, file, free_bytes: int) -> None:
        self._file, self._free_bytes = file, free_bytes

    def __getattr__(self, name):
        return getattr(self._file, name)

    def write(self, data) -> int:
        size = memoryview(data).nbytes
        if size > self._free_bytes:
            self._file.write(memoryview(data).cast("B")[: self._free_bytes])
            self._free_bytes = 0
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._free_bytes -= size
        return self._file.write(data)


@pytest.fixture(scope="module")
def tree(ct, tmp_path_factory):
    """Return the path of the phantom's tree, which is found once for all tests."""
    import carina

    volume = carina.open_volume(ct)
    path = tmp_path_factory.mktemp("tree") / "tree.json"
    return carina.write_tree(path, carina.find_airways(volume).tree)


VERBS = [
    *[("export", "CT", "-o", name) for name in (*TREE_FILES, *GRID_FILES, *MESH_FILES)],
    ("airways", "CT", "-o", "a.json"),
    ("airways", "CT", "--mask", "a.nii.gz"),
    ("render", "CT", "--view", "axial", "--size", "64x64", "-o", "a.png"),
    ("render", "CT", "--size", "32x32", "-o", "other.png", "--surface", "a.npz"),
    ("fly", "CT", *FLIGHT, "-o", "a.mp4"),
    ("fly", "CT", *FLIGHT, "-o", "a.webm"),
    ("fly", "CT", *FLIGHT, "-o", "other.mp4", "--keep", "kept"),
]


def label(verb):
    return f"{verb[0]} {verb[-1]}"


@pytest.fixture
def run(carina, ct, tree):
    """Run a command with its output files below a folder."""

    def ended(verb, folder):
        places = {"CT": ct, "TREE": tree}
        own = re.compile(r"(a|other)\.|kept")
        return carina(*(places.get(word, folder / word if own.match(word) else word) for word in verb), "--json")

    return ended


def output_name(arguments):
    """Return the name of the output file among the arguments of a command."""
    return next((word for word in arguments if re.match(r"a\.|kept", word) and word != "other.png"), arguments[-1])


def check(ended, code):
    assert ended.code == 1, ended.err
    error = ended.json()["error"]
    assert error["code"] == code, error
    assert not FAULT.search(ended.err.replace("nii.gz", "")), ended.err
    assert error["message"] in ended.err
    return error["message"]


@pytest.mark.parametrize("verb", VERBS, ids=label)
def test_command_whose_disk_becomes_full_while_writing_reports_it_and_leaves_the_old_file(
    run, tmp_path, monkeypatch, verb
):
    if verb[0] == "fly":
        pytest.importorskip("av", reason="PyAV is not installed")
    folder = tmp_path / "results"
    folder.mkdir()
    name = output_name(verb)
    if name != "kept":
        (folder / name).write_bytes(b"old")
    plain = atomic_files._create_draft

    def begin(where, mode):
        file, place = plain(where, mode)
        return Full(file, 150), place

    monkeypatch.setattr(atomic_files, "_create_draft", begin)
    message = check(run(verb, folder), "disk.full")
    assert "the disk is full" in message
    assert "free)" in message
    assert message.count("\n") == 0
    if name != "kept":
        assert str(folder) in message
        assert (folder / name).read_bytes() == b"old"
        assert "the existing file is unchanged" in message or "other." in message
    assert not [p.name for p in folder.rglob("*") if p.name.startswith(".")]


@pytest.mark.parametrize(
    ("number", "code"), [(errno.EROFS, "disk.denied"), (errno.EACCES, "disk.denied"), (errno.EIO, "disk.failed")]
)
def test_command_on_a_read_only_disk_exits_with_its_error_code(run, tmp_path, monkeypatch, number, code):
    def begin(_folder, _mode):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(atomic_files, "_create_draft", begin)
    check(run(("render", "CT", "--view", "axial", "--size", "64x64", "-o", "a.png"), tmp_path), code)


def test_phantom_command_on_a_full_disk_leaves_the_three_earlier_files(carina, tmp_path, monkeypatch):
    folder = tmp_path / "case"
    folder.mkdir()
    names = ("ct.nii.gz", "lumen.nii.gz", "truth.json")
    for name in names:
        (folder / name).write_bytes(b"old")
    plain, free_bytes = atomic_files._create_draft, iter([10**9, 10**9, 100])

    def begin(where, mode):
        file, place = plain(where, mode)
        return Full(file, next(free_bytes)), place

    monkeypatch.setattr(atomic_files, "_create_draft", begin)
    check(carina("phantom", "--spacing-mm", "4", "--generations", "3", "-o", folder, "--json"), "disk.full")
    assert {name: (folder / name).read_bytes() for name in names} == dict.fromkeys(names, b"old")
    assert sorted(p.name for p in folder.iterdir()) == sorted(names)


def test_output_to_a_folder_or_into_a_missing_folder_is_refused_before_the_computation(carina, ct, tmp_path):
    (tmp_path / "a.png").mkdir()
    for place in (tmp_path / "a.png", tmp_path / "nowhere" / "a.png"):
        ended = carina("render", ct, "--view", "axial", "--size", "16x16", "-o", place, "--json")
        assert ended.code == 2
        assert ended.json()["error"]["code"] == "usage"
