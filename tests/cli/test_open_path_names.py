"""Test of path names that ``carina open`` cannot pass to the window: the command ends with a message."""

from __future__ import annotations

import os
import sys

import pytest


@pytest.mark.skipif(sys.platform in ("win32", "darwin"), reason="file names are Unicode there")
@pytest.mark.parametrize("name", [b"l\xe9.nii", b"a\nb.nii"], ids=repr)
def test_open_command_refuses_a_path_that_is_not_valid_unicode(carina, tmp_path, name):
    path = tmp_path / os.fsdecode(name)
    path.write_bytes(b"")
    ended = carina("open", path, "--no-browser", "--json")
    assert ended.code == 3
    assert ended.json()["error"]["code"] == "import.unreadable"
    assert "rename it" in ended.err
    assert ended.err.rstrip("\n").isprintable()
