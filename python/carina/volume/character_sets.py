"""Character sets of DICOM texts: finds the set of a text whose file names none or misspells it (PS3.5 6.1).

Programs that write UTF-8 often omit SpecificCharacterSet, or write *UTF-8* instead of *ISO_IR 192*. A reader then shows
each byte as a letter: ``MÃ¼ller`` for ``Müller``. UTF-8 is recognisable, because text in another set is rarely valid
UTF-8. Other unknown sets are not recognisable: a text in such a set is *doubtful* and is not copied into other files.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterator
from typing import Any

from pydicom.charset import python_encoding
from pydicom.datadict import dictionary_VR, keyword_for_tag
from pydicom.dataelem import RawDataElement
from pydicom.dataset import Dataset
from pydicom.sequence import Sequence
from pydicom.tag import BaseTag, Tag

from carina.volume.without_warnings import without_warnings

_UTF_8 = "ISO_IR 192"
_SPECIFIC_CHARACTER_SET = Tag("SpecificCharacterSet")
_TEXT = frozenset({"PN", "LO", "SH", "ST", "LT", "UC", "UT"})
_LATIN = {1: 100, 2: 101, 3: 109, 4: 110, 5: 144, 6: 127, 7: 126, 8: 138, 9: 148}
"""ISO_IR registration number of each part of ISO 8859, by the number of the part."""
_ONE_BYTE = frozenset(f"ISO_IR {number}" for number in (6, *_LATIN.values(), 166))


def character_set_name(text: str) -> str | None:
    """Return the DICOM name of a character set, also of a misspelt one; None if the name is unknown."""
    text = text.strip()
    if not text or text in python_encoding:
        return text or "ISO_IR 6"
    plain = re.sub(r"[^A-Z0-9]+", "", text.upper())
    if plain in ("UTF8", "UNICODE", "ISO10646", "ISO10646UTF8"):
        return _UTF_8
    if plain in ("GB18030", "GBK"):
        return plain
    if found := re.fullmatch(r"(?:ISO8859|LATIN)([1-9])", plain):
        return f"ISO_IR {_LATIN[int(found[1])]}"
    if found := re.fullmatch(r"ISO2022IR(\d+)", plain):
        name = _UTF_8 if found[1] == "192" else f"ISO 2022 IR {found[1]}"
        return name if name in python_encoding else None
    if found := re.fullmatch(r"(?:ISO)?IR?(\d+)", plain):
        name = f"ISO_IR {found[1]}"
        return name if name in python_encoding else None
    return None


def settle_character_set(dataset: Dataset) -> None:
    """Correct a missing, unknown or misspelt SpecificCharacterSet of a data set that was just read.

    An unknown set whose texts are not UTF-8 becomes the default (ASCII); ``doubtful_texts`` returns the texts with
    other characters.
    """
    written = _stored_names(dataset)
    names = _declared_names(dataset)
    corrected = [name for name in names if name is not None]
    if len(corrected) < len(names) or corrected == ["ISO_IR 6"]:
        corrected = [_UTF_8] if _is_utf_8(list(_texts(dataset))) else ["ISO_IR 6"]
    if corrected == (written or ["ISO_IR 6"]):
        return
    with without_warnings():  # pydicom quotes the unknown name
        dataset.SpecificCharacterSet = corrected if len(corrected) > 1 else corrected[0]
        _set_encodings(dataset, [python_encoding[name] for name in corrected])


def doubtful_texts(dataset: Dataset) -> frozenset[str]:
    """Return the keywords of texts with uncertain characters in a data set from ``settle_character_set``."""
    names = _declared_names(dataset)
    found = set()
    for tag, value in _raw_texts(dataset):
        if value.isascii() and b"\x1b" not in value:
            continue
        if _is_doubtful(value, names):
            found.add(keyword_for_tag(tag))
    return frozenset(found)


def _is_doubtful(value: bytes, names: list[str | None]) -> bool:
    """Return whether a text may contain wrong characters when it is decoded with the given sets."""
    if None in names or names == ["ISO_IR 6"]:
        return True  # UTF-8 would have been recognised
    if len(names) > 1 or str(names[0]).startswith("ISO 2022"):
        return False  # escape sequences name the set of each part
    encoding = python_encoding[str(names[0])]
    try:
        text = value.decode(encoding)
    except (UnicodeDecodeError, LookupError):
        return True
    if "\ufffd" in text:
        return True  # another program lost the character
    if any(unicodedata.category(c) == "Cc" and c not in "\r\n\t\f\x1b\0" for c in text):
        return True  # control characters indicate a Windows code page
    # The set has one byte per letter, but the bytes are valid UTF-8, so the set or the bytes are wrong.
    return names[0] in _ONE_BYTE and _is_utf_8([value])


def _is_utf_8(values: list[bytes]) -> bool:
    """Return whether texts, at least one of them not ASCII, are UTF-8 with high probability."""
    scripts = set()
    beyond = b"".join(value for value in values if not value.isascii())
    if not beyond or b"\x1b" in b"".join(values):
        return False
    try:
        text = beyond.decode("utf-8")
    except UnicodeDecodeError:
        return False
    for character in text:
        if character.isascii():
            continue
        category = unicodedata.category(character)
        if category[0] == "C":
            return False
        if category[0] == "L":
            scripts.add(unicodedata.name(character, "unknown").split()[0])
    # Two-byte sequences that give letters of several scripts come from another set; Latin letters occur in any text.
    return len(scripts - {"LATIN", "CJK", "HIRAGANA", "KATAKANA", "KATAKANA-HIRAGANA", "HANGUL"}) <= 1


def _stored_names(dataset: Dataset) -> list[str]:
    try:
        element = dataset.get_item(_SPECIFIC_CHARACTER_SET)
        value: Any = None if element is None else element.value
    except Exception:
        return []  # pydicom raises various errors for a damaged element
    if value is None:
        return []
    if isinstance(value, bytes):
        value = value.decode("latin-1")
    if isinstance(value, str):
        value = value.split("\\")
    return [str(name).strip("\0 ") for name in value]


def _declared_names(dataset: Dataset) -> list[str | None]:
    return [character_set_name(name) for name in _stored_names(dataset)] or ["ISO_IR 6"]


def _raw_texts(dataset: Dataset) -> Iterator[tuple[BaseTag, bytes]]:
    for tag in list(dataset.keys()):
        try:
            element = dataset.get_item(tag)
            kind = element.VR if element is not None and element.VR not in (None, "UN") else dictionary_VR(tag)
        except (KeyError, AttributeError, ValueError):
            continue
        if kind in _TEXT and isinstance(element, RawDataElement) and isinstance(element.value, bytes):
            yield tag, element.value


def _texts(dataset: Dataset) -> Iterator[bytes]:
    """Yield the texts of a data set and of its sequences that were already read."""
    for _, value in _raw_texts(dataset):
        yield value
    for item in _items(dataset):
        yield from _texts(item)


def _items(dataset: Dataset) -> Iterator[Dataset]:
    for tag in list(dataset.keys()):
        try:
            element = dataset.get_item(tag)
            if isinstance(element, RawDataElement) and element.VR == "SQ":
                element = dataset[tag]
        except Exception:
            continue  # pydicom raises various errors for a damaged sequence; the reader of the sequence reports it
        if element is not None and isinstance(element.value, Sequence):
            yield from element.value


def _set_encodings(dataset: Dataset, encodings: list[str]) -> None:
    """Set the encodings with which pydicom decodes the texts of a data set and of its sequences."""
    implicit, little = dataset.original_encoding
    dataset.set_original_encoding(implicit, little, encodings)
    for item in _items(dataset):
        _set_encodings(item, encodings)
