"""Tests of `make run`: it names missing tools, downloads only after consent, and installs only what a run needs."""

from __future__ import annotations

import io
import os
import pty
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

import install_package

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "tools" / "check_build_tools.sh"
SYSTEM = ("bash", "cat", "dirname", "env", "getconf", "grep", "head", "ln", "sed", "sh")
VERSIONS = {
    "python3": "Python 3.12.1",
    "cargo": "cargo 1.95.0",
    "rustc": "rustc 1.95.0",
    "node": "v22.1.0",
    "npm": "11.0",
    "uv": "uv 0.9",
    "cc": "cc 14.2",
}
WITHIN_S = 60
"""Time limit of a script, seconds; a script that waits for an answer would block for ever."""


@pytest.fixture
def machine(tmp_path):
    """Return a function that makes a folder of commands with versions, and an environment with only this folder."""

    def make(**changed: str | None) -> dict[str, str]:
        folder = tmp_path / "bin"
        folder.mkdir()
        for name in SYSTEM:
            found = shutil.which(name)
            assert found is not None
            (folder / name).symlink_to(found)
        for name, text in {**VERSIONS, "curl": "", **changed}.items():
            if text is not None:
                command = folder / name
                ran = f'echo "$0" "$@" >>{tmp_path}/ran\n' if name == "curl" else ""
                command.write_text(f"#!/bin/sh\n{ran}echo '{text}'\n")
                command.chmod(0o755)
        return {"PATH": str(folder), "HOME": str(tmp_path)}

    return make


def check(environment: dict[str, str], *installed: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [SCRIPT, *installed], env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False,
        timeout=WITHIN_S,
    )  # fmt: skip


def check_at_a_terminal(environment: dict[str, str], answer: str, script: Path = SCRIPT) -> tuple[int, str]:
    """Run the script in a terminal and answer its question; return the exit code and the output."""
    ours, its = pty.openpty()
    with subprocess.Popen([script], env=environment, stdin=its, stdout=its, stderr=its, start_new_session=True) as ran:
        os.close(its)
        shown, typed = "", False
        while True:
            try:
                part = os.read(ours, 4096)
            except OSError:  # Linux reports EIO at the end of the output of a closed terminal.
                break
            if not part:
                break
            shown += part.decode()
            if "[y/N]" in shown and not typed:
                os.write(ours, f"{answer}\n".encode())
                typed = True
        os.close(ours)
    assert typed, shown
    return ran.returncode, shown


def needed() -> dict[str, str]:
    """Return the versions that the project files declare."""
    python = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"].removeprefix(">=")
    rust = tomllib.loads((ROOT / "Cargo.toml").read_text())["workspace"]["package"]["rust-version"]
    [node] = re.findall(r'"node": ">=([\d.]+)"', (ROOT / "web" / "package.json").read_text())
    return {"Python": python, "Rust": rust, "Node": node}


def test_check_before_the_first_build_names_the_versions_that_the_project_files_declare(machine):
    ended = check(machine())
    assert ended.returncode == 0, ended.stderr
    first = ended.stdout.splitlines()[0]
    for tool, version in needed().items():
        assert f"{tool} {version}" in first
    assert "python3-venv" in first
    assert re.search(r"Compiles: Rust crates and the web UI, about \d+ to \d+ min", ended.stdout)


def test_check_of_complete_build_tools_prints_nothing(machine, tmp_path):
    (tmp_path / "installed").touch()
    ended = check(machine(), tmp_path / "installed", tmp_path / "absent")
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


@pytest.mark.parametrize(
    ("tool", "version", "problem"),
    [
        ("rustc", "rustc 1.63.0", "Rust 1.89 or newer is needed, found 1.63.0"),
        ("cargo", "cargo 1.88.9", "Rust 1.89 or newer is needed, found 1.88.9"),
        ("node", "v20.18.3", "Node 20.19 or newer is needed, found 20.18.3"),
        ("node", "v9.99.0", "Node 20.19 or newer is needed, found 9.99.0"),
        ("python3", "Python 3.9.2", "Python 3.11 or newer is needed, found 3.9.2"),
        ("node", None, "Node 20.19 or newer is missing"),
        ("npm", None, "npm, which belongs to Node, is missing"),
        ("cc", None, "a C compiler (cc) is missing"),
        ("cargo", None, "Rust 1.89 or newer is missing"),
    ],
)
def test_missing_or_old_build_tool_is_reported_with_its_remedy_and_nothing_is_downloaded(
    machine, tmp_path, tool, version, problem
):
    environment = machine(**{tool: version})
    (tmp_path / "installed").touch()
    for ended in (check(environment), check(environment, tmp_path / "installed")):
        assert ended.returncode == 1
        assert f"{problem}: " in ended.stderr
        assert "Nothing was downloaded" in ended.stderr
    assert not (tmp_path / "ran").exists()


