"""New UIDs and aliases of patients, equal for equal originals within one run and unrelated to them."""

from __future__ import annotations

import hashlib
import hmac
import secrets

from pydicom.uid import UID

__all__ = ["Pseudonyms", "is_standard_uid"]


def is_standard_uid(uid: str) -> bool:
    """Return whether a UID is registered in the standard (a class, a syntax), so that it identifies no object."""
    return UID(uid).name != uid


class Pseudonyms:
    """Replacements of UIDs and patients in one run.

    The UIDs depend on a random key that is never stored, so nobody can compute them from the originals.

    Parameters
    ----------
    alias
        Name and ID of the patient in the copy; several patients get a number each.
    """

    def __init__(self, alias: str) -> None:
        self._alias = alias
        self._key = secrets.token_bytes(32)
        self._patients: dict[tuple[str, ...], int] = {}

    def uid(self, original: str) -> str:
        """Return the new UID of an object; a UID of the standard stays."""
        if not original or is_standard_uid(original):
            return original
        digest = hmac.new(self._key, original.encode("utf-8", "surrogateescape"), hashlib.sha256).digest()
        # PS3.5, annex B.2: a UUID as one decimal number below 2.25.
        return f"2.25.{int.from_bytes(digest[:16], 'big')}"

    def patient(self, identity: tuple[str, ...]) -> str:
        """Return the alias of a patient."""
        number = self._patients.setdefault(identity, len(self._patients) + 1)
        return self._alias if number == 1 else f"{self._alias}-{number}"

    @property
    def num_patients(self) -> int:
        """Number of patients who have received an alias so far."""
        return len(self._patients)
