"""Refuse imports that run against the architecture, and circles of files; name the allowed direction instead.

The rules are the table in ARCHITECTURE.md, read from there, so that the text and the check cannot drift apart.
Run: ``python tools/check_layers.py`` (part of ``make check``).
"""

from __future__ import annotations

import ast
import graphlib
import re
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

from file_graph import Import, all_imports, circles, in_words

ROOT = Path(__file__).resolve().parent.parent
# A clock as well: state is given the time.
BROWSER = re.compile(
    r"\b(?:(?:document|window|WebSocket|HTMLElement|CanvasRenderingContext2D|localStorage)\b[.(]|(?:performance|Date)\.now\b)"
)


@dataclass(frozen=True, slots=True)
class Rules:
    """Who may import whom, by part name."""

    rust: dict[str, frozenset[str]]
    python: dict[str, frozenset[str]]
    web: dict[str, frozenset[str]]
    compiled: frozenset[str]
    """Python parts that may import the compiled module."""
    everywhere: frozenset[str]
    """Python parts that all may import."""
    rooms: dict[str, dict[str, frozenset[str]]]
    """Of a Python part whose folders have an order of their own: who may import whom inside it."""


def read_rules(text: str) -> Rules:
    """Read the fenced ``layers`` blocks of ARCHITECTURE.md: three of the parts, and one for each part with rooms."""
    blocks = dict(re.findall(r"```layers (\w+)\n(.*?)```", text, flags=re.DOTALL))
    missing = {"rust", "python", "web"} - blocks.keys()
    if missing:
        sys.exit(f"ARCHITECTURE.md has no ```layers {missing.pop()}``` block")

    def table(block: str) -> dict[str, frozenset[str]]:
        rules = {}
        for line in block.strip().splitlines():
            part, _, allowed = line.partition(":")
            rules[part.strip()] = frozenset(allowed.split())
        return rules

    python = table(blocks["python"])
    return Rules(
        rust=table(blocks["rust"]),
        python={part: allowed for part, allowed in python.items() if not part.startswith("(")},
        web=table(blocks["web"]),
        compiled=python["(compiled module)"],
        everywhere=python["(everywhere)"],
        rooms={part: table(block) for part, block in blocks.items() if part not in {"rust", "python", "web"}},
    )


def check_rust(rules: dict[str, frozenset[str]]) -> list[str]:
    """Crate dependencies against the rules."""
    found = []
    for manifest in sorted(ROOT.glob("crates/*/Cargo.toml")):
        part = manifest.parent.name
        data = tomllib.loads(manifest.read_text(encoding="utf-8"))
        uses = {name.removeprefix("carina-") for name in data.get("dependencies", {}) if name.startswith("carina-")}
        if part not in rules:
            found.append(f"crates/{part}: not in ARCHITECTURE.md; add its row")
            continue
        for used in sorted(uses - rules[part]):
            found.append(f"crates/{part} depends on {used}; it may use {sorted(rules[part]) or 'none of our crates'}")
        external = {name for name in data.get("dependencies", {}) if name in {"pyo3", "numpy"}}
        if external and part != "bindings":
            found.append(f"crates/{part} depends on {sorted(external)}; only bindings knows Python")
    return found


def _part_of(module: str) -> str | None:
    pieces = module.split(".")
    if pieces[0] == "carina_bench":
        return "benchmarks"
    return pieces[1] if pieces[0] == "carina" and len(pieces) > 1 else None


def _imported_parts(tree: ast.AST) -> list[tuple[int, str]]:
    parts = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            parts += [(node.lineno, part) for alias in node.names if (part := _part_of(alias.name))]
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            if node.module == "carina":
                parts += [(node.lineno, alias.name) for alias in node.names]
            elif part := _part_of(node.module):
                parts.append((node.lineno, part))
        elif isinstance(node, ast.ImportFrom) and node.level > 1:
            parts.append((node.lineno, "(relative import across parts)"))
    return parts


