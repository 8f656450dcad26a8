"""Export of targets as a DICOM segmentation (SEG) that refers to the CT's own images.

References
----------
DICOM PS3.3 A.51 and C.8.20 (segmentation), C.7.6.16 (multi-frame functional groups), C.7.6.17 (dimensions); PS3.16
CID 7150, 7159 and 4031 (codes); PS3.5 8.1.1 (bits packed from the lowest).
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence as Items
from pydicom.tag import Tag
from pydicom.uid import SegmentationStorage, generate_uid

from carina.disk import write_whole
from carina.errors import NoResultError, UsageError, check_type
from carina.export.plan_content import note_sentences
from carina.export.plan_dicom import (
    CtImages,
    Identity,
    check_suffix,
    code_item,
    ct_images,
    decimals,
    file_bytes,
    named_nodules,
    new_object,
)
from carina.plan import Nodule
from carina.track import Airways, drawn_tree, lumen_mask
from carina.version import VERSION
from carina.volume import Volume

_HALF = 0.5
LUMEN_NAME: Final = "Airway lumen"
_LAB_YELLOW, _LAB_BLUE = (58111, 30069, 51143), (47000, 29000, 24500)
"""Recommended display values, CIELab scaled to 16 bits (PS3.3 C.10.7.1.1)."""

Mask = NDArray[np.bool_]
_Concept = tuple[str, str, str]


def write_target_seg(
    path: Path | str,
    targets: Nodule | Mapping[str, Nodule],
    volume: Volume,
    ct: Path | str,
    *,
    airways: Airways | None = None,
    identity: Identity = "none",
    series: str | None = None,
    now: datetime.datetime | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Path:
    """Write targets as a binary DICOM segmentation on the CT's grid, one segment per target.

    A voxel of the CT belongs to the segment if at least half of it is nodule. The measures of the nodule, which are
    more precise than voxels, are in the segment's description.

    Parameters
    ----------
    path
        File to be written; it must end in ``.dcm``.
    targets
        A nodule, or several by name; the name of a single one is "Target".
    volume
        The CT that they were marked in.
    ct
        DICOM folder of the CT, or one of its files.
    airways
        Airways whose lumen is written as a last segment, "Airway lumen".
    identity
        ``"none"`` writes no name, number, date or institution; the UIDs of the CT are written, because the segmentation
        refers to its images. ``"from the CT"`` copies name, number, birth date, sex and the study's numbers, for an
        archive.
    series
        Key of the series; without it the series is found by its pixels.
    now
        Time of creation; the computer's clock if None.
    cancel
        Called often; the work stops when it returns True.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    UsageError
        If the suffix is wrong, there is no target, a name is invalid, or the CT is not DICOM or not that of the volume.
    NoResultError
        If a target does not fill half of any voxel (``plan.too-small``).
    VolumeImportError
        If the CT cannot be read.
    DiskError
        If the file cannot be written; a former file stays unchanged.
    """
    check_suffix(path, "saving a DICOM segmentation")
    named = named_nodules(targets, "saving a DICOM segmentation")
    images = ct_images(ct, volume, series=series, cancel=cancel)
    parts = [_nodule_part(name, nodule, volume) for name, nodule in named.items()]
    if airways is not None:
        check_type("saving a DICOM segmentation", "airways", airways, Airways, "get it from carina.find_airways")
        if LUMEN_NAME in named:
            raise UsageError(
                f"saving a DICOM segmentation: a target is called {LUMEN_NAME!r}, as the airways are; rename it",
                code="plan.name",
            )
        parts.append(_lumen_part(airways, volume))
    data = new_object(
        SegmentationStorage,
        images,
        identity=identity,
        modality="SEG",
        series_number=9301,
        series_words="Carina: targets of a bronchoscopy plan",
        now=now,
    )
    _fill_frames(data, parts, images, volume)
    return write_whole(path, file_bytes(data), what="the segmentation")


def inside_on_grid(nodule: Nodule, volume: Volume) -> Mask:
    """Return the mask (nz, ny, nx) of the CT's voxels of which at least half is nodule.

    Parameters
    ----------
    nodule
        The nodule; its parts outside the CT are ignored.
    volume
        The CT.
    """
    found = np.zeros(volume.shape_zyx, dtype=bool)
    at = np.argwhere(nodule.inside_zyx)
    if not len(at):
        return found
    # Corners of the nodule's voxels, half a voxel beyond their centres.
    lo, hi = at.min(axis=0)[::-1] - 0.5, at.max(axis=0)[::-1] + 0.5
    corners = np.array([[x, y, z] for x in (lo[0], hi[0]) for y in (lo[1], hi[1]) for z in (lo[2], hi[2])])
    ijk = volume.to_ijk(corners @ nodule.lps_from_ijk[:3, :3].T + nodule.lps_from_ijk[:3, 3])
    first = np.maximum(np.floor(ijk.min(axis=0)).astype(int), 0)
    last = np.minimum(np.ceil(ijk.max(axis=0)).astype(int), np.array(volume.shape_zyx[::-1]) - 1)
    if (last < first).any():
        return found
    step_mm = float(np.linalg.norm(nodule.lps_from_ijk[:3, 0]))
    # Sample points in a voxel of the CT, no farther apart than the nodule's voxels.
    within = [
        np.linspace(-0.5, 0.5, 2 * n + 1)[1::2] for n in (max(2, round(mm / step_mm)) for mm in volume.spacing_mm)
    ]
    offsets = np.stack(np.meshgrid(*within, indexing="ij"), axis=-1).reshape(-1, 3)
    i, j = (np.arange(first[axis], last[axis] + 1) for axis in (0, 1))
    for k in range(first[2], last[2] + 1):
        voxels = np.stack(np.meshgrid(i, j, [k], indexing="ij"), axis=-1).reshape(-1, 3)
        points = volume.to_lps((voxels[:, None] + offsets).reshape(-1, 3))
        share = nodule.contains(points).reshape(len(voxels), -1).mean(axis=1)
        filled = voxels[share >= _HALF]
        found[filled[:, 2], filled[:, 1], filled[:, 0]] = True
    return found


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Voxels and description of one segment of the file."""

    label: str
    inside: Mask
    description: str
    algorithm: tuple[str, str]
    """Type and name of the algorithm."""
    codes: tuple[_Concept, _Concept]
    """Category and type of the segmented structure."""
    region: _Concept | None
    """Anatomic region, unless the type implies it."""
    cielab: tuple[int, int, int]


