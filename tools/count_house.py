"""Count how the code is built: lines per part, files that name a view, repeated classes, circles of files.

The same counter reads the working tree or any revision, so that before and after are counted in one way::

    python tools/count_house.py                 # the working tree (files that git knows)
    python tools/count_house.py --at 62b7702    # a revision
    python tools/count_house.py --json
    python tools/count_house.py --check         # what has grown beyond its limit; as ``make check`` does

*Product* is what a person wrote and a user runs: ``crates/*/src``, ``python/carina`` and ``web/src``, without tests,
generated files, the demo's data and documents. Rust's ``#[cfg(test)]`` modules inside a file are left out of it.

What is counted is read from syntax trees in Python and from the text in Rust and TypeScript, whose formatters keep it
regular. A view is *named* where one of its names stands as a string or as the key of an object; ``"xray-"`` names the
three views that begin so. Some names are also plain words (``"tree"``, ``"airway"``): their figure is an upper bound.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import re
import subprocess
import sys
import tarfile
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SUFFIXES = {".py", ".pyi", ".rs", ".ts", ".tsx", ".css", ".html", ".wgsl"}
PRODUCT = ("crates/", "python/carina/", "web/src/")
VIEWS = (
    "airway",
    "cut-plane",
    "tri-plane",
    "xray-axial",
    "xray-coronal",
    "xray-sagittal",
    "drr",
    "axial",
    "coronal",
    "sagittal",
    "straightened",
    "curved",
    "tree",
)
REPEATED = 0.6
MOST_FILES_PER_VIEW = 4
PLAIN_WORDS = {"tree"}
"""Views whose name is a word of many other things too: their files cannot be told apart by it."""
MOST_REPEATING = 5
MOST_METHODS = 15
MOST_ATTRIBUTES = 22
TEST_FILE = re.compile(r"(^|/)(tests?|benches|test_[^/]*\.py|tests\.rs|[^/]*_tests\.rs|[^/]*\.test\.tsx?)(/|$)")
GENERATED = re.compile(r"generated (from|by)|do not edit", re.IGNORECASE)
TEXT_STRING = re.compile(r"""(["'`])([a-z][a-z-]*)\1""")
OBJECT_KEY = re.compile(r"""^\s*([a-z]+):\s""", re.MULTILINE)
RUST_TEST = re.compile(
    r"^( *)#\[cfg\(test\)\]\n(?: *#\[.*\]\n)*( *)(?:pub )?mod \w+ \{\n.*?^\1\}\n", re.MULTILINE | re.DOTALL
)
RUST_PATH = re.compile(r"\b(crate|super)((?:::\w+)+)?(?:::\{((?:[^{}]|\{[^{}]*\})*)\})?")
RUST_STRUCT = re.compile(r"^(?:pub(?:\([a-z]+\))? )?struct (\w+)[^;{(]*\{\n(.*?)^\}", re.MULTILINE | re.DOTALL)
RUST_FIELD = re.compile(r"^    (?:pub(?:\([a-z]+\))? )?(\w+): (.+?),$", re.MULTILINE)
TS_IMPORT = re.compile(r"""(?:from|import)\s*\(?\s*["'](\.[^"']+)["']""")


@dataclass
class Tree:
    """The product's files: path from the root, with forward slashes, to text."""

    files: dict[str, str]

    def paths(self, suffix: str) -> list[str]:
        """Paths that end in ``suffix``."""
        return sorted(path for path in self.files if path.endswith(suffix))

    @cached_property
    def modules(self) -> dict[str, ast.Module]:
        """Parsed Python files."""
        return {path: ast.parse(self.files[path]) for path in self.paths(".py")}

    @cached_property
    def classes(self) -> list[tuple[str, ast.ClassDef]]:
        """All Python classes at the top of a file, with its path."""
        return [(p, node) for p, tree in self.modules.items() for node in tree.body if isinstance(node, ast.ClassDef)]


def is_product(path: str) -> bool:
    """Whether a path can hold product code."""
    if not path.startswith(PRODUCT) or PurePosixPath(path).suffix not in SUFFIXES or TEST_FILE.search(path):
        return False
    return not path.startswith("crates/") or "/src/" in path


def product(texts: Iterable[tuple[str, str]]) -> Tree:
    """The hand-written product among files of a tree."""
    files = {}
    for path, text in texts:
        if is_product(path) and not GENERATED.search("\n".join(text.splitlines()[:3])):
            files[path] = RUST_TEST.sub("", text) if path.endswith(".rs") else text
    return Tree(files)


def part_of(path: str) -> str:
    """``crates/grid``, ``python/carina/track``, ``web/src/state``; a file in a folder of parts is a part."""
    pieces = path.split("/")
    depth = 2 if pieces[0] == "crates" else 3
    return "/".join(pieces[:depth])


# ---------------------------------------------------------------- lines


def lines_per_part(tree: Tree) -> dict[str, int]:
    """Lines that are not blank, comments and docstrings included."""
    counted: Counter[str] = Counter()
    for path, text in tree.files.items():
        counted[part_of(path)] += sum(1 for line in text.splitlines() if line.strip())
    return dict(sorted(counted.items()))


# ---------------------------------------------------------------- views


def _python_strings(module: ast.Module) -> Iterator[str]:
    for node in ast.walk(module):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def files_naming_views(tree: Tree, views: Iterable[str] = VIEWS) -> dict[str, list[str]]:
    """For each view the files that name it."""
    naming: dict[str, list[str]] = {view: [] for view in views}
    for path, text in sorted(tree.files.items()):
        if path.endswith(".py"):
            named = set(_python_strings(tree.modules[path]))
        else:
            named = {match[2] for match in TEXT_STRING.finditer(text)}
            if path.endswith((".ts", ".tsx")):
                named |= set(OBJECT_KEY.findall(text))
        for view, files in naming.items():
            head, dash, _ = view.partition("-")
            # A family is named by its beginning too: startsWith("xray").
            family = {head, head + dash} if dash and sum(v.startswith(head + dash) for v in naming) > 1 else set()
            if named & {view, *family}:
                files.append(path)
    return naming


# ---------------------------------------------------------------- classes that repeat another


def _fields_of(node: ast.ClassDef) -> frozenset[tuple[str, str]]:
    fields = set()
    for statement in node.body:
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            kind = ast.unparse(statement.annotation)
            # What tells classes of a union apart is no field that two of them share.
            if "ClassVar" not in kind and not re.fullmatch(r"""Literal\[['"][^,]*['"]\]""", kind):
                fields.add((statement.target.id, kind))
    return frozenset(fields)


def record_classes(tree: Tree) -> dict[str, frozenset[tuple[str, str]]]:
    """Fields (name, type as written) of each class that is a record: dataclasses, structs of codecs, named tuples.

    A class that inherits from a record is one.
    """
    by_name = {node.name: node for _, node in tree.classes}

    def is_record(node: ast.ClassDef, seen: frozenset[str] = frozenset()) -> bool:
        if any("dataclass" in ast.unparse(d) for d in node.decorator_list):
            return True
        for base in node.bases:
            name = ast.unparse(base).split("[")[0].split(".")[-1]
            if name in {"Struct", "NamedTuple", "TypedDict"}:
                return True
            if name in by_name and name not in seen and is_record(by_name[name], seen | {node.name}):
                return True
        return False

    return {f"{path}:{node.name}": _fields_of(node) for path, node in tree.classes if is_record(node)}


def rust_structs(tree: Tree) -> dict[str, frozenset[tuple[str, str]]]:
    """Fields of each Rust struct with named fields."""
    return {
        f"{path}:{match[1]}": frozenset((name, kind) for name, kind in RUST_FIELD.findall(match[2]))
        for path in tree.paths(".rs")
        for match in RUST_STRUCT.finditer(tree.files[path])
    }


def repeating(classes: dict[str, frozenset[tuple[str, str]]], *, least: int) -> dict[str, tuple[str, float]]:
    """Classes of at least ``least`` fields of which 60 % stand in another, with that other and the share."""
    found = {}
    kept = {name: fields for name, fields in classes.items() if len(fields) >= least}
    for name, fields in kept.items():
        share, other = max(
            ((len(fields & others) / len(fields), other) for other, others in kept.items() if other != name),
            default=(0.0, ""),
        )
        if share >= REPEATED:
            found[name] = (other, round(share, 2))
    return found


# ---------------------------------------------------------------- one class


def _lineage(tree: Tree, name: str) -> list[ast.ClassDef]:
    """A class and all it inherits from in the product."""
    by_name = {node.name: node for _, node in tree.classes}
    found: dict[str, ast.ClassDef] = {}

    def visit(name: str) -> None:
        if name in by_name and name not in found:
            found[name] = by_name[name]
            for base in by_name[name].bases:
                visit(ast.unparse(base).split("[")[0].split(".")[-1])

    visit(name)
    return list(found.values())


def public_methods(tree: Tree, name: str) -> list[str] | None:
    """Public methods and properties of a class with what it inherits; None where no class of that name has any."""
    lineage = _lineage(tree, name)
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    names = {s.name for node in lineage for s in node.body if isinstance(s, functions)}
    return sorted(n for n in names if not n.startswith("_")) or None


def attributes(tree: Tree, name: str) -> dict[str, str] | None:
    """Attributes of a class, as fields or set on ``self`` when it is made, with their types as written."""
    lineage = _lineage(tree, name)
    if not lineage:
        return None
    found: dict[str, str] = {}
    for node in reversed(lineage):
        for statement in ast.walk(node):
            if isinstance(statement, ast.AnnAssign):
                target, kind = statement.target, ast.unparse(statement.annotation)
                is_field = isinstance(target, ast.Name) and statement in node.body
                if is_field and "ClassVar" not in kind:
                    found[ast.unparse(target)] = kind
                elif _is_own(target):
                    found[target.attr] = kind
            elif isinstance(statement, ast.Assign):
                for target in statement.targets:
                    if _is_own(target):
                        found.setdefault(target.attr, "")
    return found


def _is_own(target: ast.expr) -> bool:
    return isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name) and target.value.id == "self"


