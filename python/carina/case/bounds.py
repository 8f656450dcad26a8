"""Bounds of the numbers and texts of a case file; content outside the bounds counts as damaged.

The bounds are listed in docs/case-file.md. Carina writes no content outside the bounds: the writer shortens texts and
omits values that could not be read back.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from carina.case.error_texts import damage_error
from carina.errors import CarinaError
from carina.scopes import Pose
from carina.value import TEXT

MAX_S: Final = 1e10
"""Maximum time since the creation of a case, in seconds: 317 years, so that a wrong system clock is accepted."""
MAX_MM: Final = 1e6
MAX_PLACE_MM: Final = 1e5
MAX_NUMBER: Final = 1e9
"""Maximum absolute number that is not a length: a cost, a CT value, an angle, a percentage."""
MAX_WHOLE: Final = 2**53
MAX_LABEL_CHARS: Final = 1000
"""Maximum length of a step's label in characters; labels that Carina writes have at most about 200."""
MAX_NAME_CHARS: Final = 4000
"""Maximum length of a name or a title in characters, equal to the limit of a text in the wire protocol."""
MAX_MESSAGE_CHARS: Final = 20_000
"""Maximum length of a note or a message in characters."""
MAX_DEPTH: Final = 32
_TEXT: Final = re.compile(TEXT)
_NOT_TEXT: Final = re.compile(r"[\x00-\x08\x0b-\x1f\ud800-\udfff]")


def bounded_number(value: object, where: str, low: float, high: float) -> float:
    """Return a value of a case file as a number; raise an error unless it is a finite number within bounds.

    Parameters
    ----------
    value
        The value from the file, of any type.
    where
        Name of the value for messages.
    low, high
        Smallest and largest accepted number.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise damage_error(where, f"a number from {low:g} to {high:g}", _value_text(value))
    return float(value)


def bounded_whole(value: object, where: str, low: int, high: int) -> int:
    """Return a value of a case file as an int; raise an error unless it is a whole number within bounds.

    Parameters
    ----------
    value
        The value from the file, of any type.
    where
        Name of the value for messages.
    low, high
        Smallest and largest accepted number.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise damage_error(where, f"a whole number from {low} to {high}", _value_text(value))
    return value


def bounded_text(value: object, where: str, most: int) -> str:
    """Return a value if it is a text of bounded length without control characters; line breaks and tabs are allowed.

    Parameters
    ----------
    value
        The value from the file, of any type.
    where
        Name of the value for messages.
    most
        Largest number of characters.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    if not isinstance(value, str):
        raise damage_error(where, "text", _value_text(value))
    if len(value) > most:
        raise damage_error(where, f"at most {most} characters", f"{len(value)}")
    if _TEXT.fullmatch(value) is None:
        raise damage_error(where, "text without control characters", _value_text(value))
    return value


def bounded_array(values: NDArray[Any], where: str, low: float, high: float) -> None:
    """Raise an error if an array contains NaN or a number outside the bounds.

    Parameters
    ----------
    values
        The array.
    where
        Name of the array for messages.
    low, high
        Smallest and largest accepted number.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    # Comparisons with NaN are false, so NaN is refused too.
    if len(values) and not (np.min(values) >= low and np.max(values) <= high):
        raise damage_error(where, f"numbers from {low:g} to {high:g}", "other numbers")


def check_ascending(values: NDArray[Any] | tuple[float, ...], where: str) -> None:
    """Raise an error unless positions along a path are in ascending order.

    Parameters
    ----------
    values
        The positions, ``(n,)``.
    where
        Name of the positions for messages.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    if (np.diff(np.asarray(values, dtype=np.float64)) < 0.0).any():
        raise damage_error(where, "numbers in ascending order", "a different order")


def check_plain(value: object, where: str, *, most_chars: int = MAX_MESSAGE_CHARS) -> None:
    """Check the depth, the numbers and the texts of JSON whose fields this module does not know.

    Parameters
    ----------
    value
        The decoded JSON.
    where
        Name of the value for messages.
    most_chars
        Largest length of each text.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    waiting: list[tuple[object, int]] = [(value, 0)]
    while waiting:
        one, depth = waiting.pop()
        if depth > MAX_DEPTH:
            raise damage_error(where, f"at most {MAX_DEPTH} levels of JSON", "more")
        if isinstance(one, str):
            bounded_text(one, where, most_chars)
        elif isinstance(one, int | float) and not isinstance(one, bool):
            if not -1e15 <= one <= 1e15:
                raise damage_error(where, "numbers from -1e15 to 1e15", _value_text(one))
        elif isinstance(one, Mapping):
            waiting += ((part, depth + 1) for pair in one.items() for part in pair)
        elif isinstance(one, list | tuple):
            waiting += ((part, depth + 1) for part in one)


def check_tip(tip: Mapping[str, Any], where: str, *, has_route: bool) -> None:
    """Check the saved state of the scope tip (:meth:`carina.navigate.Navigator.state`); an empty state is valid.

    Parameters
    ----------
    tip
        The state.
    where
        Name of the state for messages.
    has_route
        Whether the document has a route, which the mode ``path`` requires.

    Raises
    ------
    CaseFileError
        ``case.damaged``.
    """
    if not tip:
        return
    expected = "a pose, a mode, offsets and a place on the path"
    try:
        arrays = {name: np.array(tip[name], dtype=np.float64) for name in ("entry", "look", "shift_lps")}
        matrix = np.array(tip["lps_from_camera"], dtype=np.float64)
        Pose(matrix)
        mode, operator = tip["mode"], tip["operator"]
        path_mm = bounded_number(tip["path_mm"], where, -MAX_MM, MAX_MM)
        bounded_number(tip["base_roll_rad"], where, -MAX_NUMBER, MAX_NUMBER)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise damage_error(where, expected, f"other content ({str(error)[:100]})") from None
    if [array.shape for array in arrays.values()] != [(3, 3), (3, 3), (3,)] or not math.isfinite(path_mm):
        raise damage_error(where, expected, "arrays of another shape")
    for turn in (arrays["entry"], arrays["look"]):
        bounded_array(turn.ravel(), where, -1.001, 1.001)
    bounded_array(arrays["shift_lps"], where, -MAX_MM, MAX_MM)
    bounded_array(matrix.ravel(), where, -MAX_MM, MAX_MM)
    if mode not in {"free", "path"} or operator not in {"head", "facing"} or (mode == "path" and not has_route):
        raise damage_error(where, expected, f"mode {_value_text(mode)}, operator {_value_text(operator)}")


def _value_text(value: object) -> str:
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) > MAX_WHOLE:
        return "a larger number"
    return repr(value)[:60]


def shortened_text(text: str, most: int) -> str:
    """Return a text with control characters replaced, cut with an ellipsis to at most ``most`` characters."""
    text = _NOT_TEXT.sub("\ufffd", text)
    return text if len(text) <= most else text[: most - 1] + "\u2026"


def with_shortened_texts(value: Any, most: int) -> Any:
    """Return a copy of plain JSON in which :func:`shortened_text` was applied to every text."""
    if isinstance(value, str):
        return shortened_text(value, most)
    if isinstance(value, Mapping):
        return {with_shortened_texts(key, most): with_shortened_texts(part, most) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [with_shortened_texts(part, most) for part in value]
    return value


def is_readable_tip(tip: Mapping[str, Any], *, has_route: bool) -> bool:
    """Return whether :func:`check_tip` accepts the saved state of the scope tip."""
    try:
        check_tip(tip, "tip", has_route=has_route)
    except CarinaError:
        return False
    return True
