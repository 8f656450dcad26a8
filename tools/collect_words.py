"""Collect every sentence that a person reads into one file per surface (docs/words), from where it is said.

``python tools/collect_words.py`` writes the files, ``--check`` fails when they are stale (in ``make check``), and
``--draw 100 --seed 13`` prints that many of them by chance, for a reader who has not seen the code. Why they are
collected and not moved: docs/decisions/0050-sentences-stay-where-they-are-said.md.
"""

from __future__ import annotations

import argparse
import ast
import json
import random
import re
import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PLACE = ROOT / "docs" / "words"
SURFACES = {
    "window": "The workstation's window",
    "phone": "The phone's page",
    "cli": "The command line",
    "messages": "Errors, notes and names that Python and Rust hand to all of them",
}
PROSE = re.compile(r"[A-Za-z\u00c0-\u024f)}][,.;:]? +[(\u201c\"{]?[A-Za-z\u00c0-\u024f{]")
UNREAD_CALLS = {"compile", "sub", "match", "search", "fullmatch", "TypeVar", "getenv", "TypeAdapter", "debug"}
"""Calls whose strings are for programs."""
PROGRAMS = {f"python/carina/server/{name}_types.py" for name in ("export", "view", "wire")}
"""They write TypeScript."""
MARKUP = re.compile(
    r"<[A-Za-z!?/][^>]*=|<Piece |\bxmlns=|;base64,|[a-z-]+: [^ ]+; |[{.][\w-]+ \{|'none';|px \{FONT\}|system-ui|_core\b"
    r"|\.react-aria-|^M\{|^#[0-9a-f]{6}$|; HttpOnly|max-age=|filename="
    r"|^(INSERT|UPDATE|SELECT|DELETE|CREATE|PRAGMA|ATTACH|WITH) "
    r"|^(comment|property|element|format|NRRD0004|attachment|// |/\*\* |export )"
)
"""Strings that look like words and are markup, headers of files or types."""
TOKENS = {
    "python/carina/commands/value.py": r"Number out of range|matching regex",
    "python/carina/export/mesh_file.py": r"o airways|# badge .*",
    "python/carina/export/tree_formats.py": r"# badge .*",
    "python/carina/scopes/library.py": r"(s|k|size|channel|OD)\b.*(\bs|\bk|\(s\)|s\))",
    "python/carina/server/strangers.py": r"accept\(\).*",
    "python/carina/track/names/solve.py": r"go on",
    "python/carina/volume/grid_writing.py": r"unsigned char|endian: little",
    "python/carina/volume/header_nrrd.py": (
        r"((un)?signed )?(char|short|int|long( long)?)( int)?|space (directions|origin|units)|(data|line|byte|old) \w+"
    ),
}
"""By file: words of a file format or of a library that look like a person's, and sources of figures."""
NEVER = ROOT / "tools" / "wrong_words.toml"
RUST_ERROR = re.compile(r'#\[error\(\s*"((?:[^"\\]|\\.)*)"', re.DOTALL)

Found = dict[str, list[str]]


def is_prose(text: str) -> bool:
    """Whether a string is words for a person: two of them at least."""
    bare = re.sub(r"\{[^}]*\}", "{x}", text)
    if re.search(r"\}[ ,;:%]* [a-z]{3,}\b|(^|\s)[a-z]{3,}[,:;]? \{", bare) and MARKUP.search(text) is None:
        return True
    return (
        PROSE.search(bare) is not None
        and MARKUP.search(text) is None
        and re.search(r"[a-z]{2}", bare.replace("{x}", "")) is not None
    )


def name_of(node: ast.expr) -> str:
    """What stands in braces: the last name of what is filled in."""
    match node:
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name
        case ast.Call(args=[first, *_]):
            return name_of(first)
        case ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name)):
            return name
        case ast.Constant(value=value):
            return str(value)
        case ast.Subscript(value=value):
            return name_of(value)
        case _:
            return "\u2026"


