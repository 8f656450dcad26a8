"""Who needs only a type waits for no reader of DICOM and no server."""

from __future__ import annotations

import subprocess
import sys

import pytest

SLOW = ("pydicom", "SimpleITK", "starlette", "typer", "ray", "av")


@pytest.mark.parametrize("part", ["volume", "scopes", "render", "track", "navigate", "export", "phantom"])
def test_a_part_is_imported_without_readers_and_servers(part: str) -> None:
    code = (
        f"import sys, carina.{part}; from carina.volume import Note, Volume, VolumeSource, badges_of; "
        f"print(*(name for name in {SLOW!r} if name in sys.modules))"
    )
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert ran.stdout.split() == []
