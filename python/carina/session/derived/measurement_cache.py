"""Cache of measurements of all airways in a history, so that undo and reopening measure no airways again."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any


class MeasuredAirways:
    """Measurements of the airways in a history, unpacked or packed; the session's lock guards the object.

    Parameters
    ----------
    pairs
        Pairs of airways and their measurements, the initial content of the cache; the measurements may still be in a
        case file.
    """

    def __init__(self, pairs: Iterable[tuple[Any, Any]] = ()) -> None:
        self._found: dict[int, tuple[Any, Any]] = {}
        self.replace_all(pairs)

    def __repr__(self) -> str:
        """Describe the cache by its number of measured airways."""
        return f"MeasuredAirways({len(self._found)})"

    def replace_all(self, pairs: Iterable[tuple[Any, Any]]) -> None:
        """Replace all cached measurements by the given pairs of airways and measurements."""
        self._found = {id(airways): (airways, measures) for airways, measures in pairs}

    def of(self, airways: Any) -> Any:
        """Return the measurements of airways; None if the airways were not measured.

        Returns
        -------
        TreeMeasures, StoredMeasures or None
            :class:`carina.track.TreeMeasures`, or :class:`carina.case.StoredMeasures` if they are still in a case file.
        """
        found = self._found.get(id(airways))
        return None if found is None else found[1]

    def add(self, airways: Any, measures: Any) -> None:
        """Add the measurements of airways to the cache."""
        self._found[id(airways)] = (airways, measures)

    def move_to(self, before: Any, after: Any) -> None:
        """Assign the measurements of ``before`` to ``after``, the packed or unpacked object of the same airways."""
        found = self._found.pop(id(before), None)
        if found is not None:
            self.add(after, found[1])

    def retain_only(self, held: Iterable[Any]) -> tuple[tuple[Any, Any], ...]:
        """Delete the measurements of all airways that are not in ``held``, and return the others."""
        ids = {id(airways) for airways in held}
        self._found = {key: found for key, found in self._found.items() if key in ids}
        return tuple(self._found.values())
