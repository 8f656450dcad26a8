"""Tests of the shutdown of a real workstation with a full disk: question at a terminal, exit code for lost work."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from forked_workstations import WAIT_S, Window

from cached_test_data import cached_phantom
from carina.case import CaseFile
from carina.volume import write_grid
from faulty_disk import FAULTS, FaultyDisk, has_compiler
from user_folders import environment_in

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not sys.platform.startswith("linux") or not has_compiler(), reason="needs Linux and a C compiler"
    ),
]


class Terminal:
    """Controlling side of a pseudo-terminal; a thread reads the output of the program."""

    def __init__(self):
        import pty
        import tty

        self._own, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        self._text = b""
        self._received = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        with contextlib.suppress(OSError):  # Reading fails with EIO after the program has ended.
            while data := os.read(self._own, 4096):
                with self._received:
                    self._text += data
                    self._received.notify_all()

    @property
    def text(self):
        return self._text.decode()

    def until(self, part, *, times=1):
        with self._received:
            assert self._received.wait_for(lambda: self._text.count(part.encode()) >= times, WAIT_S), self.text

    def type(self, line):
        os.write(self._own, f"{line}\n".encode())


class Station:
    """``carina open`` on a disk that becomes full, with saved and unsaved changes.

    Parameters
    ----------
    terminal
        Whether standard input and standard error are a terminal.
    """

    def __init__(self, tmp_path, disk, *, terminal):
        self.home, self.disk = tmp_path / "home", disk
        self.home.mkdir()
        volume = cached_phantom(spacing_mm=3.0, generations=3).volume
        ct = tmp_path / "SURNAME_FIRSTNAME_1951.nii.gz"
        write_grid(ct, volume.hu_zyx, volume.lps_from_ijk, what="the phantom")
        self.terminal = Terminal() if terminal else None
        own = {"stdin": self.terminal.theirs, "stderr": self.terminal.theirs} if self.terminal else {}
        self.process = subprocess.Popen(
            [sys.executable, "-c", STARTED, "open", str(ct), "--no-browser", "--json"],
            **({"stdin": subprocess.DEVNULL, "stderr": subprocess.PIPE, "stdout": subprocess.PIPE} | own),
            text=True,
            env={**environment_in(self.home), **disk.environment},
        )
        text = ""
        while not text.rstrip().endswith("}"):
            line = self.process.stdout.readline()
            assert line, "the workstation did not start"
            text += line
        result = json.loads(text)
        base = result["url"].partition("/?")[0]
        self.window = Window(f"ws{base[4:]}/ws", result["token"])
        self.window.wait_open()

    def work(self):
        """Make three changes that are saved, then five changes on a full disk."""
        self.change(3)
        live = self.live_file()
        end_s = time.monotonic() + WAIT_S
        while self.saved_steps(live) < 3:
            assert time.monotonic() < end_s
            self.window.hear(0.05)
        self.disk.begin(FAULTS["full"], 0, self.home / "data")
        self.change(5)
        return live

    def live_file(self):
        """Wait until the case is saved, and return the path of its live file."""
        self.window.until(lambda: self.window.state["saving"]["saved_s"] is not None)
        (live,) = (self.home / "data").rglob("case.carina")
        return live

    def change(self, num):
        wanted = len(self.window.history["steps"]) + num
        for _ in range(num):
            self.window.send({"type": "edit_key_frames", "edit": {"kind": "add"}})
        self.window.until(lambda: len(self.window.history["steps"]) >= wanted)

    @staticmethod
    def saved_steps(path):
        with CaseFile.open(path, read_only=True) as case:
            return len(case.history())

    def ended(self):
        """Wait for the end of the program; return its exit code, its standard output and its messages."""
        out, err = self.process.communicate(timeout=WAIT_S)
        return self.process.returncode, out, self.terminal.text if self.terminal else err

    def close(self):
        with self.process:
            self.process.kill()
        self.window.end()


# Program that restores SIGINT: a shell that runs the tests in the background ignores SIGINT for its children, a
# terminal does not.
STARTED = """
import signal

signal.signal(signal.SIGINT, signal.default_int_handler)

from carina.cli import main

main()
"""


@pytest.fixture
def disk(tmp_path):
    disk = FaultyDisk(tmp_path)
    yield disk
    disk.heal()


@pytest.fixture
def signals_of_a_terminal():
    """Restore the signal handling of a terminal; a process under nohup passes an ignored SIGHUP to children."""
    former = {
        number: signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
        for number in (signal.SIGHUP, signal.SIGINT)
    }
    yield
    for number, handler in former.items():
        signal.signal(number, handler)


@pytest.fixture
def station(tmp_path, disk, signals_of_a_terminal):
    stations = []

    def start(*, terminal):
        stations.append(Station(tmp_path, disk, terminal=terminal))
        return stations[-1]

    yield start
    for one in stations:
        one.close()


def test_ctrl_c_in_a_terminal_with_a_full_disk_saves_to_the_path_that_the_user_types(station, disk, tmp_path):
    mine = station(terminal=True)
    live = mine.work()
    stick = tmp_path / "stick"
    stick.mkdir()
    mine.process.send_signal(signal.SIGINT)
    mine.terminal.until("[r/PATH/q]")
    assert mine.process.poll() is None, "it waits"
    shown = mine.terminal.text
    for part in ("5 changes of Case ", "latest changes: ", "the disk is full", "with 3 changes", str(live)):
        assert part in shown
    assert "SURNAME" not in shown
    mine.terminal.type("r")
    mine.terminal.until("[r/PATH/q]", times=2)
    mine.terminal.type(str(stick))
    mine.terminal.until("saved as ")
    code, _, text = mine.ended()
    assert code == 0, text
    (written,) = stick.glob("*.carina")
    disk.heal()
    assert (mine.saved_steps(written), mine.saved_steps(live)) == (8, 3)


def test_second_signal_during_the_question_about_unsaved_work_ends_with_exit_code_5(station):
    mine = station(terminal=True)
    mine.work()
    mine.process.send_signal(signal.SIGTERM)
    mine.terminal.until("[r/PATH/q]")
    mine.process.send_signal(signal.SIGINT)
    code, out, text = mine.ended()
    assert code == 5, text
    assert json.loads(out)["error"]["code"] == "case.not-saved"
    assert "5 changes" in text.strip().splitlines()[-1], "the last line states the lost changes"


def test_shutdown_with_unsaved_work_and_without_a_terminal_has_exit_code_5(station):
    mine = station(terminal=False)
    live = mine.work()
    mine.process.send_signal(signal.SIGINT)
    code, out, text = mine.ended()
    assert code == 5, text
    error = json.loads(out)["error"]
    assert error["code"] == "case.not-saved"
    last = text.strip().splitlines()[-1]
    for part in ("5 changes of Case ", "could not be saved", "with 3 changes", str(live)):
        assert part in last and part in error["message"]
    assert "thumbnail" not in text and "SURNAME" not in text


def test_closed_terminal_saves_all_work_and_ends_with_exit_code_0(station):
    mine = station(terminal=True)
    mine.change(3)
    live = mine.live_file()
    mine.process.send_signal(signal.SIGHUP)
    code, out, text = mine.ended()
    assert (code, out) == (0, ""), text
    assert mine.saved_steps(live) == 3