# ---------------------------------------------------------------- circles of files


def _python_edges(tree: Tree) -> Iterator[tuple[str, str]]:
    """Imports between files of one part, those for types and those inside functions included."""
    module_files = {}
    for path in tree.modules:
        dotted = path.removeprefix("python/").removesuffix(".py").replace("/", ".")
        module_files[dotted.removesuffix(".__init__")] = path
    for path, module in tree.modules.items():
        own = next(dotted for dotted, file in module_files.items() if file == path)
        package = own if path.endswith("__init__.py") else own.rpartition(".")[0]
        for node in ast.walk(module):
            targets: list[str] = []
            if isinstance(node, ast.Import):
                targets = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                base = node.module or ""
                if node.level:
                    up = package.split(".")[: len(package.split(".")) - node.level + 1]
                    base = ".".join([*up, *([node.module] if node.module else [])])
                for alias in node.names:
                    inner = f"{base}.{alias.name}"
                    targets.append(inner if inner in module_files else base)
            for target in targets:
                if target in module_files:
                    yield path, module_files[target]


def _rust_uses(text: str) -> Iterator[tuple[str, list[str]]]:
    """Paths that begin at the crate or the parent, as (start, names)."""
    code = re.sub(r"//[^\n]*", "", text)
    for start, trail, group in RUST_PATH.findall(code):
        names = [name for name in trail.split("::") if name]
        if not group:
            yield start, names
        else:
            for entry in re.split(r",(?![^{]*\})", group):
                head = re.match(r"\s*(\w+(?:::\w+)*)", entry)
                yield start, names + (head[1].split("::") if head else [])


