"""Tests of moves that never replace an existing file, on disks without hard links."""

from __future__ import annotations

import errno
import os

import pytest

from carina.disk.move_files import move_to_new_name


@pytest.fixture
def files(tmp_path, monkeypatch):
    """Provide a file and an unused name on a disk without hard links."""

    def link(_source, _target):
        raise OSError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "link", link)
    source, target = tmp_path / "draft", tmp_path / "target"
    source.write_text("new")
    return source, target


def failing(monkeypatch, source, do):
    """Let the move of a file run ``do`` first and then fail."""

    def replace(_self, target):
        do(target)
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(type(source), "replace", replace)


def test_failed_move_leaves_no_file_at_the_new_name(files, monkeypatch):
    source, target = files
    failing(monkeypatch, source, lambda _target: None)
    with pytest.raises(OSError, match="Input/output"):
        move_to_new_name(source, target)
    assert source.read_text() == "new"
    assert not target.exists()


def test_file_whose_move_the_disk_reported_as_failed_has_its_content_at_the_new_name(files, monkeypatch):
    source, target = files
    failing(monkeypatch, source, lambda place: os.rename(source, place))  # noqa: PTH104 - Path.replace is replaced
    with pytest.raises(OSError, match="Input/output"):
        move_to_new_name(source, target)
    assert target.read_text() == "new"


def test_failed_move_does_not_change_a_file_that_another_program_created_at_the_new_name(files, monkeypatch):
    source, target = files
    failing(monkeypatch, source, lambda place: place.write_text("theirs"))
    with pytest.raises(OSError, match="Input/output"):
        move_to_new_name(source, target)
    assert (source.read_text(), target.read_text()) == ("new", "theirs")
