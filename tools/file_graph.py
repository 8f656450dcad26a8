"""Graph of the imports between the files of Carina, and its cycles.

The files of a cycle cannot be read, tested or moved separately. Shared code of a cycle belongs in a file that all of
them import. ``check_layers.py`` rejects every cycle; this program prints the cycles, and the number of files and layers
of each folder.

Every import counts: an import inside a function hides a cycle from the interpreter, one under ``TYPE_CHECKING`` also
from type checkers, but the files still depend on each other. Tests may import any file: a cycle through a test does not
count.
"""

from __future__ import annotations

import ast
import itertools
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True, slots=True)
class Import:
    """Import of one file by another, with its line and kind."""

    source: Path
    line: int
    target: Path
    kind: str
    """``import``, ``function`` (import inside a function) or ``types`` (import only for type checkers)."""


# ---------------------------------------------------------------- imports of Python files


def _python_modules(packages: Iterable[Path]) -> dict[str, Path]:
    modules = {}
    for package in packages:
        # The stub file represents the compiled module in the graph.
        for path in [*package.rglob("*.py"), *package.glob("_*.pyi")]:
            pieces = path.relative_to(package.parent).with_suffix("").parts
            modules[".".join(pieces[:-1] if pieces[-1] == "__init__" else pieces)] = path
    return modules


def _is_type_checking(test: ast.expr) -> bool:
    return (isinstance(test, ast.Name) and test.id == "TYPE_CHECKING") or (
        isinstance(test, ast.Attribute) and test.attr == "TYPE_CHECKING"
    )


