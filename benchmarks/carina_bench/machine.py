"""Description of the machine on which figures were measured, and check for the compared programs."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import platform
from pathlib import Path
from typing import Any

import carina
from carina.errors import CarinaError
from carina.installation import extra_command, rebuild
from carina.render import build_info

__all__ = ["load_average", "machine_facts", "require_peers", "stolen_s"]

PEERS = ("vtk", "numba", "scipy", "numpy", "dijkstra3d", "scikit-image")
"""Names of the Python packages with which Carina is compared."""


def require_peers(*names: str) -> None:
    """Raise an error if a package with which Carina is compared is missing.

    Raises
    ------
    CarinaError
        If a package is not installed (exit code 1); the message contains the command that installs it.
    """
    missing = [name for name in names if importlib.util.find_spec(name) is None]
    if missing:
        verb = "is" if len(missing) == 1 else "are"
        msg = f"{', '.join(missing)} {verb} not installed; install the peers with: {extra_command('bench')}"
        raise CarinaError(msg, code="machine.extra")
    if build_info()["profile"] != "release":
        raise CarinaError(f"benchmarks refuse a debug build: {rebuild()}", code="machine.debug-build")


def load_average() -> list[float] | None:
    """Return the load averages of the last 1, 5 and 15 minutes; None if the system does not report them."""
    try:
        return [round(v, 2) for v in os.getloadavg()]
    except (AttributeError, OSError):
        return None


def stolen_s() -> float | None:
    """Return the time in which the host did not run this virtual machine, summed over all cores, s.

    The result is None if the system does not report the time.
    """
    try:
        words = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
        return int(words[8]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError, AttributeError):
        return None


def _cpu_model() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    facts = dict(line.split(":", 1) for line in lines if ":" in line)
    named = {key.strip(): value.strip() for key, value in facts.items()}
    model = named.get("model name", platform.machine())
    if "cpu family" in named:
        model += f" (family {named['cpu family']}, model {named.get('model', '?')})"
    return model


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def machine_facts() -> dict[str, Any]:
    """Return processor, instruction sets, cores, load and versions of packages as JSON values."""
    core = build_info()
    return {
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "instruction_set": core["simd"],
        "profile": core["profile"],
        "target": core["target"],
        "platform": platform.platform(),
        "load_average": load_average(),
        "versions": {
            "carina": carina.__version__,
            "python": platform.python_version(),
            **{name: _version(name) for name in PEERS},
        },
    }
