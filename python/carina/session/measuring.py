"""Measuring the airways in the background, after they are found and after every edit."""

from __future__ import annotations

from functools import partial
from typing import Any

from carina.session.case import OpenCase
from carina.session.core import SessionCore
from carina.session.jobs import Job

__all__ = ["TreeMeasuring"]


class TreeMeasuring(SessionCore):
    """Keeps ``Snapshot.measures`` to the document's airways; flight and edits do not wait for it."""

    def _follow_document(self, case: OpenCase) -> None:
        super()._follow_document(case)
        airways = case.document.airways
        if self._parts.measure_tree is None or airways is case.wanted_measures_of:
            return
        case.wanted_measures_of = airways
        if airways is None:
            self._jobs.cancel_kinds("measures")
        else:
            # A newer job of this kind stops the one before: its tree is gone.
            self._jobs.start("measures", "measuring the airways", partial(self._measure, case, airways))

    def _measure(self, case: OpenCase, airways: Any, job: Job) -> None:
        measure_tree = self._parts.measure_tree
        assert measure_tree is not None
        # Branches that an edit did not touch keep their sections.
        measures = measure_tree(
            case.info.volume, airways, previous=case.measures, progress=job.progress, cancel=job.cancel
        )
        with self._lock:
            job.check()
            case.measures, case.measures_of = measures, airways
            if self._case is case:
                self._changed("state", "tree")
