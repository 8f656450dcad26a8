"""Shell commands that add missing parts to this installation of Carina.

Every message with such a command uses this module. No command requests the package ``carina`` from a package index: the
name is not registered there, so a package of that name would be another person's.
"""

from __future__ import annotations

import importlib.util
import json
import os
import shlex
import shutil
import sys
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from types import MappingProxyType

__all__ = ["EXTRAS", "carina_command", "extra_command", "install_command", "not_built", "rebuild"]

EXTRAS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "devices": ("pyserial>=3.5",),
        "phone": ("cryptography>=44", "segno>=1.6"),
        "video": ("av>=14",),
        "report": ("reportlab>=4.2",),
        "dicom": ("pynetdicom>=3.0.4", "dicomweb-client>=0.61"),
        "sevenzip": ("libarchive-c>=5.3",),
        "cluster": ("ray>=2.60,<2.61",),
        "notebook": ("anywidget>=0.9",),
        "bench": ("vtk>=9.4", "numba>=0.61", "scipy>=1.14", "dijkstra3d>=1.15", "scikit-image>=0.24"),
    }
)
"""Packages of each optional dependency of ``pyproject.toml``; a test compares both."""


def _checkout() -> Path | None:
    """Return the folder of Carina's source code if the package runs from there, else None."""
    folder = Path(__file__).resolve().parents[2]
    return folder if (folder / "Makefile").is_file() and (folder / "crates").is_dir() else None


def _shell_line(words: list[str]) -> str:
    """Return a command line for the system's shell, quoted so that ``>`` of a version is not a redirection."""
    if os.name == "nt":
        return " ".join(f'"{word}"' if set(word) & set(" <>&|^") else word for word in words)
    return shlex.join(words)


def install_command(*requirements: str) -> str:
    """Return the command that installs packages into the environment that runs Carina.

    An environment made by uv has no pip: the command is uv's there. Without pip and uv the command installs pip first.

    Examples
    --------
    >>> install_command("segno>=1.6").endswith("'segno>=1.6'")
    True
    """
    python = sys.executable or "python3"
    if importlib.util.find_spec("pip") is not None:
        return _shell_line([python, "-m", "pip", "install", *requirements])
    checkout = _checkout()
    checkout_uv = None if checkout is None else shutil.which("uv", path=str(checkout / ".uv" / "bin"))
    uv = shutil.which("uv") or checkout_uv
    if uv is not None:
        return _shell_line([uv, "pip", "install", "--python", python, *requirements])
    pip = _shell_line([python, "-m", "pip", "install", *requirements])
    return f"{_shell_line([python, '-m', 'ensurepip'])} && {pip}"


def carina_command(*arguments: str) -> str:
    """Return a command of Carina; with the path of the program if the shell does not find this ``carina`` by its name.

    Examples
    --------
    >>> carina_command("case", "migrate").endswith("carina case migrate")
    True
    """
    found = shutil.which("carina")
    folder = Path(sys.executable).parent
    own = shutil.which("carina", path=str(folder))
    by_name = own is None or (found is not None and Path(found).samefile(own))
    return _shell_line(["carina" if by_name or own is None else own, *arguments])


def extra_command(extra: str) -> str:
    """Return the command that installs the packages of one of :data:`EXTRAS`."""
    return install_command(*EXTRAS[extra])


def rebuild() -> str:
    """Return the request to build or install Carina again, with the command if the origin of Carina is known.

    In a folder of Carina's source the command is ``make build``. Elsewhere the command installs the wheel or the folder
    from which Carina was installed, which the installer records as a URL (PEP 610).
    """
    checkout = _checkout()
    if checkout is not None:
        return f"run: {_shell_line(['make', '-C', str(checkout), 'build'])}"
    try:
        record = metadata.distribution("carina").read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        record = None
    if record is None:
        return "install Carina again from the file or folder from which it was installed"
    return f"run: {install_command('--force-reinstall', '--no-deps', str(json.loads(record)['url']))}"


def not_built(part: str) -> str:
    """Return the message that a part of the browser's files is missing."""
    return f"{part} has not been built: {rebuild()}"
