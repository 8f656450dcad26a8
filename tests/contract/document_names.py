"""Resolver of names in backticks in the documents: files, options, commands, and names in source code."""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import click
import typer

from carina.cli.app import app

ROOT = Path(__file__).resolve().parents[2]
FENCE = re.compile(r"^(```|~~~).*?^\1", re.DOTALL | re.MULTILINE)
SPAN = re.compile(r"(?<!`)`([^`\n]+)`(?!`)")
IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
SUFFIXES = ("py", "pyi", "rs", "ts", "tsx", "md", "json", "jsonl", "toml", "html", "css", "wgsl", "yml", "sh", "lock")
FOREIGN = re.compile(r"(pip|uv|ray|ruff|pytest|git|cargo|docker|systemctl|npm|npx|ssh|scp)\b")
"""Pattern of names that begin with a command of another program."""
CODE = (".py", ".pyi", ".rs", ".ts", ".tsx", ".mjs", ".wgsl", ".c")


@dataclass(frozen=True, slots=True)
class Named:
    """Name in backticks, with its document and line."""

    document: str
    line: int
    text: str


def documents() -> list[Path]:
    """Return the pages of the root and of docs/, the page of the wire and the guides of other packages."""
    guides = sorted((ROOT / "packages").glob("*/README.md"))
    entry = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "ARCHITECTURE.md")]
    return [*entry, *sorted((ROOT / "docs").glob("*.md")), ROOT / "protocol" / "README.md", *guides]


def names_in(path: Path) -> Iterator[Named]:
    """Yield the names in backticks of a document, without its code blocks."""
    text = FENCE.sub(lambda block: "\n" * block.group().count("\n"), path.read_text(encoding="utf-8"))
    for number, line in enumerate(text.splitlines(), 1):
        for match in SPAN.finditer(line):
            yield Named(path.relative_to(ROOT).as_posix(), number, match.group(1).replace("\\|", "|").strip())


