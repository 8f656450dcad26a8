"""Measuring the airways in the background, after they are found and after every edit."""

from __future__ import annotations

from functools import partial
from typing import Any

from carina.session.case import OpenCase
from carina.session.jobs import Job
from carina.session.subject import Subject

__all__ = ["TreeMeasuring"]


class TreeMeasuring(Subject):
    """Keeps ``Snapshot.measures`` to the document's airways; flight and edits do not wait for it."""

    def follow(self, case: OpenCase) -> None:
        """Measure other airways, with the session locked."""
        airways = case.document.airways
        if self.core.parts.measure_tree is None or airways is case.wanted_measures_of:
            return
        case.wanted_measures_of = airways
        if airways is None:
            self.core.jobs.cancel_kinds("measures")
        else:
            # A newer job of this kind stops the one before: its tree is gone.
            self.core.jobs.start("measures", "measuring the airways", partial(self._measure, case, airways))

    def _measure(self, case: OpenCase, airways: Any, job: Job) -> None:
        measure_tree = self.core.parts.measure_tree
        assert measure_tree is not None
        # Branches that an edit did not touch keep their sections.
        measures = measure_tree(
            case.info.volume, airways, previous=case.measures, progress=job.progress, cancel=job.cancel
        )
        with self.core.lock:
            job.check()
            case.measures, case.measures_of = measures, airways
            if self.core.case is case:
                self.core.changed("state", "tree")