def _import_nodes(node: ast.AST, kind: str = "import") -> Iterator[tuple[ast.Import | ast.ImportFrom, str]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child, kind
        elif isinstance(child, ast.If) and _is_type_checking(child.test):
            for inner in child.body:
                yield from _import_nodes(ast.Module([inner], []), "types")
            for inner in child.orelse:
                yield from _import_nodes(ast.Module([inner], []), kind)
        elif isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from _import_nodes(child, "types" if kind == "types" else "function")
        else:
            yield from _import_nodes(child, kind)


def python_imports(packages: Iterable[Path]) -> list[Import]:
    """Return the imports between the files of Python packages.

    ``from a import b`` refers to the file of ``a.b`` if that file exists, else to the file of ``a``.
    """
    modules = _python_modules(packages)
    found = []
    for name, path in sorted(modules.items()):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        for node, kind in _import_nodes(tree):
            if isinstance(node, ast.Import):
                targets = [alias.name for alias in node.names]
            else:
                base = node.module or ""
                if node.level:
                    above = package.split(".")[: len(package.split(".")) - node.level + 1]
                    base = ".".join([*above, base] if base else above)
                targets = [
                    f"{base}.{alias.name}" if f"{base}.{alias.name}" in modules else base for alias in node.names
                ]
            for target in targets:
                if target in modules and modules[target] != path:
                    found.append(Import(path, node.lineno, modules[target], kind))
    return found


# ---------------------------------------------------------------- imports of Rust files

_RUST_TOKENS = re.compile(
    r"""
    (?P<comment>//[^\n]*|/\*.*?\*/)
  | (?P<string>b?r(?P<hashes>\#*)".*?"(?P=hashes)|b?"(?:\\.|[^"\\])*"|b?'(?:\\.[^']*|[^'\\])')
    """,
    re.VERBOSE | re.DOTALL,
)
"""Pattern of a comment or a string literal in Rust."""
_RUST_MODULE = re.compile(r"((?:\#\[[^\]]*\]\s*)*)(?:pub(?:\([^)]*\))?\s+)?mod\s+(\w+)\s*([;{])")
"""Pattern of the declaration of a Rust module: its attributes, its name, and `;` (in another file) or `{` (inline)."""
_RUST_USE = re.compile(r"\b(pub(?:\([^)]*\))?\s+)?use\s+([^;]+);")
"""Pattern of a use declaration in Rust: its visibility and the used paths."""
_RUST_PATH = re.compile(r"(?<![\w:])(\w+(?:::\w+)+)")
"""Pattern of a Rust path of two or more names."""


def _blanked(text: str) -> str:
    """Return the text with comments and strings replaced by blanks, so that offsets and lines stay."""
    return _RUST_TOKENS.sub(lambda match: re.sub(r"[^\n]", " ", match.group()), text)


def without_tests(text: str) -> str:
    """Return the text of a Rust file without the modules that are compiled only for tests."""
    for match in reversed(list(_RUST_MODULE.finditer(text))):
        if "cfg(test)" not in match.group(1).replace(" ", ""):
            continue
        end = match.end()
        depth = 1 if match.group(3) == "{" else 0
        while depth:
            depth += {"{": 1, "}": -1}.get(text[end], 0)
            end += 1
        text = text[: match.start()] + re.sub(r"[^\n]", " ", text[match.start() : end]) + text[end:]
    return text


def _leaves(tree: str, before: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the path and the local name of each item that a ``use`` tree imports."""
    tree = tree.strip()
    brace = tree.find("{")
    if brace >= 0:
        head = tuple(piece for piece in tree[:brace].replace(" ", "").split("::") if piece)
        depth, start = 0, brace + 1
        inner = tree[brace + 1 : tree.rindex("}")]
        start = 0
        for at, character in enumerate([*inner, ","]):
            depth += {"{": 1, "}": -1}.get(character, 0)
            if character == "," and depth == 0:
                if inner[start:at].strip():
                    yield from _leaves(inner[start:at], before + head)
                start = at + 1
        return
    path, _, name = tree.partition(" as ")
    pieces = before + tuple(piece.strip() for piece in path.split("::"))
    if pieces[-1] == "self":
        pieces = pieces[:-1]
    yield pieces, name.strip() or pieces[-1]


@dataclass(slots=True)
class _RustFile:
    path: Path
    module: tuple[str, ...]
    text: str
    names: dict[str, tuple[str, ...]]
    """Path as written of each local name that the file imports by ``use``."""
    globs: list[tuple[str, ...]]


def _read_crate(source: Path) -> dict[tuple[str, ...], _RustFile]:
    files: dict[tuple[str, ...], _RustFile] = {}
    waiting: list[tuple[tuple[str, ...], Path]] = [((), source / "lib.rs")]
    while waiting:
        module, path = waiting.pop()
        text = without_tests(_blanked(path.read_text(encoding="utf-8")))
        files[module] = _RustFile(path, module, text, {}, [])
        inner = _inline_modules(text)
        for match in _RUST_USE.finditer(text):
            if any(begin <= match.start() < end for begin, end, _ in inner):
                continue
            for pieces, name in _leaves(match.group(2)):
                if name == "*":
                    files[module].globs.append(pieces[:-1])
                else:
                    files[module].names[name] = pieces
        folder = path.parent if path.name in {"lib.rs", "mod.rs"} else path.with_suffix("")
        for match in _RUST_MODULE.finditer(text):
            if match.group(3) == ";":
                name = match.group(2)
                beside, inside = folder / f"{name}.rs", folder / name / "mod.rs"
                waiting.append(((*module, name), beside if beside.exists() else inside))
    return files


def _resolve(
    files: Mapping[tuple[str, ...], _RustFile], module: tuple[str, ...], pieces: tuple[str, ...], depth: int = 0
) -> Path | None:
    """Return the file that defines the item of a path, also through re-exports; None if it is outside the crate.

    ``module`` may be a module inside a file.
    """
    if pieces[0] == "crate":
        at, rest = (), pieces[1:]
    elif pieces[0] == "self":
        at, rest = module, pieces[1:]
    elif pieces[0] == "super":
        at, rest = module, pieces
        while rest and rest[0] == "super":
            at, rest = at[:-1], rest[1:]
    elif (*module, pieces[0]) in files:
        at, rest = module, pieces
    else:
        return None
    while rest and (*at, rest[0]) in files:
        at, rest = (*at, rest[0]), rest[1:]
    while at not in files:
        at = at[:-1]
    holder = files[at]
    if rest and depth < 8:
        again = holder.names.get(rest[0])
        if again is not None:
            return _resolve(files, at, again + rest[1:], depth + 1)
        # The item may be re-exported by a glob, so the target of each glob is searched.
        for glob in holder.globs:
            found = _resolve(files, at, glob, depth + 1)
            if found is not None and re.search(
                rf"\b(?:fn|struct|enum|trait|type|const|static|use)\b[^;]*\b{rest[0]}\b",
                next(file.text for file in files.values() if file.path == found),
            ):
                return found
    return holder.path


def _inline_modules(text: str) -> list[tuple[int, int, str]]:
    """Return the begin, the end (offsets) and the name of each module inside a file."""
    found = []
    for match in _RUST_MODULE.finditer(text):
        if match.group(3) == "{":
            end, depth = match.end(), 1
            while depth:
                depth += {"{": 1, "}": -1}.get(text[end], 0)
                end += 1
            found.append((match.start(), end, match.group(2)))
    return found


def rust_imports(source: Path) -> list[Import]:
    """Return the references between the modules of one crate, in ``use`` and in code, without tests."""
    files = _read_crate(source)
    found = []
    for module, file in sorted(files.items()):
        spans = []
        named: list[tuple[int, tuple[str, ...]]] = []
        for match in _RUST_USE.finditer(file.text):
            spans.append(match.span())
            named += [(match.start(), pieces) for pieces, _ in _leaves(match.group(2))]
        blank = list(file.text)
        for start, end in spans:
            blank[start:end] = " " * (end - start)
        for match in _RUST_PATH.finditer("".join(blank)):
            named.append((match.start(), tuple(match.group(1).split("::"))))
        inner = _inline_modules(file.text)
        for at, pieces in named:
            inside = tuple(name for begin, end, name in inner if begin <= at < end)
            target = _resolve(files, module + inside, tuple(piece for piece in pieces if piece != "*"))
            if target is not None and target != file.path:
                found.append(Import(file.path, file.text.count("\n", 0, at) + 1, target, "import"))
    return found


# ---------------------------------------------------------------- imports of TypeScript files

_TYPESCRIPT_IMPORT = re.compile(
    r"""\b(?:(import|export)\s+(type\s)?[^"';()]*?\bfrom\s*|(import)\s*\(?\s*)["'](\.[^"']+)["']"""
)
"""Pattern of an import or re-export of a relative path in TypeScript."""


def is_test(path: Path) -> bool:
    """Return whether a file of the web client is a test or a helper of tests."""
    return ".test." in path.name or path.name.startswith("testing")


def typescript_imports(source: Path) -> list[Import]:
    """Return the relative imports and re-exports between the files of the web client, without tests."""
    found = []
    for path in sorted([*source.rglob("*.ts"), *source.rglob("*.tsx")]):
        if is_test(path):
            continue
        text = path.read_text(encoding="utf-8")
        for match in _TYPESCRIPT_IMPORT.finditer(text):
            base = (path.parent / match.group(4)).resolve()
            names = (base, Path(f"{base}.ts"), Path(f"{base}.tsx"), base / "index.ts")
            target = next((name for name in names if name.is_file()), None)
            if target is not None and target != path:
                kind = "types" if match.group(2) else "import"
                found.append(Import(path, text.count("\n", 0, match.start()) + 1, target, kind))
    return found


# ---------------------------------------------------------------- cycles and layers of the graph


def _components(edges: Mapping[Path, set[Path]]) -> list[list[Path]]:
    """Return the strongly connected components of a graph (Tarjan 1972), dependencies first."""
    order: dict[Path, int] = {}
    low: dict[Path, int] = {}
    stack: list[Path] = []
    held: set[Path] = set()
    found: list[list[Path]] = []

    def visit(file: Path) -> None:
        order[file] = low[file] = len(order)
        stack.append(file)
        held.add(file)
        for other in sorted(edges.get(file, ())):
            if other not in order:
                visit(other)
                low[file] = min(low[file], low[other])
            elif other in held:
                low[file] = min(low[file], order[other])
        if low[file] == order[file]:
            component = []
            while not component or component[-1] != file:
                component.append(stack.pop())
                held.discard(component[-1])
            found.append(sorted(component))

    for file in sorted(edges):
        if file not in order:
            visit(file)
    return found


def _edges(imports: Iterable[Import]) -> dict[Path, set[Path]]:
    edges: dict[Path, set[Path]] = {}
    for found in imports:
        edges.setdefault(found.source, set()).add(found.target)
        edges.setdefault(found.target, set())
    return edges


def circles(imports: Iterable[Import]) -> list[list[Import]]:
    """Return one shortest cycle of imports for each strongly connected component of several files."""
    imports = list(imports)
    edges = _edges(imports)
    found = []
    for knot in _components(edges):
        if len(knot) < 2:
            continue
        inside = set(knot)
        best: list[Path] = []
        for start in knot:
            came: dict[Path, Path] = {}
            front = [start]
            while front and start not in came:
                nexts = []
                for file in front:
                    for other in sorted(edges[file] & inside):
                        if other not in came:
                            came[other] = file
                            nexts.append(other)
                front = nexts
            way = [start]
            while len(way) == 1 or way[-1] != start:
                way.append(came[way[-1]])
            if not best or len(way) < len(best):
                best = way[::-1]
        found.append(
            [next(one for one in imports if (one.source, one.target) == pair) for pair in itertools.pairwise(best)]
        )
    return found


def floors(imports: Iterable[Import], folder: Path) -> int:
    """Return the number of layers of a folder: the length of its longest chain of imports. A cycle is one layer."""
    inside = [one for one in imports if one.source.is_relative_to(folder) and one.target.is_relative_to(folder)]
    edges = _edges(inside)
    height: dict[Path, int] = {}
    for knot in _components(edges):
        below = {height[other] for file in knot for other in edges[file] if other not in knot}
        height.update(dict.fromkeys(knot, 1 + max(below, default=0)))
    return max(height.values(), default=1)


def all_imports(root: Path = ROOT) -> list[Import]:
    """Return every import between files of the product in the three languages."""
    packages = [root / "python" / "carina", root / "benchmarks" / "carina_bench"]
    packages += [path.parent for path in sorted(root.glob("packages/*/*/*/__init__.py"))]
    found = python_imports(packages)
    for source in sorted([*root.glob("crates/*/src"), *root.glob("packages/*/crates/*/src")]):
        found += rust_imports(source)
    return found + typescript_imports(root / "web" / "src")


def in_words(circle: list[Import], root: Path = ROOT) -> str:
    """Return a cycle as text: its files with the lines of the imports."""
    marks = {"import": "", "function": " (inside a function)", "types": " (for types)"}
    return " -> ".join(
        [f"{one.source.relative_to(root)}:{one.line}{marks[one.kind]}" for one in circle]
        + [str(circle[0].source.relative_to(root))]
    )


def main() -> int:
    """Print the cycles and the layers of the folders; return 1 if there is a cycle."""
    imports = all_imports()
    found = circles(imports)
    for circle in found:
        print(in_words(circle))
    knots = [knot for knot in _components(_edges(imports)) if len(knot) > 1]
    print(f"{len(found)} file circles; {sum(map(len, knots))} files in them")
    folders = {one.source.parent for one in imports}
    for folder in sorted(folders):
        files = [path for path in folder.iterdir() if path.suffix in {".py", ".rs", ".ts", ".tsx"}]
        files = [path for path in files if not is_test(path) and not path.stem.endswith("tests")]
        print(f"{folder.relative_to(ROOT)}: {len(files)} files, {floors(imports, folder)} floors")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
