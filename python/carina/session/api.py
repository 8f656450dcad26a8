"""The public interface of a case: open a case, run and undo commands, render images."""

from __future__ import annotations

import contextlib
import warnings
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, NoReturn, TypeVar

from carina.argument_checks import check_arguments, file_path, flag, having, instance, pixels, text_of
from carina.commands import Command, Query, Redo, Undo
from carina.errors import CarinaError, NoResultError, UsageError, refuse_pickle
from carina.render import LEAD_VIEW
from carina.session.attach.remote_case import RemoteCase
from carina.session.attach.select import LocalCase, ProgramCase
from carina.session.state.snapshot import Snapshot
from carina.session.store.find_scan import is_case_file
from carina.volume import Volume

if TYPE_CHECKING:
    from carina.render import Picture
    from carina.scopes import Pose
    from carina.session.session import Session
    from carina.track import Airways

A = TypeVar("A")


class Case:
    """An open chest CT with its airways, whose changes can be undone and which can be rendered as images.

    A case runs the commands of :mod:`carina.commands`, the same commands that the window sends;
    ``help(carina.commands)`` lists them. :meth:`do` returns only after the command, including its background jobs, has
    finished.

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
        """Open a CT and find its airways, or open a case file and continue from its state.

        If a Carina window of this user has the case open, this program joins that window: the window runs the commands,
        both show every change, and the window continues to save the case. Crosshair, zoom, grey-scale window and light
        are separate for this program. When the window closes the case or its process ends, this program takes over,
        saves the case as the window did, and issues a warning.

        Otherwise only this program uses the case. A case file opens with its history, and the airways are not searched
        again. While the case file is open no other program writes to it; another program that opens the file can view
        it and save it under another name (:attr:`note` and a warning state this). Changes are written to the file by
        :meth:`save` and :meth:`close`. A case that was opened from a CT is only in memory until :meth:`save`.

        Parameters
        ----------
        source
            A file, a folder, an open volume, or a case file ``NAME.carina``.
        ct
            Path of the CT of a case file, if the CT has moved.

        Returns
        -------
        Case
            The open case.

        Raises
        ------
        VolumeImportError
            If the CT or the case file cannot be opened; the code is ``case.no-scan`` if the CT of the case is not
            found.
        """
        if not isinstance(source, str | Path | Volume):
            found = type(source).__name__
            raise UsageError(f"Case.open: source: expected str, Path or Volume; found {found}; give a folder or a file")
        if ct is not None and (isinstance(source, Volume) or not is_case_file(source)):
            raise UsageError("Case.open: ct: only applies to a case file (NAME.carina)")
        joined = None if isinstance(source, Volume) else RemoteCase.join(source, ct)
        if joined is not None:
            return cls(joined)
        own = LocalCase()
        try:
            own.open(source, ct)
        except BaseException:
            own.close()
            raise
        if own.note is not None:
            # A window may have opened the case or saved it to this file since the first attempt to join.
            with contextlib.suppress(CarinaError, OSError):
                joined = None if isinstance(source, Volume) else RemoteCase.join(source, ct)
            if joined is not None:
                own.close()
                return cls(joined)
            warnings.warn(own.note, stacklevel=2)
        return cls(own)

    def __enter__(self) -> Case:
        """Return this open case, so that a ``with`` statement closes it at its end."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the case at the end of a ``with`` statement."""
        self.close()

    def __reduce__(self) -> NoReturn:
        """Raise an error, because a case with its jobs and files cannot be pickled."""
        refuse_pickle(self, "save it, and open the file with carina.Case.open in the other process")

    def __repr__(self) -> str:
        """Return a text with the state of the airways and the number of changes, without any text of the CT."""
        snapshot = self._session.snapshot()
        if snapshot.case is None:
            return "Case(closed)"
        # The text has no file name or series text of the CT, because notebooks are shared with their output.
        return f"Case(airways {snapshot.airways}, {len(self.history())} changes)"

    # ------------------------------------------------------------ commands and undo

    @check_arguments(command=instance(Command, "create one of the commands of carina.commands"))
    def do(self, command: Command) -> None:
        """Run a command and wait for the jobs that it starts.

        Parameters
        ----------
        command
            A command of :mod:`carina.commands`.

        Raises
        ------
        UsageError
            If a field is out of its bounds, or the command names an object that does not exist. The case is unchanged
            then.
        CarinaError
            If a job of the command fails, such as ``NoResultError`` where there is no path.
        """
        self._case.do(command)

    @check_arguments(question=instance(Query, "create one of the questions of carina.commands.questions"))
    def ask(self, question: Query[A]) -> A:
        """Answer a question of :mod:`carina.commands.questions` without changing the case."""
        return self._session.ask(question)

    def undo(self) -> None:
        """Undo the last change; do nothing if there is none."""
        self._case.do(Undo())

    def redo(self) -> None:
        """Redo the last change that was undone; do nothing if there is none."""
        self._case.do(Redo())

    def history(self) -> tuple[str, ...]:
        """Return the labels of the changes that can be undone, the oldest first."""
        return self._session.history()

    @check_arguments(path=file_path(optional=True), replace=flag)
    def save(self, path: str | Path | None = None, *, replace: bool = False) -> Path:
        """Write the case to one file, ``NAME.carina``; the file does not contain the CT.

        Parameters
        ----------
        path
            Path of the new case file, which later saves also use. None selects the file from which the case was opened
            or to
            which it was last saved.
        replace
            Whether to replace another file that exists at ``path``.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        UsageError
            ``case.no-place`` if the case has no file and ``path`` is None; ``case.exists`` if another file exists at
            ``path``; ``case.read-only`` if another program has that file open.
        DiskError
            If the file cannot be written; an existing file is then unchanged.
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

    # ------------------------------------------------------------ state and images

    @property
    def path(self) -> Path | None:
        """Path of the case file; None if the case has no file yet."""
        return self._case.path

    @property
    def note(self) -> str | None:
        """Reason why the case cannot be saved to the file from which it was opened; None if it can."""
        return self._case.note

    @property
    def state(self) -> Snapshot:
        """An immutable copy of the current state of the case, without the pose."""
        return self._session.snapshot()

    @property
    def volume(self) -> Volume:
        """The CT of the case; UsageError if the case is closed."""
        case = self._session.snapshot().case
        if case is None:
            raise UsageError("no case is open", code="session.no-case")
        return case.volume

    @property
    def airways(self) -> Airways:
        """The current airways; NoResultError if none were found."""
        document = self._session.snapshot().document
        if document is None or document.airways is None:
            raise NoResultError(
                "this case has no airways: mark the trachea, or import a segmentation", code="track.no-airways"
            )
        return document.airways

    @property
    def pose(self) -> Pose:
        """Pose of the scope tip, in LPS and mm; UsageError if the case is closed."""
        info = self._session.pose_info()
        if info is None:
            raise UsageError("no case is open", code="session.no-case")
        return info.pose

    @check_arguments(view=text_of(80), width=pixels(), height=pixels())
    def render(self, view: str = LEAD_VIEW, *, width: int = 512, height: int = 512) -> Picture:
        """Render an image of a view with the settings of the case.

        Parameters
        ----------
        view
            Name of the view, such as ``airway``, ``axial`` or ``tree``.
        width, height
            Size of the image, in pixels.

        Returns
        -------
        Picture
            The rendered image.

        Raises
        ------
        UsageError
            If no view has this name.
        NoResultError
            If the view needs airways or a route, and the case has none.
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
