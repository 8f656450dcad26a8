"""Check the architecture: reject forbidden imports, import cycles, and classes and views beyond their limits.

The import rules are the ``layers`` blocks in ARCHITECTURE.md, so that text and check cannot differ. The limits are
constants of this file. Run: ``python tools/check_layers.py`` (part of ``make check``).
"""

from __future__ import annotations

import ast
import graphlib
import re
import sys
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from file_graph import Import, all_imports, circles, in_words, without_tests

ROOT = Path(__file__).resolve().parent.parent
BROWSER = re.compile(
    r"\b(?:(?:document|window|WebSocket|HTMLElement|CanvasRenderingContext2D|localStorage)\b[.(]|(?:performance|Date)\.now\b)"
)
"""Pattern of uses of the browser. Clocks are included, because the pure state receives the time as an argument."""


@dataclass(frozen=True, slots=True)
class Rules:
    """Allowed imports, by the name of the importing part."""

    rust: dict[str, frozenset[str]]
    python: dict[str, frozenset[str]]
    web: dict[str, frozenset[str]]
    compiled: frozenset[str]
    """Python parts that may import the compiled module ``_core``."""
    everywhere: frozenset[str]
    """Python parts that every Python part may import."""
    folders: dict[str, dict[str, frozenset[str]]]
    """Allowed imports between the folders of a Python part, by part and by importing folder."""


def read_rules(text: str) -> Rules:
    """Read the import rules, the fenced ``layers`` blocks of ARCHITECTURE.md.

    There is one block for each language, and one for each part whose folders are ordered.
    """
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
        folders={part: table(block) for part, block in blocks.items() if part not in {"rust", "python", "web"}},
    )


def check_rust(rules: dict[str, frozenset[str]]) -> list[str]:
    """Return the dependencies between crates that break the rules."""
    found = []
    for manifest in sorted([*ROOT.glob("crates/*/Cargo.toml"), *ROOT.glob("packages/*/crates/*/Cargo.toml")]):
        part, where = manifest.parent.name, manifest.parent.relative_to(ROOT)
        data = tomllib.loads(manifest.read_text(encoding="utf-8"))
        uses = {name.removeprefix("carina-") for name in data.get("dependencies", {}) if name.startswith("carina-")}
        if part not in rules:
            found.append(f"{where}: not in ARCHITECTURE.md; add its row")
            continue
        for used in sorted(uses - rules[part]):
            found.append(f"{where} depends on {used}; it may use {sorted(rules[part]) or 'none of our crates'}")
        external = {name for name in data.get("dependencies", {}) if name in {"pyo3", "numpy"}}
        if external and not part.endswith("bindings"):
            found.append(f"{where} depends on {sorted(external)}; only bindings depend on Python")
    return found


PACKAGES = {"carina_bench": "benchmarks", "carina_haptics": "carina_haptics", "carina_haptics_bench": "benchmarks"}
"""Part to which each Python package other than ``carina`` belongs."""


def _part_of(module: str) -> str | None:
    pieces = module.split(".")
    if pieces[0] in PACKAGES:
        return PACKAGES[pieces[0]]
    return pieces[1] if pieces[0] == "carina" and len(pieces) > 1 else None