def _nodule_part(name: str, nodule: Nodule, volume: Volume) -> _Part:
    inside = inside_on_grid(nodule, volume)
    if not inside.any():
        raise NoResultError(
            f"saving a DICOM segmentation: {name} does not fill half of any voxel of the CT; save it as .seg.nrrd, "
            "which keeps its shape",
            code="plan.too-small",
        )
    return _Part(
        name,
        inside,
        f"{nodule.words} as measured (90 % within {nodule.volume_error_mm3 / 1000.0:.2f} ml); the voxels of this "
        f"segment hold {_volume_ml(inside, volume):.2f} ml.{note_sentences(nodule)}",
        ("SEMIAUTOMATIC", f"Carina {VERSION}, grown from a click"),
        (("49755003", "SCT", "Morphologically Abnormal Structure"), ("27925004", "SCT", "Nodule")),
        ("39607008", "SCT", "Lung"),
        _LAB_YELLOW,
    )


def _lumen_part(airways: Airways, volume: Volume) -> _Part:
    inside = lumen_mask(volume, airways) != 0
    drawn = drawn_tree(airways.tree).words
    words = f"the lumen of the airways found, {_volume_ml(inside, volume):.1f} ml"
    return _Part(
        LUMEN_NAME,
        inside,
        words if drawn is None else f"{words}; {drawn}: not from the CT",
        ("AUTOMATIC" if drawn is None else "SEMIAUTOMATIC", f"Carina {VERSION}"),
        (("123037004", "SCT", "Anatomical Structure"), ("89187006", "SCT", "Airway structure")),
        None,
        _LAB_BLUE,
    )


def _volume_ml(inside: Mask, volume: Volume) -> float:
    return float(np.count_nonzero(inside)) * float(np.prod(volume.spacing_mm)) / 1000.0


def _fill_frames(data: Dataset, parts: Sequence[_Part], images: CtImages, volume: Volume) -> None:
    data.FrameOfReferenceUID = images.frame_of_reference_uid
    data.PositionReferenceIndicator = ""
    data.ImageType = ["DERIVED", "PRIMARY"]
    data.ContentLabel, data.ContentDescription = "TARGETS", "Targets of a bronchoscopy plan; not a medical device"
    data.ContentCreatorName = ""
    data.Rows, data.Columns = volume.shape_zyx[1:]
    data.SamplesPerPixel, data.PhotometricInterpretation, data.PixelRepresentation = 1, "MONOCHROME2", 0
    data.BitsAllocated, data.BitsStored, data.HighBit = 1, 1, 0
    data.SegmentationType = "BINARY"
    data.LossyImageCompression = "00"
    if images.slices[0].lossy:
        data.LossyImageCompression = "01"
        for keyword in ("LossyImageCompressionRatio", "LossyImageCompressionMethod"):
            if images.first.get(keyword):
                setattr(data, keyword, images.first.get(keyword))
    data.SegmentSequence = Items(_segment(number, part) for number, part in enumerate(parts, 1))
    # Frames of a segment: all slices from its first to its last.
    frames: list[tuple[int, int]] = []
    for number, part in enumerate(parts, 1):
        slices = np.flatnonzero(part.inside.any(axis=(1, 2)))
        frames += [(number, int(k)) for k in range(slices[0], slices[-1] + 1)]
    data.NumberOfFrames = len(frames)
    used = sorted({k for _, k in frames})
    _add_references(data, images, used)
    _add_dimensions(data)
    data.SharedFunctionalGroupsSequence = Items([_shared_groups(images, volume)])
    places = {k: n for n, k in enumerate(used, 1)}
    data.PerFrameFunctionalGroupsSequence = Items(_frame_groups(images, number, k, places[k]) for number, k in frames)
    bits = np.concatenate([parts[number - 1].inside[k].reshape(-1) for number, k in frames])
    content = np.packbits(bits, bitorder="little").tobytes()
    data.PixelData = content + b"\0" * (len(content) % 2)
    data["PixelData"].VR = "OB"


