"""Reader of JSON files that a user writes; each error states the field, the expected and the found value."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from carina.disk import read_regular_text
from carina.errors import CarinaError, UsageError, VolumeImportError

MAX_BYTES = 100_000
MAX_LETTERS = 300


@dataclass(frozen=True, slots=True)
class UserFile:
    """File that a user wrote (a scope, a tool or a task): its JSON document, and texts and code of its errors."""

    where: str
    document: Any
    code: str = "plan.own-file"
    """Code of the errors."""
    remedy: str = ""
    """End of each error message: what the user can do."""

    @classmethod
    def read(
        cls, path: str | Path, *, content: str = "one instrument", code: str = "plan.own-file", remedy: str = ""
    ) -> UserFile:
        """Read the document in a file.

        Parameters
        ----------
        path
            Path of the file.
        content
            Expected content, for error messages.
        code, remedy
            Code and end of the error messages.

        Raises
        ------
        UsageError
            If the file cannot be read.
        """
        file = Path(path)
        try:
            return cls(file.name, json.loads(read_regular_text(file, max_bytes=MAX_BYTES)), code, remedy)
        except (OSError, ValueError, RecursionError) as error:
            if isinstance(error, VolumeImportError) and error.code == "disk.too-large":
                raise UsageError(f"{file.name}: expected at most {MAX_BYTES} bytes", code=code) from None
            if isinstance(error, CarinaError):
                raise
            words = f"{file.name}: expected a JSON file with {content}; it could not be read ({error})"
            raise UsageError(words, code=code) from error

    def refusal(self, what: str, expected: str, found: object) -> UsageError:
        """Return the error for a field with a wrong value.

        Parameters
        ----------
        what
            Name of the field.
        expected
            Expected values, as text.
        found
            Value that the file contains.
        """
        end = f"; {self.remedy}" if self.remedy else ""
        return UsageError(f"{self.where}: {what}: expected {expected}; found {found!r}{end}", code=self.code)

    def check(self, form: str, version: int, names: Iterable[str]) -> None:
        """Check that the document is an object of this format without unknown names.

        Parameters
        ----------
        form, version
            Expected format name and version.
        names
            Names of all allowed fields.
        """
        if not isinstance(self.document, dict):
            raise self.refusal("the whole", "an object in braces", self.document)
        found = (self.document.get("format"), self.document.get("version"))
        if found != (form, version):
            raise self.refusal("format and version", f'"{form}" and {version}', found)
        known = set(names)
        strange = sorted(set(self.document) - known - {"format", "version"})
        if strange:
            raise self.refusal("names", f"only {', '.join(sorted(known))}", strange)

    def text(self, name: str) -> str:
        """Return the value of the field ``name``, a text that is not empty."""
        found = self.document.get(name)
        if not (isinstance(found, str) and 0 < len(found.strip()) <= MAX_LETTERS):
            raise self.refusal(name, f"words, at most {MAX_LETTERS} letters", found)
        return found

    def text_or_none(self, name: str) -> str | None:
        """Return the value of the field ``name``, a text that is not empty, or None."""
        return None if self.document.get(name) is None else self.text(name)

    def flag(self, name: str, expected: str) -> bool:
        """Return the field ``name``, which must be true or false."""
        found = self.document.get(name)
        if not isinstance(found, bool):
            raise self.refusal(name, expected, found)
        return found

    def size(self, name: str, most: float) -> float:
        """Return the field ``name``, a number above 0.

        Parameters
        ----------
        name
            Name of the field.
        most
            Largest allowed value; the unit in messages follows from the name.
        """
        found = self.document.get(name)
        if not _is_number(found) or not 0.0 < found <= most:
            raise self.refusal(name, f"a number above 0 up to {most:g} {_unit(name)}", found)
        return float(found)

    def number_or_none(self, name: str, most: float) -> float | None:
        """Return the field ``name``, a number from 0 up, or None.

        Parameters
        ----------
        name
            Name of the field.
        most
            Largest allowed value; the unit in messages follows from the name.
        """
        found = self.document.get(name)
        if found is None:
            return None
        if not _is_number(found) or not 0.0 <= found <= most:
            raise self.refusal(name, f"0 to {most:g} {_unit(name)}, or null", found)
        return float(found)

    def pair_or_none(self, name: str, most: float) -> tuple[float, float] | None:
        """Return the field ``name``, two numbers from 0 up, or None.

        Parameters
        ----------
        name
            Name of the field.
        most
            Largest allowed value; the unit in messages follows from the name.
        """
        found = self.document.get(name)
        if found is None:
            return None
        if not (isinstance(found, list) and len(found) == 2 and all(_is_number(v) and 0.0 <= v <= most for v in found)):
            raise self.refusal(name, f"two numbers from 0 to {most:g} {_unit(name)}, or null", found)
        return float(found[0]), float(found[1])


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _unit(name: str) -> str:
    return "degrees" if name.endswith("_deg") else "mm"
