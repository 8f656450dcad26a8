"""Run ``carina info``, ``airways``, ``export`` and ``plan`` on many files, and list outcomes that violate the contract.

Usage: ``python tests/cli/contract_sweep.py [--no-slices] FOLDER...`` prints one line for each such outcome. A child
process runs the commands of a batch of files. If the child crashes, a new one continues with the next file.
"""

from __future__ import annotations

import contextlib
import io
import json
import multiprocessing
import os
import re
import shutil
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

EXIT_CODES = {0, 1, 2, 3, 4}
"""Exit codes that docs/contracts.md allows for a command that is not interrupted."""
MACHINE = {"machine.", "disk."}
"""Prefixes of the error codes with which a command may end with exit code 1; every other refusal has exit code 3."""
MAX_MESSAGE = 2000
LIMIT_S = 120.0
BATCH = 12
POINT = "0,0,0"


def inputs_in(folder: Path, *, slices: bool = True) -> list[Path]:
    """Return every file below a folder, and every folder with at least two files.

    Without ``slices``, a folder with more than three files of one suffix counts as a series, and only the first of
    these files is returned.
    """
    found: list[Path] = []
    for root, _, names in os.walk(folder):
        if len(names) > 1:
            found.append(Path(root))
        suffixes = Counter(Path(name).suffix for name in names)
        seen: set[str] = set()
        for name in sorted(names, key=os.fsencode):
            suffix = Path(name).suffix
            if slices or suffixes[suffix] <= 3 or suffix not in seen:
                found.append(Path(root) / name)
            seen.add(suffix)
    return sorted(found, key=os.fsencode)


def commands_for(path: Path, work: Path) -> list[list[str]]:
    """Return the four commands that read ``path`` as a CT, those with the shortest run time first."""
    name = os.fspath(path)
    return [
        ["info", name, "--json"],
        ["airways", name, "-o", str(work / "tree.json"), "--mask", str(work / "lumen.nii.gz"), "--json"],
        ["export", name, "-o", str(work / "lumen.stl"), "--json"],
        ["plan", name, "--target", POINT, "-o", str(work / "plan.json"), "--json"],
    ]


def as_target(path: Path, scan: Path, work: Path) -> list[list[str]]:
    """Return the commands that read ``path`` as a mask, a tree or a target of the scan."""
    name = os.fspath(path)
    return [
        ["airways", str(scan), "--from-mask", name, "--json"],
        ["plan", str(scan), "--target", name, "-o", str(work / "plan.json"), "--json"],
        ["export", str(scan), "--tree", name, "-o", str(work / "tree.vtp"), "--json"],
    ]


class TooLongError(BaseException):
    """Error for a command that exceeds the time limit."""


def run_command(arguments: list[str]) -> tuple[int, str, str]:
    """Run one command in this process and return its exit code, stdout and stderr."""
    from carina.cli import main

    def stop(_number: int, _frame: object) -> None:
        raise TooLongError

    signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    before, sys.argv = sys.argv, ["carina", *arguments]
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as end:
        return (end.code if isinstance(end.code, int) else 0), out.getvalue(), err.getvalue()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.argv = before
    return 0, out.getvalue(), err.getvalue()


def outcome_problem(code: int, out: str, err: str) -> str | None:
    """Return a description of how the outcome of a command with ``--json`` violates the contract.

    None if it does not.
    """
    if "Traceback" in err or "internal error" in err + out:
        return f"exit {code}: {err.strip()[-300:]}"
    if code not in EXIT_CODES:
        return f"exit {code} is not in docs/contracts.md"
    try:
        document: dict[str, Any] = json.loads(out)
    except ValueError:
        return f"exit {code}: stdout is not one JSON object: {out[:100]!r}"
    error = document.get("error")
    if code != 0 and error is None and code != 4:
        return f"exit {code} without an error object"
    if error is not None and code == 1 and not any(error["code"].startswith(one) for one in MACHINE):
        return f"exit 1 with {error['code']}: {error['message'][:200]}"
    if error is not None and len(error["message"]) > MAX_MESSAGE:
        return f"a message of {len(error['message'])} characters: {error['message'][:100]}"
    longest = max((len(line) for line in err.splitlines()), default=0)
    if longest > MAX_MESSAGE:
        return f"a line of {longest} characters on stderr"
    control = re.search(r"[\x00-\x08\x0b-\x1f\x7f]", err)
    return f"a control character on stderr: {control.group()!r}" if control else None


def run_batch(paths: list[Path], scan: Path | None, home: str, results: Any) -> None:
    """Run all commands on the files ``paths``, and send (file, command, problem) for each to ``results``."""
    for kind in ("CACHE", "CONFIG", "DATA", "STATE"):
        os.environ[f"XDG_{kind}_HOME"] = f"{home}/{kind.lower()}"
    os.environ["CARINA_CACHE_GB"] = "0"
    for path in paths:
        work = Path(tempfile.mkdtemp(dir=home))
        commands = commands_for(path, work) + ([] if scan is None else as_target(path, scan, work))
        for arguments in commands:
            results.put((path, "started", " ".join(arguments[:1])))
            try:
                found = outcome_problem(*run_command(arguments))
            except TooLongError:
                found = f"did not end within {LIMIT_S:g} s"
            except BaseException as error:
                found = f"raised {type(error).__name__}: {str(error)[:300]}"
            other = "" if arguments[1] == os.fspath(path) else f" {arguments[2]}"
            results.put((path, arguments[0] + other, found))
        shutil.rmtree(work, ignore_errors=True)


def problems(paths: list[Path], scan: Path | None = None) -> Iterator[str]:
    """Run all commands on all files in child processes; yield a line for each outcome that violates the contract."""
    context = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as home:
        waiting = [paths[n : n + BATCH] for n in range(0, len(paths), BATCH)]
        while waiting:
            batch = waiting.pop(0)
            results = context.SimpleQueue()
            child = context.Process(target=run_batch, args=(batch, scan, home, results))
            child.start()
            last: tuple[Path, str] | None = None
            while child.is_alive() or not results.empty():
                if results.empty():
                    child.join(0.05)
                    continue
                path, command, found = results.get()
                if command == "started":
                    last = (path, found)
                elif found is not None:
                    yield f"{os.fsencode(path).decode('utf-8', 'backslashreplace')}: carina {command}: {found}"
            child.join()
            if child.exitcode != 0 and last is not None:
                name = os.fsencode(last[0]).decode("utf-8", "backslashreplace")
                yield f"{name}: carina {last[1]}: the process ended with {child.exitcode}"
                rest = batch[batch.index(last[0]) + 1 :]
                if rest:
                    waiting.insert(0, rest)


if __name__ == "__main__":
    folders = [word for word in sys.argv[1:] if word != "--no-slices"]
    chosen = [path for one in folders for path in inputs_in(Path(one), slices="--no-slices" not in sys.argv)]
    count = 0
    for line in problems(chosen):
        print(line, flush=True)
        count += 1
    print(f"{len(chosen)} inputs, {count} wrong outcomes", flush=True)
    raise SystemExit(1 if count else 0)