def _rust_edges(tree: Tree) -> Iterator[tuple[str, str]]:
    """Uses between files of one crate. The root, which lists the modules, only hands on what it re-exports."""
    for crate in sorted({part_of(path) for path in tree.paths(".rs")}):
        source = f"{crate}/src/"
        module_files: dict[tuple[str, ...], str] = {}
        for path in tree.paths(".rs"):
            if path.startswith(source):
                pieces = tuple(path.removeprefix(source).removesuffix(".rs").split("/"))
                module_files[pieces[:-1] if pieces[-1] in {"mod", "lib"} else pieces] = path
        root = module_files.get(())
        handed_on = {}
        if root:
            for module, names in re.findall(r"pub(?:\([a-z]+\))? use (\w+)::\{?([^;]*?)\}?;", tree.files[root]):
                handed_on.update(dict.fromkeys(re.findall(r"\w+", names), (module,)))
        for own, path in module_files.items():
            for start, names in _rust_uses(tree.files[path]):
                full = [*own[:-1], *names] if start == "super" else names
                if full and full[0] in handed_on:
                    full = [*handed_on[full[0]]]
                while full and tuple(full) not in module_files:
                    full.pop()
                target = module_files.get(tuple(full))
                if target and target not in {root, path} and path != root:
                    yield path, target


