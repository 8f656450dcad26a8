"""Functions common to the DICOM files of a plan: references to the CT, identity of the patient, and encoding.

In this folder only files whose names begin with ``plan_dicom`` import pydicom.

References
----------
DICOM PS3.3 C.7.1.1 (patient), C.7.2.1 (study), C.7.5.1 (equipment), C.12.1 (SOP common); PS3.15 E (de-identification).
"""

from __future__ import annotations

import datetime
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.multival import MultiValue
from pydicom.uid import ExplicitVRLittleEndian, generate_uid
from pydicom.valuerep import DSfloat

from carina.errors import UsageError, VolumeImportError, check_type
from carina.export.plan_content import ONE_TARGET
from carina.plan import Nodule
from carina.version import VERSION
from carina.volume import Volume, same_geometry
from carina.volume.character_sets import doubtful_texts
from carina.volume.dicom import FoundSeries, choose_series
from carina.volume.dicom_checks import Clipping
from carina.volume.dicom_headers import IDENTITY, SliceHeader, read_dataset
from carina.volume.dicom_pixels import decode_slice
from carina.volume.digest import Geometry
from carina.volume.io_errors import guarded
from carina.volume.opening import find_in, place_name
from carina.volume.progress import Watch
from carina.volume.without_warnings import without_warnings

Identity = Literal["from the CT", "none"]
"""Identity in a file: name, number, birth date and study of the CT, or none of them."""

_WHOSE: Final = (
    *("PatientName", "PatientID", "IssuerOfPatientID", "PatientBirthDate", "PatientSex"),
    # Elements by which a CT states that it was de-identified.
    *("PatientIdentityRemoved", "DeidentificationMethod"),
    *("StudyDate", "StudyTime", "StudyID", "StudyDescription", "AccessionNumber", "ReferringPhysicianName"),
)
# Type 2 elements: a standard object must contain each of them, and may leave it empty.
_NEVER_LEFT_OUT: Final = (
    *("PatientName", "PatientID", "PatientBirthDate", "PatientSex"),
    *("StudyDate", "StudyTime", "StudyID", "AccessionNumber", "ReferringPhysicianName"),
)
_OF_THE_PATIENT: Final = frozenset({"PatientName", "PatientID", "IssuerOfPatientID"})
_FRAME_OF_REFERENCE = list(IDENTITY).index("FrameOfReferenceUID")
_NUM_SLICES_CHECKED = 5
"""Number of slices whose pixels are compared with the volume, to distinguish reconstructions with equal geometry."""
_MAX_CHARS = 64
_SUFFIX: Final = ".dcm"


@dataclass(frozen=True, slots=True, eq=False)
class CtImages:
    """DICOM images of a CT's slices, in the order of the volume.

    The object contains UIDs and a name, so its repr shows neither.
    """

    slices: tuple[SliceHeader, ...]
    first: Dataset
    """Data set of the CT's first slice, without texts in an unknown character set."""
    doubtful: frozenset[str] = frozenset()
    """Keywords of the texts that were left out of ``first``."""

    def __repr__(self) -> str:
        """Return the number of images, without their UIDs and names."""
        return f"CtImages({len(self.slices)} images)"

    def reference(self, k: int) -> Dataset:
        """Return a reference to the image of a slice; for a frame of an enhanced file with its frame number."""
        header = self.slices[k]
        item = Dataset()
        item.ReferencedSOPClassUID, item.ReferencedSOPInstanceUID = self.image_class, header.sop_uid
        if header.num_frames > 1 and header.frame is not None:
            item.ReferencedFrameNumber = header.frame + 1
        return item

    def instance_uids(self, used: Iterable[int]) -> list[str]:
        """Return the SOP instance UIDs of the files that contain the given slices, each UID once."""
        return list(dict.fromkeys(self.slices[k].sop_uid for k in used))

    @property
    def image_class(self) -> str:
        """SOP class UID of the CT's images."""
        return str(self.first.SOPClassUID)

    @property
    def study_uid(self) -> str:
        """UID of the study to which the written files belong."""
        return str(self.first.StudyInstanceUID)

    @property
    def series_uid(self) -> str:
        """UID of the series of the CT's images."""
        return self.slices[0].series_uid

    @property
    def frame_of_reference_uid(self) -> str:
        """UID of the frame of reference of the positions."""
        return self.slices[0].identity[_FRAME_OF_REFERENCE]


