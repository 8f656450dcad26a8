"""Names of dropped files: neutral ones on the disk, the person's own on the screen.

A file's name often is the patient's. What lies in the temporary folder is called ``dropped-TAG-NUMBER.SUFFIX``;
messages to the window are given the name back by which the person knows the file.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections import OrderedDict
from pathlib import PurePosixPath

__all__ = ["DroppedNames", "safe_suffix"]

_TOKEN = re.compile(r"dropped-[0-9a-f]{8}(?:-[0-9]+(?:\.[a-z0-9]+)*)?")
_KEPT = 16
"""So many uploads' names are remembered: what is on the screen is of the last few."""
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
"""Other endings may be a part of a name: they do not stay."""


def safe_suffix(name: str) -> str:
    """The ending by which a reader knows the format, in lower case; empty where there is none."""
    pieces = name.lower().rsplit(".", 2)
    for count in (2, 1):
        suffix = "." + ".".join(pieces[-count:])
        if len(pieces) > count and suffix in _SUFFIXES:
            return suffix
    return ""


class DroppedNames:
    """Hands out neutral names, and turns them into the person's own again."""

    def __init__(self) -> None:
        self._uploads: OrderedDict[str, dict[str, str]] = OrderedDict()
        self._numbers: dict[str, dict[tuple[str, str], int]] = {}

    def begin(self, tag: str) -> str:
        """A new upload; returns the name of its folder."""
        while len(self._uploads) >= _KEPT:
            gone, _ = self._uploads.popitem(last=False)
            self._numbers.pop(gone, None)
        self._uploads[tag], self._numbers[tag] = {}, {}
        return f"dropped-{tag}"

    def neutral(self, tag: str, relative: PurePosixPath, name: str) -> PurePosixPath:
        """Where a file lies: neutral names for it and its folders, the same again for the same ones.

        Parameters
        ----------
        tag
            Of :meth:`begin`.
        relative
            What the browser calls it, made harmless.
        name
            The last part as the browser wrote it.
        """
        *folders, last = relative.parts
        place = PurePosixPath()
        for depth, folder in enumerate(folders):
            # With a stroke: a file may have the name of a folder beside it.
            place /= self._named(tag, "/".join(folders[:depth]), f"{folder}/", folder, "")
        return place / self._named(tag, "/".join(folders), last, _shown(name) or last, safe_suffix(last))

    def another(self, tag: str, place: PurePosixPath) -> PurePosixPath:
        """A new neutral name for a file whose own is taken: both were made of names that are now equal."""
        known = self._uploads[tag]
        suffix = safe_suffix(place.name)
        made = f"dropped-{tag}-{self._next(tag)}{suffix}"
        known[made] = known[place.name]
        return place.with_name(made)

    def restored(self, text: str) -> str:
        """A JSON text in which neutral names are replaced by the person's own."""
        if "dropped-" not in text:
            return text
        return _TOKEN.sub(self._own, text)

    def _own(self, found: re.Match[str]) -> str:
        token = found[0]
        known = self._uploads.get(token[8:16])
        if known is None:
            return token
        if token == token[:16]:
            return "dropped files"
        while token not in known:
            # A name without its ending, or with one more; what is left over stays.
            token, dot, _ = token.rpartition(".")
            if not dot:
                return found[0]
        return json.dumps(known[token])[1:-1] + found[0][len(token) :]

    def _named(self, tag: str, above: str, part: str, own: str, suffix: str) -> str:
        """Files that differ in their ending only (a header and its data) still do."""
        known, numbers = self._uploads[tag], self._numbers[tag]
        stem = part[: len(part) - len(suffix)] if suffix else part
        number = numbers.get((above, stem))
        if number is None:
            number = numbers[above, stem] = self._next(tag)
        made = f"dropped-{tag}-{number}{suffix}"
        known.setdefault(made, own)
        if suffix:
            known.setdefault(made[: len(made) - len(suffix)], stem)
        return made

    def _next(self, tag: str) -> int:
        numbers = self._numbers[tag]
        numbers["", ""] = numbers.get(("", ""), 0) + 1
        return numbers["", ""]


def _shown(name: str) -> str:
    """The last part of a name that a browser sent, without what no screen shows."""
    last = re.split(r"[/\\]", name)[-1]
    return "".join(c for c in last if unicodedata.category(c)[0] != "C")[:120]