def _web_edges(tree: Tree) -> Iterator[tuple[str, str]]:
    paths = {*tree.paths(".ts"), *tree.paths(".tsx")}
    for path in sorted(paths):
        for target in TS_IMPORT.findall(tree.files[path]):
            pieces = list(PurePosixPath(path).parent.parts)
            for piece in target.split("/"):
                if piece == "..":
                    pieces.pop()
                elif piece != ".":
                    pieces.append(piece)
            stem = "/".join(pieces)
            for candidate in (stem, f"{stem}.ts", f"{stem}.tsx", f"{stem}/index.ts", f"{stem}/index.tsx"):
                if candidate in paths:
                    yield path, candidate
                    break


def file_circles(tree: Tree) -> list[list[str]]:
    """Groups of files of one part that import each other in a circle (strongly connected, two or more)."""
    graph: dict[str, set[str]] = {path: set() for path in tree.files}
    for edges in (_python_edges(tree), _rust_edges(tree), _web_edges(tree)):
        for path, target in edges:
            if path != target and part_of(path) == part_of(target):
                graph[path].add(target)
    return sorted(sorted(group) for group in _strongly_connected(graph) if len(group) > 1)


def _strongly_connected(graph: dict[str, set[str]]) -> Iterator[list[str]]:
    """Kosaraju's two passes, without recursion."""
    order: list[str] = []
    seen: set[str] = set()
    for start in sorted(graph):
        stack = [(start, iter(sorted(graph[start])))] if start not in seen else []
        seen.add(start)
        while stack:
            node, rest = stack[-1]
            following = next((n for n in rest if n not in seen), None)
            if following is None:
                order.append(node)
                stack.pop()
            else:
                seen.add(following)
                stack.append((following, iter(sorted(graph[following]))))
    back: dict[str, set[str]] = {node: set() for node in graph}
    for node, targets in graph.items():
        for target in targets:
            back[target].add(node)
    left = set(graph)
    for start in reversed(order):
        if start in left:
            group, reach = [], [start]
            left.discard(start)
            while reach:
                node = reach.pop()
                group.append(node)
                reach += sorted(back[node] & left)
                left -= back[node]
            yield group


# ---------------------------------------------------------------- all of it


@dataclass
class House:
    """All figures of one tree."""

    lines: dict[str, int]
    views: dict[str, list[str]]
    record_classes: int
    repeating: dict[str, tuple[str, float]]
    """By at least one field, as classes of the wire have."""
    repeating_two: dict[str, tuple[str, float]]
    """By at least two fields."""
    structs: int
    structs_repeating: dict[str, tuple[str, float]]
    methods: dict[str, list[str] | None]
    open_case: dict[str, str] | None
    circles: list[list[str]] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return dict(vars(self))


def count(tree: Tree) -> House:
    """Count a tree."""
    records, structs = record_classes(tree), rust_structs(tree)
    return House(
        lines=lines_per_part(tree),
        views=files_naming_views(tree),
        record_classes=len(records),
        repeating=repeating(records, least=1),
        repeating_two=repeating(records, least=2),
        structs=len(structs),
        structs_repeating=repeating(structs, least=2),
        methods={name: public_methods(tree, name) for name in ("Session", "Case")},
        open_case=attributes(tree, "OpenCase"),
        circles=file_circles(tree),
    )


