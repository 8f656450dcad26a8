"""Preview of an edit: the lines that the edit would make, computed by the same steps."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError, UsageError
from carina.track.edit.add_branch_path import branch_way
from carina.track.edit.edit_list import AddBranch, Bridge, MoveFork
from carina.track.edit.edits import edit_airways, steps_of
from carina.track.edit.preview_lines import EditPreview, PreviewLine
from carina.track.find.result import Airways
from carina.track.names.renaming import renamed_branches
from carina.track.progress import Cancel
from carina.track.tree.airway_tree import Branch
from carina.volume.model import Volume

__all__ = ["EditPreview", "PreviewLine", "new_lines", "preview_edit"]


def preview_edit(
    volume: Volume,
    airways: Airways,
    edit: AddBranch | Bridge | MoveFork,
    *,
    with_names: bool = False,
    cancel: Cancel | None = None,
) -> EditPreview:
    """Compute the lines that :func:`carina.track.edit_airways` would make of an edit, by the same steps.

    Parameters
    ----------
    volume
        The CT in which ``airways`` were found.
    airways
        Airways before the edit; not changed.
    edit
        The edit. An :class:`AddBranch` is previewed as if ``even_without_evidence`` were False; its line states
        where evidence is missing.
    with_names
        Whether to determine which other branches the edit would rename. This makes the whole edit, so that it takes
        some tenths of a second in place of some hundredths.
    cancel
        Function that returns True to stop the calculation.

    Returns
    -------
    EditPreview
        The new lines; if the edit is impossible, no lines and a ``problem``.

    Raises
    ------
    CancelledError
        If ``cancel()`` returned True.
    """
    preview = _new_lines_of(volume, airways, edit, cancel)
    if not with_names or preview.problem is not None:
        return preview
    if isinstance(edit, AddBranch):
        edit = AddBranch(edit.lps, even_without_evidence=True)
    edited = edit_airways(volume, airways, edit, progress=False, cancel=cancel)
    return dataclasses.replace(preview, renamed=renamed_branches(airways.tree, edited.tree))


def _new_lines_of(
    volume: Volume, airways: Airways, edit: AddBranch | Bridge | MoveFork, cancel: Cancel | None
) -> EditPreview:
    if isinstance(edit, AddBranch):
        return branch_way(volume, airways, edit.lps)
    try:
        steps = steps_of(airways, cancel=cancel)
        steps.make(edit)
    except (NoResultError, UsageError) as error:
        return EditPreview((), False, str(error))
    return EditPreview(new_lines(airways.tree.branches, tuple(steps.draft.ordered())), True, None)


def new_lines(before: tuple[Branch, ...], after: tuple[Branch, ...]) -> tuple[PreviewLine, ...]:
    """Return the lines that differ between two trees: pieces of branches between unchanged points."""
    known = {point.tobytes() for branch in before for point in branch.points}
    lines = []
    for branch in after:
        is_old = np.array([point.tobytes() in known for point in branch.points])
        new_segment = ~(is_old[1:] & is_old[:-1])
        for first, last in _runs(new_segment):
            drawn = np.full(last - first, branch.kind != "tracked")
            lines.append(PreviewLine(branch.points[first : last + 1].copy(), drawn, drawn))
    return tuple(lines)


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the start and end (one past the last) indices of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]
