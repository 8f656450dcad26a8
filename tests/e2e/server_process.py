"""Real servers in child processes: ``carina`` as a person starts it, and a host of many workstations."""

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

from own_folders import own_folders

STOP_S = 120.0
"""Longer than a server needs to end, on whatever machine."""
HOST = Path(__file__).parent / "workstation_host.py"


class Child:
    """A Python program with its output as a pipe, and its log read as it comes."""

    def __init__(self, arguments: list[str], home: Path) -> None:
        own = own_folders(home)
        # What was computed is shared: it is none of the person's.
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
        self.said = threading.Condition()
        self._reader = threading.Thread(target=self._read_log, daemon=True)
        self._reader.start()

    def _read_log(self) -> None:
        for line in self._errors:
            with self.said:
                self.log.append(line.rstrip())
                self.said.notify_all()

    def wait(self) -> int:
        """Wait for its end, however it was told; kill it only if it does not leave."""
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
    """A running workstation."""

    child: Child
    url: str
    number: int = 0
    """Which one it is of its host."""
    begins: int = 0
    """First line of the log that it may have written."""
    cookies: list[dict[str, object]] = field(default_factory=list)
    """What the first page got for the token."""

    def errors(self) -> list[str]:
        """Log lines that report a fault."""
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
    """Ctrl-C, as a person would."""
    server.child.process.send_signal(signal.SIGINT)
    return server.child.wait()


class Host:
    """The process of ``workstation_host.py``: a fresh workstation costs a tenth of a new process and its search."""

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
        """A new workstation, with settings of its own."""
        begins = len(self._child.log)
        answer = self._ask({"open": {"home": str(next(self._homes)), "demo": None, "path": None, **options}})
        return Server(self._child, answer["url"], answer["number"], begins)

    def close(self, server: Server) -> None:
        """End it, and wait for the last word of its log."""
        self._ask({"close": server.number})
        last = f"workstation {server.number} is closed"
        with self._child.said:
            assert self._child.said.wait_for(lambda: last in self._child.log, STOP_S), "its log does not end"

    def end(self) -> int:
        """No more orders: the process leaves."""
        self._child.input.close()
        return self._child.wait()
