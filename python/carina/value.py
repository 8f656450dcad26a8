"""What values that travel are made of: frozen fields, whose bounds stand in their types."""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from carina.display import as_words, joined

__all__ = ["TEXT", "Coordinate", "Count", "FrozenValue", "Part", "PointLps", "Words"]

TEXT = r"\A[^\x00-\x08\x0b-\x1f\ud800-\udfff]*\Z"
"""Without control characters, but line breaks and tabs, and without half a character."""

Coordinate = Annotated[float, Meta(ge=-1e5, le=1e5)]
PointLps = tuple[Coordinate, Coordinate, Coordinate]
"""World, LPS mm."""
Words = Annotated[str, Meta(max_length=4000, pattern=TEXT)]
Count = Annotated[int, Meta(ge=0, le=2**53 - 1)]
Part = Annotated[float, Meta(ge=0.0, le=1.0)]


class FrozenValue(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A value of named fields that never changes; in JSON it has these fields and no others."""

    def __repr__(self) -> str:
        """One line; fields that have their default are left out."""
        pieces = []
        for field in msgspec.structs.fields(type(self)):
            value = getattr(self, field.name)
            made = field.default_factory is not msgspec.NODEFAULT
            if value != (field.default_factory() if made else field.default):
                pieces.append(f"{field.name}={as_words(value)}")
        return joined(type(self).__name__, pieces)

    def choice_problem(self) -> str | None:
        """What the types cannot say: which of the fields go together. None where they do."""
        return None
