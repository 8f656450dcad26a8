"""PEP 517 backend: builds the web UI where its sources are newer, then hands over to maturin.

maturin has no build hooks; an in-tree wrapper keeps ``pip install .`` and ``uv run`` one command. In an sdist the built
UI is included and all times are equal, so neither Node nor npm is needed there.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import maturin
from maturin import *  # noqa: F403  (PEP 517 hooks are passed on as they are)

ROOT = Path(__file__).resolve().parent.parent
WEB = ROOT / "web"
BUILT = ROOT / "python" / "carina" / "_web" / "index.html"
# A wheel has GPU support inside; an editable build (`make run`, `make test`, CI) has not, since wgpu is large. What is
# given here replaces the features of pyproject.toml.
WHEEL_ARGUMENTS = ("--features", "extension-module,gpu")


def _newest_source() -> float:
    newest = 0.0
    for folder, folders, files in os.walk(WEB):
        folders[:] = [name for name in folders if name not in {"node_modules", "dist"}]
        newest = max([newest, *((Path(folder) / name).stat().st_mtime for name in files)])
    return newest


def build_web() -> None:
    """Run ``npm ci`` and ``npm run build`` where the built UI is missing or older than its sources."""
    if not (WEB / "package.json").exists():
        return
    if BUILT.exists() and BUILT.stat().st_mtime >= _newest_source():
        return
    npm = shutil.which("npm")
    if npm is None:
        sys.exit("carina: building the web UI needs npm (Node 20 or newer); install Node and try again")
    if not (WEB / "node_modules" / ".package-lock.json").exists():
        subprocess.run([npm, "ci", "--omit=dev", "--no-audit", "--no-fund"], cwd=WEB, check=True)
    subprocess.run([npm, "run", "build"], cwd=WEB, check=True)


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):  # noqa: ANN001, ANN201
    """Build a wheel with the web UI and GPU support inside."""
    build_web()
    settings = {"build-args": list(WHEEL_ARGUMENTS), **(config_settings or {})}
    return maturin.build_wheel(wheel_directory, settings, metadata_directory)


def build_editable(wheel_directory, config_settings=None, metadata_directory=None):  # noqa: ANN001, ANN201
    """Build the extension in place, with the web UI beside it."""
    build_web()
    return maturin.build_editable(wheel_directory, config_settings, metadata_directory)


def build_sdist(sdist_directory, config_settings=None):  # noqa: ANN001, ANN201
    """Build an sdist that needs no Node."""
    build_web()
    return maturin.build_sdist(sdist_directory, config_settings)
