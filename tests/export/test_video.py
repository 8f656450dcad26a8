"""Videos are written whole or not at all, with the permissions of any new file."""

from __future__ import annotations

import errno
import os
import sys

import numpy as np
import pytest

from carina.export import VideoWriter

pytest.importorskip("av", reason="PyAV is not installed")

FRAME = np.zeros((32, 48, 3), dtype=np.uint8)


class Full:
    """A container for whose last bytes there is no room."""

    def __init__(self, container) -> None:
        self._container = container

    def __getattr__(self, name):
        return getattr(self._container, name)

    def close(self) -> None:
        self._container.close()
        raise OSError(errno.ENOSPC, "No space left on device")


def write_to_full_disk(target, *, reason: Exception | None = None) -> None:
    with VideoWriter(target, 48, 32) as video:
        video.add(FRAME)
        video._container = Full(video._container)
        if reason is not None:
            raise reason


@pytest.mark.parametrize("suffix", [".mp4", ".webm"])
def test_a_full_disk_leaves_the_old_video_and_no_draft(tmp_path, suffix):
    target = tmp_path / f"a{suffix}"
    target.write_bytes(b"old")
    with pytest.raises(OSError, match="the disk is full"):
        write_to_full_disk(target)
    assert target.read_bytes() == b"old"
    assert [found.name for found in tmp_path.iterdir()] == [target.name]


def test_a_video_that_is_given_up_on_a_full_disk_leaves_no_draft_and_keeps_its_reason(tmp_path):
    with pytest.raises(KeyError, match="reason"):
        write_to_full_disk(tmp_path / "a.mp4", reason=KeyError("reason"))
    assert list(tmp_path.iterdir()) == []


def test_a_video_that_cannot_begin_leaves_no_draft(tmp_path, monkeypatch):
    monkeypatch.setattr(VideoWriter, "_made_stream", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        VideoWriter(tmp_path / "a.mp4", 48, 32)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such permissions")
@pytest.mark.parametrize("mask", [0o022, 0o077, 0o002])
def test_a_video_has_the_permissions_of_a_new_file(tmp_path, mask):
    before = os.umask(mask)
    try:
        with VideoWriter(tmp_path / "a.mp4", 48, 32) as video:
            video.add(FRAME)
    finally:
        os.umask(before)
    assert (tmp_path / "a.mp4").stat().st_mode & 0o777 == 0o666 & ~mask
