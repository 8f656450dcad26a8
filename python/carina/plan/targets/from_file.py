"""Targets from files: a mask, a DICOM segmentation or a structure set, each only for the CT that it belongs to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from numpy.typing import ArrayLike

from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import VolumeImportError, check_type
from carina.plan.targets.click_comparison import click_note
from carina.plan.targets.contours import OutlineError, drawn_in
from carina.plan.targets.from_mask import nodule_from_mask, one_piece, target_of
from carina.plan.targets.mask_measures import drawn_nodule
from carina.plan.targets.nodule import Nodule
from carina.plan.targets.target import NAME_CHARS, PlanTarget, TargetSource
from carina.scopes import WallField
from carina.volume import MaskLabel, MaskLabelError, Volume, open_mask
from carina.volume.dicom_references import References
from carina.volume.dicom_signature import looks_like_dicom
from carina.volume.dicom_structures import (
    Structure,
    ct_references,
    is_structure_set,
    read_references,
    read_structures,
    structures_refused,
)
from carina.volume.io_errors import guarded
from carina.volume.progress import Watch

MIN_MM2 = 0.01
"""Minimum area in mm2 of an outline; a smaller one is a point or a line."""
UNCHECKED = "its file does not say on which CT it was drawn; only its position was checked"
NO_DICOM = "whether it was drawn on this very CT could not be checked; only its position was"
PART_OF_SCAN = "the segmentation covers only part"
SISTER = "it was drawn on another series of the same examination, which has the same coordinates"


@shows_progress
def target_from_file(
    path: str | Path,
    volume: Volume,
    *,
    structure: int | str | None = None,
    at_lps: ArrayLike | None = None,
    ct: str | Path | References | None = None,
    target_id: str = "target",
    name: str | None = None,
    resample: bool = False,
    wall: WallField | None = None,
    compare_click: bool = False,
    progress: ProgressChoice = None,
    cancel: Callable[[], bool] | None = None,
) -> PlanTarget:
    """Read a target from a mask (NIfTI, NRRD, MetaImage), a DICOM SEG or an RTSTRUCT.

    Parameters
    ----------
    path
        The file.
    volume
        The CT that the target is planned in.
    structure
        Number or name of the structure (label, segment, ROI). Required only if the file contains several.
    at_lps
        (3,) point in LPS mm that selects a part of the structure, if it has several.
    ct
        Folder or file from which the CT was opened, or its `ct_references`, with which the references in a DICOM file
        are compared. A file that refers to a CT with other coordinates is refused. Without ``ct`` only the position is
        checked, and a note of the target states this.
    target_id
        Identifier of the target.
    name
        Name of the target; the name of the structure if None.
    resample
        Whether to accept a mask on another grid (not for outlines).
    wall
        Wall of the airways, with which a target in an airway is recognised.
    compare_click
        Whether to add a note with the volume and the diameters that a click at the middle of the structure gives.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is None while the progress is unknown.
    cancel
        Called often; the work stops when it returns True.

    Raises
    ------
    VolumeImportError
        If the file is damaged, belongs to another CT or has another grid (codes as for `open_mask`), or if it contains
        several structures and none is selected (`MaskLabelError`).
    NoResultError
        If the structure is empty, or has several parts and no point selects one.
    CancelledError
        If ``cancel()`` returned True.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> ct, lumen, _ = carina.write_phantom(phantom, "phantom")
    >>> target_from_file(lumen, phantom.volume, name="a mask").source
    'mask'
    """
    check_type("target_from_file", "volume", volume, Volume, "open a volume with carina.open_volume")
    watch = Watch(progress_function(progress), cancel)
    file = Path(path).expanduser()
    source: TargetSource = "mask"
    ours: References | None = None
    if file.is_file() and looks_like_dicom(file):
        source = "rtstruct" if is_structure_set(file) else "seg"
        ours = ct if ct is None or isinstance(ct, References) else ct_references(Path(ct).expanduser(), volume, watch)
    if source == "rtstruct":
        nodule, named = guarded(
            file, lambda where: _from_structures(where, volume, structure, at_lps, ours=ours, watch=watch)
        )
    else:
        notes = _belonging(file, read_references(file), ours) if source == "seg" else ()
        number, named = _label(file, volume, structure, resample=resample)
        mask = open_mask(file, volume, label=number, resample=resample, progress=watch.progress, cancel=cancel)
        nodule = nodule_from_mask(volume, mask, at_lps=at_lps)
        # The note about partial coverage is dropped: the file of a nodule need not cover the whole scan.
        nodule_notes = (note for note in nodule.notes if not note.startswith(PART_OF_SCAN))
        nodule = replace(nodule, notes=(*nodule_notes, *notes))
    given = named[:NAME_CHARS] if name is None else name
    if compare_click:
        text = click_note(volume, nodule, wall=wall, progress=watch.step)
        nodule = replace(nodule, notes=(*nodule.notes, text))
    return target_of(volume, nodule, source, target_id=target_id, name=given, wall=wall)


def _label(file: Path, volume: Volume, structure: int | str | None, *, resample: bool) -> tuple[int | None, str]:
    """Return the number and the name of the selected label; the name is empty where the file has none."""
    try:
        # No file has the label -1, so the error lists the labels of the file.
        open_mask(file, volume, label=-1, resample=resample)
    except MaskLabelError as error:
        labels = error.labels
    else:
        return None, ""
    if isinstance(structure, str):
        chosen = _named(file, structure, labels)
    elif structure is None and len(labels) == 1:
        chosen = labels[0]
    else:
        found = [label for label in labels if label.number == structure]
        if not found:
            why = "choose the nodule" if structure is None else f"{structure} is not among them"
            raise _several(file, labels, why)
        chosen = found[0]
    return chosen.number, chosen.name or ""


def _named(file: Path, name: str, labels: tuple[MaskLabel, ...]) -> MaskLabel:
    found = [label for label in labels if (label.name or "").casefold() == name.strip().casefold()]
    if len(found) != 1:
        raise _several(file, labels, f"{len(found)} of them are named {name}" if found else f"none is named {name}")
    return found[0]


def _several(file: Path, labels: tuple[MaskLabel, ...], why: str) -> MaskLabelError:
    listed = ", ".join(f"{label.number} ({label.name})" if label.name else str(label.number) for label in labels[:12])
    more = f" and {len(labels) - 12} more" if len(labels) > 12 else ""
    return MaskLabelError(
        f"reading {file.name}: it contains the structures {listed}{more}; {why}; choose one by its number or name "
        "(--structure, or structure= in Python)",
        labels,
    )


def _from_structures(
    file: Path,
    volume: Volume,
    wanted: int | str | None,
    at_lps: ArrayLike | None,
    *,
    ours: References | None,
    watch: Watch,
) -> tuple[Nodule, str]:
    """Return the nodule of a structure in a structure set, and the structure's name."""
    chosen = _chosen(file, read_structures(file, watch).structures, wanted, volume)
    if not chosen.contours:
        problem = f"the structure {_number_and_name(chosen)} is empty"
        if chosen.num_open:
            problem = f"the structure {_number_and_name(chosen)} holds only points or open lines, which enclose nothing"
        raise structures_refused(file, problem, "choose another structure, or click on the nodule")
    notes = _belonging(file, chosen.references, ours)
    watch.step("Placing the outlines", None)
    closed = [contour for contour in chosen.contours if contour.area_mm2 >= MIN_MM2]
    if not closed:
        raise structures_refused(file, f"the structure {_number_and_name(chosen)} encloses no area", "export it again")
    same_frame = ours is not None and bool(chosen.references.frames & ours.frames)
    try:
        drawn, drawn_notes, off_mm = drawn_in(volume, closed, may_be_between=same_frame)
    except OutlineError as error:
        raise structures_refused(file, str(error), error.way_out, code=error.code) from None
    drawn, left = one_piece(volume, drawn, at_lps)
    if chosen.num_open:
        left = (*left, f"{chosen.num_open} of its points or open lines left out")
    return drawn_nodule(volume, drawn, notes=(*notes, *drawn_notes, *left), off_mm=off_mm), chosen.name