def check_suffix(path: Path | str, what: str) -> None:
    """Raise UsageError, which names the task ``what``, unless a file name ends in ``.dcm``."""
    name = Path(path).name
    if not name.lower().endswith(_SUFFIX):
        raise UsageError(f"{what}: expected a file name that ends in {_SUFFIX}; found {name!r}")


def ct_images(
    path: Path | str, volume: Volume, *, series: str | None = None, cancel: Callable[[], bool] | None = None
) -> CtImages:
    """Return the DICOM images of a CT: those with the volume's geometry and, where compared, its exact pixels.

    Parameters
    ----------
    path
        The folder of the CT, or one of its files.
    volume
        The CT that the plan was made on.
    series
        Key of its series; without it the series of the volume is searched.
    cancel
        Called often; the work stops when it returns True.

    Raises
    ------
    UsageError
        ``plan.not-dicom`` if the CT is not DICOM; ``plan.other-ct`` if none of its series is the volume, or if nodules
        were inserted into the volume; ``plan.corrected-ct`` if its slices were resampled or interpolated.
    VolumeImportError
        If it cannot be read, or lacks the UIDs that are required for references.
    CancelledError
        If ``cancel()`` returned True.
    """
    check_type("referring to the CT", "volume", volume, Volume, "open a volume with carina.open_volume")
    if volume.source.inserted:
        # Only some slices are compared with the volume, and a nodule may be between them.
        raise UsageError(
            "a nodule was inserted into the CT of this plan for training, so a DICOM object must not refer to the "
            "patient's images; plan on the original CT",
            code="plan.other-ct",
        )
    watch = Watch(None, cancel)
    return guarded(Path(path).expanduser(), lambda where: _images(where, volume, series, watch))


def _images(path: Path, volume: Volume, series: str | None, watch: Watch) -> CtImages:
    found = find_in(path, watch)
    if isinstance(found, str):
        raise UsageError(
            f"{path.name} is a {found} file; a DICOM object refers to the images of a DICOM series: name the CT's "
            "DICOM folder, or save the target as .seg.nrrd",
            code="plan.not-dicom",
        )
    chosen = [choose_series(found, key=series, where=place_name(path))[0]] if series is not None else found
    for one in chosen:
        if one.stack is not None and one.stack.is_corrected and _has_geometry(one, volume):
            raise UsageError(
                f"{place_name(path)}: the CT was corrected when it was opened (gantry tilt or missing slices), so a "
                "DICOM object cannot refer to its slices; save the target as .seg.nrrd",
                code="plan.corrected-ct",
            )
        if _is_volume(one, volume, watch):
            return _referable(path, one)
    which = "none of its series is" if series is None else "that series is not"
    raise UsageError(
        f"{place_name(path)}: {which} the CT that the "
        "plan was made on (geometry or pixels differ); name the folder of that CT, or plan on this one",
        code="plan.other-ct",
    )


def _has_geometry(series: FoundSeries, volume: Volume) -> bool:
    if series.lps_from_ijk is None or series.info.shape_zyx is None:
        return False
    # The order of the axes must agree too, because frames are referenced by slice.
    if series.info.shape_zyx != volume.shape_zyx or not np.allclose(
        series.lps_from_ijk[:3, :3], volume.lps_from_ijk[:3, :3], atol=1e-4
    ):
        return False
    return same_geometry(Geometry(series.info.shape_zyx, series.lps_from_ijk), volume)