def test_python_without_venv_is_refused_if_uv_is_missing(machine):
    environment = machine(uv=None)
    python = Path(environment["PATH"]) / "python3"
    python.write_text('#!/bin/sh\n[ "$1" = --version ] && echo Python 3.12.1\n')
    ended = check(environment)
    assert ended.returncode == 1
    assert "apt install python3-venv" in ended.stderr


def test_rust_is_not_downloaded_without_consent(machine, tmp_path):
    code, shown = check_at_a_terminal(machine(cargo=None), "")
    assert code == 1, shown
    assert not (tmp_path / "ran").exists()


def test_rust_is_downloaded_into_the_checkout_after_consent(machine, tmp_path):
    """Run the script in a copy of the files that it reads."""
    copy = tmp_path / "copy"
    for name in ("tools/check_build_tools.sh", "Cargo.toml", "pyproject.toml", "web/package.json"):
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, copy / name)
    tool_chain = '"$RUSTUP_HOME/toolchains/stable/bin"'
    environment = machine(cargo=None, curl=f"mkdir -p {tool_chain}")
    (Path(environment["PATH"]) / "mkdir").symlink_to(shutil.which("mkdir") or "")
    code, shown = check_at_a_terminal(environment, "y", copy / "tools" / "check_build_tools.sh")
    assert code == 0, shown
    assert "https://sh.rustup.rs" in (tmp_path / "ran").read_text()
    assert (copy / ".rust" / "bin").resolve() == copy / ".rust" / "rustup" / "toolchains" / "stable" / "bin"


def dry_run(*arguments: str) -> list[str]:
    """Return the commands that make would run in a folder without a build."""
    absent = [f"{name}=build/absent-{name}" for name in ("STAMP", "RUN_STAMP", "WEB_TOOLS", "WEB_LIBRARIES")]
    command = ["make", "-n", "UV=uv", *absent, *arguments]
    # The variables of an outer make are removed, because they would change the output of this one.
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    return ended.stdout.splitlines()


def test_make_run_checks_the_build_tools_first_and_installs_no_test_or_lint_tools():
    commands = dry_run("run")
    assert commands[0].startswith("tools/check_build_tools.sh")
    text = "\n".join(commands)
    assert "npm ci --omit=dev" in text
    assert "requirements-run.lock" in text
    assert "requirements.lock" not in text
    assert commands[-1].endswith("carina demo phantom")


def test_make_setup_installs_the_test_and_lint_tools():
    text = "\n".join(dry_run("setup"))
    assert "requirements.lock" in text
    assert "npm ci --no-audit" in text


def locked(name: str) -> set[str]:
    """Return the pinned packages of a lock file, with markers and hashes."""
    text = (ROOT / name).read_text(encoding="utf-8")
    return set(re.findall(r"^[\w.-]+==.*(?:\n    --hash.*)+", text, re.MULTILINE))


def test_runtime_packages_are_locked_to_the_versions_of_the_tests():
    run, tests = locked("requirements-run.lock"), locked("requirements.lock")
    assert 15 < len(run) < len(tests)
    assert run < tests
    names = {block.partition("==")[0] for block in run}
    assert names.isdisjoint({"pytest", "mypy", "ruff", "playwright", "hypothesis", "highdicom", "av"})
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {re.split("[>=<]", one)[0].lower() for one in project["dependencies"]} <= names


def test_makefile_disables_the_tool_downloads_of_maturin_and_uv():
    text = (ROOT / "Makefile").read_text()
    assert "export MATURIN_NO_INSTALL_RUST := 1" in text
    assert "export UV_PYTHON_DOWNLOADS := never" in text


@pytest.mark.parametrize("document", ["README.md", "CONTRIBUTING.md", "docs/getting-started.md"])
def test_document_states_the_versions_that_a_build_needs(document):
    text = " ".join((ROOT / document).read_text(encoding="utf-8").split())
    for tool, version in needed().items():
        assert re.search(rf"{tool} {re.escape(version)}\b", text), f"{tool} {version}"


def test_progress_of_an_installation_names_each_crate_and_the_time():
    lines = [
        "DEBUG   vite v8.3.8 building client\n",
        "DEBUG    Compiling libm v0.2.15\n",
        "DEBUG noise\n",
        "DEBUG Compiling carina-grid v0.1.0 (/x)\n",
    ]
    clock = iter([0.0, 1.0, 61.5, 75.0])
    out = io.StringIO()
    assert install_package.show(lines, total=47, out=out, now=lambda: next(clock)) == lines
    assert out.getvalue().splitlines() == [
        "  0:01  building the web UI",
        "  1:01  compiling crate 1 of at most 47: libm",
        "  1:15  compiling crate 2 of at most 47: carina-grid",
    ]
