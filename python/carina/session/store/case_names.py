"""Neutral names and suggested file names of cases, without the patient's name and the scan's date."""

from __future__ import annotations

import hashlib
import re
import secrets

CROCKFORD = "0123456789ABCDEFGHJKMNPQRSTVWXYZ"
"""Base32 without I, L, O and U (Crockford): the digits can be read aloud and typed."""
CODE_DIGITS = 6
MAX_SLUG_CHARS = 40


def new_case_id() -> str:
    """Return a random case id, 16 hexadecimal digits."""
    return secrets.token_hex(8)


def case_code(case_id: str) -> str:
    """Return the code of a case for names: 6 digits in Crockford's base32, 2**30 codes.

    Parameters
    ----------
    case_id
        Hexadecimal id of the case. The id is random, so the code contains no information about the CT.
    """
    number = int.from_bytes(hashlib.sha256(case_id.lower().encode()).digest()[:8], "big")
    return "".join(CROCKFORD[number >> (5 * place) & 31] for place in range(CODE_DIGITS))


def neutral_alias(case_id: str) -> str:
    """Return the name by which a case is shown if its user gave it none, such as ``Case K7M4QX``.

    Examples
    --------
    >>> neutral_alias("00112233aabbccdd")
    'Case TJM0Z7'
    """
    return f"Case {case_code(case_id)}"


def suggested_file_name(alias: str | None, case_id: str) -> str:
    """Return a file name without suffix: the user's name of the case, and its code.

    The code makes the file names of two cases different, also if both cases have one name.

    Examples
    --------
    >>> suggested_file_name(None, "00112233aabbccdd")
    'case-TJM0Z7'
    >>> suggested_file_name("Nodule in RB4 / left?", "00112233aabbccdd")
    'Nodule-in-RB4-left-TJM0Z7'
    """
    slug = re.sub(r"[^\w]+", "-", alias or "").strip("-_")[:MAX_SLUG_CHARS].strip("-_")
    return f"{slug or 'case'}-{case_code(case_id)}"