def _is_volume(series: FoundSeries, volume: Volume, watch: Watch) -> bool:
    if not _has_geometry(series, volume):
        return False
    clipping = Clipping()
    for k in np.unique(np.linspace(0, len(series.slices) - 1, _NUM_SLICES_CHECKED).astype(int)):
        watch.step("Comparing the CT")
        header = series.slices[k]
        numbers: NDArray[Any] = decode_slice(header).numbers
        if not np.array_equal(clipping.clip(header, np.rint(numbers)).astype(np.int16), volume.hu_zyx[k]):
            return False
    return True


def _referable(path: Path, series: FoundSeries) -> CtImages:
    first = series.slices[0]
    try:
        dataset = read_dataset(first.path, pixels=True)
        doubtful = doubtful_texts(dataset)
        for keyword in doubtful & set(_WHOSE):
            del dataset[keyword]
        # Carina writes UTF-8, so names are decoded from the character set of the CT's file.
        with without_warnings():
            dataset.decode()
    except Exception as error:  # pydicom raises many kinds of errors on damaged elements
        raise VolumeImportError(
            f"reading {first.path.name}: its header cannot be read ({type(error).__name__}); export the CT again",
            code="import.header",
        ) from None
    missing = [
        words
        for words, value in (
            ("a study", dataset.get("StudyInstanceUID")),
            ("a series", first.series_uid),
            ("one frame of reference", len({h.identity[_FRAME_OF_REFERENCE] for h in series.slices} - {""}) == 1),
            ("a kind of image", dataset.get("SOPClassUID")),
            ("an identifier of each image", all(header.sop_uid for header in series.slices)),
        )
        if not value
    ]
    if missing:
        raise VolumeImportError(
            f"{place_name(path)}: the CT's files do not name {', '.join(missing)}, so that no other object can refer "
            "to them; save the target as .seg.nrrd",
            code="import.identity-missing",
        )
    return CtImages(series.slices, dataset, doubtful)


def new_object(
    kind: str,
    images: CtImages | None,
    *,
    identity: Identity,
    modality: str,
    series_number: int,
    series_words: str,
    now: datetime.datetime | None = None,
) -> Dataset:
    """Return a DICOM object with all attributes that do not depend on its kind.

    Parameters
    ----------
    kind
        SOP class UID.
    images
        The CT that the object refers to; the object belongs to the CT's study. None makes an independent object in a
        new study.
    identity
        ``"from the CT"`` copies name, number, birth date, sex and the study's dates and numbers; ``"none"`` leaves them
        empty and marks the object as de-identified. Every object that refers to a CT contains the UIDs of the CT's
        study, series and images, without which it could not be displayed over the CT.
    modality, series_number, series_words
        Modality, number and description of the object's series.
    now
        Time of creation; the computer's clock if None.

    Raises
    ------
    UsageError
        If ``identity`` is unknown, is ``"from the CT"`` without a CT, or the patient's name or number in the CT is in
        an unknown character set.
    """
    if identity not in ("from the CT", "none"):
        raise UsageError(f'identity: expected "from the CT" or "none"; found {identity!r}', code="plan.identity")
    if identity == "from the CT" and images is None:
        raise UsageError(
            'identity: "from the CT" needs the CT\'s DICOM folder; name it, or choose "none"', code="plan.identity"
        )
    if identity == "from the CT" and images is not None and (lost := sorted(images.doubtful & _OF_THE_PATIENT)):
        raise UsageError(
            f"copying the identity from the CT: {', '.join(lost)} of the CT has letters in an unknown character set, "
            "so it could be written wrongly; expected SpecificCharacterSet to name their set; export the CT again "
            'with its character set, or choose the identity "none"',
            code="plan.identity",
        )
    made = datetime.datetime.now().astimezone() if now is None else now
    made_on, made_at = made.strftime("%Y%m%d"), made.strftime("%H%M%S")
    data = Dataset()
    data.SpecificCharacterSet = "ISO_IR 192"
    data.SOPClassUID, data.SOPInstanceUID = kind, generate_uid(prefix=None)
    with without_warnings():
        # Values are copied as they are in the CT; a warning would quote them.
        for keyword in _WHOSE:
            value = None if images is None or identity == "none" else images.first.get(keyword)
            if value not in (None, "") or keyword in _NEVER_LEFT_OUT:
                setattr(data, keyword, _plain_value(value))
    if identity == "none":
        data.PatientIdentityRemoved = "YES"
        data.DeidentificationMethod = "Not written by Carina; UIDs of a CT referred to are kept"
    data.StudyInstanceUID = generate_uid(prefix=None) if images is None else images.study_uid
    data.Modality = modality
    data.SeriesInstanceUID, data.SeriesNumber = generate_uid(prefix=None), series_number
    data.SeriesDescription = series_words
    data.InstanceNumber = 1
    data.SeriesDate = data.InstanceCreationDate = data.ContentDate = made_on
    data.SeriesTime = data.InstanceCreationTime = data.ContentTime = made_at
    data.Manufacturer, data.ManufacturerModelName = "Carina", "Carina virtual bronchoscopy"
    data.DeviceSerialNumber, data.SoftwareVersions = "none", VERSION
    return data


