"""Measurement of the airways in the background, after each segmentation and each edit."""

from __future__ import annotations

from carina.session.command_registry import CommandHandlers
from carina.session.open_case.open_case import OpenCase


class MeasurementHandlers(CommandHandlers):
    """Starter of the background job that measures the document's airways for ``Snapshot.measures``."""

    def follow(self, case: OpenCase) -> None:
        """Request the measurements of the document's airways; the caller holds the session's lock."""
        if self.core.parts.measure_tree is not None:
            case.measures.want(case.document.airways)
