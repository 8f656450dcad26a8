"""Commands that edit the airway tree; each edit is a job and an undo step, and updates targets and route."""

from __future__ import annotations

import itertools
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from carina import commands as c
from carina.case.document import Document, Target
from carina.errors import NoEvidenceError, NoResultError
from carina.session.command_registry import CommandHandlers, does
from carina.session.core import ALL_TOPICS, SessionCore
from carina.session.jobs.background_jobs import Job
from carina.session.open_case.open_case import OpenCase
from carina.session.state.snapshot import EvidenceMissing, UserMessage
from carina.session.targets.retrack import followed_route, renamed_route, tracked_target
from carina.track import (
    AddBranch,
    FoldedAirways,
    RenameBranch,
    edit_words,
    fold_airways,
    name_edited,
    renamed_branches,
    renaming_texts,
)

if TYPE_CHECKING:
    from carina.track import TreeEdit

MAX_STORED_AIRWAYS = 4
"""Maximum number of segmented airways that undo can restore; a lumen and its tracker take some hundred megabytes."""
NUM_EDITS_WHOLE = 6
"""Number of edited airway trees next to the current undo step that are stored uncompressed.

Other ones are packed to save memory.
"""
MAX_RENAMINGS_LISTED = 6
"""Maximum number of renamed branches that the message after an edit lists."""
POLL_INTERVAL_S = 0.05
"""Interval, in s, at which an edit that waits for an earlier edit checks whether it was stopped."""


class TreeEditHandlers(CommandHandlers):
    """The commands that change the airway tree."""

    def __init__(self, core: SessionCore) -> None:
        super().__init__(core)
        self._edit_numbers = itertools.count(1)
        self._one_edit = threading.Lock()

    @does(c.EditTree)
    def edit_tree(self, command: c.EditTree) -> str:
        """Make one edit as a job, undoable under a label such as ``cut RB3``.

        The paths to targets are searched again. A route to a deleted branch or target is removed, and the user is
        notified. Edits that are requested during another edit follow it. If an edit is impossible, the job fails with a
        message and nothing changes. If a branch is to be added and the CT shows no wall along its path, the session
        sends :class:`carina.session.EvidenceMissing`, which asks the user.
        """
        edit = command.edit
        case = self.core.needed_case()
        for point in _points_of(edit):
            case.check_inside(point)
        words = self._edit_label(case, edit)
        number = next(self._edit_numbers)

        def work(job: Job) -> None:
            while not self._one_edit.acquire(timeout=POLL_INTERVAL_S):
                job.check()
            try:
                self._run_edit(case, edit, job)
            except NoEvidenceError as doubt:
                if not isinstance(edit, AddBranch):
                    # Only a branch can be drawn by hand, so other edits end with an error and not with a question.
                    raise NoResultError(str(doubt), code=doubt.code) from doubt
                self.core.answer(EvidenceMissing(job.job_id, edit.lps, doubt))
                raise
            finally:
                self._one_edit.release()

        return self.core.jobs.start(f"edit {number}", words, work)

    def unfold(self, case: OpenCase) -> None:
        """Replace compressed airways in the document, which undo has restored, by decompressed ones.

        The caller holds the session's lock.
        """
        airways: Any = case.document.airways
        if isinstance(airways, FoldedAirways):
            whole = airways.unfold()
            case.history.amend(lambda d: replace(d, airways=whole) if d.airways is airways else d)
            case.measured.move_to(airways, whole)

    def fold(self, case: OpenCase) -> None:
        """Pack the airways of steps far from the present one; the caller holds the session's lock."""
        folded: dict[int, Any] = {}

        def fold(document: Document) -> Document:
            edited: Any = document.airways
            if edited is None or isinstance(edited, FoldedAirways) or found_airways(document) is edited:
                return document
            if id(edited) not in folded:
                folded[id(edited)] = fold_airways(edited)
                case.measured.move_to(edited, folded[id(edited)])
            return replace(document, airways=folded[id(edited)])

        case.history.fold_far(lambda d: d.airways, NUM_EDITS_WHOLE, fold)

    def _edit_label(self, case: OpenCase, edit: TreeEdit) -> str:
        with self.core.lock:
            return edit_words(edit, _needed_airways(case.document))

    def _run_edit(self, case: OpenCase, edit: TreeEdit, job: Job) -> None:
        while True:
            with self.core.lock:
                job.check()
                before = case.document
            airways = _needed_airways(before)
            label = edit_words(edit, airways)
            edited = self.core.parts.edit_airways(
                case.info.volume, airways, edit, name_branches=False, progress=job.progress, cancel=job.cancel
            )
            targets = tuple(tracked_target(edited, target) for target in before.targets)
            route = followed_route(edited, before.route, targets)
            with self.core.lock:
                job.check()
                # The document may have changed while the job ran (undo, new target, other route); the edit then runs on
                # the
                # document.
                now = case.document
                if now.airways is airways and now.targets == before.targets and now.route is before.route:
                    self._put_edit(case, label, replace(now, airways=edited, targets=targets, route=route))
                    break
        named = name_edited(_needed_airways(before), edited)
        if named is not edited:
            with self.core.lock:
                self._put_names(case, edited, named)
                for line in _renaming_message(airways, named, edit):
                    self.core.emit(UserMessage(line))

    def _put_names(self, case: OpenCase, edited: Any, named: Any) -> None:
        """Add the branch names to the step of their edit, even if undo has changed the current document meanwhile."""
        case.history.amend(lambda document: _with_names(document, edited, named))
        # Measurements do not depend on names.
        case.measured.move_to(edited, named)
        if self.core.case is case:
            self.core.follow(case)
            self.core.changed(*ALL_TOPICS)

    def _put_edit(self, case: OpenCase, label: str, document: Document) -> None:
        before = case.document
        case.search = replace(case.search, words=airway_words(document.airways))
        self.core.change(case, label, document)
        case.history.keep_distinct(found_airways, MAX_STORED_AIRWAYS)
        for line in _lost_messages(before, document):
            self.core.emit(UserMessage(line))


