"""DICOM series of the corpus that test rescale tags and the division of images into series."""
# ruff: noqa: E501 (a table: one input a line)

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from corpus import Input
from corpus_dicom_files import FILES, PIXELS
from corpus_dicom_values import MODALITY_LUT, PADDING
from dicom_writer import GAP_MM, NUM_SLICES, Edit, chest, series
from pydicom.dataset import Dataset

__all__ = ["INPUTS"]

Make = Callable[[Path], Path]
SOURCE = "Export the series again from its original archive."
CHOOSE = "To open another series, use `--series`."
CHECK = "Check that this is the right scan."
TISSUE = "Compare a known tissue with its HU."
OTHER = "Choose another series."
MISSING_SLICES = "Copy the missing slices."
WHOLE = {"expected": "opens", "voxels": chest}
SECOND = chest(seed=6)
"""HU values of a second CT with the same anatomy and other noise."""


def _tags(change: Callable[[int], dict[str, Any]]) -> Make:
    """Return a function that writes a series whose slices have the tags of ``change(index)``.

    A tag with the value None is removed.
    """

    def edit(dataset: Dataset, index: int) -> None:
        for keyword, value in change(index).items():
            if value is None:
                delattr(dataset, keyword)
            elif value == "":
                setattr(dataset, keyword, None)
            else:
                setattr(dataset, keyword, value)

    return lambda folder: series(folder, edit)


def _some(at: tuple[int, ...], **tags: Any) -> Make:
    return _tags(lambda index: tags if index in at else {})


def _all(**tags: Any) -> Make:
    return _tags(lambda index: tags)


THREE = (4, 9, 11)
NAMED = ("IM004", "IM009", "IM011", "3 of its 20 slices")


def _lettered(keyword: str, text: str) -> Make:
    """Return a function that writes a series in which one slice has a text in place of a number.

    pydicom does not check this text.
    """

    def edit(dataset: Dataset, index: int) -> None:
        if index == 4:
            setattr(dataset, keyword, 1)
            dataset[keyword]._value = text

    return lambda folder: series(folder, edit)


def _own_rescale(folder: Path) -> Path:
    def edit(dataset: Dataset, index: int) -> None:
        slope, intercept = (0.5, 1.0, 0.25)[index % 3], -1200 + 7 * index
        dataset.RescaleSlope, dataset.RescaleIntercept = slope, intercept
        dataset.PixelData = ((chest()[index] - float(intercept)) / slope).astype("<u2").tobytes()

    return series(folder, edit)


def _unscaled(*, as_hu: bool) -> Make:
    def edit(dataset: Dataset, index: int) -> None:
        del dataset.RescaleSlope, dataset.RescaleIntercept
        if as_hu:
            dataset.PixelRepresentation = 1
            dataset.PixelData = chest()[index].astype("<i2").tobytes()

    return lambda folder: series(folder, edit)


def _stored() -> np.ndarray:
    return (chest() + np.int16(1024)).astype(np.int16)


MIXED = {"expected": "import.rescale-mixed", "do": SOURCE}
RESCALE = [
    Input("three slices without slope and intercept", "DICOM: rescale", _some(THREE, RescaleSlope=None, RescaleIntercept=None), names=NAMED, **MIXED),
    Input("three slices with an empty slope and intercept", "DICOM: rescale", _some(THREE, RescaleSlope="", RescaleIntercept=""), names=NAMED, **MIXED),
    Input("the last slice without intercept", "DICOM: rescale", _some((19,), RescaleIntercept=None), names=("IM019", "RescaleIntercept"), **MIXED),
    Input("half of the slices without slope", "DICOM: rescale", _some(tuple(range(10)), RescaleSlope=None), names=("10 of its 20", "RescaleSlope"), **MIXED),
    Input("three slices with intercept 0, the others -1024", "DICOM: rescale", _some(THREE, RescaleIntercept=0), "import.rescale-contradicts", names=("IM004",), do=SOURCE),
    Input("the upper half with intercept 0, the lower -1024", "DICOM: rescale", _some(tuple(range(10)), RescaleIntercept=0), "import.rescale-contradicts", names=("IM010",), do=SOURCE),
    Input("one slice with an intercept that is not a number", "DICOM: rescale", _lettered("RescaleIntercept", "none"), "import.tags", names=("IM004",), do=SOURCE),
    Input("one slice with slope 0", "DICOM: rescale", _some((4,), RescaleSlope=0), "import.tags", names=("IM004",), do=SOURCE),
    Input("one slice with slope NaN", "DICOM: rescale", _lettered("RescaleSlope", "nan"), "import.tags", names=("IM004",), do=SOURCE),
    Input("no rescale in any slice, stored values 1024 above HU", "DICOM: rescale", _unscaled(as_hu=False), "opens", ("import.rescale-absent",), is_hu=False, voxels=_stored, do=SOURCE),
    Input("no rescale in any slice, stored values are HU", "DICOM: rescale", _unscaled(as_hu=True), "opens", ("import.rescale-absent",), voxels=chest, do=TISSUE),
    Input("intercept 0 in all slices, stored values 1024 above HU", "DICOM: rescale", _all(RescaleIntercept=0), "opens", is_hu=False, voxels=_stored, do=SOURCE),
    Input("no slope in any slice, an intercept in all", "DICOM: rescale", _all(RescaleSlope=None), "opens", ("import.rescale-absent",), voxels=chest, do=TISSUE),
    Input("a rescale type that is not HU", "DICOM: rescale", _all(RescaleType="US"), "opens", is_hu=False, voxels=chest, do=OTHER),
    Input("a different slope and intercept in every slice", "DICOM: rescale", _own_rescale, **WHOLE),
    Input("several frames in one file, without functional groups", "DICOM: rescale", _all(NumberOfFrames=7), "import.multi-frame", do="Export the series with one file for each slice (classic CT images)."),
]  # fmt: skip


