"""Commands that open and close a case, stop jobs, undo and redo."""

from __future__ import annotations

from typing import Annotated, Any

from msgspec import Meta

from carina.commands.fields import DemoName, Identifier, OwnName, PathText
from carina.commands.value import Command, LocalCommand


class OpenPath(Command, frozen=True):
    """Open a file or folder of this machine."""

    path: PathText


class OpenCaseFile(LocalCommand, frozen=True):
    """Open a case file of this machine."""

    path: Any
    """Path of the case file, a :class:`pathlib.Path`."""
    ct: Any = None
    """Present path of the case's CT, a :class:`pathlib.Path`; None uses the recorded path."""


class OpenDemo(Command, frozen=True):
    """Open a bundled case."""

    name: DemoName


class OpenRecent(Command, frozen=True):
    """Open a case of ``start.recent``; its path never travels."""

    recent_id: Identifier


class BeginAnew(Command, frozen=True):
    """Begin another case of the open CT; the one that was continued stays in the list."""


class RenameCase(Command, frozen=True):
    """Call a case of the list by a name of one's own; null is what the scan calls itself.

    The name stays on this machine: no file that is saved or exported holds it.
    """

    recent_id: Identifier
    title: OwnName | None


class ForgetCase(Command, frozen=True):
    """Take a case out of the list, and what is kept of its CT; for a day it can be brought back."""

    recent_id: Identifier


class RestoreCase(Command, frozen=True):
    """Bring a forgotten case back."""

    recent_id: Identifier


class EmptyForgotten(Command, frozen=True):
    """Remove all forgotten cases from the disk, for good."""


class EmptyCtCache(Command, frozen=True):
    """Remove the CTs that are kept to open faster; they are read from their files again."""


class KeepCts(Command, frozen=True):
    """Whether CTs that are opened are kept to open faster; without, those kept are removed."""

    on: bool


class OpenFiles(LocalCommand, frozen=True):
    """Open files that belong to no case of this machine, such as dropped files; recent cases do not list them."""

    path: str


class OpenVolume(LocalCommand, frozen=True):
    """Open a volume that is already in memory."""

    volume: Any
    """Volume, a :class:`carina.volume.Volume`."""
    kept: Any = None
    """Saved state to continue from, a :class:`carina.case.Moment`; None starts a new case."""
    follows: bool = False
    """Whether another process owns the case, so that this process looks for no saved state."""


class CloseCase(Command, frozen=True):
    """Back to the start page."""


class Cancel(Command, frozen=True):
    """Stop a job of ``progress``."""

    job_id: Identifier


class Undo(Command, frozen=True):
    """Take back the last change."""


class Redo(Command, frozen=True):
    """Do it again."""


class SaveCase(Command, frozen=True):
    """Write the case as one whole file, which is kept up to date while the case is open.

    Nothing needs it against loss: what is done is always kept on this machine.
    """

    path: PathText | None = None
    """Path of the file; null is the path where the case was saved before."""
    replace: bool = False
    """Whether an existing file may be replaced."""


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
    """Have so many steps of the history hold, from 0: others are taken back, or done again."""

    step: Annotated[int, Meta(ge=0, le=1_000_000)]
