"""Tests of the writing and reading of ``tree.json``."""

from __future__ import annotations

import json

import numpy as np
import pytest

from carina.errors import CarinaError, VolumeImportError
from carina.export import read_tree, write_tree
from carina.track import AirwayTree, Branch


@pytest.fixture
def tree() -> AirwayTree:
    points = np.array([[0.1, 0.2, 0.3], [1.0 / 3.0, 0.0, -9.0]])
    return AirwayTree((Branch(0, None, (), 0, "Trachea", "tracked", points, np.array([8.0, 7.5])),))


def test_tree_is_written_and_read_back_bit_for_bit(tree, tmp_path):
    path = write_tree(tmp_path / "t.json", tree)
    back = read_tree(path)
    assert back.root.points.tobytes() == tree.root.points.tobytes()
    assert json.loads(path.read_text(encoding="utf-8")) == tree.to_json()
    # No temporary file remains in the folder.
    assert [p.name for p in tmp_path.iterdir()] == ["t.json"]


def test_failed_write_of_a_tree_leaves_the_old_file(tree, tmp_path, monkeypatch):
    path = write_tree(tmp_path / "t.json", tree)
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("carina.disk.atomic_files.os.fsync", full)
    with pytest.raises(CarinaError, match="the disk is full") as caught:
        write_tree(path, tree)
    assert caught.value.exit_code == 1
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["t.json"]


def test_tree_written_to_a_missing_folder_is_refused_with_the_name_of_the_folder(tree, tmp_path):
    with pytest.raises(CarinaError, match="missing"):
        write_tree(tmp_path / "missing" / "t.json", tree)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "not JSON"),
        (b"\xff\xfe\x00", "not JSON"),
        (b"[" * 100_000, "not JSON"),
        (b'{"format": "carina-tree", "version": NaN}', "is not a number in JSON"),
        (b'{"format": "carina-transfer", "version": 1}', "format"),
    ],
)
def test_tree_file_of_another_format_is_refused_with_its_name(tmp_path, content, word):
    path = tmp_path / "other.json"
    path.write_bytes(content)
    with pytest.raises(VolumeImportError, match=word) as caught:
        read_tree(path)
    assert "other.json" in str(caught.value)
    assert caught.value.exit_code == 3


def test_missing_tree_file_is_refused_with_its_name(tmp_path):
    with pytest.raises(VolumeImportError, match=r"nowhere\.json"):
        read_tree(tmp_path / "nowhere.json")
