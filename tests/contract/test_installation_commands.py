"""Tests of installation commands in messages: they extend this installation and request no `carina` from an index."""

from __future__ import annotations

import importlib.util
import re
import shlex
import sys
import tomllib
from pathlib import Path

import pytest
import typer

from carina import installation
from carina.cli.app import app
from carina.installation import EXTRAS, carina_command, extra_command, install_command, not_built, rebuild

ROOT = Path(__file__).resolve().parents[2]
SOURCES = {
    "python": (".py", ".pyi", ".html", ".js"),
    "web/src": (".ts", ".tsx", ".json"),
    "web/public": (".html", ".js"),
    "crates": (".rs",),
    "packages": (".py", ".rs", ".md", ".toml"),
    "benchmarks": (".py", ".md"),
    "examples": (".py", ".ipynb", ".md"),
    "docs": (".md", ".txt"),
    "tools": (".py", ".sh", ".mjs"),
}
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "Makefile", ".ci/run", "web/index.html", "web/phone.html")


def message_files() -> list[Path]:
    """Return every file with text that a user can read, except `docs/words`, which repeats messages."""
    found = [ROOT / name for name in PAGES]
    for folder, suffixes in SOURCES.items():
        found += [
            path
            for path in sorted((ROOT / folder).rglob("*"))
            if path.suffix in suffixes and not {"node_modules", "_web", "target", "words"} & set(path.parts)
        ]
    return found


def test_no_message_installs_carina_from_a_package_index() -> None:
    """No message may install `carina` from a package index, because anybody could register this name there."""
    files = message_files()
    assert len(files) > 800
    unsafe = re.compile(
        r"(?:pip|uv|pipx|uvx|conda|mamba|poetry)3?(?:\s+[a-z]+)*\s+(?:install|add|run)\s[^\n]*?(?<![\w./-])carina(?![\w./-])"
        r"|[\"' ]carina\[(?:" + "|".join(EXTRAS) + r")\]"
    )
    wrong = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}"
        for path in files
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if unsafe.search(line) and "--reinstall-package carina -e ." not in line
    ]
    assert not wrong, "\n".join(wrong)


def test_only_one_module_contains_installation_commands() -> None:
    command = re.compile(r"pip install|\buv add\b")
    source = [path for path in message_files() if path.is_relative_to(ROOT / "python") or "web" in path.parts]
    found = [path for path in source if command.search(path.read_text(encoding="utf-8"))]
    assert len(source) > 500
    assert {path.name for path in found} <= {"installation.py"}


def test_extras_named_in_messages_are_those_of_the_project_file() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {
        extra: tuple(requirement.partition(";")[0] for requirement in requirements)
        for extra, requirements in project["optional-dependencies"].items()
    }
    assert dict(EXTRAS) == declared


def without(monkeypatch: pytest.MonkeyPatch, *, pip: bool, uv: str | None) -> None:
    """Simulate an environment with or without pip and uv."""
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object() if pip and name == "pip" else None)
    monkeypatch.setattr(installation.shutil, "which", lambda name, path=None: uv if path is None else None)


def test_installation_command_in_an_environment_with_pip_uses_the_pip_of_its_python(monkeypatch) -> None:
    without(monkeypatch, pip=True, uv="/usr/bin/uv")
    words = shlex.split(install_command("segno>=1.6"))
    assert words == [sys.executable, "-m", "pip", "install", "segno>=1.6"]


def test_installation_command_in_an_environment_of_uv_without_pip_uses_uv(monkeypatch) -> None:
    without(monkeypatch, pip=False, uv="/usr/bin/uv")
    words = shlex.split(extra_command("report"))
    assert words == ["/usr/bin/uv", "pip", "install", "--python", sys.executable, "reportlab>=4.2"]


def test_installation_command_without_pip_and_uv_installs_pip_first(monkeypatch) -> None:
    without(monkeypatch, pip=False, uv=None)
    first, second = extra_command("video").split(" && ")
    assert shlex.split(first) == [sys.executable, "-m", "ensurepip"]
    assert shlex.split(second) == [sys.executable, "-m", "pip", "install", "av>=14"]


def test_version_condition_is_quoted_for_the_windows_shell(monkeypatch) -> None:
    without(monkeypatch, pip=True, uv=None)
    monkeypatch.setattr(installation.os, "name", "nt")
    assert install_command("ray>=2.60,<2.61").endswith(' -m pip install "ray>=2.60,<2.61"')


def test_rebuild_command_of_a_checkout_is_a_makefile_target() -> None:
    words = shlex.split(rebuild().removeprefix("run: "))
    assert words[:2] == ["make", "-C"]
    target = words[3]
    assert re.search(rf"^{target}:", (Path(words[2]) / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert not_built("the window").startswith("the window has not been built: run: make -C ")


@pytest.mark.parametrize(
    ("record", "expected"),
    [
        (
            '{"url": "file:///media/stick/carina-0.1.0-cp311-abi3-linux_x86_64.whl"}',
            "file:///media/stick/carina-0.1.0-",
        ),
        (None, "from the file or folder from which it was installed"),
    ],
)
def test_installed_wheel_is_reinstalled_from_the_file_or_address_of_its_installation(
    monkeypatch, record, expected
) -> None:
    class Distribution:
        def read_text(self, _name: str) -> str | None:
            return record

    monkeypatch.setattr(installation, "_checkout", lambda: None)
    monkeypatch.setattr(installation.metadata, "distribution", lambda _name: Distribution())
    assert expected in rebuild()
    assert "install carina" not in rebuild()


def test_carina_command_in_a_message_has_its_full_path_unless_the_shell_finds_it(monkeypatch, tmp_path) -> None:
    own, other = tmp_path / "own", tmp_path / "other"
    for folder in (own, other):
        folder.mkdir()
        (folder / "carina").write_text("#!/bin/sh\n")
        (folder / "carina").chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(own / "python"))
    monkeypatch.setenv("PATH", str(own))
    assert carina_command("case", "migrate") == "carina case migrate"
    for path in (str(other), str(tmp_path)):
        monkeypatch.setenv("PATH", path)
        assert shlex.split(carina_command("case", "migrate")) == [str(own / "carina"), "case", "migrate"]


def test_carina_commands_in_messages_exist() -> None:
    """Check the commands of `carina`, `carina case` and `carina cluster`."""
    commands = typer.main.get_command(app)
    wrong = []
    for path in message_files():
        if path.suffix in {".py", ".ts", ".tsx", ".rs"}:
            for words in re.findall(r"`carina ([a-z]+(?: [a-z]+)?)", path.read_text(encoding="utf-8")):
                verb, _, below = words.partition(" ")
                found = commands.commands.get(verb)
                group = getattr(found, "commands", None)
                if found is None or (group is not None and below and below not in group):
                    wrong.append(f"{path.relative_to(ROOT)}: carina {words}")
    assert not wrong
