"""Tests of opening files that the user names: only regular files are opened; pipes, sockets and devices never block."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

import pytest

from carina.cli.render import chosen_transfer
from carina.cluster.node import check_token
from carina.disk import check_regular, open_regular, open_regular_text, read_regular_text, special_kind
from carina.errors import CarinaError, VolumeImportError
from carina.export import read_tree
from carina.navigate import open_key_frames, open_recording
from carina.plan import scope_from_file, tool_from_file
from carina.plan.targets.from_file import target_from_file
from carina.render.png_text import read_png_pose
from carina.scopes import lens_from_file
from carina.volume import inspect_path, open_mask, open_volume
from small_case import small_volume

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and sockets of POSIX")

FIFO, SOCKET, DEVICE = "a named pipe (FIFO)", "a socket", "a device"


class BlockedError(Exception):
    """Error for a call that blocks on a pipe."""


@pytest.fixture(autouse=True)
def ends():
    """Limit the time of a test, because a call that blocks never returns."""

    def interrupt(*_arguments):
        raise BlockedError

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture
def special(tmp_path):
    """Return one path for each kind of special file."""
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as sock:
        here = Path.cwd()
        os.chdir(tmp_path)  # the path of a socket is limited to about 100 characters
        sock.bind("socket")
        os.chdir(here)
        yield {FIFO: tmp_path / "pipe", SOCKET: tmp_path / "socket", DEVICE: Path("/dev/zero")}


def test_regular_file_opens_as_bytes_and_as_text(tmp_path):
    path = tmp_path / "file"
    path.write_bytes("größer\n".encode())
    (tmp_path / "link").symlink_to(path)
    for place in (path, tmp_path / "link", str(path)):
        check_regular(place)
        assert special_kind(place) is None
        with open_regular(place) as file:
            assert file.read() == "größer\n".encode()
        with open_regular_text(place) as text:
            assert text.readline() == "größer\n"
        assert read_regular_text(place, max_bytes=9) == "größer\n"
    with pytest.raises(VolumeImportError, match="larger than 8 bytes") as refusal:
        read_regular_text(path, max_bytes=8)
    assert refusal.value.code == "disk.too-large"


def test_missing_file_is_reported_as_missing(tmp_path):
    check_regular(tmp_path / "missing")
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "missing")


@pytest.mark.parametrize("kind", [FIFO, SOCKET, DEVICE])
def test_special_file_is_refused_with_its_kind_in_the_message(special, kind):
    path = special[kind]
    assert special_kind(path) == kind
    for refuses in (check_regular, open_regular, open_regular_text, lambda p: read_regular_text(p, max_bytes=10)):
        with pytest.raises(VolumeImportError) as refusal:
            refuses(path)
        assert refusal.value.code == "disk.not-a-file"
        assert refusal.value.exit_code == 3
        assert str(refusal.value) == f"{path}: expected a file; found {kind}; choose a file"


def test_folder_is_refused_where_a_file_is_expected(tmp_path):
    check_regular(tmp_path)
    with pytest.raises(VolumeImportError, match="found a folder"):
        open_regular(tmp_path)


def test_pipe_that_replaces_a_file_after_the_check_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "file"
    path.write_bytes(b"content")
    os.mkfifo(tmp_path / "pipe")
    opening = os.open

    def exchanged(place, flags, *rest):
        (tmp_path / "pipe").replace(place)
        return opening(place, flags, *rest)

    monkeypatch.setattr(os, "open", exchanged)
    with pytest.raises(VolumeImportError, match="named pipe"):
        open_regular(path)


OPENERS = {
    "CT": open_volume,
    "inspection": inspect_path,
    "mask": lambda path: open_mask(path, small_volume()),
    "target": lambda path: target_from_file(path, small_volume()),
    "tree": read_tree,
    "lens": lens_from_file,
    "recording": open_recording,
    "key frames": open_key_frames,
    "scope": scope_from_file,
    "tool": tool_from_file,
    "image": read_png_pose,
    "transfer": lambda path: chosen_transfer(str(path)),
    "token": check_token,
}


@pytest.mark.parametrize("kind", [FIFO, SOCKET, DEVICE])
@pytest.mark.parametrize("what", OPENERS)
def test_every_function_that_reads_a_named_file_refuses_a_special_file(special, tmp_path, what, kind):
    path = tmp_path / "named.json"
    path.symlink_to(special[kind])
    with pytest.raises(CarinaError) as refusal:
        OPENERS[what](path)
    assert "internal" not in str(refusal.value)
    if what != "token":  # A cluster command states where its token comes from.
        assert kind in str(refusal.value)


def test_pipe_among_the_slices_of_a_folder_is_skipped(special, tmp_path):
    with pytest.raises(VolumeImportError, match="no DICOM images"):
        open_volume(tmp_path)


@pytest.mark.parametrize("kind", [FIFO, SOCKET, DEVICE])
@pytest.mark.parametrize("packed", ["raw", "gzip"])
def test_image_header_whose_voxels_are_in_a_special_file_is_refused(special, tmp_path, kind, packed):
    header = tmp_path / "ct.nhdr"
    (tmp_path / "voxels").symlink_to(special[kind])
    header.write_text(
        "NRRD0004\ntype: short\ndimension: 3\nsizes: 8 8 8\nspace: left-posterior-superior\n"
        "space directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (0,0,0)\nendian: little\n"
        f"encoding: {packed}\ndata file: voxels\n"
    )
    with pytest.raises(VolumeImportError):
        open_volume(header)
    meta = tmp_path / "ct.mhd"
    meta.write_text(
        "ObjectType = Image\nNDims = 3\nDimSize = 8 8 8\nElementSpacing = 1 1 1\nElementType = MET_SHORT\n"
        f"CompressedData = {packed == 'gzip'}\nElementDataFile = voxels\n"
    )
    with pytest.raises(VolumeImportError):
        open_volume(meta)
