"""Real servers in child processes: ``carina`` as a user starts it, and a host of many workstations."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from user_folders import user_folders

STOP_S = 120.0
"""Upper limit for the shutdown of a server on any machine, in seconds."""
HOST = Path(__file__).parent / "workstation_host.py"


class Child:
    """Child process that runs a Python program, with a pipe for its output and a thread that reads its log."""

    def __init__(self, arguments: list[str], home: Path) -> None:
        own = user_folders(home)
        # The cache of computed data is common to all tests, and no folder of the user.
        del own["XDG_CACHE_HOME"]
        environment = {**os.environ, **own}
        self.process = subprocess.Popen(
            [sys.executable, *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        self.input, self.output, self._errors = self.process.stdin, self.process.stdout, self.process.stderr
        self.log: list[str] = []
        self.log_changed = threading.Condition()
        self._reader = threading.Thread(target=self._read_log, daemon=True)
        self._reader.start()

    def _read_log(self) -> None:
        for line in self._errors:
            with self.log_changed:
                self.log.append(line.rstrip())
                self.log_changed.notify_all()

    def wait(self) -> int:
        """Wait for the end of the process, and return its exit code; kill the process if it does not end in time."""
        try:
            code = self.process.wait(timeout=STOP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            raise
        self._reader.join(timeout=STOP_S)
        for pipe in (self.input, self.output, self._errors):
            pipe.close()
        return code


@dataclass
class Server:
    """Running workstation: process, URL and log."""

    child: Child
    url: str
    number: int = 0
    """Number of the workstation among those of its host."""
    begins: int = 0
    """Index of the first log line that this workstation may have written."""
    cookies: list[dict[str, object]] = field(default_factory=list)
    """Cookies that the first page received in exchange for the token."""

    def errors(self) -> list[str]:
        """Return the log lines that report an error."""
        log = self.child.log[self.begins :]
        return [line for line in log if "ERROR" in line or "Traceback" in line or "CRITICAL" in line]


def start_server(arguments: list[str], home: Path) -> Server:
    """Start ``carina ARGUMENTS`` on loopback and wait for its URL."""
    child = Child(["-m", "carina.cli", *arguments, "--no-browser", "--json"], home)
    text = ""
    for line in child.output:
        text += line
        try:
            return Server(child, json.loads(text)["url"])
        except json.JSONDecodeError:
            continue
    child.wait()
    raise AssertionError(f"the server ended without a URL: {child.log}")


def stop_server(server: Server) -> int:
    """Send SIGINT, as a user does with Ctrl-C, and return the exit code."""
    server.child.process.send_signal(signal.SIGINT)
    return server.child.wait()


class Host:
    """Client of the process ``workstation_host.py``, which runs many workstations."""

    def __init__(self, home: Path) -> None:
        self._homes = (home / f"config-{n}" for n in itertools.count(1))
        self._child = Child([str(HOST)], home)

    def _ask(self, order: dict[str, Any]) -> dict[str, Any]:
        self._child.input.write(json.dumps(order) + "\n")
        self._child.input.flush()
        line = self._child.output.readline()
        answer: dict[str, Any] = json.loads(line) if line else {"error": f"the host has ended: {self._child.log}"}
        assert "error" not in answer, answer["error"]
        return answer

    def open(self, **options: Any) -> Server:
        """Open a new workstation in the host, with default settings of its user."""
        begins = len(self._child.log)
        answer = self._ask({"open": {"home": str(next(self._homes)), "demo": None, "path": None, **options}})
        return Server(self._child, answer["url"], answer["number"], begins)

    def drive(self, server: Server, offset_mm: float) -> int:
        """Fly the running inspection of a workstation by a script in compressed time; return the number of poses.

        Drives with different offsets of the tip, mm, have different poses.
        """
        poses: int = self._ask({"drive": server.number, "offset_mm": offset_mm})["poses"]
        return poses

    def close(self, server: Server) -> None:
        """Close a workstation, and wait for its last log line."""
        self._ask({"close": server.number})
        last = f"workstation {server.number} is closed"
        with self._child.log_changed:
            assert self._child.log_changed.wait_for(lambda: last in self._child.log, STOP_S), "its log does not end"

    def end(self) -> int:
        """Close the input, so that the process ends, and return its exit code."""
        self._child.input.close()
        return self._child.wait()
