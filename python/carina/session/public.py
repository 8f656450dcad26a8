"""The public interface of a case: open a case, run and undo commands, render images."""

from __future__ import annotations

import contextlib
import warnings
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, NoReturn, TypeVar

from carina.argument_checks import check_arguments, file_path, flag, having, instance, pixels, text_of
from carina.commands import Command, Question, Redo, Undo
from carina.errors import CarinaError, NoResultError, UsageError, refuse_pickle
from carina.render import LEAD_VIEW
from carina.session.case_scan import is_case_file
from carina.session.joined_case import JoinedCase
from carina.session.own_case import OwnCase, ProgramCase
from carina.session.snapshot import Snapshot
from carina.volume import Volume

if TYPE_CHECKING:
    from carina.render import Picture
    from carina.scopes import Pose
    from carina.session.session import Session
    from carina.track import Airways

__all__ = ["Case"]

A = TypeVar("A")


class Case:
    """An open chest CT with its airways: what a person decided about it can be undone, and pictures show it.

    What can be done are the commands of :mod:`carina.commands`, the same that the window sends;
    ``help(carina.commands)`` lists them. Each is done before :meth:`do` returns, also where it takes a while.

    Examples
    --------
    >>> import carina
    >>> from carina.commands import ChooseRoute, GoTo, SetTexture
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> with carina.Case.open(phantom.volume) as case:
    ...     case.do(SetTexture(on=False))
    ...     case.do(ChooseRoute(branch_id=case.airways.tree.tips()[0].id))
    ...     case.do(GoTo(path_mm=40.0))
    ...     case.history()[0], case.render(width=64, height=48).rgb.shape
    ('route to LB9', (48, 64, 3))
    """

    @check_arguments(case=having("session", "open one with carina.Case.open"))
    def __init__(self, case: ProgramCase) -> None:
        self._case = case

    @property
    def _session(self) -> Session:
        return self._case.session

    @classmethod
    @check_arguments(source=file_path(also=Volume), ct=file_path(optional=True))
    def open(cls, source: str | Path | Volume, *, ct: str | Path | None = None) -> Case:
        """Open a CT and find its airways, or open a case file and go on from there.

        What a Carina window of this person has open is joined: commands are done there, both see what the other does,
        and the window keeps saving it. Crosshair, zoom, window and light are this program's own. Once that window is
        closed, or ends, this program takes over and saves as the window did, which a warning says.

        Anything else is this program's alone. A case file opens with its history, and nothing is found again. While it
        is open nobody else writes it; whoever opens it meanwhile can look at it and save it under another name
        (:attr:`note` says so, as a warning, too). What is done goes into the file at :meth:`save` and at :meth:`close`.
        A CT stays in memory until :meth:`save`.

        Parameters
        ----------
        source
            A file, a folder, a volume that is open already, or a case: ``NAME.carina``.
        ct
            Where the CT of the case file lies, if it is not where it was.

        Raises
        ------
        VolumeImportError
            If the CT or the case is refused; ``case.no-scan`` where the CT of the case is not found.
        """
        if not isinstance(source, str | Path | Volume):
            found = type(source).__name__
            raise UsageError(f"Case.open: source: expected str, Path or Volume; found {found}; give a folder or a file")
        if ct is not None and (isinstance(source, Volume) or not is_case_file(source)):
            raise UsageError("Case.open: ct: only applies to a case file (NAME.carina)")
        joined = None if isinstance(source, Volume) else JoinedCase.join(source, ct)
        if joined is not None:
            return cls(joined)
        own = OwnCase()
        try:
            own.open(source, ct)
        except BaseException:
            own.close()
            raise
        if own.note is not None:
            # A window that opened it, or saved it there, a moment ago can be joined by now.
            with contextlib.suppress(CarinaError, OSError):
                joined = None if isinstance(source, Volume) else JoinedCase.join(source, ct)
            if joined is not None:
                own.close()
                return cls(joined)
            warnings.warn(own.note, stacklevel=2)
        return cls(own)

    def __enter__(self) -> Case:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __reduce__(self) -> NoReturn:
        refuse_pickle(self, "save it, and open the file with carina.Case.open in the other process")

    def __repr__(self) -> str:
        snapshot = self._session.snapshot()
        if snapshot.case is None:
            return "Case(closed)"
        # The text has no file name or series text of the CT, because notebooks are shared with their output.
        return f"Case(airways {snapshot.airways}, {len(self.history())} changes)"

    # ------------------------------------------------------------ doing

    @check_arguments(command=instance(Command, "create one of the commands of carina.commands"))
    def do(self, command: Command) -> None:
        """Do a command, and wait for what goes on with it.

        Raises
        ------
        UsageError
            If a field is out of its bounds, or what it names is not there. Nothing is changed then.
        CarinaError
            As what goes on with it ends: ``NoResultError`` where there is no path, and so on.
        """
        self._case.do(command)

    @check_arguments(question=instance(Question, "create one of the questions of carina.commands.questions"))
    def ask(self, question: Question[A]) -> A:
        """Answer a question of :mod:`carina.commands.questions`; nothing changes."""
        return self._session.ask(question)

    def undo(self) -> None:
        """Take back the last change; nothing where there is none."""
        self._case.do(Undo())

    def redo(self) -> None:
        """Do the last change taken back again; nothing where there is none."""
        self._case.do(Redo())

    def history(self) -> tuple[str, ...]:
        """Return the labels of the changes that can be undone, the oldest first."""
        return self._session.history()

    @check_arguments(path=file_path(optional=True), replace=flag)
    def save(self, path: str | Path | None = None, *, replace: bool = False) -> Path:
        """Write the case as one whole file, ``NAME.carina``; the CT is not in it.

        Parameters
        ----------
        path
            Where to; the case belongs there from now on. None is where it was opened from or saved before.
        replace
            Whether another file that is there already may be replaced.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        UsageError
            ``case.no-place``, ``case.exists``, or ``case.read-only`` where somebody else has that file open.
        DiskError
            If it cannot be written; what was there before stays.
        """
        return self._case.save(path, replace=replace)

    def close(self) -> None:
        """Save the case to its file, if it has one, stop all jobs, and release the memory.

        Raises
        ------
        DiskError
            If the file cannot be written; the case is closed nevertheless.
        UnsavedWorkError
            If another program has the file open, so that the changes are in no file; the case is closed nevertheless.
        """
        self._case.close()

    # ------------------------------------------------------------ looking

    @property
    def path(self) -> Path | None:
        """The file that it is saved to; None where it has none yet."""
        return self._case.path

    @property
    def note(self) -> str | None:
        """Why it cannot be saved in its place; None where it can."""
        return self._case.note

    @property
    def state(self) -> Snapshot:
        """All that was decided and is shown, but the pose; it does not change any more."""
        return self._session.snapshot()

    @property
    def volume(self) -> Volume:
        """The CT."""
        case = self._session.snapshot().case
        if case is None:
            raise UsageError("no case is open", code="session.no-case")
        return case.volume

    @property
    def airways(self) -> Airways:
        """The airways as they are now; NoResultError where none were found."""
        document = self._session.snapshot().document
        if document is None or document.airways is None:
            raise NoResultError(
                "this case has no airways: mark the trachea, or import a segmentation", code="track.no-airways"
            )
        return document.airways

    @property
    def pose(self) -> Pose:
        """Where the tip is."""
        info = self._session.pose_info()
        if info is None:
            raise UsageError("no case is open", code="session.no-case")
        return info.pose

    @check_arguments(view=text_of(80), width=pixels(), height=pixels())
    def render(self, view: str = LEAD_VIEW, *, width: int = 512, height: int = 512) -> Picture:
        """Render a picture of a view as the window shows it.

        Parameters
        ----------
        view
            Such as ``airway``, ``axial`` or ``tree``.
        width, height
            Of the picture, in pixels.

        Raises
        ------
        UsageError
            If no view is called so.
        NoResultError
            If the view needs airways or a route, and there are none.
        """
        from carina.render import view_row

        row = view_row(view)
        scene = self._session.scene()
        if scene is None:
            raise UsageError("no case is open", code="session.no-case")
        if not scene.has(row.needs):
            raise NoResultError(f"the view {view} needs {' and '.join(row.needs)}, which this case does not have yet")
        picture: Picture = scene.renderer.render(scene.spec(row.name, width, height, 0.5))
        return picture
