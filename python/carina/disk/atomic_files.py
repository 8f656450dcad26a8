"""Atomic file writes: content goes to a draft file beside the target, and the complete draft replaces the target.

A draft is called ``.carina-HEX.draft``; the name shows that Carina created the file and reveals nothing about its
content. The process that writes a draft holds a lock on it (``locks.py``). A crash leaves a draft without a lock; the
next process of Carina that writes a file into the same folder deletes such drafts.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import stat
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from carina.disk.disk_errors import disk_trouble
from carina.disk.locks import try_lock
from carina.display import as_words
from carina.errors import CarinaError

Placement = Callable[[Path, Path], None]
"""``placement(draft, target)`` moves a complete draft to its target, or raises and leaves the target unchanged."""
DRAFT = re.compile(r"\.carina-[0-9a-f]{16}\.draft")
SWEEP_AGAIN_S = 60.0
"""Minimum time in s between two deletions of old drafts in one folder; a flight writes thousands of pictures there."""
UNKNOWN_AFTER_S = 86_400.0
"""Age in s from which a draft (unfinished file) counts as abandoned if the state of its lock is unknown.

The age decides on file systems without locks, and on Windows, where a draft has no lock shortly before its renaming.
"""
_swept: dict[str, float] = {}
_sweeping = threading.Lock()


def write_whole(
    path: Path | str,
    content: bytes,
    *,
    what: str,
    private: bool = False,
    lasting: bool = False,
    placement: Placement | None = None,
) -> Path:
    """Write a file so that it is either complete or unchanged.

    Parameters
    ----------
    path
        The file, in an existing folder.
    content
        The whole content.
    what
        Name of the file for messages, such as "the tree".
    private
        Whether only the user may read the file.
    lasting
        Flush the folder as well, so that the file survives a power cut after the call.
    placement
        Moves the complete draft to ``path``; None replaces any file at ``path``.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    DiskError
        If the folder is missing or not writable, the disk is full, or ``path`` is not a regular file; a former file
        stays unchanged.
    CarinaError
        If ``placement`` refuses the move; a former file stays unchanged.
    """
    with drafted(
        path, what=what, needed_bytes=len(content), private=private, lasting=lasting, placement=placement
    ) as file:
        file.write(content)
    return Path(path)


class Draft:
    """A file that is written beside its target until :meth:`commit` or :meth:`discard` is called.

    Parameters
    ----------
    path, what, private, needed_bytes, lasting, placement
        As in :func:`drafted`.

    Raises
    ------
    DiskError
        If the draft cannot be created.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        what: str,
        needed_bytes: int | None = None,
        private: bool = False,
        lasting: bool = False,
        placement: Placement | None = None,
    ) -> None:
        self._target = Path(path)
        self._lasting = lasting
        self._placement = placement
        self._what = what
        self._needed_bytes = needed_bytes
        self._place: Path | None = None
        try:
            former = _former_status(self._target)
            sweep_drafts(self._target.parent)
            self.file, self._place = _create_draft(self._target.parent, 0o600 if private else 0o666)
            if former is not None and not private and os.name == "posix":
                # The replaced file may be readable by its user only, so the new file gets the same mode.
                os.fchmod(self.file.fileno(), stat.S_IMODE(former.st_mode))
        except OSError as error:
            if self._place is not None:
                self.discard()
            raise self.disk_error(error) from error

    def __repr__(self) -> str:
        """Return the target and the name of the file for messages."""
        return f"Draft({as_words(str(self._target))}, what={as_words(self._what)})"

    def commit(self) -> None:
        """Move the complete draft to its target and flush it to the disk.

        Raises
        ------
        DiskError
            If the disk refuses the move; a former file stays unchanged.
        CarinaError
            If the placement refuses the move; a former file stays unchanged.
        """
        assert self._place is not None
        try:
            self.file.flush()
            os.fsync(self.file.fileno())
            if os.name == "nt":  # pragma: no cover
                self.file.close()  # Windows cannot rename an open file
            if self._placement is None:
                self._place.replace(self._target)
            else:
                self._placement(self._place, self._target)
            self._place = None
            if self._lasting:
                sync_folder(self._target.parent)
        except OSError as error:
            self.discard()
            raise self.disk_error(error) from error
        finally:
            if self._place is None:
                self.file.close()

    def discard(self) -> None:
        """Delete the draft; a call after :meth:`commit` or :meth:`discard` does nothing."""
        place, self._place = self._place, None
        if place is None:
            return
        if os.name == "posix":
            # Unlink the file before closing it, so that closing can flush its buffer even if the disk is full.
            with contextlib.suppress(OSError):
                place.unlink()
        with contextlib.suppress(OSError):
            self.file.close()
        if os.name != "posix":  # pragma: no cover
            with contextlib.suppress(OSError):
                place.unlink()

    def disk_error(self, error: OSError) -> CarinaError:
        """Return the error for the user after a failed write; Carina's own errors are returned as they are."""
        if isinstance(error, CarinaError):
            return error
        unchanged = ""
        with contextlib.suppress(OSError):  # is_file raises an error for a name that is too long
            unchanged = "the existing file is unchanged" if self._target.is_file() else ""
        if error.errno == errno.ENOENT and self._target.parent.is_dir():
            unchanged = "another program removed its temporary file; try again"
        doing = f"cannot write {self._what} to"
        return disk_trouble(error, doing, self._target, needed_bytes=self._needed_bytes, unchanged=unchanged)


