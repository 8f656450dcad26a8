"""Base class of values that are sent or stored: frozen fields, whose bounds are part of their types."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from carina.display import as_words, joined_in_line

__all__ = ["TEXT", "Coordinate", "Count", "FrozenValue", "Part", "PointLps", "Words"]

TEXT = r"\A[^\x00-\x08\x0b-\x1f\ud800-\udfff]*\Z"
"""Pattern of text without control characters, except line breaks and tabs, and without unpaired surrogates."""

Coordinate = Annotated[float, Meta(ge=-1e5, le=1e5)]
PointLps = tuple[Coordinate, Coordinate, Coordinate]
"""Point in LPS mm."""
Words = Annotated[str, Meta(max_length=4000, pattern=TEXT)]
Count = Annotated[int, Meta(ge=0, le=2**53 - 1)]
Part = Annotated[float, Meta(ge=0.0, le=1.0)]


class FrozenValue(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Immutable value with named fields; its JSON object has exactly these fields."""

    def __repr__(self) -> str:
        """Return the value in one line, without fields that have their default."""
        pieces = []
        for field in msgspec.structs.fields(type(self)):
            value = getattr(self, field.name)
            made = field.default_factory is not msgspec.NODEFAULT
            if value != (field.default_factory() if made else field.default):
                pieces.append(f"{field.name}={as_words(value)}")
        return joined_in_line(type(self).__name__, pieces)

    def choice_problem(self) -> str | None:
        """Return a problem of the combination of fields, which the types cannot express; None if there is none."""
        return None
