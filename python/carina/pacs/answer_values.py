"""Values of the data sets that a PACS sends, read without the warnings of pydicom, which quote the values."""

from __future__ import annotations

from typing import Any

from pydicom.dataset import Dataset
from pydicom.multival import MultiValue

from carina.volume.without_warnings import without_warnings

__all__ = ["text_list", "text_value", "value_of", "whole_value"]


def value_of(dataset: Dataset, keyword: str) -> Any:
    """Return a value of an answer; None if it is missing or damaged."""
    with without_warnings():
        try:
            value = dataset.get(keyword)
        except Exception:
            return None  # pydicom raises various errors for a damaged value
    return None if value == "" else value


def text_value(dataset: Dataset, keyword: str) -> str:
    """Return a value of an answer as printable text of at most 128 characters; empty if it is missing."""
    value = value_of(dataset, keyword)
    return "" if value is None else _printable(value, 128)


def text_list(dataset: Dataset, keyword: str) -> tuple[str, ...]:
    """Return the values of an element as printable texts of at most 16 characters."""
    value = value_of(dataset, keyword)
    if value is None:
        return ()
    return tuple(_printable(one, 16) for one in (value if isinstance(value, MultiValue) else [value]))


def whole_value(dataset: Dataset, keyword: str) -> int | None:
    """Return a value of an answer as integer; None if it is missing or not a number."""
    try:
        return int(value_of(dataset, keyword))
    except (TypeError, ValueError, OverflowError):
        return None


def _printable(value: Any, length: int) -> str:
    return "".join(c for c in str(value) if c.isprintable()).strip()[:length]