def _part_of_file(path: Path) -> str:
    """Return the part of a Python file: its package, or its first folder (or the file itself) in ``carina``."""
    package = ROOT / "python" / "carina"
    if path.is_relative_to(package):
        return path.relative_to(package).parts[0].removesuffix(".py")
    return next((PACKAGES[name] for name in path.parts if name in PACKAGES), "benchmarks")


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
    """Return the imports between Python parts that break the rules."""
    found = []
    files = [*(ROOT / "python" / "carina").rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")]
    files += [*ROOT.glob("packages/*/python/**/*.py"), *ROOT.glob("packages/*/benchmarks/**/*.py")]
    for path in sorted(files):
        own = _part_of_file(path)
        # The public interface exports names of every part except the command line; other packages are not part of it.
        allowed = rules.python.keys() - {"cli", *PACKAGES.values()} if own == "__init__" else rules.python.get(own)
        if own == "__main__":  # `python -m carina` is the command line.
            allowed = {"cli"}
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


def check_folders(parts: dict[str, dict[str, frozenset[str]]], imports: list[Import]) -> list[str]:
    """Return the imports between the folders and single files of a Python part that break the rules of this part."""
    found = []
    for part, rules in parts.items():
        try:
            graphlib.TopologicalSorter(rules).prepare()
        except graphlib.CycleError as circle:
            found.append(f"ARCHITECTURE.md: the folders of {part} form a circle: {' -> '.join(circle.args[1])}")
        folder = ROOT / "python" / "carina" / part
        names = {path.stem for path in folder.glob("*.py")} | {path.parent.name for path in folder.glob("*/*.py")}
        names -= {"__init__", "__main__"}
        found += [f"python/carina/{part}/{name}: not in ARCHITECTURE.md; add its row" for name in names - rules.keys()]
        found += [f"ARCHITECTURE.md: python/carina/{part} has no {name}" for name in rules.keys() - names]
        for one in imports:
            if not (one.source.is_relative_to(folder) and one.target.is_relative_to(folder)):
                continue
            own, used = (path.relative_to(folder).parts[0].removesuffix(".py") for path in (one.source, one.target))
            # The `__init__` file of a package re-exports the contents of every folder.
            if own in {used, "__init__", "__main__"} or used in rules.get(own, frozenset()):
                continue
            where = f"{one.source.relative_to(ROOT)}:{one.line}"
            allowed = sorted(rules.get(own, ()))
            found.append(f"{where}: {part}.{own} imports {part}.{used}; it may import {allowed or 'no other folder'}")
    return sorted(set(found))


def check_web(rules: dict[str, frozenset[str]]) -> list[str]:
    """Return the forbidden imports between the folders of web/src, and the uses of the DOM in the pure state."""
    found = []
    source = ROOT / "web" / "src"
    pattern = re.compile(r"""(?:from|import)\s*\(?\s*["'](\.[^"']+)["']""")
    for path in sorted([*source.rglob("*.ts"), *source.rglob("*.tsx")]):
        inside = path.relative_to(source)
        if len(inside.parts) == 1:
            continue
        part = inside.parts[0]
        # A test may import any parts; files of the product may not.
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
            # The state is tested without a browser and replayed without a screen, so it must not use the DOM or clocks.
            if part == "state" and (dom := BROWSER.search(line)):
                found.append(f"web/src/{inside}:{number}: state is pure and may not use {dom.group()}")
    return found


# ---------------------------------------------------------------- limits of classes and views

AMBIGUOUS_VIEWS = frozenset({"tree"})
"""Views whose name has another meaning in the code, so that the files that name the view cannot be counted."""


def view_names() -> frozenset[str]:
    """Return the views of the tables in ``render/view_table.py`` and ``volume/anatomical_planes.py``."""
    found: set[str] = set()
    for file, name in (("render/view_table.py", "ViewName"), ("volume/anatomical_planes.py", "Plane")):
        tree = ast.parse((ROOT / "python" / "carina" / file).read_text(encoding="utf-8"))
        [value] = (
            node.value for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets) == name
        )
        found |= {node.value for node in ast.walk(value) if isinstance(node, ast.Constant)}
    return frozenset(found) - AMBIGUOUS_VIEWS


VIEWS = view_names()
MAX_FILES_PER_VIEW = 4
"""Maximum number of files that may name one view.

A view is one row of a table in each language (docs/decisions/0102).
"""
REPEATED_SHARE = 0.6
"""Share of the fields of a record class which, if another class also has them, makes the class repeating."""
MAX_REPEATING = 5
"""Maximum number of repeating classes.

A repeating class is a record class of two or more fields of which a share of REPEATED_SHARE is also in another class.
"""
MAX_METHODS = {"Session": 15, "Case": 15}
"""Maximum number of public methods and properties by class."""
MAX_ATTRIBUTES = {"OpenCase": 22}
"""Maximum number of attributes of the named classes."""

