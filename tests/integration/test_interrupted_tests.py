"""Tests of Ctrl-C during the tests or CI, sent as a terminal sends it: no process and no file remains."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import run_cleanup

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="processes are found in /proc")
ROOT = Path(__file__).resolve().parents[2]
WITHIN_S = 120.0
ENDING_S = 10.0
"""Maximum time until killed processes have disappeared, seconds."""
TESTS = '''
import subprocess, sys, tempfile, time
from pathlib import Path
import pytest
from run_cleanup import run_name

SLEEP = "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print(flush=True); time.sleep(600)"

@pytest.mark.parametrize("n", range(2))
def test_runs_until_it_is_interrupted(n, tmp_path):
    """With a file in each place, and a process that has left the terminal and ignores its signals."""
    Path(tempfile.mkdtemp(), "file").write_text("x")
    draft = Path(CACHE, f"digest/draft-{run_name()}-{n}")
    draft.mkdir(parents=True)
    Path(draft, "file").write_text("x")
    Path(CACHE, f"digest/airways-{n}.draft-{run_name()}").write_text("x")
    (tmp_path / "file").write_text("x")
    process = subprocess.Popen([sys.executable, "-c", SLEEP], stdout=subprocess.PIPE, start_new_session=True)
    process.stdout.readline()
    Path(READY, str(n)).touch()
    time.sleep(600)
'''


START = "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_DFL); os.execvp(sys.argv[1], sys.argv[1:])"
"""Program that restores SIGINT and then runs a command; a shell starts background processes with SIGINT ignored."""


def wait_for(state: Callable[[], bool], what: str) -> None:
    end = time.monotonic() + WITHIN_S
    while not state():
        assert time.monotonic() < end, what
        time.sleep(0.05)


@pytest.mark.parametrize("interrupts", [1, 3])
@pytest.mark.parametrize("options", [["-n", "2"], ["-p", "no:xdist"]], ids=["workers", "one process"])
def test_interrupted_test_run_leaves_no_process_and_no_file(tmp_path, options, interrupts):
    tests, ready, temporary = (tmp_path / name for name in ("tests", "ready", "tmp"))
    for folder in (tests, ready, temporary):
        folder.mkdir()
    (tests / "conftest.py").write_text("from run_cleanup import pytest_configure\n")
    mark = f"interrupted {tmp_path}"
    cache = tests / ".pytest_cache" / "d" / "made"
    (tests / "test_it.py").write_text(f"READY = {str(ready)!r}\nCACHE = {str(cache)!r}\n{TESTS}")
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    environment |= {"TMPDIR": str(temporary), "OWN_MARK": mark, "PYTHONPATH": str(Path(run_cleanup.__file__).parent)}
    command = [sys.executable, "-m", "pytest", "-q", "-c", os.devnull, "--rootdir", str(tests), *options, str(tests)]
    interrupt(command, environment, tests, lambda: any(ready.iterdir()), times=interrupts)
    assert [path for path in temporary.rglob("*") if not path.is_dir()] == []
    assert list(temporary.iterdir()) == []
    assert list(cache.glob("digest/*")) == []


@pytest.fixture
def ci(tmp_path):
    """Return a function that writes replacements of CI's commands and returns an environment for them without apt."""
    commands, temporary = tmp_path / "bin", tmp_path / "tmp"
    commands.mkdir()
    temporary.mkdir()
    for name in ("bash", "cat", "dirname", "env", "grep", "id", "mktemp", "nice", "rm", "sh", "sleep", "tee", "touch"):
        (commands / name).symlink_to(shutil.which(name) or "")

    def environment(make: str) -> dict[str, str]:
        for name in ("python3", "cargo", "node", "npm", "make"):
            (commands / name).write_text(
                f'#!/bin/sh\ncase "$*" in\n{make}\nesac\n' if name == "make" else "#!/bin/sh\n"
            )
            (commands / name).chmod(0o755)
        return {"PATH": str(commands), "TMPDIR": str(temporary), "OWN_MARK": f"interrupted {tmp_path}"}

    return environment


def test_interrupted_ci_run_leaves_no_process_and_no_file(ci, tmp_path):
    ready = tmp_path / "ready"
    environment = ci(f"*test-rust*) touch {ready}; sleep 600 & wait ;;\n*test-python*) sleep 600 ;;")
    interrupt([str(ROOT / ".ci" / "run")], environment, tmp_path, ready.exists)
    assert list((tmp_path / "tmp").iterdir()) == []


@pytest.mark.parametrize(
    ("make", "code", "end"),
    [
        ("*) echo ran ;;", 0, "ran"),
        ("*docs*) exit 2 ;;", 1, "CI failed: check-python, docs or test-rust"),
        ("*test-python*) exit 2 ;;", 1, "CI failed: test-python"),
        ("*setup-tests*) exit 2 ;;", 1, "CI failed: setup, lints or web"),
    ],
)
def test_ci_script_prints_the_name_of_the_failed_step(ci, tmp_path, make, code, end):
    ended = subprocess.run(
        [ROOT / ".ci" / "run"], env=ci(make), capture_output=True, text=True, check=False, timeout=WITHIN_S
    )
    assert (ended.returncode, ended.stdout.splitlines()[-1:]) == (code, [end])
    assert list((tmp_path / "tmp").iterdir()) == []


def interrupt(
    command: list[str], environment: dict[str, str], folder: Path, started: Callable[[], bool], *, times: int = 1
) -> None:
    """Start a command, send SIGINT to its process group, and assert that none of its processes remains."""
    output = folder / "output"
    with output.open("w") as file:
        run = subprocess.Popen(
            [sys.executable, "-c", START, *command], cwd=folder, env=environment, stdout=file, stderr=file,
            start_new_session=True,
        )  # fmt: skip
        try:
            wait_for(lambda: started() or run.poll() is not None, "nothing has started")
            assert run.poll() is None, output.read_text()
            for n in range(times):
                os.killpg(run.pid, signal.SIGINT)
                if n + 1 < times:
                    time.sleep(0.2)  # The user presses Ctrl-C again.
            run.wait(WITHIN_S)
        finally:
            left = marked(environment["OWN_MARK"])
            end = time.monotonic() + ENDING_S
            while left and time.monotonic() < end:
                time.sleep(0.05)
                left = marked(environment["OWN_MARK"])
            for number in left:
                os.kill(number, signal.SIGKILL)
    assert run.returncode != 0
    assert not left


def marked(mark: str) -> dict[int, str]:
    """Return process ID and command line of each process of a run."""
    found = {}
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if f"OWN_MARK={mark}\0".encode() in (process / "environ").read_bytes() + b"\0":
                found[int(process.name)] = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode()
    return found
