"""Opening and closing a case, stopping jobs, and undo."""

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
    """A :class:`pathlib.Path`."""
    ct: Any = None
    """Where its CT lies now, a :class:`pathlib.Path`; None looks where it was."""


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
    """Open files that are no case of this machine, such as dropped ones: not kept in the list of recent cases."""

    path: str


class OpenVolume(LocalCommand, frozen=True):
    """Open a volume that is already in memory."""

    volume: Any
    """A :class:`carina.volume.Volume`."""
    kept: Any = None
    """A :class:`carina.case.Moment` to go on from; None begins anew."""
    follows: bool = False
    """Another process owns the case: nothing is looked for here."""


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
    """Where to; null is where it was saved before."""
    replace: bool = False
    """Whether a file that is there already may be replaced."""


class KeepNow(LocalCommand, frozen=True):
    """Write what is not on the disk yet, before anything else is done; it would be written by itself soon."""


class FollowMoment(LocalCommand, frozen=True):
    """Show the open case as it is now in the process that owns it; the sight stays."""

    moment: Any
    """A :class:`carina.case.Moment` of the same case."""


class TakeOver(LocalCommand, frozen=True):
    """Own the case that was followed until now, and keep it from now on: its owner has gone."""

    case_id: Identifier


class GoToStep(Command, frozen=True):
    """Have so many steps of the history hold, from 0: others are taken back, or done again."""

    step: Annotated[int, Meta(ge=0, le=1_000_000)]