@cache
def tracked_files() -> tuple[str, ...]:
    """Return the paths of all files of the repository, relative to its root."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode == 0 and listed.stdout:
        return tuple(listed.stdout.splitlines())
    skipped = {".git", ".venv", "node_modules", "target", "__pycache__"}
    found = (path for path in ROOT.rglob("*") if path.is_file() and not skipped & set(path.parts))
    return tuple(path.relative_to(ROOT).as_posix() for path in found)


@cache
def folders() -> frozenset[str]:
    """Return the paths of all folders of the repository."""
    return frozenset(str(above) for name in tracked_files() for above in Path(name).parents)


@cache
def code_of(name: str) -> str:
    """Return the text of a source file without comments and docstrings."""
    text = (ROOT / name).read_text(encoding="utf-8", errors="replace")
    if not name.endswith((".py", ".pyi")):
        return re.sub(r"//.*|/\*.*?\*/", "", text, flags=re.DOTALL if "/*" in text and "//" not in text else 0)
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list) and body:
            node.body = [one for one in body if not _is_bare_text(one)] or [ast.Pass()]  # type: ignore[attr-defined]
    return ast.unparse(tree)


def _is_bare_text(node: Any) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


@cache
def source_files() -> tuple[str, ...]:
    """Return the source files of the product and of its tools, without the tests."""
    return tuple(
        name
        for name in tracked_files()
        if name.endswith(CODE)
        and not re.match(r"tests/|packages/[^/]+/tests/", name)
        and ".test." not in name
        and (ROOT / name).is_file()
    )


@cache
def defined() -> dict[str, frozenset[str]]:
    """Return the files in which each identifier of the source code occurs, by identifier."""
    found: dict[str, set[str]] = {}
    for name in source_files():
        for word in set(IDENTIFIER.findall(code_of(name))):
            found.setdefault(word, set()).add(name)
    for name in tracked_files():
        for part in Path(name).parts:
            found.setdefault(part.partition(".")[0], set()).add(name)
    return {word: frozenset(files) for word, files in found.items()}


@cache
def all_source() -> str:
    """Return the source code of all files as one text."""
    extra = [name for name in tracked_files() if name.endswith(".toml") or name == "Makefile"]
    more = [(ROOT / name).read_text(encoding="utf-8", errors="replace") for name in extra if (ROOT / name).is_file()]
    return "\n".join([*(code_of(name) for name in source_files()), *more])


@cache
def command_options() -> frozenset[str]:
    """Return every option of every command of ``carina``."""
    found: set[str] = set()
    waiting: list[Any] = [typer.main.get_command(app)]
    while waiting:
        command = waiting.pop()
        for parameter in command.params:
            found.update([*parameter.opts, *parameter.secondary_opts])
        waiting += list(getattr(command, "commands", {}).values())
        found.update(click.Context(command).help_option_names)
    return frozenset(found | {"--help"})


@cache
def command_names() -> frozenset[str]:
    """Return the commands of ``carina`` and of its groups ``case`` and ``cluster``, such as ``case info``."""
    group: Any = typer.main.get_command(app)
    found = set(group.commands)
    for name, command in group.commands.items():
        found.update(f"{name} {below}" for below in getattr(command, "commands", {}))
    return frozenset(found)


@cache
def make_targets() -> frozenset[str]:
    """Return the names of the targets in the Makefile."""
    return frozenset(re.findall(r"^([a-z][\w-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))


def is_path(text: str) -> bool:
    """Return whether a name has the form of a file or a folder of the repository."""
    if not re.fullmatch(r"[\w.@-]+(/[\w.@-]+)*/?", text):
        return False
    return text.rpartition(".")[2] in SUFFIXES or text.partition("/")[0] in {
        "crates", "packages", "python", "docs", "web", "tests", "tools", "benchmarks", "protocol", "examples",
        "build_backend",
    }  # fmt: skip


def path_problem(text: str, document: str) -> str | None:
    """Return the reason why a name in the form of a path is wrong; None if it is correct."""
    name = text.rstrip("/")
    places = {name, f"{Path(document).parent.as_posix()}/{name}".removeprefix("./")}
    if places & set(tracked_files()) or places & folders():
        return None
    if any(file.endswith("/" + name) for file in tracked_files()) or any(one.endswith("/" + name) for one in folders()):
        return None
    # The name of a file that Carina writes or reads occurs as a text in the source code.
    if "/" not in name and (name in all_source() or name.rpartition(".")[0].isupper()):
        return None
    # A decision may be named by its number: docs/decisions/0125.
    if any(file.startswith(name + "-") for file in tracked_files()):
        return None
    return "no such file or folder"


def dotted_problem(text: str) -> str | None:
    """Return the reason why a dotted name such as ``carina.track.wall_field`` or ``Session.do`` is wrong, or None."""
    parts = text.split(".")
    homes = [defined().get(part) for part in parts]
    missing = [part for part, files in zip(parts, homes, strict=True) if not files]
    if missing:
        return f"no {missing[0]} in the source code"
    if parts[0] == "carina" and len(parts) > 1:
        return _import_problem(parts)
    if parts[0][0].isupper() and re.search(rf"\b(class|struct|enum|interface|type|trait)\s+{parts[0]}\b", all_source()):
        files = [file for file in defined()[parts[0]] if file.endswith(CODE)]
        pattern = rf"\b(class|struct|enum|interface|type|trait|impl)\s+(\w+\s+for\s+)?{parts[0]}\b"
        owners = [file for file in files if re.search(pattern, code_of(file))]
        if not any(_has_member(file, parts[1]) for file in owners):
            return f"{parts[0]} has no {parts[1]}"
    return None


def _has_member(file: str, name: str) -> bool:
    """Return whether a file, or a file that it imports from its own package, has an identifier."""
    return bool(re.search(rf"\b{name}\b", code_of(file)))


def _import_problem(parts: list[str]) -> str | None:
    import importlib

    value: Any = importlib.import_module("carina")
    for n, part in enumerate(parts[1:], 2):
        if hasattr(value, part) or part in getattr(value, "__annotations__", {}):
            value = getattr(value, part, None)
            continue
        try:
            value = importlib.import_module(".".join(parts[:n]))
        except ImportError:
            return f"{'.'.join(parts[: n - 1])} has no {part}"
    return None


@cache
def quoted_options() -> frozenset[str]:
    """Return every option that is quoted in the source code of the tools and the benchmarks."""
    return frozenset(re.findall(r"[\"'](--[a-z][a-z-]+)[\"']", all_source()))


def option_problems(text: str) -> list[str]:
    """Return the options in a text that no command of ``carina`` and no tool of the repository has."""
    found = []
    for option in re.findall(r"(?<![\w-])--[a-z][a-z-]+", text):
        if option not in command_options() and option not in quoted_options():
            found.append(f"no option {option}")
    return found


ALLOWED = {
    "RAY_TLS_SERVER_CERT": "variable of Ray",
    "RAY_TLS_SERVER_KEY": "variable of Ray",
    "RAY_TLS_CA_CERT": "variable of Ray",
    "HANDLE_AS_HID": "switch of the handle's firmware (examples)",
    "plan.json": "name that the reader chooses",
    "_lps": "suffix of names",
    "_camera": "suffix of names",
    "_zyx": "suffix of names",
    "cv2.fisheye": "module of OpenCV",
    "cv2.FileStorage": "class of OpenCV",
    "center_px": "field of wire version 1",
    "num_centers": "key of earlier versions",
}
"""Names in backticks that are not names of this repository, each with its meaning."""


def problem(named: Named) -> str | None:
    """Return the reason why a name in backticks cannot be resolved; None if it is correct or no name."""
    text = named.text
    if text in ALLOWED:
        return None
    if is_path(text):
        return path_problem(text, named.document)
    options = [] if FOREIGN.match(text) else option_problems(text)
    if options:
        return options[0]
    if text.startswith("carina ") and not text.startswith("carina --"):
        words = re.split(r"[ |]", text)
        if words[1] not in command_names() and not words[1].startswith("<"):
            return f"no command {words[1]}"
        return None
    if text.startswith("make "):
        return None if text.split()[1] in make_targets() else f"no target {text.split()[1]} in the Makefile"
    name = text.removesuffix("()")
    if re.fullmatch(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+", name):
        return dotted_problem(name)
    if re.fullmatch(r"[A-Za-z_]\w+", name) and (
        "_" in name.strip("_") or name.startswith("_") or re.search(r"[a-z][A-Z]", name)
    ):
        return None if name in defined() else f"no {name} in the source code"
    called = re.fullmatch(r"(carina(?:\.\w+)+)\(.*\)", text)
    return _import_problem(called.group(1).split(".")) if called else None