def _change(keyword: str, first: Any, second: Any, at: Callable[[int], bool] = lambda index: index >= 10) -> Make:
    return _tags(lambda index: {keyword: second if at(index) else first})


CHANGE, MISSING = ("import.settings-change",), ("import.settings-missing",)
NAMELESS = ("import.identity-missing",)
FRAMES = ("import.frame-per-slice",)


def _without(*lost: int) -> Make:
    def make(folder: Path) -> Path:
        series(folder)
        for index in lost:
            (folder / f"IM{index:03d}").unlink()
        return folder

    return make


def _tilted(folder: Path) -> Path:
    lean_mm = GAP_MM * float(np.tan(np.radians(20.0)))
    return series(
        folder,
        lambda d, k: setattr(d, "ImagePositionPatient", [-11.25, round(-14.5 + k * lean_mm, 6), k * GAP_MM]),
    )


def _two_distances(folder: Path) -> Path:
    return series(
        folder, lambda d, k: setattr(d, "ImagePositionPatient", [-11.25, -14.5, k * GAP_MM - 1.0 * max(k - 12, 0)])
    )


def _two_mixed_scans(folder: Path) -> Path:
    return series(folder, lambda d, k: setattr(d, "ImagePositionPatient", [-11.25, -14.5, k // 2 * GAP_MM + k % 2]))


def _frame_per_slice_with_a_gap(folder: Path) -> Path:
    _tags(lambda i: {"FrameOfReferenceUID": f"1.2.3.4.6.{i}"})(folder)
    (folder / "IM008").unlink()
    return folder


def _two_kernels_and_a_frame_per_slice(folder: Path) -> Path:
    for number, kernel, hu in ((0, "B41f", chest()), (1, "B70f", SECOND[:18])):

        def edit(dataset: Dataset, index: int, number: int = number, kernel: str = kernel) -> None:
            dataset.FrameOfReferenceUID, dataset.ConvolutionKernel = f"1.2.3.4.6.{number + 1}{index}", kernel

        name = "IJ"[number] + "M{:03d}"
        series(folder, edit, hu=hu, uid="1.2.3.98", shift_mm=number * GAP_MM / 2, name=name.format)
    return folder


def _copied(folder: Path) -> Path:
    series(folder)
    for index in (3, 4):
        shutil.copy(folder / f"IM{index:03d}", folder / f"IM{index:03d} (1)")
    return folder


def _with_scout(folder: Path) -> Path:
    uid = "1.2.3.99"
    series(folder, uid=uid)

    def scout(dataset: Dataset, index: int) -> None:
        dataset.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]
        dataset.ImageOrientationPatient = [1, 0, 0, 0, 0, -1]

    return series(folder, scout, hu=chest()[:1], uid=uid, name=lambda i: "scout")


ONE = "DICOM: one series"
HEALTHY = [
    Input("the acquisition number changes in mid-stack (two breath-holds)", ONE, _change("AcquisitionNumber", 1, 2), notes=CHANGE, **WHOLE),
    Input("a different acquisition number in every slice (step and shoot)", ONE, _tags(lambda i: {"AcquisitionNumber": i}), notes=CHANGE, **WHOLE),
    Input("a different acquisition number in every two slices", ONE, _tags(lambda i: {"AcquisitionNumber": i // 2}), notes=CHANGE, **WHOLE),
    Input("slices of another acquisition in mid-stack", ONE, _change("AcquisitionNumber", 1, 2, lambda i: 5 <= i < 12), notes=CHANGE, **WHOLE),
    Input("the kernel changes in mid-stack", ONE, _change("ConvolutionKernel", "B41f", "B70f"), notes=CHANGE, **WHOLE),
    Input("one slice of another kernel in mid-stack", ONE, _change("ConvolutionKernel", "B41f", "B70f", lambda i: i == 7), notes=CHANGE, **WHOLE),
    Input("another image type in the first and the last slice", ONE, _change("ImageType", ["ORIGINAL", "PRIMARY", "AXIAL"], ["DERIVED", "PRIMARY", "AXIAL"], lambda i: i in (0, 19)), notes=CHANGE, **WHOLE),
    Input("the temporal position changes in mid-stack", ONE, _change("TemporalPositionIdentifier", 1, 2), notes=CHANGE, **WHOLE),
    Input("contrast agent and tube voltage change in mid-stack", ONE, _tags(lambda i: {"KVP": 100 + 20 * (i < 9), "ContrastBolusAgent": ("X", "Y")[i < 9]}), notes=CHANGE, names=("tube voltage and contrast agent",), **WHOLE),
    Input("a different time in every slice", ONE, _tags(lambda i: {"AcquisitionTime": f"1015{i:02d}.5"}), **WHOLE),
    Input("120 kV written as 120 and as 120.0", ONE, _change("KVP", "120", "120.0", lambda i: i % 2 == 1), **WHOLE),
    Input("the patient's name in capitals in some slices", ONE, _change("PatientName", "Secret^One", "SECRET^ONE^^", lambda i: i % 3 == 1), **WHOLE),
    Input("half of the slices without contrast agent", ONE, _tags(lambda i: {"ContrastBolusAgent": "X"} if i < 10 else {}), notes=MISSING, **WHOLE),
    Input("every second slice without acquisition number", ONE, _some(tuple(range(0, 20, 2)), AcquisitionNumber=None), notes=MISSING, **WHOLE),
    Input("some slices without series number and kernel", ONE, _some(THREE, SeriesNumber=None, ConvolutionKernel=""), notes=MISSING, **WHOLE),
    Input("three slices without patient name, ID and birth date", ONE, _some(THREE, PatientID=None, PatientName="", PatientBirthDate=None), notes=NAMELESS, names=NAMED[:3], do=CHECK, **WHOLE),
    Input("three slices without SeriesInstanceUID", ONE, _some(THREE, SeriesInstanceUID=None), notes=NAMELESS, names=NAMED[:3], do=CHECK, **WHOLE),
    Input("no slice with a SeriesInstanceUID", ONE, _all(SeriesInstanceUID=""), **WHOLE),
    Input("half of the slices without frame of reference", ONE, _some(tuple(range(10)), FrameOfReferenceUID=None), notes=NAMELESS, do=CHECK, **WHOLE),
    Input("a different frame of reference in every slice", ONE, _tags(lambda i: {"FrameOfReferenceUID": f"1.2.3.4.6.{i}"}), notes=FRAMES, names=("20 slices", "20 frames"), **WHOLE),
    Input("a different frame of reference in most slices; two slices share one, three slices have none", ONE, _tags(lambda i: {"FrameOfReferenceUID": None if i in THREE else f"1.2.3.4.6.{max(i, 1)}"}), notes=FRAMES, **WHOLE),
    Input("a different frame of reference in every slice, and two kernels in alternating slices", ONE, _two_kernels_and_a_frame_per_slice, "opens", ("import.several-series", "import.frame-per-slice", "import.series-parted"), series=2, voxels=chest, do=CHOOSE),
    Input("a different frame of reference in every slice, and a missing slice", ONE, _frame_per_slice_with_a_gap, "opens", ("import.frame-per-slice", "import.slices-interpolated"), names=("slice 9",), do=MISSING_SLICES),
    Input("some slices without StudyInstanceUID", ONE, _some(THREE, StudyInstanceUID=""), notes=NAMELESS, do=CHECK, **WHOLE),
    Input("no patient, study, frame of reference, series number or acquisition number in any slice", ONE, _all(PatientID=None, PatientName=None, PatientBirthDate=None, StudyInstanceUID=None, FrameOfReferenceUID=None, SeriesNumber=None, AcquisitionNumber=None, SOPInstanceUID=None), **WHOLE),
    Input("image orientations that are rounded differently", ONE, _change("ImageOrientationPatient", [1, 0, 0, 0, 1, 0], [1, 0.00001, 0, -0.00001, 1, 0]), **WHOLE),
    Input("two slices that are present twice, byte for byte", ONE, _copied, notes=("import.copies",), **WHOLE),
    Input("each slice in a separate folder, file names in another order", ONE, lambda folder: series(folder, name=lambda i: f"{(i * 7) % 20:02d}/slice"), **WHOLE),
    Input("a scout in the same series", ONE, _with_scout, notes=("import.several-series",), series=2, **WHOLE),
]  # fmt: skip


def _two(
    tags: dict[str, Any],
    *,
    shift_mm: float = GAP_MM / 2,
    same_uid: bool = True,
    keep: Callable[[int], bool] = lambda index: True,
    both: dict[str, Any] | None = None,
    keep_first: Callable[[int], bool] = lambda index: True,
) -> Make:
    """Return a function that writes a folder with two scans.

    The second scan differs in tags and is ``shift_mm`` higher (default: half of the distance between slices).
    """

    def make(folder: Path) -> Path:
        def edit(mine: dict[str, Any]) -> Edit:
            def change(dataset: Dataset, index: int) -> None:
                for keyword, value in {**(both or {}), **mine}.items():
                    if value is None:
                        delattr(dataset, keyword)
                    else:
                        setattr(dataset, keyword, value)

            return change

        series(folder, edit({}), uid="1.2.3.98")
        series(
            folder,
            edit(tags),
            hu=SECOND,
            uid="1.2.3.98" if same_uid else "1.2.3.97",
            shift_mm=shift_mm,
            name=lambda i: f"JM{i:03d}",
        )
        for index in range(NUM_SLICES):
            if not keep(index):
                (folder / f"JM{index:03d}").unlink()
            if not keep_first(index):
                (folder / f"IM{index:03d}").unlink()
        return folder

    return make


OTHER_PATIENT = {"PatientID": "SECRET-2", "PatientName": "Secret^Two", "PatientBirthDate": "19020202"}
PARTED = ("import.several-series", "import.series-parted")
PATIENTS = ("import.several-series", "import.two-patients")
TWO = "DICOM: several stacks in one folder"


def _short(index: int) -> bool:
    """Return whether a slice belongs to the second scan, which has 18 slices; the first scan has 20."""
    return index < 18


def _coronal_too(folder: Path) -> Path:
    series(folder, uid="1.2.3.98")

    def coronal(dataset: Dataset, index: int) -> None:
        dataset.ImageOrientationPatient = [1, 0, 0, 0, 0, -1]
        dataset.ImagePositionPatient = [0, 3 * index, 20]

    return series(folder, coronal, hu=chest()[:6], uid="1.2.3.98", name=lambda i: f"cor{i}")


def _four_patients(folder: Path) -> Path:
    """Write slices of two patients without a series UID; only the patient tags differ."""

    def edit(dataset: Dataset, index: int) -> None:
        del dataset.SeriesInstanceUID
        if index >= 12:
            dataset.PatientID, dataset.PatientName = "SECRET-2", "Secret^Two"

    return series(folder, edit)


PART = {"expected": "opens", "do": CHOOSE, "series": 2, "voxels": chest}
SEVERAL = [
    Input("two patients under one series UID, in alternating slices", TWO, _two(OTHER_PATIENT, keep=_short), notes=(*PATIENTS, "import.series-parted"), **PART),
    Input("two patients under one series UID, at the same positions", TWO, _two(OTHER_PATIENT, shift_mm=0, keep=_short), notes=(*PATIENTS, "import.series-parted"), **PART),
    Input("two patients under one series UID, one above the other", TWO, _two(OTHER_PATIENT, shift_mm=50, keep=_short), notes=(*PATIENTS, "import.series-parted"), **PART),
    Input("two patients with the same name and different IDs", TWO, _two({"PatientID": "SECRET-2"}, keep=_short), notes=(*PATIENTS, "import.series-parted"), **PART),
    Input("two patients with the same ID and different names", TWO, _two({"PatientName": "Secret^Two"}, keep=_short), notes=(*PATIENTS, "import.series-parted"), **PART),
    Input("two patients with different series UIDs", TWO, _two(OTHER_PATIENT, same_uid=False, keep=_short), notes=PATIENTS, **PART),
    Input("two patients without a series UID, one above the other", TWO, _four_patients, "opens", (*PATIENTS, "import.series-parted"), voxels=lambda: chest()[:12], series=2, do=CHECK),
    Input("two studies in alternating slices", TWO, _two({"StudyInstanceUID": "1.2.3.4.55"}, keep=_short), notes=PARTED, **PART),
    Input("two frames of reference in alternating slices", TWO, _two({"FrameOfReferenceUID": "1.2.3.4.66"}, keep=_short), notes=PARTED, **PART),
    Input("CT and MR under one series UID", TWO, _two({"Modality": "MR"}, keep=_short), notes=PARTED, **PART),
    Input("two pixel spacings under one series UID", TWO, _two({"PixelSpacing": [0.8, 0.6]}, keep=_short), notes=PARTED, **PART),
    Input("coronal images under the series UID of the axial slices", TWO, _coronal_too, notes=PARTED, **PART),
    Input("two kernels at the same positions", TWO, _two({"ConvolutionKernel": "B70f"}, shift_mm=0, keep=_short), notes=PARTED, **PART),
    Input("two kernels in alternating slices", TWO, _two({"ConvolutionKernel": "B70f"}, keep=_short), notes=PARTED, **PART),
    Input("two kernels in alternating slices, with equal numbers of slices", TWO, _two({"ConvolutionKernel": "B70f"}), notes=PARTED, **PART),
    Input("two acquisitions in alternating slices", TWO, _two({"AcquisitionNumber": 2}), notes=PARTED, **PART),
    Input("two acquisitions in alternating slices that differ only in their time", TWO, _two({"AcquisitionTime": "101530.0"}), notes=PARTED, **PART),
    Input("two phases at the same positions", TWO, _two({"TemporalPositionIdentifier": 2}, both={"TemporalPositionIdentifier": 1}, shift_mm=0), notes=PARTED, **PART),
    Input("with and without contrast agent at the same positions", TWO, _two({"ContrastBolusAgent": "X"}, shift_mm=0, keep=_short), notes=PARTED, **PART),
    Input("maximum intensity projections at the positions of the slices", TWO, _two({"ImageType": ["DERIVED", "SECONDARY", "MIP"]}, shift_mm=0), notes=PARTED, **PART),
    Input("no series UID, two kernels in alternating slices", TWO, _two({"ConvolutionKernel": "B70f"}, both={"SeriesInstanceUID": None}), notes=PARTED, **PART),
    Input("two breath-holds that overlap by four slices", TWO, _two({"AcquisitionNumber": 2}, shift_mm=16 * GAP_MM, keep=_short), notes=(*PARTED, "import.part-of-stack"), **PART),
    Input("a second kernel at some of the positions", TWO, _two({"ConvolutionKernel": "B70f"}, shift_mm=0, keep=lambda i: i in (2, 3, 7, 11)), notes=PARTED, **PART),
    Input("two kernels at the same positions, both with missing slices", TWO, _two({"ConvolutionKernel": "B70f"}, shift_mm=0, keep=lambda i: i not in (6, 7), keep_first=lambda i: i not in (11, 12, 13)), "opens", ("import.several-series", "import.series-parted", "import.slices-interpolated"), series=2, names=("slices 7 to 8",), do=MISSING_SLICES),
    Input("one missing slice", ONE, _without(8), "opens", ("import.slices-interpolated",), names=("slice 9",), do=MISSING_SLICES),
    Input("two gaps of one slice", ONE, _without(4, 15), "opens", ("import.slices-interpolated",), names=("slices 5, 16",), do=MISSING_SLICES),
    Input("three of twenty slices missing", ONE, _without(4, 8, 15), "import.geometry.irregular", names=("10 %",), do=MISSING_SLICES),
    Input("slice distances of 2.5 and 1.5 mm", ONE, _two_distances, "opens", ("import.slices-resampled",), names=("1.50 to 2.50 mm apart",)),
    Input("two distances that alternate, as in two mixed scans", ONE, _two_mixed_scans, "import.geometry.irregular", names=("may be mixed",), do=CHOOSE),
    Input("a gantry tilt of 20 degrees", ONE, _tilted, "opens", ("import.tilt-corrected",), names=("20.0 degrees",)),
    Input("two scans at the same positions that do not differ in any tag", TWO, _two({}, shift_mm=0), "import.geometry.duplicate", do="Keep one slice for each position."),
]  # fmt: skip

INPUTS = (*RESCALE, *HEALTHY, *SEVERAL, *FILES, *PIXELS, *PADDING, *MODALITY_LUT)
