"""Commands that open and close a case, stop jobs, undo and redo."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta

from carina.commands.fields import DemoName, Identifier, OwnName, PathText
from carina.commands.value import Command, LocalCommand


class OpenPath(Command, frozen=True):
    """Open a file or folder of this machine."""

    path: PathText


class OpenSeries(Command, frozen=True):
    """Open another DICOM series of the folder from which the CT on screen was opened, or of a folder being opened."""

    key: Identifier
    """Key of the DICOM series to open: ``case.other_series[].key``, or ``opening.series[].key``."""
    job_id: Identifier | None = None
    """Job that opens a series of the same folder now, which this command cancels; null: the folder of the open CT."""


class OpenCaseFile(LocalCommand, frozen=True):
    """Open a case file of this machine."""

    path: Any
    """Path of the case file, a :class:`pathlib.Path`."""
    ct: Any = None
    """Present path of the case's CT, a :class:`pathlib.Path`; None uses the recorded path."""


class OpenDemo(Command, frozen=True):
    """Open a case that is bundled with Carina."""

    name: DemoName


class OpenRecent(Command, frozen=True):
    """Open a case of ``start.recent``, by its ID; the path of the case is never sent."""

    recent_id: Identifier


class BeginAnew(Command, frozen=True):
    """Start a new case of the open CT; the present case stays in the list."""


class RenameCase(Command, frozen=True):
    """Give a case in the list a name; null restores the name from the scan.

    The name stays on this machine: no saved or exported file contains it.
    """

    recent_id: Identifier
    title: OwnName | None


class ForgetCase(Command, frozen=True):
    """Delete a case from the list, and its cached CT; the case can be restored for a day."""

    recent_id: Identifier


class RestoreCase(Command, frozen=True):
    """Restore a case that the user deleted within the last 24 hours."""

    recent_id: Identifier


class EmptyForgotten(Command, frozen=True):
    """Delete all deleted cases from the disk permanently."""


class EmptyCtCache(Command, frozen=True):
    """Delete the cached CTs; later openings read the CTs from their files."""


class KeepCts(Command, frozen=True):
    """Set whether opened CTs are cached for faster opening; off deletes the cached CTs."""

    on: bool


class OpenFiles(LocalCommand, frozen=True):
    """Open files that belong to no case of this machine, such as dropped files; recent cases do not list them."""

    path: str


class OpenVolume(LocalCommand, frozen=True):
    """Open a volume that is already in memory."""

    volume: Any
    """Volume to open, a :class:`carina.volume.Volume`."""
    kept: Any = None
    """Saved state to continue from, a :class:`carina.case.Moment`; None starts a new case."""
    follows: bool = False
    """Whether another process owns the case, so that this process looks for no saved state."""


class CloseCase(Command, frozen=True):
    """Close the case and return to the start page."""


class Cancel(Command, frozen=True):
    """Stop a background job that ``progress`` lists."""

    job_id: Identifier


class Undo(Command, frozen=True):
    """Undo the case's last change that was not undone."""


class Redo(Command, frozen=True):
    """Redo the case's last undone change."""


class SaveCase(Command, frozen=True):
    """Write the whole case to one file, which is then updated while the case is open.

    The file is not needed against loss: Carina always saves the case on this machine.
    """

    path: PathText | None = None
    """Path of the file; null is the path where the case was saved before."""
    replace: bool = False
    """Whether a file that exists at the path may be replaced."""


class KeepNow(LocalCommand, frozen=True):
    """Write unsaved changes to the disk before the next command, instead of by the next automatic save."""


class FollowMoment(LocalCommand, frozen=True):
    """Show the open case in the state of the process that owns it; the display settings stay."""

    moment: Any
    """State of the same case, a :class:`carina.case.Moment`."""


class TakeOver(LocalCommand, frozen=True):
    """Become the owner of the followed case and save it from now on, because its owner has ended."""

    case_id: Identifier


class GoToStep(Command, frozen=True):
    """Undo or redo changes until this number of steps of the history is in effect, counted from 0."""

    step: Annotated[int, Meta(ge=0, le=1_000_000)]
