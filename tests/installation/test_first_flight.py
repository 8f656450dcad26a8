"""Test of the way from a wheel file to the first flight: two commands of a user without root and without compilers.

The test prints the time of each part: installation, start, first picture, flight. Run: ``make wheels test-wheels``.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_wheels import WAIT_S, wheel_of
from workstation import FLAGS, Workstation

from find_browser import find_browser

sync_api = pytest.importorskip("playwright.sync_api")

pytestmark = pytest.mark.soak

ROOT = Path(__file__).resolve().parents[2]
NOBODY = 65534
SYSTEM_PYTHON = Path("/usr/bin/python3")
OPEN = "/var/tmp"
"""Folder that every user of the machine can read, unlike the temporary folders of the tests."""
NETWORK = re.compile(
    r"SSL_CERT_(FILE|DIR)|(https?|no|all)_proxy|UV_(NATIVE_TLS|SYSTEM_CERTS|DEFAULT_INDEX|INDEX_URL)", re.IGNORECASE
)
FIRST_PICTURE = """() => [...document.querySelectorAll('canvas[data-view]')]
    .some((canvas) => canvas.offsetParent && canvas.dataset.frameId)"""


# The user of the commands is not root, even where the test itself runs as root.
USER: dict[str, Any] = {"user": NOBODY, "group": NOBODY, "extra_groups": []} if os.geteuid() == 0 else {}


@pytest.fixture
def home() -> Iterator[Path]:
    """Return a new folder that belongs to the user, with a copy of uv and nothing else in its search path."""
    folder = Path(tempfile.mkdtemp(prefix="carina-user-", dir=OPEN))
    programs = folder / "programs"
    programs.mkdir()
    shutil.copy(shutil.which("uv") or ROOT / ".uv" / "bin" / "uv", programs / "uv")
    if os.geteuid() == 0:
        for path in (folder, programs, programs / "uv"):
            os.chown(path, NOBODY, NOBODY)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """Return a folder with the wheel and the wheels of all packages that it needs."""
    if not SYSTEM_PYTHON.exists():
        pytest.skip(f"no {SYSTEM_PYTHON}: a user without root cannot read this test's own Python")
    folder = Path(tempfile.mkdtemp(prefix="carina-files-", dir=OPEN))
    folder.chmod(0o755)
    environment = tmp_path_factory.mktemp("downloader")
    subprocess.run([SYSTEM_PYTHON, "-m", "venv", environment], check=True, timeout=WAIT_S)
    download = [environment / "bin" / "python", "-m", "pip", "download", "-q", "-d", folder, wheel_of("x86_64")]
    subprocess.run([*download, "--disable-pip-version-check"], check=True, timeout=WAIT_S)
    yield folder
    shutil.rmtree(folder)


@pytest.mark.parametrize("source", ["local wheel files", "downloads"])
def test_two_commands_lead_from_the_wheel_file_to_the_first_flight(files, home, source):
    environment = {
        "PATH": str(home / "programs"),
        "HOME": str(home),
        "LANG": "C.UTF-8",
        "UV_TOOL_DIR": str(home / "tools"),
        "UV_TOOL_BIN_DIR": str(home / "programs"),
        "UV_PYTHON_DOWNLOADS": "never",
    }
    # Settings of this machine for the connection to the package index.
    environment |= {name: value for name, value in os.environ.items() if NETWORK.fullmatch(name)}
    assert not [name for name in ("cargo", "rustc", "node", "cc", "gcc") if shutil.which(name, path=str(home))]
    [wheel] = files.glob("carina-*.whl")
    offline = ["--offline", "--no-index", "--find-links", files] if source == "local wheel files" else []
    times: dict[str, float] = {}
    began = time.monotonic()

    # The first command.
    install = [home / "programs" / "uv", "tool", "install", "-q", "--python", SYSTEM_PYTHON, *offline, wheel]
    options: dict[str, Any] = {"env": environment, "cwd": home, "text": True, **USER}
    done = subprocess.run(install, capture_output=True, check=False, timeout=WAIT_S, **options)
    assert done.returncode == 0, done.stderr
    times["installed"] = time.monotonic() - began

    # The second command.
    start = [home / "programs" / "carina", "demo", "phantom", "--no-browser", "--json"]
    with subprocess.Popen(start, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options) as process:
        try:
            text = ""
            while not text.rstrip().endswith("}"):
                line = process.stdout.readline()
                assert line, process.stderr.read()
                text += line
            times["address printed"] = time.monotonic() - began
            with sync_api.sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=find_browser(), args=FLAGS)
                station = Workstation(browser.new_page(viewport={"width": 1440, "height": 900}))
                station.page.goto(json.loads(text)["url"])
                station.accept_notice()
                station.page.wait_for_function(FIRST_PICTURE, timeout=1000 * WAIT_S)
                times["first picture"] = time.monotonic() - began
                station.wait_ready()
                times["flight"] = time.monotonic() - began
                before = station.state("pose.path_mm")
                station.page.keyboard.press("Space")
                station.wait_for("(before) => window.__carina.state.pose.path_mm > before + 5", before)
                browser.close()
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=WAIT_S)
        finally:
            process.kill()
    assert (process.returncode, errors) == (0, "")
    print(f"\n{source}: " + ", ".join(f"{name} {seconds:.1f} s" for name, seconds in times.items()))