@contextlib.contextmanager
def drafted(
    path: Path | str,
    *,
    what: str,
    needed_bytes: int | None = None,
    private: bool = False,
    lasting: bool = False,
    placement: Placement | None = None,
) -> Iterator[BinaryIO]:
    """Open a file for writing that replaces the target when the block ends; after an error the former file stays.

    Parameters
    ----------
    path, what, private, lasting, placement
        As in :func:`write_whole`.
    needed_bytes
        Number of bytes that will be written, if known, for the message.

    Yields
    ------
    BinaryIO
        The draft, open for writing.

    Raises
    ------
    DiskError
        As in :func:`write_whole`; an ``OSError`` raised in the block counts as an error of the disk.
    """
    draft = Draft(path, what=what, needed_bytes=needed_bytes, private=private, lasting=lasting, placement=placement)
    try:
        yield draft.file
        draft.commit()
    except OSError as error:
        draft.discard()
        raise draft.disk_error(error) from error
    except BaseException:
        draft.discard()
        raise


def make_folder(path: os.PathLike[str] | str, *, what: str, private: bool = False, lasting: bool = False) -> Path:
    """Create a folder and its missing parent folders; an existing folder stays unchanged.

    Parameters
    ----------
    path, what
        As in :func:`write_whole`.
    private
        Create the folder, and every missing parent folder, with mode 0700.
    lasting
        Flush the parents of the new folders, so that all new folders survive a power cut after the call.

    Raises
    ------
    DiskError
        If a folder cannot be created.
    """
    folder = Path(path)
    try:
        made = create_folders(folder, private=private)
        for one in made if lasting else ():
            sync_folder(one.parent)
    except OSError as error:
        raise disk_trouble(error, f"cannot create the folder for {what} at", folder) from error
    return folder


def create_folders(folder: Path, *, private: bool) -> tuple[Path, ...]:
    """Create a folder and its missing parent folders, and return the created folders, the innermost first.

    All private folders get mode 0700. ``Path.mkdir(mode=0o700, parents=True)`` gives that mode only to the innermost
    folder.

    Parameters
    ----------
    folder
        The folder to create.
    private
        Create every folder with mode 0700, and not with the default mode.

    Raises
    ------
    OSError
        If a folder cannot be created.
    """
    missing = tuple(one for one in (folder, *folder.parents) if not one.exists())
    for one in reversed(missing):
        one.mkdir(exist_ok=True, mode=0o700 if private else 0o777)
    # mkdir raises an error here if a file has the name of the folder.
    folder.mkdir(exist_ok=True)
    return missing


def sync_folder(folder: Path | str) -> None:
    """Flush the directory entries of a folder to the disk.

    The function does nothing on Windows, and ignores file systems that do not support fsync on a folder.

    Raises
    ------
    OSError
        If the disk fails.
    """
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY | getattr(os, "O_DIRECTORY", 0))
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in {errno.EINVAL, errno.ENOTSUP, errno.EBADF, errno.EACCES}:
            raise
    finally:
        os.close(descriptor)


def _former_status(target: Path) -> os.stat_result | None:
    """Return the status of the file that a new file will replace; None if no file has the target's name.

    Raises
    ------
    OSError
        If the target is a folder, a device, or another object that a file must not replace.
    """
    try:
        found = target.stat()
    except FileNotFoundError:
        return None
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(found.st_mode):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
    return found


def _create_draft(folder: Path, mode: int) -> tuple[BinaryIO, Path]:
    """Create a draft that only this process writes; return the open file and its path."""
    while True:
        place = folder / f".carina-{secrets.token_hex(8)}.draft"
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
        descriptor = os.open(place, flags, mode)
        # A sweep by another process may delete the draft before the lock is taken; then create another draft.
        if try_lock(descriptor) is not False and _has_same_inode(place, descriptor):
            return os.fdopen(descriptor, "w+b"), place
        os.close(descriptor)
        with contextlib.suppress(OSError):
            place.unlink()


def _has_same_inode(place: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(place.lstat(), os.fstat(descriptor))
    except OSError:
        return False


def sweep_drafts(folder: Path, *, now_s: float | None = None) -> int:
    """Delete the drafts (unfinished files) in a folder that a crash has left, and return their number.

    Drafts that a process still writes stay. Errors of the disk are ignored. A folder is swept at most once in
    :data:`SWEEP_AGAIN_S`, unless ``now_s`` is given.

    Parameters
    ----------
    folder
        The folder to search.
    now_s
        Current time in seconds since 1970, for tests.
    """
    with _sweeping:
        key = str(Path(folder).absolute())
        moment_s = time.monotonic()
        if now_s is None and moment_s - _swept.get(key, -SWEEP_AGAIN_S) < SWEEP_AGAIN_S:
            return 0
        if len(_swept) > 1000:
            _swept.clear()
        _swept[key] = moment_s
    try:
        with os.scandir(folder) as entries:
            found = [Path(entry.path) for entry in entries if DRAFT.fullmatch(entry.name)]
    except OSError:
        return 0
    return sum(_sweep_draft(place, time.time() if now_s is None else now_s) for place in found)


def _sweep_draft(place: Path, now_s: float) -> bool:
    """Delete a draft whose owner has ended; return whether the draft was deleted."""
    flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        # Check the type before opening: a pipe or a link of this name is not a draft of Carina.
        if not stat.S_ISREG(place.lstat().st_mode):
            return False
        descriptor = os.open(place, flags)
    except OSError:
        return False
    try:
        held = try_lock(descriptor)
        seen = os.fstat(descriptor)
        mine = not hasattr(os, "geteuid") or seen.st_uid == os.geteuid()
        certain = held is True and os.name != "nt"
        if not mine or held is False or not (certain or now_s - seen.st_mtime > UNKNOWN_AFTER_S):
            return False
        if os.name != "nt":
            place.unlink()
            return True
    except OSError:
        return False
    finally:
        os.close(descriptor)
    with contextlib.suppress(OSError):  # pragma: no cover
        place.unlink()  # Windows cannot delete an open file
        return True
    return False  # pragma: no cover
