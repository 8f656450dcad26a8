"""Export of a plan to a file, in the format of its suffix."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carina.errors import UsageError
from carina.export.plan_content import marked_nodules, named_plans
from carina.export.plan_markups import PLAN_MARKUPS_SUFFIX, write_plan_markups
from carina.export.plan_nrrd import TARGET_NRRD_SUFFIX, write_target_nrrd
from carina.plan import Plan
from carina.track import Airways, AirwayTree
from carina.volume import Note, Volume

if TYPE_CHECKING:
    from carina.export.plan_dicom import Identity

_SEG, _SR, _PDF = ".seg.dcm", ".sr.dcm", ".pdf.dcm"

PLAN_FORMATS: Final[dict[str, str]] = {
    PLAN_MARKUPS_SUFFIX: "Targets, routes and needles for 3D Slicer",
    TARGET_NRRD_SUFFIX: "The target as a segmentation for 3D Slicer",
    _SEG: "The targets as a DICOM segmentation of the CT",
    _SR: "Measurements of the targets as a DICOM report",
}
"""Suffixes that :func:`export_plan` can write, with a description of each for the user."""


def check_plan_file(
    path: Path | str,
    volume: Volume | None,
    ct: Path | str | None,
    *,
    series: str | None = None,
    identity: Identity = "none",
    cancel: Callable[[], bool] | None = None,
) -> None:
    """Check, before a plan is made, that a plan on this CT can be written to a file of this name.

    Parameters
    ----------
    path
        The file to be written, with a suffix of :data:`PLAN_FORMATS`, or a ``.pdf.dcm`` for an archive.
    volume, ct, series, identity, cancel
        As in :func:`export_plan`.

    Raises
    ------
    UsageError
        If the suffix is unknown, or the file refers to the images of a CT that is not DICOM.
    VolumeImportError
        If the CT cannot be read.
    """
    refers = _PDF if Path(path).name.lower().endswith(_PDF) else _plan_suffix(path)
    # A report for an archive needs the CT only for the patient's identity.
    if refers not in (_SEG, _SR) and not (refers == _PDF and identity == "from the CT"):
        return
    if volume is None or ct is None:
        raise UsageError(
            f"{Path(path).name}: a DICOM file refers to the CT's images: give the CT (volume) and its DICOM folder "
            "(ct)",
            code="plan.not-dicom",
        )
    # Imported here, because other formats do not need pydicom.
    from carina.export.plan_dicom import ct_images

    ct_images(ct, volume, series=series, cancel=cancel)


def _plan_suffix(path: Path | str) -> str:
    name = Path(path).name
    suffix = next((one for one in PLAN_FORMATS if name.lower().endswith(one)), None)
    if suffix is None:
        known = ", ".join(PLAN_FORMATS)
        raise UsageError(f"a plan: expected a file name that ends in {known}; found {name!r}")
    return suffix


def export_plan(
    path: Path | str,
    plan: Plan | Mapping[str, Plan],
    tree: AirwayTree | None = None,
    *,
    volume: Volume | None = None,
    ct: Path | str | None = None,
    series: str | None = None,
    airways: Airways | None = None,
    segmentation: Path | str | None = None,
    identity: Identity = "none",
    badges: Sequence[Note] = (),
    now: datetime.datetime | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Path:
    """Write a plan for other software, in the format of the suffix, with coordinates in LPS, mm.

    ``.mrk.json``: targets, routes, needles and scope positions for 3D Slicer. ``.seg.nrrd``: the target as a
    segmentation for 3D Slicer, one target per file. ``.seg.dcm``: the targets as a DICOM segmentation that refers to
    the CT's images. ``.sr.dcm``: the measures of the targets as a DICOM report. :func:`carina.export_airways` writes
    the airways.

    Parameters
    ----------
    path
        File to be written.
    plan
        A plan, or several by the names of their targets.
    tree
        The airway tree of the plan; for ``.mrk.json``.
    volume, ct
        The CT of the plan and its DICOM folder; for DICOM.
    series
        Key of the CT's series; without it the series is found by its pixels.
    airways
        Airways whose lumen becomes a segment; for ``.seg.dcm``.
    segmentation
        Existing ``.seg.dcm`` of the same targets, to which a ``.sr.dcm`` refers.
    identity
        ``"none"`` writes no data of the patient except the CT's UIDs; ``"from the CT"`` copies name, number, birth
        date, sex and the study's numbers.
    badges
        Lasting notes of the case; for ``.mrk.json`` and ``.seg.nrrd``.
    now
        Time of creation of a DICOM file; the computer's clock if None.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    UsageError
        If the suffix is unknown, an argument that the format requires is missing, or the plan does not fit the format.
    NoResultError
        If a target does not fill half of any voxel of the CT (DICOM segmentation).
    VolumeImportError
        If the CT cannot be read.
    DiskError
        If the file cannot be written; a former file stays unchanged.

    Examples
    --------
    >>> import carina
    >>> from carina.export import export_plan
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> found = carina.find_airways(made.volume)
    >>> plan = carina.plan_route(made.volume, found, made.truth["nodule"]["centre_lps"])
    >>> export_plan("plan.mrk.json", plan, found.tree).name
    'plan.mrk.json'
    """
    name = Path(path).name
    suffix = _plan_suffix(path)
    plans = named_plans(plan)
    nodules = marked_nodules(plans)
    if suffix == PLAN_MARKUPS_SUFFIX:
        if tree is None:
            raise UsageError(f"{name}: routes need the airway tree that the plan was made on", code="plan.other-tree")
        return write_plan_markups(path, plans, tree, badges=badges)
    if suffix == TARGET_NRRD_SUFFIX:
        if len(plans) > 1:
            raise UsageError(
                f"{name}: a segmentation of this kind holds one target and the plan has {len(plans)}; write a file for "
                f"each, or all of them into one {_SEG}",
                code="plan.several",
            )
        ((title, only),) = nodules.items()
        return write_target_nrrd(path, only, name=title, badges=badges)
    if volume is None or ct is None:
        raise UsageError(
            f"{name}: a DICOM file refers to the CT's images: give the CT (volume) and its DICOM folder (ct)",
            code="plan.not-dicom",
        )
    # Imported here, because other formats do not need pydicom.
    from carina.export.plan_dicom_seg import write_target_seg
    from carina.export.plan_dicom_sr import write_target_report

    if suffix == _SEG:
        return write_target_seg(
            path, nodules, volume, ct, airways=airways, identity=identity, series=series, now=now, cancel=cancel
        )
    return write_target_report(
        path,
        nodules,
        volume,
        ct,
        segmentation=segmentation,
        identity=identity,
        series=series,
        now=now,
        cancel=cancel,
    )
