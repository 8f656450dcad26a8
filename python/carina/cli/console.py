"""What a command prints and how it ends: JSON or words on stdout, progress on stderr, exit codes."""

from __future__ import annotations

import json
import logging
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from carina.errors import CancelledError, CarinaError

__all__ = ["exit_codes", "print_json", "progress_printer", "say"]

ProgressCallback = Callable[[str, float | None], None]


def say(text: str) -> None:
    """A line of progress or a remark, on stderr."""
    print(text, file=sys.stderr, flush=True)


def print_json(payload: dict[str, Any]) -> None:
    """One JSON object on stdout; NaN and infinities are refused, so every reader can parse it."""
    print(json.dumps(payload, allow_nan=False, ensure_ascii=False, indent=2), flush=True)


def progress_printer() -> ProgressCallback:
    """A callback that shows what is done and the time left: a live line on a terminal, else a line per task."""
    live = sys.stderr.isatty()
    state: dict[str, Any] = {"what": None, "start": 0.0, "shown": 0.0, "open": False}

    def show(what: str, fraction: float | None) -> None:
        now = time.monotonic()
        if what != state["what"]:
            if state["open"]:
                print(file=sys.stderr)
            state.update(what=what, start=now, shown=0.0, open=False)
            if not live:
                say(what)
        if not live or now - state["shown"] < 0.1:
            return
        text = what
        if fraction is not None and 0.02 < fraction < 1.0:
            left_s = math.ceil((now - state["start"]) * (1.0 - fraction) / fraction)
            text += f" {100 * fraction:3.0f} %, {left_s} s left"
        print(f"\r\x1b[2K{text}", end="", file=sys.stderr, flush=True)
        state.update(shown=now, open=True)

    return show


@contextmanager
def exit_codes(as_json: bool) -> Iterator[None]:
    """Turn every end of a command into its exit code (DESIGN section 3) and one clear message.

    With ``--json`` a failure is one object on stdout as well: ``{"error": {"code", "message"}}``.
    """
    try:
        yield
    except BrokenPipeError:
        # The reader of our output went away (``carina info x | head``): no fault, and nothing left to say.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(0) from None
    except (KeyboardInterrupt, CancelledError):
        say("stopped")
        raise SystemExit(130) from None
    except CarinaError as error:
        logging.getLogger("carina").debug("command failed", exc_info=True)
        if as_json:
            print_json({"error": {"code": error.code, "message": str(error)}})
        say(f"carina: {error}")
        raise SystemExit(error.exit_code) from None
    except OSError as error:
        message = f"{error.strerror or error}: {error.filename}" if error.filename else str(error)
        if as_json:
            print_json({"error": {"code": "machine", "message": message}})
        say(f"carina: {message}")
        raise SystemExit(1) from None
