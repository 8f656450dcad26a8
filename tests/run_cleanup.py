"""Cleanup at the end of a test run: no process and no temporary file remains, also after Ctrl-C.

The process that the user started gives the run a temporary folder. All its child processes inherit the folder as
``TMPDIR``, and the name of the folder marks them (``CARINA_TEST_RUN``). At the end the run kills every marked process,
then deletes the folder. The ``tmp_path`` folders of pytest, which are stored for three runs, are deleted only after an
interrupt.

Processes are found in ``/proc``; on systems other than Linux only the folder is deleted.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path
from types import FrameType

import pytest

MARK = "CARINA_TEST_RUN"
WITHIN_S = 10.0
"""Maximum time until killed processes have disappeared, seconds."""


def marked_processes(folder: str) -> dict[int, str]:
    """Return the process ID and the command line of each other process of a run."""
    mark, found = f"{MARK}={folder}\0".encode(), {}
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if int(process.name) != os.getpid() and mark in (process / "environ").read_bytes() + b"\0":
                command = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
                found[int(process.name)] = command or process.name
    return found


def kill_marked(folder: str) -> list[str]:
    """Kill every other process of a run, wait until all have ended, and return their command lines."""
    killed: dict[int, str] = {}
    end = time.monotonic() + WITHIN_S
    while (left := marked_processes(folder)) and time.monotonic() < end:
        for number in left:
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        killed |= left
        time.sleep(0.05)
    return list(killed.values())


def remove_leftover_folder(folder: Path) -> None:
    """Delete the ``tmp_path`` folders of a run and their parent folders of pytest that are then empty."""
    newest = folder.parent / "pytest-current"
    if newest.is_symlink() and newest.resolve() == folder.resolve():
        newest.unlink()
    shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):
        folder.parent.rmdir()


def run_name() -> str:
    """Return the name of this run, which marks its drafts outside its temporary folder."""
    return Path(os.environ.get(MARK, "no-run")).name


def remove_drafts(cache: Path, run: str) -> None:
    """Delete the unfinished files and folders of a run in the cache of test data."""
    for draft in list(cache.glob(f"*/*draft-{run}*")):
        shutil.rmtree(draft, ignore_errors=True)
        draft.unlink(missing_ok=True)


class Interrupts:
    """Counter of SIGINT; pytest does not call its interrupt hook if the user interrupts twice."""

    def __init__(self) -> None:
        self.num = 0
        is_main = threading.current_thread() is threading.main_thread()
        # Only the main thread can set signal handlers. A shell starts background processes with SIGINT ignored.
        if is_main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._count)

    def _count(self, number: int, frame: FrameType | None) -> None:
        self.num += 1
        signal.default_int_handler(number, frame)

    def ignore(self) -> None:
        """Ignore further interrupts of the user, so that none stops the cleanup."""
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, signal.SIG_IGN)


def clean_up(config: pytest.Config, folder: str, interrupts: Interrupts) -> None:
    """Kill the processes of a run and delete its files."""
    interrupts.ignore()
    killed = kill_marked(folder)
    shutil.rmtree(folder, ignore_errors=True)
    remove_drafts(config.rootpath / ".pytest_cache" / "d" / "made", Path(folder).name)
    if interrupts.num and config.option.basetemp is None:
        # pytest has no public attribute for this folder; xdist reads the same one.
        remove_leftover_folder(config._tmp_path_factory.getbasetemp())
    for command in [] if interrupts.num else killed:
        print(f"left running by the tests, killed: {command[:160]}", file=sys.stderr)


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Create the temporary folder of the run; workers of xdist inherit it.

    Cleanups run in reverse order. This one is added last, so that pytest's own folders still exist when it runs.
    """
    if hasattr(config, "workerinput"):
        return
    os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", tempfile.gettempdir())
    # The name is short, because Ray creates sockets below the folder, and the path of a socket has at most 107 bytes.
    folder = tempfile.mkdtemp(prefix="ct-")
    os.environ["TMPDIR"] = os.environ[MARK] = folder
    tempfile.tempdir = None
    interrupts = Interrupts()
    config.add_cleanup(lambda: clean_up(config, folder, interrupts))
