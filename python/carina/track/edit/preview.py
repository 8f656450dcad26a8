"""What an edit would make, without making it: the lines under the pointer are the lines that the click makes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError, UsageError
from carina.track.edit.edits import steps_of
from carina.track.edit.kinds import AddBranch, Bridge, MoveFork
from carina.track.edit.previewed import EditPreview, PreviewLine
from carina.track.edit.way import branch_way
from carina.track.find.found import Airways
from carina.track.stages import Cancel
from carina.track.tree.airway_tree import Branch
from carina.volume.model import Volume

__all__ = ["EditPreview", "PreviewLine", "new_lines", "preview_edit"]


def preview_edit(
    volume: Volume, airways: Airways, edit: AddBranch | Bridge | MoveFork, *, cancel: Cancel | None = None
) -> EditPreview:
    """What :func:`carina.track.edit_airways` would make of an edit, by the same steps, without making it.

    Parameters
    ----------
    volume
        The CT that ``airways`` were found in.
    airways
        Not changed.
    edit
        An :class:`AddBranch` is looked at as if it were not asked for without evidence: its line says where that is
        missing.
    cancel
        Asked whether to stop.

    Returns
    -------
    EditPreview
        Also where the edit cannot be made: see ``problem``.

    Raises
    ------
    CancelledError
        If ``cancel()`` said so.
    """
    if isinstance(edit, AddBranch):
        return branch_way(volume, airways, edit.lps)
    try:
        steps = steps_of(airways, cancel=cancel)
        steps.make(edit)
    except (NoResultError, UsageError) as error:
        return EditPreview((), False, str(error))
    return EditPreview(new_lines(airways.tree.branches, tuple(steps.draft.ordered())), True, None)


def new_lines(before: tuple[Branch, ...], after: tuple[Branch, ...]) -> tuple[PreviewLine, ...]:
    """What of a tree's lines was not there before: pieces of branches between points that stayed."""
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
    """First and one past the last place of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]
