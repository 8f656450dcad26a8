"""Files of Carina on a disk: atomic writes by drafts (unfinished files), temporary folders, and safe opening."""

from __future__ import annotations

from carina.disk.atomic_files import (
    Draft,
    Placement,
    create_folders,
    drafted,
    make_folder,
    sweep_drafts,
    sync_folder,
    write_whole,
)
from carina.disk.disk_errors import disk_trouble, is_disk_trouble, say_size
from carina.disk.library_paths import library_path
from carina.disk.regular_files import (
    check_regular,
    open_regular,
    open_regular_text,
    read_regular_text,
    special_kind,
)
from carina.disk.temporary_folders import ScratchFolder, scratch_folder, sweep_scratch

__all__ = [
    "Draft",
    "Placement",
    "ScratchFolder",
    "check_regular",
    "create_folders",
    "disk_trouble",
    "drafted",
    "is_disk_trouble",
    "library_path",
    "make_folder",
    "open_regular",
    "open_regular_text",
    "read_regular_text",
    "say_size",
    "scratch_folder",
    "special_kind",
    "sweep_drafts",
    "sweep_scratch",
    "sync_folder",
    "write_whole",
]
