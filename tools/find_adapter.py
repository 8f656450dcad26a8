"""Find a Vulkan driver for the GPU tests; ``--install`` installs Debian's software driver if no driver is found."""

from __future__ import annotations

import ctypes.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

PACKAGES = ("mesa-vulkan-drivers", "libvulkan1")
"""Debian packages of the software driver lavapipe and of the loader that finds drivers."""
PLACES = ("/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d")
"""Folders in which manifests of drivers are searched."""
NAMED = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES")
"""Environment variables that can contain the path of a driver's manifest."""


def find_driver() -> str | None:
    """Return the path of a Vulkan driver's manifest, or the name of the system's API on macOS and Windows.

    Else None.
    """
    if sys.platform in {"darwin", "win32"}:
        return "Metal" if sys.platform == "darwin" else "Direct3D 12"
    if ctypes.util.find_library("vulkan") is None:
        return None
    named = next((value for name in NAMED if (value := os.environ.get(name))), None)
    found = (str(path) for place in PLACES for path in sorted(Path(place).glob("*.json")))
    return named or next(found, None)


def install_driver() -> bool:
    """Install the software driver lavapipe and return whether it succeeded.

    This needs Debian and the user root; in other cases the function prints what the user can do.
    """
    apt = shutil.which("apt-get")
    if apt is None or not hasattr(os, "geteuid") or os.geteuid() != 0:
        print(
            f"no Vulkan driver found: install {' and '.join(PACKAGES)} (a driver in software is enough)",
            file=sys.stderr,
        )
        return False
    quiet = {"stdout": subprocess.DEVNULL}
    subprocess.run([apt, "update", "-q"], check=True, **quiet)
    subprocess.run([apt, "install", "-y", "-q", "--no-install-recommends", *PACKAGES], check=True, **quiet)
    return True


if __name__ == "__main__":
    if find_driver() is None and "--install" in sys.argv[1:]:
        install_driver()
    driver = find_driver()
    print(f"graphics driver: {driver or 'none'}")
    sys.exit(0 if driver else 1)
