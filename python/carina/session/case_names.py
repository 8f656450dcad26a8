"""Neutral names of cases, and the file names that Carina suggests: without the patient's name and the scan's date."""

from __future__ import annotations

import hashlib
import re

__all__ = ["case_code", "neutral_alias", "suggested_file_name"]

_CROCKFORD = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
"""Base 32 without I, L, O and U, which are easily misread."""
MAX_SLUG = 40


def case_code(case_id: str) -> str:
    """Return six characters that stand for a case id in names.

    Examples
    --------
    >>> len(case_code("00ff00ff00ff00ff"))
    6
    """
    number = int.from_bytes(hashlib.blake2b(case_id.encode(), digest_size=4).digest(), "big")
    return "".join(_CROCKFORD[(number >> shift) & 31] for shift in range(0, 30, 5))


def neutral_alias(case_id: str) -> str:
    """Return the name of a case that its user has not named."""
    return f"Case {case_code(case_id)}"


def suggested_file_name(alias: str | None, case_id: str) -> str:
    """Return a file name without suffix: the user's name of the case, and its code.

    The code makes the names of two cases different, also where their users gave them one name.

    Examples
    --------
    >>> suggested_file_name(None, "00ff00ff00ff00ff") == f"case-{case_code('00ff00ff00ff00ff')}"
    True
    >>> suggested_file_name("Nodule in RB4 / left?", "00ff00ff00ff00ff").startswith("Nodule-in-RB4-left-")
    True
    """
    slug = re.sub(r"[^\w]+", "-", alias or "").strip("-_")[:MAX_SLUG].strip("-_")
    return f"{slug or 'case'}-{case_code(case_id)}"