QUOTED = re.compile(r"""(["'`])([a-z][a-z-]*)\1""")
"""Pattern of a name in quotation marks in a TypeScript or Rust file."""
OBJECT_KEY = re.compile(r"^\s*([a-z]+):\s", re.MULTILINE)
"""Pattern of a key at the start of a line of a TypeScript object."""
TEST_FILE = re.compile(r"\.test\.tsx?$|(^|_)tests\.rs$")
"""Pattern of the names of TypeScript and Rust test files."""
GENERATED = re.compile(r"generated (from|by)|do not edit", re.IGNORECASE)
"""Pattern of the notice at the top of a generated file."""
Fields = frozenset[tuple[str, str]]


def product_files() -> dict[str, str]:
    """Return the text of each source file of the product by its path, without tests and generated files."""
    found = {}
    for folder in (ROOT / "python" / "carina", ROOT / "web" / "src", *sorted(ROOT.glob("crates/*/src"))):
        for path in sorted(folder.rglob("*")):
            if path.suffix not in {".py", ".ts", ".tsx", ".rs", ".wgsl"} or TEST_FILE.search(path.name):
                continue
            text = path.read_text(encoding="utf-8")
            if not GENERATED.search("\n".join(text.splitlines()[:3])):
                found[path.relative_to(ROOT).as_posix()] = without_tests(text) if path.suffix == ".rs" else text
    return found


def files_naming_views(files: Mapping[str, str], trees: Mapping[str, ast.Module]) -> dict[str, list[str]]:
    """Return for each view the files that contain its name as a string or as a key."""
    naming: dict[str, list[str]] = {view: [] for view in sorted(VIEWS)}
    for path, text in files.items():
        if path in trees:
            nodes = (node for node in ast.walk(trees[path]) if isinstance(node, ast.Constant))
            named = {node.value for node in nodes if isinstance(node.value, str)}
        else:
            named = {quoted for _, quoted in QUOTED.findall(text)}
            if path.endswith((".ts", ".tsx")):
                named |= set(OBJECT_KEY.findall(text))
        for view, found in naming.items():
            head, dash, _ = view.partition("-")
            family = {head, head + dash} if sum(one.startswith(head + "-") for one in VIEWS) > 1 else set()
            if named & {view, *family}:
                found.append(path)
    return naming


def _bases(node: ast.ClassDef) -> list[str]:
    return [ast.unparse(base).split("[")[0].split(".")[-1] for base in node.bases]


def _fields_of(node: ast.ClassDef) -> Fields:
    fields = set()
    for statement in node.body:
        if isinstance(statement, ast.AnnAssign) and isinstance(statement.target, ast.Name):
            kind = ast.unparse(statement.annotation)
            # The tag that distinguishes the classes of a union is not a shared field.
            if "ClassVar" not in kind and not re.fullmatch(r"""Literal\[['"][^,]*['"]\]""", kind):
                fields.add((statement.target.id, kind))
    return frozenset(fields)


def record_classes(classes: Iterable[tuple[str, ast.ClassDef]]) -> dict[str, Fields]:
    """Return the fields (name, type) of each record class, by class name.

    Record classes are dataclasses, msgspec structs, named tuples and their subclasses.
    """
    classes = list(classes)
    by_name = {node.name: node for _, node in classes}

    def is_record(node: ast.ClassDef, seen: frozenset[str] = frozenset()) -> bool:
        if any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list):
            return True
        return any(
            base in {"Struct", "NamedTuple", "TypedDict"}
            or (base in by_name and base not in seen and is_record(by_name[base], seen | {node.name}))
            for base in _bases(node)
        )

    return {f"{path}:{node.name}": _fields_of(node) for path, node in classes if is_record(node)}


def repeating(classes: Mapping[str, Fields]) -> dict[str, str]:
    """Return each repeating class, with the name of the class of which it repeats most fields."""
    found = {}
    records = {name: fields for name, fields in classes.items() if len(fields) > 1}
    for name, fields in records.items():
        shares = ((len(fields & others) / len(fields), other) for other, others in records.items() if other != name)
        share, other = max(shares, default=(0.0, ""))
        if share >= REPEATED_SHARE:
            found[name] = other
    return found


def defined_twice(classes: Iterable[tuple[str, ast.ClassDef]]) -> dict[str, list[str]]:
    """Return each public class name that several files define, with these files."""
    files: dict[str, list[str]] = {}
    for path, node in classes:
        if not node.name.startswith("_"):
            files.setdefault(node.name, []).append(path)
    return {name: paths for name, paths in files.items() if len(paths) > 1}