def report(house: House) -> str:
    """The figures as a table; ``--json`` names the files."""
    rows = [f"{'product lines (not blank)':<44}{sum(house.lines.values()):>7}"]
    rows += [f"  {part:<42}{lines:>7}" for part, lines in house.lines.items()]
    rows.append("files that name a view")
    rows += [f"  {view:<42}{len(files):>7}" for view, files in house.views.items()]
    rows.append(f"{'Python record classes':<44}{house.record_classes:>7}")
    here: Counter[str] = Counter(part_of(name.partition(":")[0]) for name in house.repeating)
    rows.append(f"{'  that repeat 60 % of another':<44}{len(house.repeating):>7}")
    rows += [f"    {part:<40}{number:>7}" for part, number in sorted(here.items())]
    rows.append(f"{'  ... of those with two fields or more':<44}{len(house.repeating_two):>7}")
    rows.append(f"{'Rust structs with two fields or more':<44}{house.structs:>7}")
    rows.append(f"{'  that repeat 60 % of another':<44}{len(house.structs_repeating):>7}")
    for name, methods in house.methods.items():
        rows.append(f"{'public methods of ' + name:<44}{'none' if methods is None else len(methods):>7}")
    if house.open_case is not None:
        loose = sum(1 for kind in house.open_case.values() if re.search(r"\bAny\b", kind))
        rows.append(f"{'attributes of OpenCase':<44}{len(house.open_case):>7}")
        rows.append(f"{'  with Any in their type':<44}{loose:>7}")
    rows.append(f"{'circles of files inside a part':<44}{len(house.circles):>7}")
    for circle in house.circles:
        names = ", ".join(path.removeprefix(part_of(path) + "/") for path in circle)
        rows.append(f"  {part_of(circle[0])}: {names}")
    return "\n".join(rows)


def overgrown(house: House) -> list[str]:
    """What is larger than it may be, each in a sentence."""
    found = [
        f"{len(files)} files name the view {view!r} (at most {MOST_FILES_PER_VIEW}): {', '.join(files)}"
        for view, files in house.views.items()
        if len(files) > MOST_FILES_PER_VIEW and view not in PLAIN_WORDS
    ]
    if len(house.repeating_two) > MOST_REPEATING:
        pairs = ", ".join(f"{name} {other}" for name, (other, _) in house.repeating_two.items())
        found.append(f"{len(house.repeating_two)} classes repeat another (at most {MOST_REPEATING}): {pairs}")
    for name, methods in house.methods.items():
        if len(methods or ()) > MOST_METHODS:
            found.append(f"{name} has {len(methods or ())} public methods (at most {MOST_METHODS})")
    if len(house.open_case or {}) > MOST_ATTRIBUTES:
        found.append(f"OpenCase has {len(house.open_case or {})} attributes (at most {MOST_ATTRIBUTES})")
    loose = [name for name, kind in (house.open_case or {}).items() if re.search(r"\bAny\b", kind)]
    if loose:
        found.append(f"attributes of OpenCase without a type: {', '.join(loose)}")
    found += [f"files import each other in a circle: {', '.join(circle)}" for circle in house.circles]
    return found


def read_folder(root: Path, names: Iterable[str]) -> Tree:
    """The product among named files of a folder."""
    return product(
        (name, (root / name).read_text(encoding="utf-8"))
        for name in names
        if is_product(name) and (root / name).is_file()
    )


def read_working_tree() -> Tree:
    """Files that git knows, as they lie in the folder."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True)
    return read_folder(ROOT, listed.stdout.decode().split("\0"))


def read_revision(revision: str) -> Tree:
    """Files of a revision, unpacked into a folder that is gone afterwards."""
    archive = subprocess.run(["git", "archive", revision], cwd=ROOT, check=False, capture_output=True)
    if archive.returncode:
        sys.exit(f"git knows no revision {revision!r}: {archive.stderr.decode().strip()}")
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(archive.stdout)) as tar:
        tar.extractall(folder, filter="data")
        return read_folder(Path(folder), [entry.name for entry in tar.getmembers() if entry.isfile()])


def main(arguments: list[str] | None = None) -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--at", metavar="REV", help="a git revision; the working tree unless told")
    parser.add_argument("--json", action="store_true", help="all figures, with the files' names")
    parser.add_argument("--check", action="store_true", help="only what is larger than it may be")
    told = parser.parse_args(arguments)
    house = count(read_revision(told.at) if told.at else read_working_tree())
    if told.check:
        found = overgrown(house)
        print("\n".join(found) or "house: nothing is larger than it may be")
        return 1 if found else 0
    print(json.dumps(house.as_json(), indent=1) if told.json else report(house))
    return 0


if __name__ == "__main__":
    sys.exit(main())
