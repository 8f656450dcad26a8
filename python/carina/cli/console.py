"""Output and end of a command: JSON or text on stdout, progress on stderr, exit codes."""

from __future__ import annotations

import io
import json
import logging
import math
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn, TypeVar

from carina.disk import disk_trouble, is_disk_trouble
from carina.display.escaped_text import printable, shortened_words
from carina.display.terminal import as_line, as_terminal_text, escaped_json
from carina.errors import CancelledError, CarinaError

Result = TypeVar("Result")
ProgressCallback = Callable[[str, float | None], None]


def print_note(text: str) -> None:
    """Print one line on stderr (progress or a note), without control characters or line breaks of file names."""
    print(printable(as_terminal_text(text)), file=sys.stderr, flush=True)


def print_result(*lines: object, flush: bool = False) -> None:
    """Print result lines on stdout; the content of files cannot add control characters or line breaks."""
    print("\n".join(as_line(str(line)) for line in lines), flush=flush)


def print_usage_error(error: Any) -> None:
    """Print an error of the argument parser with its usage line on stderr, without control characters of file names."""
    text = io.StringIO()
    error.show(file=text)
    for line in shortened_words(text.getvalue().rstrip()).splitlines():
        print_note(line)


class _LogFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        return as_terminal_text(super().format(record))


def log_to_terminal(level: str) -> None:
    """Print the log on stderr, without control characters."""
    handler = logging.StreamHandler()
    handler.setFormatter(_LogFormatter("%(levelname)s %(name)s: %(message)s"))
    logging.basicConfig(level=level, handlers=[handler])


def accept_any_text() -> None:
    """Let stdout and stderr escape characters that their encoding lacks, as in file names that are not UTF-8."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def print_json(payload: dict[str, Any]) -> None:
    """Print one JSON object on stdout; NaN and infinities are refused, so that every parser can read the object."""
    print(escaped_json(json.dumps(payload, allow_nan=False, ensure_ascii=False, indent=2)), flush=True)


def progress_printer() -> ProgressCallback:
    """Return a callback that shows progress and time left: a live line on a terminal, else a line per task."""
    live = sys.stderr.isatty()
    state: dict[str, Any] = {"what": None, "start": 0.0, "shown": 0.0, "open": False}

    def print_result(what: str, fraction: float | None) -> None:
        now = time.monotonic()
        if what != state["what"]:
            if state["open"]:
                print(file=sys.stderr)
            state.update(what=what, start=now, shown=0.0, open=False)
            if not live:
                print_note(what)
        if not live or now - state["shown"] < 0.1:
            return
        text = as_line(what)
        if fraction is not None and 0.02 < fraction < 1.0:
            left_s = math.ceil((now - state["start"]) * (1.0 - fraction) / fraction)
            text += f" {100 * fraction:3.0f} %, {left_s} s left"
        print(f"\r\x1b[2K{text}", end="", file=sys.stderr, flush=True)
        state.update(shown=now, open=True)

    return print_result


def interruptible(work: Callable[[], Result]) -> Result:
    """Run a function that cannot be cancelled (one image may take minutes) so that Ctrl-C still works at once.

    The function runs in a daemon thread, which ends with the process, and therefore must not write any files.
    """
    results: list[Result] = []
    troubles: list[BaseException] = []

    def run() -> None:
        try:
            results.append(work())
        except BaseException as error:
            troubles.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    while thread.is_alive():
        # On Windows, Ctrl-C is handled only between waits.
        thread.join(0.2)
    if troubles:
        raise troubles[0]
    return results[0]


NO_THREAD = "can't start new thread"
"""Message of Python's RuntimeError where memory for the stack of a thread is missing."""


@contextmanager
def exit_codes(as_json: bool) -> Iterator[None]:
    """Convert the result or exception of a command into its exit code (docs/contracts.md) and one message.

    With ``--json``, a failure is also printed on stdout, as one object: ``{"error": {"code", "message"}}``.
    """
    try:
        yield
    except BrokenPipeError:
        # The reader of stdout has closed the pipe (``carina info x | head``); this is not an error.
        _drop_stdout()
        raise SystemExit(0) from None
    except (KeyboardInterrupt, CancelledError):
        print_note("stopped")
        end_with_error(as_json, CancelledError.code, "stopped", CancelledError.exit_code)
    except CarinaError as error:
        logging.getLogger("carina").debug("command failed", exc_info=True)
        print_note(f"carina: {error}")
        end_with_error(as_json, error.code, str(error), error.exit_code)
    except OSError as error:
        if is_disk_trouble(error):
            doing = "cannot read or write" if error.filename else "cannot read or write a file"
            disk_error = disk_trouble(error, doing, error.filename)
            print_note(f"carina: {disk_error}")
            end_with_error(as_json, disk_error.code, str(disk_error), disk_error.exit_code)
        message = f"{error.strerror or error}: {error.filename}" if error.filename else str(error)
        print_note(f"carina: {message}")
        end_with_error(as_json, "machine", message, 1)
    except SystemExit:
        raise
    except BaseException as error:
        # BaseException, because a Rust panic in the compiled module is not an Exception.
        logging.getLogger("carina").debug("command failed", exc_info=True)
        if isinstance(error, MemoryError) or (isinstance(error, RuntimeError) and str(error) == NO_THREAD):
            message = "not enough memory; close other programs, or use a smaller volume or image"
            print_note(f"carina: {message}")
            end_with_error(as_json, "machine.memory", message, 1)
        message = (
            f"internal error in Carina ({type(error).__name__}: {error}); please report it "
            "(CARINA_LOG_LEVEL=DEBUG shows where it occurred)"
        )
        print_note(f"carina: {message}")
        end_with_error(as_json, "carina.fault", message, 1)


def end_with_error(as_json: bool, code: str, message: str, exit_code: int) -> NoReturn:
    """End the command with this exit code; with ``--json``, print the failure as one object on stdout."""
    if as_json:
        try:
            print_json({"error": {"code": code, "message": message}})
        except OSError:
            # Writing to stdout failed (full disk, closed pipe); the message is on stderr.
            _drop_stdout()
    raise SystemExit(exit_code) from None


def _drop_stdout() -> None:
    """Redirect stdout to the null device: Python would otherwise fail again at exit, on the buffered output."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