def _lineage(classes: Mapping[str, ast.ClassDef], name: str, seen: tuple[str, ...] = ()) -> list[ast.ClassDef]:
    """Return a class and the classes that it inherits from, if they are in the product."""
    if name not in classes or name in seen:
        return []
    above = (_lineage(classes, base, (*seen, name)) for base in _bases(classes[name]))
    return [classes[name], *(node for nodes in above for node in nodes)]


def public_methods(lineage: Iterable[ast.ClassDef]) -> set[str]:
    """Return the public methods and properties of a class, inherited ones included."""
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    names = {one.name for node in lineage for one in node.body if isinstance(one, functions)}
    return {name for name in names if not name.startswith("_")}


def attributes(lineage: Iterable[ast.ClassDef]) -> dict[str, str]:
    """Return the attributes of a class with their annotated types.

    The type of an attribute that is set on ``self`` without annotation is "".
    """
    found: dict[str, str] = {}
    for node in lineage:
        found.update(_fields_of(node))
        for statement in ast.walk(node):
            if isinstance(statement, ast.AnnAssign):
                targets: list[ast.expr] = [statement.target]
                kind = ast.unparse(statement.annotation)
            elif isinstance(statement, ast.Assign):
                targets, kind = statement.targets, ""
            else:
                continue
            for target in targets:
                if isinstance(target, ast.Attribute) and ast.unparse(target.value) == "self":
                    found[target.attr] = found.get(target.attr) or kind
    return found


def check_limits(files: Mapping[str, str]) -> list[str]:
    """Return a line for each view, class or group of classes that exceeds its limit."""
    trees = {path: ast.parse(text) for path, text in files.items() if path.endswith(".py")}
    classes = [(path, node) for path, tree in trees.items() for node in tree.body if isinstance(node, ast.ClassDef)]
    by_name = {node.name: node for _, node in classes}
    found = [
        f"{len(named)} files name the view {view!r} (at most {MAX_FILES_PER_VIEW}): {', '.join(named)}"
        for view, named in files_naming_views(files, trees).items()
        if len(named) > MAX_FILES_PER_VIEW
    ]
    repeated = repeating(record_classes(classes))
    if len(repeated) > MAX_REPEATING:
        pairs = ", ".join(f"{name} {other}" for name, other in repeated.items())
        found.append(f"{len(repeated)} classes repeat another (at most {MAX_REPEATING}): {pairs}")
    found += [
        f"class {name} is defined {len(paths)} times: {', '.join(paths)}; use one class, or name what differs"
        for name, paths in sorted(defined_twice(classes).items())
    ]
    for name in (*MAX_METHODS, *MAX_ATTRIBUTES):
        if name not in by_name:
            found.append(f"no class {name} in python/carina: correct the limits in tools/check_layers.py")
    for name, most in MAX_METHODS.items():
        methods = public_methods(_lineage(by_name, name))
        if len(methods) > most:
            found.append(f"{name} has {len(methods)} public methods (at most {most})")
    for name, most in MAX_ATTRIBUTES.items():
        kinds = attributes(_lineage(by_name, name))
        if len(kinds) > most:
            found.append(f"{name} has {len(kinds)} attributes (at most {most})")
        loose = sorted(attribute for attribute, kind in kinds.items() if re.search(r"\bAny\b", kind))
        if loose:
            found.append(f"attributes of {name} without a type: {', '.join(loose)}")
    return found


def main() -> int:
    """Print every violation of the rules of ARCHITECTURE.md and of the limits; return 1 if there is one."""
    rules = read_rules((ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8"))
    imports = all_imports()
    found = [
        *check_rust(rules.rust),
        *check_python(rules),
        *check_folders(rules.folders, imports),
        *check_web(rules.web),
        *check_limits(product_files()),
    ]
    # Files of one part may import each other, but without a cycle: shared code belongs in a file that both import.
    found += [f"circle: {in_words(circle)}" for circle in circles(imports)]
    for line in found:
        print(line)
    print(
        f"layers: {len(found)} faults"
        if found
        else "layers: imports follow ARCHITECTURE.md without circles, and no limit is exceeded"
    )
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
