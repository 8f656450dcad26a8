"""Export of a plan's report as an encapsulated PDF in DICOM, for an archive.

References
----------
DICOM PS3.3 A.45.1 and C.24 (encapsulated document).
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from pathlib import Path
from typing import Final

from pydicom.sequence import Sequence as Items
from pydicom.uid import EncapsulatedPDFStorage

from carina.disk import write_whole
from carina.errors import UsageError
from carina.export.plan_dicom import Identity, check_suffix, check_text, code_item, ct_images, file_bytes, new_object
from carina.volume import Volume

MAX_BYTES: Final = 500_000_000
"""Maximum size of a PDF; a report of some pages has a few million bytes."""


def write_plan_pdf(
    path: Path | str,
    pdf: bytes,
    *,
    names_patient: bool,
    identity: Identity = "none",
    volume: Volume | None = None,
    ct: Path | str | None = None,
    series: str | None = None,
    title: str = "Bronchoscopy plan",
    now: datetime.datetime | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Path:
    """Write a report's PDF as a DICOM object.

    Parameters
    ----------
    path
        File to be written; it must end in ``.dcm``.
    pdf
        Contents of the whole PDF file.
    names_patient
        Whether the pages contain a patient's name, number or birth date. The object states this, and such a report is
        refused without an identity.
    identity
        ``"from the CT"`` uses the patient and study of the CT and requires ``volume`` and ``ct``. ``"none"`` makes a
        new study without any data of the CT.
    volume, ct, series
        The CT that the plan was made on, its DICOM folder, and the key of its series.
    title
        Title of the document, one line.
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
        If the suffix is wrong, ``pdf`` is not a PDF, the title is invalid, the identity does not fit the report, or the
        CT is not that of the volume.
    VolumeImportError
        If the CT cannot be read.
    DiskError
        If the file cannot be written; a former file stays unchanged.
    """
    check_suffix(path, "saving the report for an archive")
    check_text(title, "the title of the report")
    # Line breaks may follow the end mark.
    if not pdf.startswith(b"%PDF-") or b"%%EOF" not in pdf[-1024:] or len(pdf) > MAX_BYTES:
        raise UsageError(
            f"saving the report for an archive: expected a whole PDF of at most {MAX_BYTES} bytes; found {len(pdf)} "
            f"bytes that begin with {pdf[:5]!r}; make the report again",
            code="plan.pdf",
        )
    if names_patient and identity == "none":
        raise UsageError(
            "saving the report for an archive: its pages name the patient, but no identity was requested; make the "
            'report without a name, or choose identity "from the CT"',
            code="plan.identity",
        )
    if identity == "from the CT" and (volume is None or ct is None):
        raise UsageError(
            'identity: "from the CT" needs the CT and its DICOM folder; name both, or choose "none"',
            code="plan.identity",
        )
    images = None
    if identity == "from the CT" and volume is not None and ct is not None:
        images = ct_images(ct, volume, series=series, cancel=cancel)
    data = new_object(
        EncapsulatedPDFStorage,
        images,
        identity=identity,
        modality="DOC",
        series_number=9303,
        series_words="Carina: report of a bronchoscopy plan",
        now=now,
    )
    data.ConversionType = "WSD"
    data.BurnedInAnnotation = "YES" if names_patient else "NO"
    data.AcquisitionDateTime = ""
    data.DocumentTitle = title
    data.ConceptNameCodeSequence = Items([code_item("18776-5", "LN", "Plan of care note")])
    data.MIMETypeOfEncapsulatedDocument = "application/pdf"
    data.EncapsulatedDocumentLength = len(pdf)
    data.EncapsulatedDocument = pdf + b"\0" * (len(pdf) % 2)
    return write_whole(path, file_bytes(data), what="the report")
