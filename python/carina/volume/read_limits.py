"""Limits of the data that are read, independent of the claims of a header or a folder."""

from __future__ import annotations

MAX_FILES = 200_000
"""Maximum number of files in one folder; more files cannot be one scan."""
MAX_VOXELS = 1 << 31
"""Maximum number of voxels of a volume: 4 GiB as int16, ten times a large chest CT."""
