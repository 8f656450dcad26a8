"""Application of the basic profile to one data set, in all its sequences.

Beyond the table, every attribute that is not known to be free of identity is removed: names, dates, free text, binary
data and unknown attributes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from pydicom.datadict import dictionary_has_tag
from pydicom.dataelem import DataElement
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.tag import BaseTag

from carina.deidentification.profile_table import ACTIONS, RETAINED_BINARY, RETAINED_TEXT
from carina.deidentification.pseudonyms import Pseudonyms
from carina.version import VERSION
from carina.volume.without_warnings import without_warnings

__all__ = ["clean_dataset"]

_PATIENT_NAME, _PATIENT_ID, _MODALITY, _PHOTOMETRIC = 0x00100010, 0x00100020, 0x00080060, 0x00280004
_PIXEL_GROUP = 0x7FE0
_DUMMIES: dict[str, Any] = {
    "DA": "19000101", "DT": "19000101000000", "TM": "000000", "AS": "000Y", "DS": "0", "IS": "0",
    **dict.fromkeys(("AE", "CS", "LO", "LT", "PN", "SH", "ST", "UC", "UT"), "ANONYMIZED"),
    **dict.fromkeys(("FD", "FL", "SL", "SS", "SV", "UL", "US", "UV"), 0),
}  # fmt: skip
_NUMBERS = frozenset({"FD", "FL", "SL", "SS", "SV", "UL", "US", "UV", "AT"})
_BINARY = frozenset({"OB", "OW", "OF", "OD", "OL", "OV", "OB or OW", "US or OW", "US or SS or OW", "US or SS"})
_TEXT = frozenset({"LO", "LT", "SH", "ST", "UC", "UT"})
_CODE = re.compile(r"[A-Z0-9_ ]{0,16}")
_DECIMAL = re.compile(r" *[+-]?\d*\.?\d*([eE][+-]?\d+)? *")
_SCHEMES = frozenset({"DCM", "SCT", "SRT", "SNM3", "UCUM", "FMA", "LN", "RADLEX", "MSH", "UMLS", "NCIt"})
"""Public coding schemes, whose codes and meanings identify nobody."""
_ENHANCED = frozenset(f"1.2.840.10008.5.1.4.1.1.{kind}" for kind in ("2.1", "4.1", "4.4", "128.1", "130", "2.2"))
"""Classes of enhanced images, in which more attributes are required, so that a dummy replaces them."""
_IDENTITY = ("PatientID", "PatientBirthDate", "AccessionNumber", "StudyID", "InstitutionName", "StationName")
_LEAST_TERM = 4
_PROFILE = ("113100", "DCM", "Basic Application Confidentiality Profile")
_PIXELS = ("113101", "DCM", "Clean Pixel Data Option")


def clean_dataset(dataset: Dataset, names: Pseudonyms, *, masked: bool) -> None:
    """Remove the identity of the patient, the staff and the institution from a data set, in place.

    Parameters
    ----------
    dataset
        The data set of one file, without its file meta information.
    names
        New UIDs and aliases of this run.
    masked
        Whether burned-in text was masked in the pixels.
    """
    with without_warnings():  # warnings of pydicom may quote a value
        identity = tuple(_text(dataset, keyword) for keyword in ("PatientID", "PatientName", "PatientBirthDate"))
        alias = names.patient(identity)
        terms = frozenset(_terms(dataset))
        enhanced = _text(dataset, "SOPClassUID") in _ENHANCED
        _clean(dataset, names, terms, enhanced=enhanced)
        # One encoding for all texts, which are decoded now.
        dataset.SpecificCharacterSet = "ISO_IR 192"
        dataset.PatientName = dataset.PatientID = alias
        dataset.PatientIdentityRemoved = "YES"
        dataset.DeidentificationMethod = f"Carina {VERSION}"
        codes = [_PROFILE, _PIXELS] if masked else [_PROFILE]
        dataset.DeidentificationMethodCodeSequence = [_code(*code) for code in codes]
        dataset.LongitudinalTemporalInformationModified = "REMOVED"
        if masked:
            dataset.BurnedInAnnotation = "NO"


def _code(value: str, scheme: str, meaning: str) -> Dataset:
    item = Dataset()
    item.CodeValue, item.CodingSchemeDesignator, item.CodeMeaning = value, scheme, meaning
    return item


def _text(dataset: Dataset, keyword: str) -> str:
    try:
        return str(dataset.get(keyword) or "")
    except Exception:
        return ""  # pydicom raises various errors for a damaged value


def _terms(dataset: Dataset) -> Iterator[str]:
    """Yield the texts that identify somebody in this file, in capital letters: names and numbers."""
    for tag in list(dataset.keys()):
        try:
            element = dataset[tag]
        except Exception:
            continue
        if element.VR == "SQ":
            for item in element.value:
                yield from _terms(item)
        elif element.VR == "PN" or element.keyword in _IDENTITY:
            for part in re.split(r"[\^=\\\s]+", str(element.value).upper()):
                if len(part) >= _LEAST_TERM:
                    yield part


def _clean(dataset: Dataset, names: Pseudonyms, terms: frozenset[str], *, enhanced: bool) -> None:
    for tag in list(dataset.keys()):
        if _is_removed_group(tag):
            del dataset[tag]
            continue
        try:
            element = dataset[tag]
            _ = element.value
        except Exception:
            del dataset[tag]  # a damaged value may contain anything
            continue
        # The value of an element that stays is decoded here, so that it is written in the new encoding.
        action = ACTIONS.get(int(tag))
        if action is None:
            if not _clean_unlisted(element, names, terms, enhanced=enhanced):
                del dataset[tag]
        elif action == "U" and element.VR == "UI":
            _replace_uids(element, names)
        elif action == "X/Z/U*" and element.VR == "SQ":
            _clean_items(element, names, terms, enhanced=enhanced)
        elif action == "Z" or (enhanced and action in ("X/Z", "Z/D")) or action == "Z/D":
            _empty(element)
        elif (action == "D" or (enhanced and action in ("X/D", "X/Z/D"))) and element.VR in _DUMMIES:
            element.value = _DUMMIES[element.VR]
        else:
            del dataset[tag]
    _clean_code(dataset)


def _clean_items(element: DataElement, names: Pseudonyms, terms: frozenset[str], *, enhanced: bool) -> None:
    """Clean the items of a sequence; pictures in them (icons, prints), whose text no mask covers, are removed."""
    for item in element.value:
        for tag in [tag for tag in item.keys() if tag.group == _PIXEL_GROUP]:  # noqa: SIM118 - a data set is no dict
            del item[tag]
        _clean(item, names, terms, enhanced=enhanced)


def _clean_code(item: Dataset) -> None:
    """Replace a code of a private coding scheme, whose meaning may be free text."""
    keywords = [one for one in ("CodeValue", "CodingSchemeDesignator", "CodeMeaning") if one in item]
    if keywords and item.get("CodingSchemeDesignator") not in _SCHEMES:
        for keyword in keywords:
            item[keyword].value = "ANONYMIZED"
        if "CodingSchemeVersion" in item:
            del item.CodingSchemeVersion


def _is_removed_group(tag: BaseTag) -> bool:
    """Return whether a tag is private, a group length, a curve, an overlay, padding or a command element."""
    curve_or_overlay = tag.group & 0xFF00 in (0x5000, 0x6000)
    return tag.is_private or tag.element == 0 or curve_or_overlay or tag.group in (0x0000, 0x0002, 0x4000, 0xFFFC)


def _clean_unlisted(element: DataElement, names: Pseudonyms, terms: frozenset[str], *, enhanced: bool) -> bool:
    """Clean an attribute that the table does not list; return whether it stays."""
    kind, tag = str(element.VR), int(element.tag)
    if not dictionary_has_tag(tag):
        return False
    if kind == "SQ":
        _clean_items(element, names, terms, enhanced=enhanced)
        return True
    if kind == "UI":
        _replace_uids(element, names)
        return True
    if kind in _BINARY:
        return tag in RETAINED_BINARY
    if kind in _NUMBERS:
        return isinstance(element.value, int | float) or not isinstance(element.value, str | bytes)
    values = [str(value) for value in (element.value if element.VM > 1 else [element.value])]
    if kind in ("DS", "IS"):
        return all(
            _DECIMAL.fullmatch(_original(value)) for value in (element.value if element.VM > 1 else [element.value])
        )
    if kind == "CS":
        if tag in (_MODALITY, _PHOTOMETRIC):
            return all(_CODE.fullmatch(value) for value in values)  # "MONO" may be part of a name
        return all(_CODE.fullmatch(value) for value in values) and not _names_somebody(values, terms)
    return kind in _TEXT and tag in RETAINED_TEXT and not _names_somebody(values, terms)


def _original(value: Any) -> str:
    """Return the text of a decimal number as the file stores it."""
    return str(getattr(value, "original_string", value) if value is not None else "")


def _names_somebody(values: list[str], terms: frozenset[str]) -> bool:
    return any(term in value.upper() for value in values for term in terms)


def _replace_uids(element: DataElement, names: Pseudonyms) -> None:
    if element.VM > 1:
        element.value = [names.uid(str(uid)) for uid in element.value]
    elif element.value:
        element.value = names.uid(str(element.value))


def _empty(element: DataElement) -> None:
    element.value = Sequence() if element.VR == "SQ" else (b"" if element.VR in _BINARY else "")
