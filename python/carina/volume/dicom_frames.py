"""Frames of enhanced (multi-frame) CT and MR files: each frame gets the tags that a single slice has in its own file.

An enhanced file (PS3.3 C.7.6.16) states position, orientation, spacing, rescale, kernel and phase in functional groups,
for each frame or once for all frames. The frames may be in any order; ``dicom_series`` and ``dicom_geometry`` sort and
check them like slices in separate files.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from pydicom.dataset import Dataset
from pydicom.tag import Tag

_CLASSES = frozenset(f"1.2.840.10008.5.1.4.1.1.{kind}" for kind in ("2", "2.1", "2.2", "4", "4.1", "4.4"))
"""Classes of CT and MR images: classic, enhanced, and legacy converted."""
HU_UNIT = "[hnsf'u]"
"""UCUM code of the Hounsfield unit, in lower case."""

_MACROS: dict[str, dict[str, str]] = {
    "PixelMeasuresSequence": {"PixelSpacing": "PixelSpacing", "SliceThickness": "SliceThickness"},
    "PlanePositionSequence": {"ImagePositionPatient": "ImagePositionPatient"},
    "PlaneOrientationSequence": {"ImageOrientationPatient": "ImageOrientationPatient"},
    "PixelValueTransformationSequence": {
        "RescaleSlope": "RescaleSlope",
        "RescaleIntercept": "RescaleIntercept",
        "RescaleType": "RescaleType",
    },
    "FrameContentSequence": {
        "StackID": "StackID",
        "TemporalPositionIndex": "TemporalPositionIndex",
        "FrameAcquisitionNumber": "AcquisitionNumber",
        "FrameReferenceDateTime": "AcquisitionTime",
        "FrameAcquisitionDateTime": "AcquisitionTime",
    },
    "TemporalPositionSequence": {"TemporalPositionTimeOffset": "TemporalPositionTimeOffset"},
    "CTImageFrameTypeSequence": {"FrameType": "ImageType"},
    "MRImageFrameTypeSequence": {"FrameType": "ImageType"},
    "CTReconstructionSequence": {"ConvolutionKernel": "ConvolutionKernel"},
    "CTXRayDetailsSequence": {"KVP": "KVP", "FilterType": "FilterType"},
    "MREchoSequence": {"EffectiveEchoTime": "EchoTime"},
    "MRDiffusionSequence": {"DiffusionBValue": "DiffusionBValue"},
    "CardiacSynchronizationSequence": {
        "NominalPercentageOfCardiacPhase": "NominalPercentageOfCardiacPhase",
        "NominalCardiacTriggerDelayTime": "TriggerTime",
    },
    "RespiratorySynchronizationSequence": {
        "NominalPercentageOfRespiratoryPhase": "NominalPercentageOfRespiratoryPhase",
    },
}
"""Tags of a single slice by functional group and by the group's tag with the same meaning."""
_FRAME_TAGS = tuple(dict.fromkeys(own for macro in _MACROS.values() for own in macro.values()))


def is_enhanced(dataset: Dataset) -> bool:
    """Return whether a file is a CT or MR image with functional groups, whose frames can be read like slices."""
    kind = str(dataset.get("SOPClassUID") or "")
    return kind in _CLASSES and bool(dataset.get("PerFrameFunctionalGroupsSequence"))


def described_frames(dataset: Dataset) -> int:
    """Return the number of frames that the functional groups of an enhanced file describe."""
    return len(dataset.PerFrameFunctionalGroupsSequence)


def each_frame(dataset: Dataset) -> Iterator[int]:
    """Give the data set the tags of each frame in turn; yield the index of the frame.

    The data set is changed in place, because a copy for each of a thousand frames would take most of the time.
    """
    top = {tag: dataset.get_item(tag) for tag in map(Tag, _FRAME_TAGS) if tag in dataset}
    shared = dataset.get("SharedFunctionalGroupsSequence") or [Dataset()]
    for index, frame in enumerate(dataset.PerFrameFunctionalGroupsSequence):
        for tag in map(Tag, _FRAME_TAGS):
            if tag in dataset:
                del dataset[tag]
        for element in top.values():
            dataset[element.tag] = element
        groups = (shared[0], frame)
        for macro, tags in _MACROS.items():
            # A group of the frame replaces the group that all frames share.
            item = next(filter(None, (_first(group, macro) for group in reversed(groups))), None)
            if item is not None:
                _copy(item, dataset, tags)
        if "RescaleSlope" not in dataset and "RescaleIntercept" not in dataset:
            _use_real_world_values(groups, dataset)
        yield index


def _first(group: Dataset, macro: str) -> Dataset | None:
    items: Sequence[Dataset] | None = group.get(macro)
    return items[0] if items else None


def _copy(item: Dataset, dataset: Dataset, tags: dict[str, str]) -> None:
    """Copy the tags of a functional group to the tags with the same meaning of a single slice."""
    for keyword, own in tags.items():
        if keyword not in item:
            continue
        if keyword == own:
            dataset[Tag(own)] = item.get_item(Tag(keyword))
        else:
            value: Any = item.get(keyword)
            setattr(dataset, own, str(value)[8:] if own == "AcquisitionTime" else value)


def _use_real_world_values(groups: Sequence[Dataset], dataset: Dataset) -> None:
    """Use a frame's real-world value map in HU as its rescale, if the frame has no other rescale."""
    maps = next((found for group in reversed(groups) if (found := group.get("RealWorldValueMappingSequence"))), ())
    for entry in maps:
        units = entry.get("MeasurementUnitsCodeSequence") or ()
        in_hu = any(str(unit.get("CodeValue", "")).lower() == HU_UNIT for unit in units)
        slope, intercept = entry.get("RealWorldValueSlope"), entry.get("RealWorldValueIntercept")
        if in_hu and slope is not None and intercept is not None:
            dataset.RescaleSlope, dataset.RescaleIntercept, dataset.RescaleType = slope, intercept, "HU"
            return