def _chosen(file: Path, structures: tuple[Structure, ...], wanted: int | str | None, volume: Volume) -> Structure:
    """Return the structure that the user selected, or the only structure that is drawn."""
    labels = tuple(MaskLabel(one.number, one.name or None, _about_ml(one, volume)) for one in structures)
    if wanted is None:
        drawn = [one for one in structures if one.contours]
        if len(drawn) == 1:
            return drawn[0]
        if not drawn:
            problem = "all of its structures are empty" if len(structures) > 1 else "its structure is empty"
            raise structures_refused(file, problem, "export it with the outline of the nodule")
        raise _several(file, tuple(label for label in labels if label.volume_ml > 0.0), "choose the nodule")
    number = _named(file, wanted, labels).number if isinstance(wanted, str) else wanted
    for one in structures:
        if one.number == number:
            return one
    raise _several(file, labels, f"{number} is not among them")


def _about_ml(structure: Structure, volume: Volume) -> float:
    """Return the approximate volume of a structure in ml: area times slice distance, without regard to holes."""
    return sum(contour.area_mm2 for contour in structure.contours) * volume.spacing_mm[2] / 1000.0


def _belonging(file: Path, theirs: References, ours: References | None) -> tuple[str, ...]:
    """Return notes on the CT to which a file belongs; raise an error if the file belongs to another CT."""
    if not (theirs.frames or theirs.series or theirs.images):
        return (UNCHECKED,)
    if ours is None:
        return (NO_DICOM,)
    same_series = bool(theirs.series & ours.series) or bool(theirs.images & ours.images)
    other_frame = bool(theirs.frames) and bool(ours.frames) and not theirs.frames & ours.frames
    other_study = bool(theirs.studies) and bool(ours.studies) and not theirs.studies & ours.studies
    if other_frame or (not same_series and other_study):
        raise VolumeImportError(
            f"reading {file.name}: it was drawn on another CT (its frame of reference or its examination differs), "
            "perhaps an earlier or a later scan; open the CT that it was drawn on, or mark the target in this one",
            code="import.other-ct",
        )
    if same_series:
        return ()
    return (SISTER,) if theirs.frames & ours.frames else (NO_DICOM,)


def _number_and_name(structure: Structure) -> str:
    return f"{structure.number} ({structure.name})" if structure.name else str(structure.number)
