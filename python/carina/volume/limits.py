"""How much is read at most, whatever a header or a folder claims."""

from __future__ import annotations

__all__ = ["MAX_FILES", "MAX_VOXELS"]

MAX_FILES = 200_000
"""In one folder. More is somebody's disk, not a scan."""
MAX_VOXELS = 1 << 31
"""Of any volume that is opened: 4 GiB as int16, ten times a large chest CT."""