def _with_names(document: Document, edited: Any, named: Any) -> Document:
    """Return the document with the named airways in place of the edited ones, if it contains the edited ones."""
    if document.airways is not edited:
        return document
    return replace(
        document,
        airways=named,
        targets=tuple(replace(target, route=renamed_route(target.route, named.tree)) for target in document.targets),
        route=renamed_route(document.route, named.tree),
    )


def found_airways(document: Document) -> Any:
    """Return the airways from which a document's edits started: a search result or an imported mask."""
    return getattr(document.airways, "base", None) or document.airways


def airway_words(airways: Any) -> str | None:
    """Return the notes of the airway search or import as one line of text for the user; None if there are no notes."""
    return "; ".join(str(note) for note in airways.report) or None


def _lost_messages(before: Document, after: Document) -> list[str]:
    """Return a message for the user for each target path and for the route that an edit removed from the document."""
    lines = [
        f"there is no longer a path to {new.name}: {new.problem}"
        for old, new in zip(before.targets, after.targets, strict=True)
        if _has_path(old) and not _has_path(new)
    ]
    if before.route is not None and after.route is None:
        lines.append(f"the edit removed the route to {before.route.title}; choose another one, or undo")
    return lines


def _renaming_message(before: Any, named: Any, edit: TreeEdit) -> list[str]:
    """Return the message about the branches that an edit renamed, beside the one that the user renamed."""
    own = edit.branch_id if isinstance(edit, RenameBranch) else None
    texts = renaming_texts([one for one in renamed_branches(before.tree, named.tree) if one.branch_id != own])
    if not texts:
        return []
    more = len(texts) - MAX_RENAMINGS_LISTED
    listed = ", ".join(texts[:MAX_RENAMINGS_LISTED]) + (f" and {more} more" if more > 0 else "")
    return [f"the edit also renamed branches: {listed}; undo restores the names"]


def _has_path(target: Target) -> bool:
    return target.route is not None


def _needed_airways(document: Document) -> Any:
    if document.airways is None:
        raise NoResultError(
            "there is no airway tree to edit yet: wait for the segmentation, or mark the trachea",
            code="track.no-airways",
        )
    return document.airways


def _points_of(edit: TreeEdit) -> tuple[tuple[float, float, float], ...]:
    """Return the points of an edit that must lie inside the scan; a stroke may leave the scan."""
    point = getattr(edit, "lps", None)
    return () if point is None else (point,)
