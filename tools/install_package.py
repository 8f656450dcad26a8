"""Install Carina in place with uv, and print each compiled crate with the time since the start of the build.

uv prints the output of a build only among its own messages (``-v``); this program selects the lines of cargo and Vite
and writes the whole output to ``build/install.log``.

Run: ``python3 tools/install_package.py UV PYTHON`` (part of ``make build`` and ``make setup``).
"""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TextIO

ROOT = Path(__file__).resolve().parent.parent
LOG = ROOT / "build" / "install.log"
"""File to which the whole output of the build is written."""
TAIL = 40
"""Number of lines of the output that are printed after a failure."""
COMPILING = re.compile(r"\bCompiling ([\w-]+) v[\w.+-]+")
"""Pattern of the line that cargo prints when it begins to compile a crate."""
WEB = re.compile(r"\bvite v[\d.]+ building\b")
"""Pattern of the line that Vite prints when it begins to build the web client."""


def num_crates() -> int | None:
    """Return the number of crates of the compiled module; None if cargo cannot list them."""
    command = ["cargo", "tree", "--locked", "-p", "carina-bindings", "--features", "extension-module"]
    command += ["-e", "normal,build", "--prefix", "none", "--format", "{p}"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    names = {line.removesuffix(" (*)") for line in ended.stdout.splitlines() if line.strip()}
    return len(names) if ended.returncode == 0 and names else None


def clock(seconds: float) -> str:
    """Return a duration in seconds as text with minutes and seconds.

    Examples
    --------
    >>> clock(134.4)
    '2:14'
    """
    return f"{int(seconds) // 60}:{int(seconds) % 60:02d}"


def show(
    lines: Iterable[str], *, total: int | None, out: TextIO, now: Callable[[], float] = time.monotonic
) -> list[str]:
    """Print a line for each crate and for the web UI as they are built; return all lines."""
    began, num, seen = now(), 0, []
    for line in lines:
        seen.append(line)
        crate = COMPILING.search(line)
        if crate is not None:
            num += 1
            of = "" if total is None else f" of at most {total}"
            print(f"  {clock(now() - began)}  compiling crate {num}{of}: {crate[1]}", file=out, flush=True)
        elif WEB.search(line):
            print(f"  {clock(now() - began)}  building the web UI", file=out, flush=True)
    return seen


def main(uv: str, python: str) -> int:
    """Install Carina and return the exit code of uv; after a failure print the end of the output."""
    command = [uv, "pip", "install", "-v", "--python", python, "--no-deps"]
    command += ["--reinstall-package", "carina", "-e", "."]
    print("Installing Carina (the whole output: build/install.log)", flush=True)
    began = time.monotonic()
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True, errors="replace",
    ) as running:  # fmt: skip
        assert running.stdout is not None
        seen = show(running.stdout, total=num_crates(), out=sys.stdout)
    LOG.parent.mkdir(exist_ok=True)
    LOG.write_text("".join(seen), encoding="utf-8")
    if running.returncode:
        print("".join(seen[-TAIL:]), end="", file=sys.stderr)
        print("Carina could not be installed; the whole output is in build/install.log", file=sys.stderr)
        return running.returncode
    print(f"Installed in {clock(time.monotonic() - began)} min", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
