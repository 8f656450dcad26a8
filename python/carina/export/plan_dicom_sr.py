"""Export of the measures of targets as a DICOM structured report: a measurement report of template 1500.

References
----------
DICOM PS3.3 A.35.13 (Comprehensive 3D SR), C.17 (SR documents); PS3.16 TID 1500, 1600, 1411, 1501 and 1204.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence as Items
from pydicom.uid import Comprehensive3DSRStorage, SegmentationStorage, generate_uid
from pydicom.valuerep import DSfloat

from carina.disk import write_whole
from carina.errors import UsageError, VolumeImportError
from carina.export.plan_content import note_sentences
from carina.export.plan_dicom import (
    CtImages,
    Identity,
    check_suffix,
    code_item,
    ct_images,
    file_bytes,
    named_nodules,
    new_object,
)
from carina.export.plan_dicom_seg import inside_on_grid
from carina.plan import Nodule
from carina.volume import Volume
from carina.volume.dicom_headers import damaged_elements_refused, read_dataset

_Concept = tuple[str, str, str]
_REPORT: _Concept = ("126000", "DCM", "Imaging Measurement Report")
_LANGUAGE: _Concept = ("121049", "DCM", "Language of Content Item and Descendants")
_ENGLISH: _Concept = ("en", "RFC5646", "English")
_OBSERVER_TYPE: _Concept = ("121005", "DCM", "Observer Type")
_DEVICE: _Concept = ("121007", "DCM", "Device")
_OBSERVER_UID: _Concept = ("121012", "DCM", "Device Observer UID")
_OBSERVER_NAME: _Concept = ("121013", "DCM", "Device Observer Name")
_PROCEDURE: _Concept = ("121058", "DCM", "Procedure reported")
_CT: _Concept = ("77477000", "SCT", "Computed Tomography")
_LIBRARY: _Concept = ("111028", "DCM", "Image Library")
_LIBRARY_GROUP: _Concept = ("126200", "DCM", "Image Library Group")
_MEASUREMENTS: _Concept = ("126010", "DCM", "Imaging Measurements")
_GROUP: _Concept = ("125007", "DCM", "Measurement Group")
_TRACKING: _Concept = ("112039", "DCM", "Tracking Identifier")
_TRACKING_UID: _Concept = ("112040", "DCM", "Tracking Unique Identifier")
_FINDING: _Concept = ("121071", "DCM", "Finding")
_NODULE: _Concept = ("27925004", "SCT", "Nodule")
_SITE: _Concept = ("363698007", "SCT", "Finding Site")
_LUNG: _Concept = ("39607008", "SCT", "Lung")
_SEGMENT: _Concept = ("121191", "DCM", "Referenced Segment")
_SOURCE_SERIES: _Concept = ("121232", "DCM", "Source series for segmentation")
_VOLUME: _Concept = ("118565006", "SCT", "Volume")
_LONG: _Concept = ("103339001", "SCT", "Long Axis")
_SHORT: _Concept = ("103340004", "SCT", "Short Axis")
_CENTRE: _Concept = ("111010", "DCM", "Center")
_COMMENT: _Concept = ("121106", "DCM", "Comment")
_MM: _Concept = ("mm", "UCUM", "mm")
_MM3: _Concept = ("mm3", "UCUM", "mm3")


def write_target_report(
    path: Path | str,
    targets: Nodule | Mapping[str, Nodule],
    volume: Volume,
    ct: Path | str,
    *,
    segmentation: Path | str | None = None,
    identity: Identity = "none",
    series: str | None = None,
    now: datetime.datetime | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Path:
    """Write volume, diameters and centre of each target as a DICOM measurement report, unverified and preliminary.

    Parameters
    ----------
    path
        File to be written; it must end in ``.dcm``.
    targets
        A nodule, or several by name; the name of a single one is "Target".
    volume, ct, identity, series, now, cancel
        As for :func:`carina.export.write_target_seg`.
    segmentation
        Existing DICOM segmentation of these targets, to whose segments the measurement groups refer.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    UsageError
        If the suffix is wrong, there is no target, a name is invalid, the CT is not DICOM or not that of the volume, or
        the segmentation has no segment with a target's name or belongs to another CT.
    VolumeImportError
        If the CT or the segmentation cannot be read.
    DiskError
        If the file cannot be written; a former file stays unchanged.
    """
    check_suffix(path, "saving a DICOM report")
    named = named_nodules(targets, "saving a DICOM report")
    images = ct_images(ct, volume, series=series, cancel=cancel)
    segments = None if segmentation is None else _segments(Path(segmentation), images, list(named))
    data = new_object(
        Comprehensive3DSRStorage,
        images,
        identity=identity,
        modality="SR",
        series_number=9302,
        series_words="Carina: measurements of a bronchoscopy plan",
        now=now,
    )
    used = sorted({k for nodule in named.values() for k in _slices(nodule, volume)})
    _document(data)
    data.CurrentRequestedProcedureEvidenceSequence = Items([_evidence_sequence(images, used, segments)])
    groups = [_measurement_group(name, nodule, images, segments) for name, nodule in named.items()]
    data.ContentSequence = Items(
        [
            _code_item("HAS CONCEPT MOD", _LANGUAGE, _ENGLISH),
            _code_item("HAS OBS CONTEXT", _OBSERVER_TYPE, _DEVICE),
            _content_item("HAS OBS CONTEXT", "UIDREF", _OBSERVER_UID, UID=generate_uid(prefix=None)),
            _content_item("HAS OBS CONTEXT", "TEXT", _OBSERVER_NAME, TextValue="Carina, not a medical device"),
            _code_item("HAS CONCEPT MOD", _PROCEDURE, _CT),
            _container_item(
                _LIBRARY,
                [_container_item(_LIBRARY_GROUP, [_image_item(images, k) for k in used], template=None)],
                "1600",
            ),
            _container_item(_MEASUREMENTS, groups, template=None),
        ]
    )
    return write_whole(path, file_bytes(data), what="the report")


@dataclass(frozen=True, slots=True)
class _Segments:
    """UIDs and segment numbers of a segmentation, for references to it."""

    series_uid: str
    instance_uid: str
    numbers: dict[str, int]
    tracking_uids: dict[str, str]


def _segments(path: Path, images: CtImages, names: Sequence[str]) -> _Segments:
    def damaged(problem: str) -> VolumeImportError:
        msg = f"reading the segmentation {path.name}: {problem}; write it again"
        return VolumeImportError(msg, code="import.mask")

    with damaged_elements_refused(damaged):
        return _read_segments(path, images, names)


def _read_segments(path: Path, images: CtImages, names: Sequence[str]) -> _Segments:
    try:
        data = read_dataset(path, pixels=True)
    except ValueError as error:
        raise VolumeImportError(
            f"reading the segmentation {path.name}: it {error}; write it again", code="import.mask"
        ) from None
    if data.get("SOPClassUID") != SegmentationStorage:
        raise UsageError(
            f"{path.name} is not a DICOM segmentation; name the file that write_target_seg wrote", code="plan.other-seg"
        )
    referred = {str(one.get("SeriesInstanceUID", "")) for one in data.get("ReferencedSeriesSequence", [])}
    if images.series_uid not in referred:
        raise UsageError(
            f"{path.name} is a segmentation of another CT; write the segmentation of this one", code="plan.other-seg"
        )
    rows = {str(one.SegmentLabel): one for one in data.get("SegmentSequence", [])}
    missing = [name for name in names if name not in rows]
    if missing:
        raise UsageError(
            f"{path.name} has no segment called {missing[0]!r}; it has {', '.join(rows) or 'none'}",
            code="plan.other-seg",
        )
    return _Segments(
        str(data.SeriesInstanceUID),
        str(data.SOPInstanceUID),
        {name: int(rows[name].SegmentNumber) for name in names},
        {name: str(rows[name].get("TrackingUID") or generate_uid(prefix=None)) for name in names},
    )


def _slices(nodule: Nodule, volume: Volume) -> list[int]:
    """Return the indices of the CT slices that contain the nodule; the nearest slice if it fills half of no voxel."""
    seen = np.flatnonzero(inside_on_grid(nodule, volume).any(axis=(1, 2)))
    if len(seen):
        return [int(k) for k in seen]
    nearest = float(volume.to_ijk(np.array(nodule.centre_lps))[2])
    return [int(np.clip(round(nearest), 0, volume.shape_zyx[0] - 1))]


def _document(data: Dataset) -> None:
    data.ReferencedPerformedProcedureStepSequence = Items()
    data.PerformedProcedureCodeSequence = Items()
    data.CompletionFlag, data.VerificationFlag, data.PreliminaryFlag = "COMPLETE", "UNVERIFIED", "PRELIMINARY"
    data.ValueType, data.ContinuityOfContent = "CONTAINER", "SEPARATE"
    data.ConceptNameCodeSequence = Items([code_item(*_REPORT)])
    data.ContentTemplateSequence = Items([_template("1500")])


def _evidence_sequence(images: CtImages, used: Sequence[int], segments: _Segments | None) -> Dataset:
    def instance(kind: str, uid: str) -> Dataset:
        item = Dataset()
        item.ReferencedSOPClassUID, item.ReferencedSOPInstanceUID = kind, uid
        return item

    of_ct = Dataset()
    of_ct.SeriesInstanceUID = images.series_uid
    of_ct.ReferencedSOPSequence = Items(instance(images.image_class, uid) for uid in images.instance_uids(used))
    series = [of_ct]
    if segments is not None:
        of_segments = Dataset()
        of_segments.SeriesInstanceUID = segments.series_uid
        of_segments.ReferencedSOPSequence = Items([instance(SegmentationStorage, segments.instance_uid)])
        series.append(of_segments)
    study = Dataset()
    study.StudyInstanceUID, study.ReferencedSeriesSequence = images.study_uid, Items(series)
    return study


def _measurement_group(name: str, nodule: Nodule, images: CtImages, segments: _Segments | None) -> Dataset:
    tracking_uid = generate_uid(prefix=None) if segments is None else segments.tracking_uids[name]
    items = [
        _content_item("HAS OBS CONTEXT", "TEXT", _TRACKING, TextValue=name),
        _content_item("HAS OBS CONTEXT", "UIDREF", _TRACKING_UID, UID=tracking_uid),
        _code_item("CONTAINS", _FINDING, _NODULE),
    ]
    if segments is not None:
        referred = Dataset()
        referred.ReferencedSOPClassUID, referred.ReferencedSOPInstanceUID = SegmentationStorage, segments.instance_uid
        referred.ReferencedSegmentNumber = segments.numbers[name]
        items += [
            _content_item("CONTAINS", "IMAGE", _SEGMENT, ReferencedSOPSequence=Items([referred])),
            _content_item("CONTAINS", "UIDREF", _SOURCE_SERIES, UID=images.series_uid),
        ]
    items += [
        _code_item("HAS CONCEPT MOD", _SITE, _LUNG),
        _number_item(_VOLUME, nodule.volume_mm3, _MM3),
        _number_item(_LONG, nodule.long_mm, _MM),
        _number_item(_SHORT, nodule.short_mm, _MM),
        _content_item(
            "CONTAINS",
            "SCOORD3D",
            _CENTRE,
            GraphicType="POINT",
            GraphicData=[float(v) for v in nodule.centre_lps],
            ReferencedFrameOfReferenceUID=images.frame_of_reference_uid,
        ),
        _content_item("CONTAINS", "TEXT", _COMMENT, TextValue=_nodule_text(nodule)),
    ]
    return _container_item(_GROUP, items, "1501" if segments is None else "1411")


def _nodule_text(nodule: Nodule) -> str:
    touches = f"; touches: {', '.join(nodule.touches)}" if nodule.touches else ""
    return (
        f"{nodule.words}{touches}. Nine times of ten the volume lies within {nodule.volume_error_mm3:.0f} mm3 and the "
        f"axial diameters within {nodule.diameter_error_mm:.1f} mm.{note_sentences(nodule)} "
        "Not verified by a reader. Not a medical device."
    )


def _content_item(relationship: str, kind: str, concept: _Concept, **values: Any) -> Dataset:
    item = Dataset()
    item.RelationshipType, item.ValueType = relationship, kind
    item.ConceptNameCodeSequence = Items([code_item(*concept)])
    for keyword, value in values.items():
        setattr(item, keyword, value)
    return item


def _code_item(relationship: str, concept: _Concept, value: _Concept) -> Dataset:
    return _content_item(relationship, "CODE", concept, ConceptCodeSequence=Items([code_item(*value)]))


def _number_item(concept: _Concept, value: float, unit: _Concept) -> Dataset:
    measured = Dataset()
    measured.NumericValue = DSfloat(value, auto_format=True)
    measured.FloatingPointValue = value
    measured.MeasurementUnitsCodeSequence = Items([code_item(*unit)])
    return _content_item("CONTAINS", "NUM", concept, MeasuredValueSequence=Items([measured]))


def _image_item(images: CtImages, k: int) -> Dataset:
    item = Dataset()
    item.RelationshipType, item.ValueType = "CONTAINS", "IMAGE"
    item.ReferencedSOPSequence = Items([images.reference(k)])
    return item


def _container_item(concept: _Concept, items: Sequence[Dataset], template: str | None) -> Dataset:
    held = _content_item("CONTAINS", "CONTAINER", concept, ContinuityOfContent="SEPARATE", ContentSequence=Items(items))
    if template is not None:
        held.ContentTemplateSequence = Items([_template(template)])
    return held


def _template(number: str) -> Dataset:
    item = Dataset()
    item.MappingResource, item.MappingResourceUID = "DCMR", "1.2.840.10008.8.1.1"
    item.TemplateIdentifier = number
    return item