def text_of(node: ast.Constant | ast.JoinedStr) -> str:
    """A string as it is read, what is filled in between braces."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    parts = []
    for part in node.values:
        if isinstance(part, ast.FormattedValue):
            parts.append("{" + name_of(part.value) + "}")
        else:
            parts.append(str(part.value) if isinstance(part, ast.Constant) else "")
    return "".join(parts)


class Reader(ast.NodeVisitor):
    """Strings of a module that are prose. Docstrings are not, except those of verbs: ``--help`` shows them."""

    def __init__(self, verbs: frozenset[str]) -> None:
        self.found: list[tuple[int, int, str]] = []
        self.verbs = verbs

    def keep(self, node: ast.stmt | ast.expr, text: str) -> None:
        tidy = " ".join(text.split())
        if tidy:
            self.found.append((node.lineno, node.col_offset, tidy))

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if node.name in self.verbs and (docstring := ast.get_docstring(node)):
            for paragraph in docstring.split("\n\n"):
                self.keep(node, paragraph)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = name_of(node.func) if isinstance(node.func, ast.Name | ast.Attribute) else ""
        if name not in UNREAD_CALLS:
            self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str) and is_prose(node.value):
            self.keep(node, node.value)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        text = text_of(node)
        if is_prose(text):
            self.keep(node, text)
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                self.visit(part.value)


def verbs_of(tree: ast.Module) -> set[str]:
    """Functions that typer shows: decorated with ``app.command()``, or handed to it."""
    verbs = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and any(
            "command(" in ast.unparse(d) or "callback(" in ast.unparse(d) for d in node.decorator_list
        ):
            verbs.add(node.name)
        if isinstance(node, ast.Call) and ".command(" in ast.unparse(node.func):
            verbs |= {arg.id for arg in node.args if isinstance(arg, ast.Name)}
    return verbs


def from_python() -> dict[str, Found]:
    """Sentences of the package: the command line's, and everybody's."""
    files = sorted((ROOT / "python" / "carina").rglob("*.py"))
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in files}
    in_cli = {path for path in files if "cli" in path.relative_to(ROOT).parts}
    verbs = frozenset().union(*(verbs_of(trees[path]) for path in in_cli))
    found: dict[str, Found] = {"cli": {}, "messages": {}}
    for path, tree in trees.items():
        if path.relative_to(ROOT).as_posix() in PROGRAMS:
            continue
        reader = Reader(verbs if path in in_cli else frozenset())
        reader.visit(tree)
        tokens = re.compile(TOKENS.get(path.relative_to(ROOT).as_posix(), "$."))
        texts = [text for _, _, text in sorted(reader.found) if tokens.fullmatch(text) is None]
        found["cli" if path in in_cli else "messages"][path.relative_to(ROOT).as_posix()] = texts
    return found


def from_rust() -> Found:
    """Errors of the crates."""
    found = {}
    for path in sorted((ROOT / "crates").rglob("*.rs")):
        texts = [
            re.sub(r"\\?\s*\n\s*", " ", text).replace('\\"', '"')
            for text in RUST_ERROR.findall(path.read_text(encoding="utf-8"))
        ]
        found[path.relative_to(ROOT).as_posix()] = [" ".join(text.split()) for text in texts if is_prose(text)]
    return found


def from_web() -> dict[str, Found]:
    """Sentences of the window and of the phone's page."""
    source = ROOT / "web" / "src"
    files = [
        path
        for path in sorted(source.rglob("*.ts*"))
        if ".test" not in path.name and "wire" not in path.relative_to(source).parts[:1]
    ]
    files.append(source / "wire" / "views.ts")
    ran = subprocess.run(
        ["node", str(ROOT / "tools" / "collect_words.mjs"), str(ROOT / "web"), *map(str, files)],
        check=True,
        capture_output=True,
        text=True,
    )
    found: dict[str, Found] = {"window": {}, "phone": {}}
    for name, texts in json.loads(ran.stdout).items():
        place = Path(name).relative_to(ROOT).as_posix()
        surface = "phone" if place.startswith("web/src/phone") else "window"
        found[surface][place] = [text for text in texts if MARKUP.search(text) is None]
    return found


def collect() -> dict[str, Found]:
    """All sentences: surface, file, in the file's order, each once in a file."""
    found = {**from_web(), **from_python()}
    found["messages"].update(from_rust())
    return {
        surface: {name: list(dict.fromkeys(texts)) for name, texts in sorted(found[surface].items()) if texts}
        for surface in SURFACES
    }


def page(surface: str, found: Found) -> str:
    """A surface's file."""
    lines = [
        f"# {SURFACES[surface]}. Collected by tools/collect_words.py:",
        "# change a sentence where it is said, then run `make words`.",
    ]
    for name, texts in found.items():
        lines += ["", f"## {name}", *texts]
    return "\n".join(lines) + "\n"


def wrong(found: dict[str, Found]) -> list[str]:
    """Sentences with words that docs/voice.md does not want, each with what to say in their place."""
    rules = [
        (re.compile(rule["found"], re.IGNORECASE), rule["say"])
        for rule in tomllib.loads(NEVER.read_text(encoding="utf-8"))["never"]
    ]
    return [
        f"{name}: {text!r}: {say}"
        for part in found.values()
        for name, texts in part.items()
        for text in texts
        for pattern, say in rules
        if pattern.search(text)
    ]


def main() -> int:
    """Write, check or draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="fail when a file is stale")
    parser.add_argument("--draw", type=int, metavar="N", help="print N sentences by chance")
    parser.add_argument("--seed", type=int, default=13)
    options = parser.parse_args()
    found = collect()
    if options.draw:
        everything = [
            (surface, name, text) for surface in found for name, texts in found[surface].items() for text in texts
        ]
        drawn = random.Random(options.seed).sample(everything, options.draw)
        print(f"{options.draw} of {len(everything)} sentences, seed {options.seed}\n")
        for surface, name, text in sorted(drawn):
            print(f"{surface}\t{name}\t{text}")
        return 0
    stale = []
    for surface in SURFACES:
        path = PLACE / f"{surface}.txt"
        text = page(surface, found[surface])
        if options.check:
            if not path.exists() or path.read_text(encoding="utf-8") != text:
                stale.append(path.relative_to(ROOT).as_posix())
        else:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
    unwanted = wrong(found)
    for line in unwanted:
        print(line)
    for name in stale:
        print(f"{name}: not what the code says; run `make words` and read what changed")
    if not stale and not unwanted:
        print(f"words: {sum(len(texts) for part in found.values() for texts in part.values())} sentences")
    return 1 if stale or unwanted else 0


if __name__ == "__main__":
    sys.exit(main())
