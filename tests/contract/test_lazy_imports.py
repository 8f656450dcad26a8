"""Tests of fast imports: types load no DICOM reader and no server, and the start page loads no file reader."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from user_folders import environment_in

SLOW = ("pydicom", "SimpleITK", "starlette", "typer", "ray", "av")
LATE = (
    "pydicom",
    "SimpleITK",
    "PIL",
    "ray",
    "av",
    "reportlab",
    "cryptography",
    "rich",
    "urllib.request",
    "xml.etree.ElementTree",
)
"""Modules that only some commands or files need, and that the start of a window must not load."""

START = f"""
import os, signal, sys
import carina.cli.app
from carina.server import serve

def ready(url, token):
    print(*(name for name in {LATE!r} if name in sys.modules), flush=True)
    os.kill(os.getpid(), signal.SIGINT)

serve(None, open_browser=False, on_ready=ready)
"""


@pytest.mark.parametrize("part", ["volume", "scopes", "render", "track", "navigate", "export", "phantom"])
def test_subpackage_is_imported_without_file_readers_and_servers(part: str) -> None:
    code = (
        f"import sys, carina.{part}; from carina.volume import Note, Volume, VolumeSource, badges_of; "
        f"print(*(name for name in {SLOW!r} if name in sys.modules))"
    )
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert ran.stdout.split() == []


def test_start_page_loads_no_module_that_only_some_file_types_need(tmp_path: Path) -> None:
    environment = environment_in(tmp_path)
    ran = subprocess.run([sys.executable, "-c", START], check=True, capture_output=True, text=True, env=environment)
    assert ran.stdout.split() == []


def test_grid_file_is_opened_without_dicom_readers() -> None:
    code = "import sys, carina; carina.demo_patient(); print('pydicom' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert ran.stdout.strip() == "False"