def _plain_value(value: Any) -> str | list[str]:
    """Return a value as text or texts, independent of the CT's character set, with all component groups of a name."""
    if isinstance(value, MultiValue):
        return [str(one) for one in value]
    return "" if value is None else str(value)


def code_item(value: str, scheme: str, meaning: str) -> Dataset:
    """Return a coded concept (PS3.3 8.8).

    Parameters
    ----------
    value, scheme, meaning
        Code value, designator of the coding scheme, and meaning of the code.
    """
    item = Dataset()
    item.CodeValue, item.CodingSchemeDesignator, item.CodeMeaning = value, scheme, meaning
    return item


def decimals(values: Sequence[float] | NDArray[np.float64]) -> list[DSfloat]:
    """Return decimal strings of at most 16 characters, with the precision that this allows."""
    return [DSfloat(float(value), auto_format=True) for value in values]


def check_text(text: str, what: str) -> str:
    """Check a text for an element of 64 characters, and return it.

    Parameters
    ----------
    text
        The text.
    what
        Name of the text in the error message.

    Raises
    ------
    UsageError
        If the text is empty, too long, of several lines, or contains a backslash, which separates values in DICOM.
    """
    if not text.strip() or len(text) > _MAX_CHARS or not text.isprintable() or "\\" in text:
        raise UsageError(
            f"{what}: expected one line of at most {_MAX_CHARS} characters without a backslash; found {text!r}",
            code="plan.name",
        )
    return text


def named_nodules(targets: Nodule | Mapping[str, Nodule], doing: str) -> dict[str, Nodule]:
    """Return nodules by name; the name of a single nodule is "Target".

    Parameters
    ----------
    targets
        A nodule, or several by name.
    doing
        Beginning of the error messages: what the caller was doing.

    Raises
    ------
    UsageError
        If there is none, or a name is not a valid text for DICOM.
    """
    named = {ONE_TARGET: targets} if isinstance(targets, Nodule) else dict(targets)
    if not named:
        raise UsageError(f"{doing}: there is no target; mark one first", code="plan.no-target")
    for name, nodule in named.items():
        check_text(name, "the name of a target")
        check_type(doing, name, nodule, Nodule, "get it from carina.grow_nodule")
    return named


def file_bytes(data: Dataset) -> bytes:
    """Return the whole DICOM file as bytes, explicit little endian."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID, meta.MediaStorageSOPInstanceUID = data.SOPClassUID, data.SOPInstanceUID
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    data.file_meta = meta
    content = io.BytesIO()
    # A warning would quote values of the patient.
    with without_warnings():
        data.save_as(content, enforce_file_format=True)
    return content.getvalue()
