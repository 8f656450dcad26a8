"""Checks of the arguments of public functions and value classes: type, range and finite numbers.

:func:`check_arguments` is the decorator for functions and methods, :func:`check_fields` the call for ``__post_init__``
of a value class. ``tests/contract/test_public_arguments.py`` calls every public function with wrong values; a function
without checks fails there.
"""

from __future__ import annotations

import functools
import inspect
import math
import numbers
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from carina.errors import CarinaError, UsageError, check_type

__all__ = [
    "COORDINATE_MM",
    "Check",
    "any_number",
    "array_of",
    "bounded",
    "check_arguments",
    "check_fields",
    "choice",
    "coordinates",
    "direction",
    "each",
    "file_path",
    "flag",
    "function",
    "having",
    "instance",
    "is_number",
    "lps_point",
    "lps_points",
    "mask_array",
    "name_or",
    "number_from",
    "numbers_within",
    "pixels",
    "progress_choice",
    "shown",
    "text_of",
    "whole_from",
]

P = ParamSpec("P")
T = TypeVar("T")
Check = Callable[[str, str, Any], None]
"""Function ``check(function_name, argument_name, value)`` that raises UsageError for a wrong value."""
COORDINATE_MM = 1e5
"""Maximum absolute coordinate in LPS mm, and maximum length; equal to the bound of ``carina.value.Coordinate``."""
SHOWN_CHARACTERS = 60
PATH_CHARACTERS = 4096
NAME_CHARACTERS = 255
"""Limits of file systems for paths and names, in characters.

A longer path or name would raise an OSError that does not name the argument.
"""


