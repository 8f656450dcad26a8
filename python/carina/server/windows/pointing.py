"""Answers to requests that follow the cursor: live path, preview of an edit, measurements along a branch."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from carina.commands import LivePathTo, LumenBeforeWall, MarkAt, MeasuresOf, PreviewOf
from carina.errors import CarinaError, UsageError
from carina.server.to_wire.thin_points import thinned
from carina.server.to_wire.tree import branch_detail_message
from carina.server.windows.latest_only import LatestTaskRunner
from carina.server.wire import messages as wire
from carina.session import EvidenceMissing, Session, log_fault
from carina.track import AddBranch, BranchWay, Bridge, EditPreview, MoveFork, renaming_texts

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carina.server.frames.pump import ShownPicture
    from carina.session.targets.routing import Mark

logger = logging.getLogger(__name__)


class Pointing:
    """Worker threads that answer the latest request of each kind about the point under the cursor.

    Parameters
    ----------
    session
        Session that computes the answers.
    shown
        Returns the airway picture of a frame id, or None if it is no longer stored.
    push
        Sends the answer; called from the thread of the worker.
    """

    def __init__(
        self, session: Session, shown: Callable[[int], ShownPicture | None], push: Callable[[Any], None]
    ) -> None:
        self._session = session
        self._shown = shown
        self._push = push
        self._latest_task_runner = LatestTaskRunner("carina-pointing")
        self._mark_task_runner = LatestTaskRunner("carina-marking")
        """Thread of the segmentation under the cursor, which takes longer than a path."""

    def start(self) -> None:
        """Start the threads that answer the requests."""
        self._latest_task_runner.start()
        self._mark_task_runner.start()

    def stop_soon(self) -> None:
        """End the threads after the answers in progress, without waiting for the threads."""
        self._latest_task_runner.stop_soon()
        self._mark_task_runner.stop_soon()

    def stop(self) -> None:
        """End the threads and wait for the answers in progress."""
        self._latest_task_runner.stop()
        self._mark_task_runner.stop()

    @property
    def threads(self) -> tuple[threading.Thread, ...]:
        """Threads that answer the requests."""
        return self._latest_task_runner.thread, self._mark_task_runner.thread

    def request_live_path(self, message: wire.AskLivePath) -> None:
        """Queue a request for the live path to a position; the answer contains the message of any error."""
        self._latest_task_runner.submit("live_path", lambda: self._answer_live_path(message))

    def request_target_mark(self, message: wire.AskTargetMark) -> None:
        """Queue a request for the target that a click would mark."""
        self._mark_task_runner.submit("target_mark", lambda: self._answer_target_mark(message))

    def request_edit_preview(self, message: wire.AskEditPreview) -> None:
        """Queue a request for the preview of an edit; the answer contains the message of any error."""
        self._latest_task_runner.submit("edit_preview", lambda: self._answer_edit_preview(message))

    def request_branch_detail(self, message: wire.AskBranchDetail) -> None:
        """Queue a request for the measurements along a branch.

        Without measurements the fields of the answer are None.
        """
        self._latest_task_runner.submit("branch_detail", lambda: self._answer_branch_detail(message))

    def _answer_live_path(self, message: wire.AskLivePath) -> None:
        lps = None
        try:
            lps = self._place_of_request(message)
            found = self._session.ask(LivePathTo(lps))
            answer = live_path_message(message.request_id, lps, found.path, found.from_carina_mm)
        except CarinaError as error:
            answer = _no_path_message(message.request_id, str(error), lps)
        except Exception as error:
            log_fault(logger, "could not calculate the live path", error)
            answer = _no_path_message(
                message.request_id,
                f"no path through the airways could be calculated: internal error in Carina ({type(error).__name__})",
            )
        self._push(answer)

    def _answer_target_mark(self, message: wire.AskTargetMark) -> None:
        mark: Mark | None = None
        try:
            mark = self._session.ask(MarkAt(message.lps))
        except CarinaError as error:
            # The cursor has moved, or the point is outside the scan.
            logger.debug("no mark: %s", error)
        except Exception as error:
            log_fault(logger, "the preview of a target failed", error)
        sentences, warns = ((), False) if mark is None else (mark.sentences, mark.warns)
        self._push(wire.TargetMark(message.request_id, message.lps, sentences, warns))

    def _answer_edit_preview(self, message: wire.AskEditPreview) -> None:
        lps = None
        try:
            lps = self._place_of_request(message)
            answer = edit_preview_message(
                message,
                lps,
                self._session.ask(PreviewOf(_preview_of_message(message, lps), with_names=message.with_names)),
            )
        except CarinaError as error:
            answer = _no_preview_message(message, lps, str(error))
        except Exception as error:
            log_fault(logger, "the preview of an edit failed", error)
            answer = _no_preview_message(
                message, lps, (f"the preview could not be made: internal error in Carina ({type(error).__name__})")
            )
        self._push(answer)

    def _place_of_request(self, message: wire.AskLivePath | wire.AskEditPreview) -> tuple[float, float, float]:
        if message.lps is not None:
            x, y, z = message.lps
            return x, y, z
        assert message.frame_id is not None
        assert message.column is not None
        assert message.row is not None
        shown = self._shown(message.frame_id)
        if shown is None:
            raise UsageError("the view has changed since you moved the cursor; move it again", code="session.pick")
        hit = shown.wall_at(message.column, message.row)
        if hit is None:
            raise UsageError("there is no airway wall under the cursor", code="session.pick")
        x, y, z = (float(v) for v in hit.position_lps)
        return self._session.ask(LumenBeforeWall((x, y, z), shown.lens_lps))

    def _answer_branch_detail(self, message: wire.AskBranchDetail) -> None:
        measures = None
        try:
            measures = self._session.ask(MeasuresOf(message.branch_id))
        except CarinaError as error:
            # The tree has changed since the request; the page requests again after it receives the new tree.
            logger.debug("no measures: %s", error)
        except Exception as error:
            log_fault(logger, "measuring a branch failed", error)
        self._push(branch_detail_message(message, measures))


def live_path_message(
    request_id: int, lps: tuple[float, float, float], path: Any, from_carina_mm: float | None = None
) -> wire.LivePathMessage:
    """Return a :class:`carina.track.LivePath` as a message, with fewer points.

    ``from_carina_mm`` is the distance of its end from the main carina.
    """
    if path.problem is not None:
        return _no_path_message(request_id, path.problem, lps)
    points = np.asarray(path.points_lps, dtype=np.float64).reshape(-1, 3)
    return wire.LivePathMessage(
        request_id=request_id,
        lps=lps,
        points_lps=tuple((float(x), float(y), float(z)) for x, y, z in np.round(thinned(points), 2)),
        length_mm=_rounded_mm(path.length_mm),
        min_diameter_mm=None if path.min_radius_mm is None else _rounded_mm(2.0 * path.min_radius_mm),
        confidence=None if path.confidence is None else round(min(1.0, max(0.0, float(path.confidence))), 3),
        snapped_mm=_rounded_mm(path.snapped_mm),
        new_mm=_rounded_mm(path.new_mm),
        joins_branch_id=path.joins_branch_id,
        problem=None,
        from_carina_mm=_rounded_mm(from_carina_mm),
    )


def _no_path_message(
    request_id: int, problem: str, lps: tuple[float, float, float] | None = None
) -> wire.LivePathMessage:
    return wire.LivePathMessage(request_id, lps, (), None, None, None, None, None, None, problem)


def _rounded_mm(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 2)


def edit_preview_message(
    message: wire.AskEditPreview, lps: tuple[float, float, float], preview: EditPreview
) -> wire.EditPreviewMessage:
    """Return a :class:`carina.track.EditPreview` as a message, with every point that the edit would create."""
    if preview.problem is not None:
        return _no_preview_message(message, lps, preview.problem)
    return wire.EditPreviewMessage(
        request_id=message.request_id,
        tool=message.tool,
        lps=lps,
        lines=tuple(_line_message(line.points_lps, line.doubtful, line.drawn) for line in preview.lines),
        length_mm=_rounded_mm(preview.length_mm),
        doubtful_mm=_rounded_mm(preview.doubtful_mm),
        has_evidence=preview.has_evidence,
        problem=None,
        origin=_origin_of(preview),
        renamed=None if preview.renamed is None else tuple(renaming_texts(preview.renamed)),
    )


def _origin_of(preview: EditPreview) -> wire.BranchOrigin | None:
    if not isinstance(preview, BranchWay) or preview.parent_title is None:
        return None
    return wire.BranchOrigin(preview.parent_title, preview.extends)


def no_evidence_message(event: EvidenceMissing) -> wire.NoEvidence:
    """Return the message that asks the user whether to draw a branch by hand."""
    error = event.error
    length_mm = float(np.linalg.norm(np.diff(error.way_lps, axis=0), axis=1).sum())
    return wire.NoEvidence(
        job_id=event.job_id,
        code="track.no-evidence",
        message=str(error),
        lps=event.lps,
        line=_line_message(error.way_lps, error.doubtful, np.ones(len(error.doubtful), dtype=bool)),
        length_mm=round(length_mm, 2),
        doubtful_mm=round(error.doubtful_mm, 2),
    )


def _line_message(
    points_lps: NDArray[np.float64], doubtful: NDArray[np.bool_], drawn: NDArray[np.bool_]
) -> wire.EditLine:
    # The points are not rounded, because the edit creates the branch with exactly these points.
    points = tuple((float(x), float(y), float(z)) for x, y, z in points_lps)
    return wire.EditLine(points, tuple(bool(d) for d in doubtful), tuple(bool(d) for d in drawn))


def _no_preview_message(
    message: wire.AskEditPreview, lps: tuple[float, float, float] | None, problem: str
) -> wire.EditPreviewMessage:
    return wire.EditPreviewMessage(message.request_id, message.tool, lps, (), None, None, False, problem, None, None)


def _preview_of_message(message: wire.AskEditPreview, lps: tuple[float, float, float]) -> AddBranch | Bridge | MoveFork:
    match message.tool:
        case "add-branch":
            return AddBranch(lps)
        case "bridge":
            return Bridge(lps)
        case "move-fork":
            assert message.branch_id is not None
            return MoveFork(message.branch_id, lps)
