"""Measuring the airways in the background, after they are found and after every edit."""

from __future__ import annotations

from carina.session.case import OpenCase
from carina.session.subject import Subject

__all__ = ["TreeMeasuring"]


class TreeMeasuring(Subject):
    """Keeps ``Snapshot.measures`` to the document's airways; flight and edits do not wait for it."""

    def follow(self, case: OpenCase) -> None:
        """Measure other airways, with the session locked."""
        if self.core.parts.measure_tree is not None:
            case.measures.want(case.document.airways)