def check_arguments(**checks: Check) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Check the named arguments before each call of a function or method.

    Parameters
    ----------
    **checks
        The check of each argument. An argument that has its default is not checked.

    Raises
    ------
    UsageError
        ``usage.type`` or ``usage.range``: the message has the function, the argument, the expected and the found value.
    """

    def decorate(called: Callable[P, T]) -> Callable[P, T]:
        parameters = inspect.signature(called).parameters
        unknown = checks.keys() - parameters.keys()
        assert not unknown, f"{called.__qualname__} has no parameter {', '.join(unknown)}"
        in_order = [(name, checks.get(name), value.default) for name, value in parameters.items()]
        by_name = {name: (check, default) for name, check, default in in_order}
        where = called.__qualname__.removesuffix(".__init__")

        @functools.wraps(called)
        def checked(*args: P.args, **kwargs: P.kwargs) -> T:
            for (name, check, default), value in zip(in_order, args, strict=False):
                if check is not None and value is not default:
                    check(where, name, value)
            for name, value in kwargs.items():
                found, default = by_name.get(name, (None, None))
                if found is not None and value is not default:
                    found(where, name, value)
            return called(*args, **kwargs)

        return checked

    return decorate


def check_fields(
    value: object, kind: type[CarinaError] = UsageError, code: str | None = None, /, **checks: Check
) -> None:
    """Check the fields of a value class; ``__post_init__`` calls this function.

    Parameters
    ----------
    value
        The object with the fields.
    kind, code
        Class and code of the error.
    **checks
        The check of each field.
    """
    where = type(value).__name__
    for name, check in checks.items():
        try:
            check(where, name, getattr(value, name))
        except UsageError as error:
            raise kind(str(error), code=code or (error.code if kind is UsageError else None)) from None


def _wrong(where: str, name: str, expected: str, found: Any, *, kind: bool = False) -> UsageError:
    return UsageError(
        f"{where}: {name}: expected {expected}; found {shown(found)}", code="usage.type" if kind else "usage.range"
    )


def shown(value: Any) -> str:
    """Return a short form of a value for a message."""
    if value is None or isinstance(value, bool):
        return str(value)
    if isinstance(value, int) and abs(value) > 10**15:
        return "a whole number of more than 15 digits"
    if isinstance(value, numbers.Integral):
        return str(int(value))
    if isinstance(value, numbers.Real):
        return f"{float(value):g}"
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}" if value.size > 4 else repr(value.tolist())[:SHOWN_CHARACTERS]
    if isinstance(value, str | bytes | tuple | list):
        return repr(value)[:SHOWN_CHARACTERS] if len(value) <= SHOWN_CHARACTERS else f"{len(value)} entries"
    return type(value).__name__


def is_number(value: Any) -> bool:
    """Return whether a value is a real number; True and False are not real numbers."""
    return isinstance(value, numbers.Real) and not isinstance(value, bool | np.bool_)


def number_from(least: float, most: float, *, optional: bool = False, unit: str = "") -> Check:
    """Return a check for one finite number in a closed range; ``optional`` allows None."""
    expected = f"a number from {least:g} to {most:g}{f' {unit}' if unit else ''}" + (" or None" if optional else "")

    def check(where: str, name: str, value: Any) -> None:
        if value is None and optional:
            return
        if not is_number(value):
            raise _wrong(where, name, expected, value, kind=True)
        if not least <= value <= most:
            raise _wrong(where, name, expected, value)

    return check


def whole_from(least: int, most: int, *, optional: bool = False) -> Check:
    """Return a check for one whole number in a closed range; ``optional`` allows None."""
    expected = f"a whole number from {least} to {most}" + (" or None" if optional else "")

    def check(where: str, name: str, value: Any) -> None:
        if value is None and optional:
            return
        if not isinstance(value, numbers.Integral) or isinstance(value, bool | np.bool_):
            raise _wrong(where, name, expected, value, kind=True)
        if not least <= int(value) <= most:
            raise _wrong(where, name, expected, value)

    return check


def bounded(largest: float, *, optional: bool = False, unit: str = "") -> Check:
    """Return a check for the type and the size of one number, for a function that rejects NaN and infinity itself."""
    expected = f"a number from -{largest:g} to {largest:g}{f' {unit}' if unit else ''}" + (
        " or None" if optional else ""
    )

    def check(where: str, name: str, value: Any) -> None:
        if value is None and optional:
            return
        if not is_number(value):
            raise _wrong(where, name, expected, value, kind=True)
        if not isinstance(value, numbers.Integral) and not math.isfinite(value):
            return
        if not -largest <= value <= largest:
            raise _wrong(where, name, expected, value)

    return check


def any_number(*, optional: bool = False) -> Check:
    """Return a check for the type of one number, for a class that checks the range itself; ``optional`` allows None."""

    def check(where: str, name: str, value: Any) -> None:
        if not is_number(value) and not (value is None and optional):
            raise _wrong(where, name, "a number" + (" or None" if optional else ""), value, kind=True)

    return check


def pixels(most: int = 8192) -> Check:
    """Return a check for the width or the height of an image."""
    return whole_from(1, most)


def flag(where: str, name: str, value: Any) -> None:
    """Reject any value but True and False."""
    if not isinstance(value, bool | np.bool_):
        raise _wrong(where, name, "True or False", value, kind=True)


def choice(*options: str, optional: bool = False) -> Check:
    """Return a check for one of the allowed texts; ``optional`` allows None."""
    expected = f"one of {', '.join(options)}" + (" or None" if optional else "")

    def check(where: str, name: str, value: Any) -> None:
        if value is None and optional:
            return
        if not isinstance(value, str):
            raise _wrong(where, name, expected, value, kind=True)
        if value not in options:
            raise _wrong(where, name, expected, value)

    return check


def text_of(most: int = 4000, *, least: int = 1, optional: bool = False) -> Check:
    """Return a check for text with a least and a largest length; ``optional`` allows None."""
    expected = f"text of {least} to {most} characters" + (" or None" if optional else "")

    def check(where: str, name: str, value: Any) -> None:
        if value is None and optional:
            return
        if not isinstance(value, str):
            raise _wrong(where, name, expected, value, kind=True)
        if not least <= len(value) <= most:
            raise _wrong(where, name, expected, value)

    return check


def file_path(*, optional: bool = False, also: type | tuple[type, ...] = ()) -> Check:
    """Return a check for the path of a file or folder: not empty, without a NUL character.

    ``optional`` allows None; ``also`` lists other types that the argument may have.
    """

    def check(where: str, name: str, value: Any) -> None:
        if (value is None and optional) or isinstance(value, also):
            return
        if not isinstance(value, str | os.PathLike):
            check_type(where, name, value, (str, Path), "name a folder or a file")
        found = os.fspath(value)
        if not isinstance(found, str) or not found.strip() or "\0" in found:
            raise _wrong(where, name, "the path of a folder or a file", found)
        if len(found) > PATH_CHARACTERS or max(map(len, Path(found).parts)) > NAME_CHARACTERS:
            expected = f"a path of at most {PATH_CHARACTERS} characters, {NAME_CHARACTERS} for each name in it"
            raise _wrong(where, name, expected, found)

    return check


def instance(kinds: type | tuple[type, ...], remedy: str, *, optional: bool = False) -> Check:
    """Return a check for a type; ``remedy`` states how to get such a value. ``optional`` allows None."""

    def check(where: str, name: str, value: Any) -> None:
        if not (value is None and optional):
            check_type(where, name, value, kinds, remedy)

    return check


def name_or(kinds: type | tuple[type, ...], remedy: str, *, optional: bool = False) -> Check:
    """Return a check for an object of a type or its name in a library; ``optional`` allows None."""
    a_name = text_of(200)
    an_object = instance((*(kinds if isinstance(kinds, tuple) else (kinds,)), str), remedy, optional=optional)

    def check(where: str, name: str, value: Any) -> None:
        (a_name if isinstance(value, str) else an_object)(where, name, value)

    return check


def having(attribute: str, remedy: str, *, optional: bool = False) -> Check:
    """Return a check for an object with an attribute; ``remedy`` states how to get it. ``optional`` allows None."""

    def check(where: str, name: str, value: Any) -> None:
        if not (value is None and optional) and not hasattr(value, attribute):
            raise _wrong(where, name, f"an object with {attribute} ({remedy})", value, kind=True)

    return check


def function(where: str, name: str, value: Any) -> None:
    """Reject any value but a function and None."""
    if value is not None and (not callable(value) or isinstance(value, type)):
        raise _wrong(where, name, "a function or None", value, kind=True)


def progress_choice(where: str, name: str, value: Any) -> None:
    """Reject any value but a function, True, False and None."""
    if value is not None and not isinstance(value, bool) and (not callable(value) or isinstance(value, type)):
        expected = "True, False, None or a function that takes a string and a fraction"
        raise UsageError(f"{where}: {name}: expected {expected}; found {type(value).__name__}", code="usage.type")


def each(check_one: Check, *, least: int = 0, most: int = 1_000_000, optional: bool = False) -> Check:
    """Return a check for a list or tuple whose every entry passes ``check_one``; ``optional`` allows None."""

    def check(where: str, name: str, value: Any) -> None:
        if value is None and optional:
            return
        if not isinstance(value, list | tuple | np.ndarray):
            raise _wrong(where, name, "a list", value, kind=True)
        if not least <= len(value) <= most:
            raise _wrong(where, name, f"{least} to {most} entries", value)
        for n, entry in enumerate(value):
            check_one(where, f"{name}[{n}]", entry)

    return check


def numbers_within(largest: float = COORDINATE_MM, *, optional: bool = False) -> Check:
    """Return a check for numbers of any shape, for a function that rejects wrong shapes and NaN itself.

    Finite numbers with an absolute value above ``largest`` are rejected. ``optional`` allows None.
    """
    expected = f"finite numbers between -{largest:g} and {largest:g}" + (" or None" if optional else "")

    def check(where: str, name: str, value: Any) -> None:
        if value is None and optional:
            return
        found = _as_numbers(where, name, expected, value)
        finite = found[np.isfinite(found)]
        if finite.size and not -largest <= finite.min() <= finite.max() <= largest:
            raise _wrong(where, name, expected, value)

    return check


def _as_numbers(where: str, name: str, expected: str, value: Any) -> np.ndarray[Any, Any]:
    """Return an array of numbers; raise UsageError if the value is not one."""
    try:
        found = np.asarray(value)
    except (ValueError, TypeError, OverflowError):
        raise _wrong(where, name, expected, value, kind=True) from None
    if found.dtype.kind not in "iuf":
        raise _wrong(where, name, expected, value, kind=True)
    return found


def array_of(
    *shape: int | None,
    largest: float = COORDINATE_MM,
    optional: bool = False,
    what: str | None = None,
) -> Check:
    """Return a check for an array of finite numbers.

    Parameters
    ----------
    *shape
        Length of each axis; None is any length from 1.
    largest
        Largest absolute value.
    optional
        Whether None is allowed.
    what
        Description of the expected value.
    """
    size = " x ".join("n" if length is None else str(length) for length in shape)
    expected = (what or f"{size} finite numbers") + f" between -{largest:g} and {largest:g}"
    expected += " or None" if optional else ""

    def check(where: str, name: str, value: Any) -> None:
        if value is None and optional:
            return
        found = _as_numbers(where, name, expected, value)
        same = found.ndim == len(shape) and all(
            have == want or (want is None and have > 0) for have, want in zip(found.shape, shape, strict=True)
        )
        if not same:
            raise _wrong(where, name, expected, value)
        low, high = float(found.min()), float(found.max())
        if not (math.isfinite(low) and math.isfinite(high) and -largest <= low and high <= largest):
            raise _wrong(where, name, expected, value)

    return check


def coordinates(largest: float = 1e7) -> Check:
    """Return a check for points of shape (..., 3), finite numbers; an array without points is allowed."""
    expected = f"points of shape (..., 3), finite numbers between -{largest:g} and {largest:g}"

    def check(where: str, name: str, value: Any) -> None:
        found = _as_numbers(where, name, expected, value)
        if found.ndim == 0 or found.shape[-1] != 3:
            raise _wrong(where, name, expected, value)
        # The comparison is False for NaN.
        if found.size and not (-largest <= found.min() and found.max() <= largest):
            raise _wrong(where, name, expected, value)

    return check


def mask_array(*, optional: bool = False) -> Check:
    """Return a check for a mask: an array of three axes, of whole numbers or of True and False."""

    def check(where: str, name: str, value: Any) -> None:
        if value is None and optional:
            return
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "iub" or value.ndim != 3 or value.size == 0:
            raise _wrong(where, name, "an array (nz, ny, nx) of whole numbers or of True and False", value, kind=True)

    return check


def lps_point(*, optional: bool = False) -> Check:
    """Return a check for one point x, y, z in LPS mm."""
    return array_of(3, optional=optional, what="a point of three finite numbers in mm (LPS)")


def lps_points(*, optional: bool = False, or_one: bool = False, or_none: bool = False) -> Check:
    """Return a check for points of shape (n, 3) in LPS mm, n at least 1.

    Parameters
    ----------
    optional
        Whether the value None is allowed.
    or_one
        Whether one point of shape (3,) is allowed.
    or_none
        Whether there may be no points: shape (0, 3).
    """
    what = "points of shape (n, 3), finite numbers in mm (LPS)"
    several = array_of(None, 3, optional=optional, what=what)
    one = lps_point()

    def check(where: str, name: str, value: Any) -> None:
        shape = None if value is None else _as_numbers(where, name, what, value).shape
        if or_one and shape == (3,):
            one(where, name, value)
        elif not (or_none and shape == (0, 3)):
            several(where, name, value)

    return check


def direction(*, optional: bool = False) -> Check:
    """Return a check for a direction of three finite numbers with a length above 0."""
    inner = array_of(3, optional=optional, what="a direction of three finite numbers")

    def check(where: str, name: str, value: Any) -> None:
        inner(where, name, value)
        if value is not None and not np.any(np.asarray(value)):
            raise _wrong(where, name, "a direction longer than 0", value)

    return check
