"""A real server as a child process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path

STOP_S = 120.0
"""Longer than a server needs to end, on whatever machine."""


@dataclass
class Server:
    """A running ``carina`` process."""

    process: subprocess.Popen[str]
    reader: threading.Thread
    url: str
    log: list[str] = field(default_factory=list)
    cookies: list[dict[str, object]] = field(default_factory=list)
    """What the first page got for the token."""

    def errors(self) -> list[str]:
        """Log lines that report a fault."""
        return [line for line in self.log if "ERROR" in line or "Traceback" in line or "CRITICAL" in line]


def start_server(arguments: list[str], home: Path, *, program: tuple[str, ...] = ("-m", "carina.cli")) -> Server:
    """Start ``carina ARGUMENTS`` on loopback and wait for its URL; ``program`` is what Python runs."""
    environment = {**os.environ, "XDG_CONFIG_HOME": str(home / "config"), "XDG_STATE_HOME": str(home / "state")}
    process = subprocess.Popen(
        [sys.executable, *program, *arguments, "--no-browser", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    log: list[str] = []
    errors = process.stderr

    def read_log() -> None:
        for line in errors:
            log.append(line.rstrip())

    reader = threading.Thread(target=read_log, daemon=True)
    reader.start()
    text = ""
    for line in process.stdout:
        text += line
        try:
            return Server(process, reader, json.loads(text)["url"], log)
        except json.JSONDecodeError:
            continue
    process.wait(timeout=STOP_S)
    raise AssertionError(f"the server ended without a URL: {log}")


def stop_server(server: Server) -> int:
    """Ctrl-C, as a person would; kill it only if it does not leave."""
    server.process.send_signal(signal.SIGINT)
    try:
        code = server.process.wait(timeout=STOP_S)
    except subprocess.TimeoutExpired:
        server.process.kill()
        server.process.wait()
        raise
    server.reader.join(timeout=STOP_S)
    for pipe in (server.process.stdout, server.process.stderr):
        assert pipe is not None
        pipe.close()
    return code
