"""What the airways of a history measure, so that undo and reopening measure none of them again."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

__all__ = ["MeasuredAirways"]


class MeasuredAirways:
    """Measures of airways that a history holds, whole or folded; guarded by the session's lock.

    Parameters
    ----------
    kept
        Airways with their measures, which may still lie in a case file.
    """

    def __init__(self, kept: Iterable[tuple[Any, Any]] = ()) -> None:
        self._found: dict[int, tuple[Any, Any]] = {}
        self.take(kept)

    def __repr__(self) -> str:
        return f"MeasuredAirways({len(self._found)})"

    def take(self, kept: Iterable[tuple[Any, Any]]) -> None:
        """These, and no others."""
        self._found = {id(airways): (airways, measures) for airways, measures in kept}

    def of(self, airways: Any) -> Any:
        """What airways measure: :class:`carina.track.TreeMeasures`, or :class:`carina.case.KeptMeasures`; None where
        they were not measured."""
        found = self._found.get(id(airways))
        return None if found is None else found[1]

    def put(self, airways: Any, measures: Any) -> None:
        """Airways were measured."""
        self._found[id(airways)] = (airways, measures)

    def became(self, before: Any, after: Any) -> None:
        """The same airways were folded, or unfolded."""
        found = self._found.pop(id(before), None)
        if found is not None:
            self.put(after, found[1])

    def among(self, held: Iterable[Any]) -> tuple[tuple[Any, Any], ...]:
        """Airways with their measures, of those that are held; others are forgotten."""
        ids = {id(airways) for airways in held}
        self._found = {key: found for key, found in self._found.items() if key in ids}
        return tuple(self._found.values())
