"""Location of the CT of the open case, for objects that refer to its DICOM files."""

from __future__ import annotations

from pathlib import Path

from carina.session.open_case.open_case import OpenCase
from carina.volume.dicom_references import References

DROPPED = (
    "the CT was dropped into the window, so the folder of its DICOM files is not known: open the CT by its folder to "
    "save DICOM files that refer to it"
)


def ct_of(case: OpenCase) -> Path | References | None:
    """Return the CT with which a target's file is compared: its path, or the references read from a dropped CT."""
    if case.planning.origin.place is not None and Path(case.planning.origin.place).exists():
        return Path(case.planning.origin.place)
    return case.planning.origin.references


def dicom_problem(case: OpenCase) -> str | None:
    """Return a message why no DICOM file can refer to the CT; None if one can."""
    if case.info.volume.source.format != "dicom":
        return "the CT was not opened from DICOM files, which a DICOM object has to refer to"
    if case.planning.origin.place is None:
        return DROPPED
    if not Path(case.planning.origin.place).exists():
        return "the folder that the CT was opened from is no longer there: connect it, or open the CT again"
    return None