def _segment(number: int, part: _Part) -> Dataset:
    item = Dataset()
    item.SegmentNumber, item.SegmentLabel, item.SegmentDescription = number, part.label, part.description
    item.SegmentAlgorithmType, item.SegmentAlgorithmName = part.algorithm
    category, kind = part.codes
    item.SegmentedPropertyCategoryCodeSequence = Items([code_item(*category)])
    item.SegmentedPropertyTypeCodeSequence = Items([code_item(*kind)])
    if part.region is not None:
        item.AnatomicRegionSequence = Items([code_item(*part.region)])
    item.TrackingID, item.TrackingUID = part.label, generate_uid(prefix=None)
    item.RecommendedDisplayCIELabValue = list(part.cielab)
    return item


def _add_references(data: Dataset, images: CtImages, used: Sequence[int]) -> None:
    series = Dataset()
    series.SeriesInstanceUID = images.series_uid
    series.ReferencedInstanceSequence = Items(_instance_reference(images, uid) for uid in images.instance_uids(used))
    data.ReferencedSeriesSequence = Items([series])


def _instance_reference(images: CtImages, uid: str) -> Dataset:
    item = Dataset()
    item.ReferencedSOPClassUID, item.ReferencedSOPInstanceUID = images.image_class, uid
    return item


def _add_dimensions(data: Dataset) -> None:
    """Add the dimensions: frames are ordered by segment, then by position."""
    uid = generate_uid(prefix=None)
    organisation = Dataset()
    organisation.DimensionOrganizationUID = uid
    data.DimensionOrganizationSequence = Items([organisation])
    pointers: tuple[tuple[str, str, str], ...] = (
        ("ReferencedSegmentNumber", "SegmentIdentificationSequence", "Segment"),
        ("ImagePositionPatient", "PlanePositionSequence", "Place of the slice"),
    )
    items = []
    for element, group, words in pointers:
        item = Dataset()
        item.DimensionOrganizationUID = uid
        item.DimensionIndexPointer, item.FunctionalGroupPointer = Tag(element), Tag(group)
        item.DimensionDescriptionLabel = words
        items.append(item)
    data.DimensionIndexSequence = Items(items)


def _shared_groups(images: CtImages, volume: Volume) -> Dataset:
    first = images.slices[0]
    gap_mm = volume.spacing_mm[2]
    measures, orientation = Dataset(), Dataset()
    # The row distance comes first, then the column distance.
    measures.PixelSpacing = decimals((first.spacing_mm[1], first.spacing_mm[0]))
    measures.SliceThickness, measures.SpacingBetweenSlices = decimals((gap_mm, gap_mm))
    orientation.ImageOrientationPatient = decimals((*first.row_lps, *first.column_lps))
    shared = Dataset()
    shared.PixelMeasuresSequence, shared.PlaneOrientationSequence = Items([measures]), Items([orientation])
    return shared


def _frame_groups(images: CtImages, number: int, k: int, place: int) -> Dataset:
    content, position, segment, derived = Dataset(), Dataset(), Dataset(), Dataset()
    content.DimensionIndexValues = [number, place]
    position.ImagePositionPatient = decimals(images.slices[k].position_lps)
    segment.ReferencedSegmentNumber = number
    source: Any = images.reference(k)
    source.PurposeOfReferenceCodeSequence = Items(
        [code_item("121322", "DCM", "Source image for image processing operation")]
    )
    source.SpatialLocationsPreserved = "YES"
    derived.SourceImageSequence = Items([source])
    derived.DerivationCodeSequence = Items([code_item("113076", "DCM", "Segmentation")])
    frame = Dataset()
    frame.FrameContentSequence, frame.PlanePositionSequence = Items([content]), Items([position])
    frame.SegmentIdentificationSequence, frame.DerivationImageSequence = Items([segment]), Items([derived])
    return frame
