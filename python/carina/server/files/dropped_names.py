"""Neutral names for dropped files on disk, and their replacement by the original names in messages.

A file name often contains the name of the patient. Files in the temporary folder are therefore called
``dropped-TAG-NUMBER.SUFFIX``. In messages to the window each such name is replaced by the original name.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections import OrderedDict
from pathlib import PurePosixPath

_TOKEN = re.compile(r"dropped-[0-9a-f]{8}(?:-[0-9]+(?:\.[a-z0-9]+)*)?")
_MAX_UPLOADS = 16
"""Number of uploads whose names are stored; messages on the screen refer only to recent uploads."""
_SUFFIXES = frozenset(
    [
        ".nii",
        ".nii.gz",
        ".nii.bz2",
        ".gz",
        ".bz2",
        ".nrrd",
        ".nhdr",
        ".mha",
        ".mhd",
        ".raw",
        ".zraw",
        ".raw.gz",
        ".hdr",
        ".hdr.gz",
        ".img",
        ".img.gz",
        ".dcm",
        ".dicom",
        ".ima",
        ".sr",
        ".seg",
        ".carina",
        ".json",
        ".jsonl",
        ".csv",
        ".txt",
        ".xml",
        ".pdf",
        ".zip",
        ".7z",
        ".rar",
        ".tar",
        ".tgz",
        ".tar.gz",
        ".tar.bz2",
        ".tar.xz",
        ".png",
        ".jpg",
        ".jpeg",
        ".tif",
        ".tiff",
        ".mp4",
        ".stl",
        ".obj",
        ".ply",
        ".vtk",
        ".vti",
        ".vtp",
        ".vtu",
        ".mnc",
        ".mgh",
        ".mgz",
    ]
)
"""File suffixes that neutral names contain; any other suffix may be part of a patient name and is removed."""


def safe_suffix(name: str) -> str:
    """Return the suffix that identifies the file format, in lower case; empty if the suffix is not known."""
    pieces = name.lower().rsplit(".", 2)
    for count in (2, 1):
        suffix = "." + ".".join(pieces[-count:])
        if len(pieces) > count and suffix in _SUFFIXES:
            return suffix
    return ""


class DroppedNames:
    """Table from the neutral names of dropped files to their original names."""

    def __init__(self) -> None:
        self._uploads: OrderedDict[str, dict[str, str]] = OrderedDict()
        self._numbers: dict[str, dict[tuple[str, str], int]] = {}

    def begin(self, tag: str) -> str:
        """Register a new upload by its tag, and return the neutral name of its folder."""
        while len(self._uploads) >= _MAX_UPLOADS:
            oldest, _ = self._uploads.popitem(last=False)
            self._numbers.pop(oldest, None)
        self._uploads[tag], self._numbers[tag] = {}, {}
        return f"dropped-{tag}"

    def neutral_path(self, tag: str, relative: PurePosixPath, name: str) -> PurePosixPath:
        """Return the neutral relative path of a file; equal folders and stems always get equal neutral names.

        Parameters
        ----------
        tag
            Tag of the upload, as passed to :meth:`begin`.
        relative
            Safe relative path of the file, as the browser named it.
        name
            Unchanged name that the browser sent; its last part is shown to the user.
        """
        *folders, last = relative.parts
        place = PurePosixPath()
        for depth, folder in enumerate(folders):
            # The slash separates a folder from a file of the same name beside it.
            place /= self._neutral_part(tag, "/".join(folders[:depth]), f"{folder}/", folder, "")
        return place / self._neutral_part(
            tag, "/".join(folders), last, _shortened_name(name) or last, safe_suffix(last)
        )

    def another_neutral_path(self, tag: str, place: PurePosixPath) -> PurePosixPath:
        """Return a new neutral path for a file whose neutral path ``place`` is taken.

        A path can be taken because two original names may have the same safe form.
        """
        known = self._uploads[tag]
        suffix = safe_suffix(place.name)
        made = f"dropped-{tag}-{self._next_number(tag)}{suffix}"
        known[made] = known[place.name]
        return place.with_name(made)

    def with_original_names(self, text: str) -> str:
        """Return a JSON text in which the original names replace the neutral names."""
        if "dropped-" not in text:
            return text
        return _TOKEN.sub(self._original_name, text)

    def _original_name(self, found: re.Match[str]) -> str:
        token = found[0]
        known = self._uploads.get(token[8:16])
        if known is None:
            return token
        if token == token[:16]:
            return "dropped files"
        while token not in known:
            # The text may name a file with an additional suffix; that suffix is left unchanged.
            token, dot, _ = token.rpartition(".")
            if not dot:
                return found[0]
        return json.dumps(known[token])[1:-1] + found[0][len(token) :]

    def _neutral_part(self, tag: str, above: str, part: str, own: str, suffix: str) -> str:
        """Return the neutral name of a folder or file of an upload, and store its own name for messages.

        Names that differ only in suffix get the same number.

        Parameters
        ----------
        tag
            Identifier of the upload.
        above
            Path of the folder that contains the file or folder.
        part
            Name of the file or folder in the path.
        own
            Name that messages show in place of the neutral name.
        suffix
            Suffix of ``part`` that the neutral name keeps, such as ``.dcm``; may be empty.
        """
        known, numbers = self._uploads[tag], self._numbers[tag]
        stem = part[: len(part) - len(suffix)] if suffix else part
        number = numbers.get((above, stem))
        if number is None:
            number = numbers[above, stem] = self._next_number(tag)
        made = f"dropped-{tag}-{number}{suffix}"
        known.setdefault(made, own)
        if suffix:
            known.setdefault(made[: len(made) - len(suffix)], stem)
        return made

    def _next_number(self, tag: str) -> int:
        numbers = self._numbers[tag]
        numbers["", ""] = numbers.get(("", ""), 0) + 1
        return numbers["", ""]


def _shortened_name(name: str) -> str:
    """Return the last part of a name without control characters, at most 120 characters long."""
    last = re.split(r"[/\\]", name)[-1]
    return "".join(c for c in last if unicodedata.category(c)[0] != "C")[:120]