def check_python(rules: Rules) -> list[str]:
    """Imports between the parts of the Python package."""
    found = []
    package = ROOT / "python" / "carina"
    for path in sorted([*package.rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")]):
        # The first folder or file of the package; a folder beside it is one part.
        part = path.relative_to(package).parts[0] if path.is_relative_to(package) else "benchmarks"
        own = part.removesuffix(".py")
        # The facade hands on every part but cli.
        allowed = rules.python.keys() - {"cli"} if own == "__init__" else rules.python.get(own)
        if allowed is None and own not in rules.everywhere:
            found.append(f"{path.relative_to(ROOT)}: part {own!r} is not in ARCHITECTURE.md; add its row")
            continue
        for line, used in _imported_parts(ast.parse(path.read_text(encoding="utf-8"))):
            where = f"{path.relative_to(ROOT)}:{line}"
            if used == own or used in rules.everywhere or used.startswith("__"):
                continue
            if used == "_core":
                if own not in rules.compiled:
                    found.append(f"{where}: {own} imports the compiled module; only {sorted(rules.compiled)} may")
            elif used not in (allowed or frozenset()):
                found.append(f"{where}: {own} imports {used}; it may import {sorted(allowed or ()) or 'no other part'}")
    return found


def check_rooms(rooms: dict[str, dict[str, frozenset[str]]], imports: list[Import]) -> list[str]:
    """Imports between the rooms of a Python part: its folders, and the files beside them."""
    found = []
    for part, rules in rooms.items():
        try:
            graphlib.TopologicalSorter(rules).prepare()
        except graphlib.CycleError as circle:
            found.append(f"ARCHITECTURE.md: the rooms of {part} form a circle: {' -> '.join(circle.args[1])}")
        folder = ROOT / "python" / "carina" / part
        # The door of the part hands on what its rooms hold.
        names = {path.stem for path in folder.glob("*.py")} | {path.parent.name for path in folder.glob("*/*.py")}
        names -= {"__init__", "__main__"}
        found += [f"python/carina/{part}/{name}: not in ARCHITECTURE.md; add its row" for name in names - rules.keys()]
        found += [f"ARCHITECTURE.md: python/carina/{part} has no {name}" for name in rules.keys() - names]
        for one in imports:
            if not (one.source.is_relative_to(folder) and one.target.is_relative_to(folder)):
                continue
            own, used = (path.relative_to(folder).parts[0].removesuffix(".py") for path in (one.source, one.target))
            if own in {used, "__init__", "__main__"} or used in rules.get(own, frozenset()):
                continue
            where = f"{one.source.relative_to(ROOT)}:{one.line}"
            allowed = sorted(rules.get(own, ()))
            found.append(f"{where}: {part}.{own} imports {part}.{used}; it may import {allowed or 'no other room'}")
    return sorted(set(found))


def check_web(rules: dict[str, frozenset[str]]) -> list[str]:
    """Imports between the folders of web/src, and no DOM in the pure state."""
    found = []
    source = ROOT / "web" / "src"
    pattern = re.compile(r"""(?:from|import)\s*\(?\s*["'](\.[^"']+)["']""")
    for path in sorted([*source.rglob("*.ts"), *source.rglob("*.tsx")]):
        inside = path.relative_to(source)
        if len(inside.parts) == 1:
            continue
        part = inside.parts[0]
        # A test may wire parts together to see them work; the product may not.
        if ".test." in path.name:
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            for target in pattern.findall(line):
                resolved = (path.parent / target).resolve()
                if not resolved.is_relative_to(source):
                    continue
                used = resolved.relative_to(source).parts[0].removesuffix(".ts")
                if used != part and used not in rules.get(part, frozenset()):
                    allowed = sorted(rules.get(part, ()))
                    found.append(f"web/src/{inside}:{number}: {part} imports {used}; it may import {allowed or 'none'}")
            # State is tested without a browser and replayed without a screen, so it may not reach for either.
            if part == "state" and (dom := BROWSER.search(line)):
                found.append(f"web/src/{inside}:{number}: state is pure and may not use {dom.group()}")
    return found


def main() -> int:
    """Print every violation; 1 if there is one."""
    rules = read_rules((ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8"))
    imports = all_imports()
    found = [
        *check_rust(rules.rust),
        *check_python(rules),
        *check_rooms(rules.rooms, imports),
        *check_web(rules.web),
    ]
    # Files of one part may import each other, but not in a circle: what they share belongs into a file below them.
    found += [f"circle: {in_words(circle)}" for circle in circles(imports)]
    for line in found:
        print(line)
    print(
        f"layers: {len(found)} faults" if found else "layers: all imports follow ARCHITECTURE.md, and none in a circle"
    )
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
