"""Commands that create the airways of the open case, from the CT or from an imported segmentation, as jobs."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from msgspec import structs

from carina import commands as c
from carina.case.document import Document, Point, Target
from carina.case.routes import ChosenRoute, default_branch_id, route_to_branch
from carina.errors import CarinaError, NoResultError, TrackingError, UsageError
from carina.session.airways.editing import MAX_STORED_AIRWAYS, airway_words, found_airways
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.core import ALL_TOPICS
from carina.session.flights.tip_commands import place_pose
from carina.session.jobs.background_jobs import Job
from carina.session.open_case.open_case import AirwaySearch, OpenCase, PendingMask, as_point
from carina.session.open_case.start_pose import pose_at_root
from carina.session.state.snapshot import MaskQuestion
from carina.session.targets.retrack import tracked_target
from carina.volume import Mask, MaskGridError, MaskLabel, MaskLabelError

SET_THE_ROOT = "Mark the trachea: click inside it on a slice."
AIRWAY_NAMES = re.compile(r"airway|bronch|trache|lumen|luftweg|luftröhre|voies a", re.IGNORECASE)


class AirwayHandlers(CommandHandlers):
    """Commands that replace the airways of the case; each runs as a job and forms one undo step."""

    # ------------------------------------------------------------ segmentation of the CT

    @does(c.SetRoot)
    def set_root(self, command: c.SetRoot) -> str:
        """Segment the airways from a root point, as a job; the change can be undone once the airways are found."""
        root_lps = command.lps
        case = self.core.needed_case()
        case.check_inside(root_lps)
        return self.start(case, root_lps, case.document.lumen_threshold, label="mark the trachea")

    @does(c.SetLumenThreshold)
    def set_lumen_threshold(self, command: c.SetLumenThreshold) -> str:
        """Segment the airways with another lumen threshold, as a job; None uses the automatic threshold."""
        value = command.value
        case = self.core.needed_case()
        airways = case.document.airways
        root = None if airways is None else as_point(airways.root_lps)
        wanted = case.info.scale.threshold if value is None else value
        if airways is None:
            # The threshold is stored even if the search finds nothing, because the next search must use it.
            with self.core.lock:
                case.history.amend_current(lambda d: replace(d, lumen_threshold=wanted))
                self.core.changed("state")
        return self.start(case, root, wanted, label="set the lumen threshold")

    # ------------------------------------------------------------ imported segmentation

    @answers(c.MaskFileNeeded)
    def mask_file_needed(self, _mask_question: c.MaskFileNeeded) -> bool:
        """Return whether the imported file is still needed, because a job reads it or a question about it is open."""
        with self.core.lock:
            is_open = self.core.case is not None and self.core.case.pending_mask is not None
            return is_open or any(job.kind == "mask" for job in self.core.jobs.running)

    @does(c.TakeMask)
    def take_mask(self, command: c.TakeMask) -> str:
        """Import a segmentation: one job reads and resamples the mask, and another one builds its tree.

        The jobs fail with a message if the file is not a mask of the scan.
        """
        path, label, resample = command.path, command.label, command.resample
        case = self.core.needed_case()
        with self.core.lock:
            self._request_mask_answer(case, None)

        def work(job: Job) -> None:
            job.check()
            try:
                mask = self.core.parts.open_mask(
                    path, case.info.volume, label=label, resample=resample, progress=job.progress, cancel=job.cancel
                )
            except (MaskLabelError, MaskGridError) as error:
                with self.core.lock:
                    job.check()
                    self._request_mask_answer(case, PendingMask(command, _mask_question(Path(path).name, error)))
                return
            with self.core.lock:
                job.check()
                if self.core.case is case:
                    self._start_airways_of(case, mask)

        return self.core.jobs.start("mask", "reading the segmentation", work)

    @does(c.AnswerMask)
    def answer_mask(self, command: c.AnswerMask) -> str:
        """Continue an import with the user's answer to a question; earlier answers remain valid.

        Raises
        ------
        UsageError
            If no question is open.
        """
        open_question = self.core.needed_case().pending_mask
        if open_question is None:
            raise UsageError(
                "the imported segmentation is no longer available; choose its file again", code="session.mask"
            )
        mask = open_question.command
        label = mask.label if command.label is None else command.label
        return self.take_mask(c.TakeMask(mask.path, label, command.resample))

    @does(c.DismissMask)
    def dismiss_mask(self, _command: c.DismissMask) -> None:
        """Cancel the import; the airways are unchanged."""
        case = self.core.needed_case()
        with self.core.lock:
            self.core.jobs.cancel_kinds("mask")
            self._request_mask_answer(case, None)

    def _request_mask_answer(self, case: OpenCase, mask: PendingMask | None) -> None:
        if case.pending_mask is not mask:
            case.pending_mask = mask
            self.core.changed("state")

    def follow(self, case: OpenCase) -> None:
        """Update the search status in the airway panel after a change of the document.

        The caller holds the session's lock.
        """
        # Undo may restore other airways or none; a running search updates the panel when it ends.
        airways = case.document.airways
        if airways is not None and case.search.status in {"found", "failed"}:
            case.search = AirwaySearch("found", airway_words(airways))
        elif airways is None and case.search.status == "found":
            case.search = AirwaySearch("failed", f"this step of the history has no airways. {SET_THE_ROOT}")

    # ------------------------------------------------------------ common steps

    def _start_airways_of(self, case: OpenCase, mask: Mask) -> None:
        """Build the tree of a mask from its trachea, or from the known root if the mask contains no trachea."""
        known = case.document.airways
        # The notes, which are stored with the case, omit the file name, because it may contain a patient's name.
        texts = ("the airway lumen is an imported segmentation", *mask.notes)

        def find(job: Job) -> Any:
            options = {"lumen_zyx": mask.inside_zyx, "notes": texts, "progress": job.progress, "cancel": job.cancel}
            volume = case.info.volume
            try:
                return self.core.parts.find_airways(volume, root_lps=None, lumen_threshold=None, **options)
            except NoResultError:
                if known is None:
                    raise
                root = as_point(known.root_lps)
                return self.core.parts.find_airways(volume, root_lps=root, lumen_threshold=None, **options)

        self._start(
            case,
            find,
            case.document.lumen_threshold,
            ("use the segmentation for the airways"),
            "building the airway tree from the segmentation",
        )

    def start(self, case: OpenCase, root_lps: Point | None, threshold: float | None, *, label: str | None) -> str:
        """Search for the airways as a job; ``label`` is None if the search is part of opening the case."""

        def find(job: Job) -> Any:
            return self.core.parts.find_airways(
                case.info.volume,
                root_lps=root_lps,
                lumen_threshold=threshold,
                progress=job.progress,
                cancel=job.cancel,
            )

        return self._start(case, find, threshold, label, "segmenting the airways")

    def _start(
        self, case: OpenCase, find: Callable[[Job], Any], threshold: float | None, label: str | None, title: str
    ) -> str:
        def work(job: Job) -> None:
            try:
                job.check()
                airways = find(job)
                job.progress("building the tree", None)
                self._set_found_airways(case, airways, threshold, label, job)
            except BaseException as error:
                self._restore_search_status(case, error, job)
                if case.document.airways is not None or not isinstance(error, TrackingError):
                    raise
                # The airway panel shows this error, so a second message is not sent.

        with self.core.lock:
            case.search = AirwaySearch("finding")
            self.core.changed("state")
            return self.core.jobs.start("airways", title, work)

    def _restore_search_status(self, case: OpenCase, trouble: BaseException, job: Job) -> None:
        """Restore the search status after a search without result.

        If the case has no airways, the status shows the error.
        """
        with self.core.lock:
            if any(other.kind == "airways" and other is not job for other in self.core.jobs.running):
                return  # A newer search replaces this one.
            if case.document.airways is not None:
                case.search = AirwaySearch("found", airway_words(case.document.airways))
            else:
                words = str(trouble) if isinstance(trouble, CarinaError) else "segmenting the airways failed"
                case.search = AirwaySearch("failed", f"{words}. {SET_THE_ROOT}")
            if self.core.case is case:
                self.core.changed("state")

    def _set_found_airways(
        self, case: OpenCase, airways: Any, threshold: float | None, label: str | None, job: Job
    ) -> None:
        """Set the found airways with paths to the targets; with a ``label`` the change can be undone."""
        branch_id = default_branch_id(airways.tree)
        default_route = None if branch_id is None else route_to_branch(airways.tree, branch_id)
        targets: tuple[Target, ...] = ()
        requested: tuple[Target, ...] | None = None
        while True:
            with self.core.lock:
                job.check()
                if requested == case.document.targets:
                    found = replace(case.document, airways=airways, lumen_threshold=threshold, targets=targets)
                    self._put_airways(case, found, default_route, label)
                    return
                requested = case.document.targets
            # The paths are searched without the lock: a search takes a while, and the user may edit targets meanwhile.
            targets = tuple(tracked_target(airways, target) for target in requested)

    def _put_airways(
        self, case: OpenCase, found: Document, default_route: ChosenRoute | None, label: str | None
    ) -> None:
        chosen = case.document.route
        to_target = [t.route for t in found.targets if chosen is not None and t.target_id == chosen.target_id]
        route = next((r for r in to_target if r is not None), default_route)
        found = replace(found, route=route)
        airways, threshold = found.airways, found.lumen_threshold
        if label is None:
            # Earlier documents of this case have no airways; undo of a change must not remove the airways.
            case.history.amend(lambda d: replace(d, airways=airways, lumen_threshold=threshold, route=default_route))
            case.history.amend_current(lambda _: found)
        else:
            self.core.add_step(case, label, found)
            case.history.keep_distinct(found_airways, MAX_STORED_AIRWAYS)
        case.search = AirwaySearch("found", airway_words(airways))
        self.core.follow(case)
        if not case.last_move.person_moved:
            if route is not None:
                case.pilot.apply(c.GoTo(0.0))
            elif airways is not None:
                case.pilot.apply(place_pose(pose_at_root(airways)))
            self.core.moved()
        self.core.changed(*ALL_TOPICS)


def _mask_question(name: str, trouble: MaskLabelError | MaskGridError) -> MaskQuestion:
    if isinstance(trouble, MaskGridError):
        return MaskQuestion(
            name, "grid", expected=trouble.expected, found=trouble.found, share_inside=trouble.share_inside
        )
    labels = tuple(structs.replace(label, volume_ml=round(label.volume_ml, 3)) for label in trouble.labels)
    return MaskQuestion(name, "label", labels=labels, suggested=_suggested_label(trouble.labels))


def _suggested_label(labels: tuple[MaskLabel, ...]) -> int | None:
    """Return the number of the one mask label whose name denotes the airway; None if no name or several names do."""
    named = [label.number for label in labels if label.name and AIRWAY_NAMES.search(label.name)]
    return named[0] if len(named) == 1 else None
