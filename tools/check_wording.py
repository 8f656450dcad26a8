"""Check text for users in all parts of the code, and reject wrong phrases.

``python tools/check_wording.py`` (in ``make check``) collects the sentences of the window, the phone page, the command
line and the messages from the syntax trees and compares each with the rules of ``tools/wrong_words.toml``. ``--list
window`` prints the sentences of one surface, and ``--draw 100 --seed 13`` prints a random sample for a reader who has
not seen the code. The sentences are not stored; docs/decisions/0131 gives the reason.
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
SURFACES = {
    "window": "The workstation's window",
    "phone": "The phone page",
    "cli": "The command line",
    "messages": "Errors, notes and names that Python and Rust pass to every surface",
}
"""Surfaces on which users read text, with their titles."""
PROSE = re.compile(r"[A-Za-z\u00c0-\u024f)}\]][,.;:]? +[(\u201c\"{\[]?[A-Za-z\u00c0-\u024f{]")
"""Pattern of two consecutive words, by which text for users is recognised."""
UNREAD_CALLS = {"compile", "sub", "match", "search", "fullmatch", "TypeVar", "getenv", "TypeAdapter", "debug"}
"""Names of functions whose string arguments are not text for users."""
PROGRAMS = {"python/carina/server/wire/generate.py"}
"""Files of programs that generate TypeScript; their strings are code."""
MARKUP = re.compile(
    r"<[A-Za-z!?/][^>]*=|<Piece |\bxmlns=|;base64,|[a-z-]+: [^ {]+; "
    r"|[{.][\w-]+ \{|'none';|px \{FONT\}|system-ui|_core\b"
    r"|\.react-aria-|^M\{|^#[0-9a-f]{6}$|; HttpOnly|max-age=|filename="
    r"|^(INSERT|UPDATE|SELECT|DELETE|CREATE|PRAGMA|ATTACH|WITH) "
    r"|^(comment|property|element|format|NRRD0004|attachment|// |/\*\* |export )"
)
"""Pattern of strings that contain two words but are markup, headers of files or types."""
TOKENS = {
    "python/carina/case/rescue.py": r"(n|id), .*",
    "python/carina/case/schema.py": r"id INTEGER .*",
    "python/carina/commands/value.py": r"Number out of range|matching regex",
    "python/carina/export/mesh_file.py": r"o airways|# badge .*",
    "python/carina/export/tree_formats.py": r"# badge .*",
    "python/carina/scopes/library.py": r"(s|k|size|channel|OD)\b.*(\bs|\bk|\(s\)|s\))",
    "python/carina/server/network/connection_limits.py": r"accept\(\).*",
    "python/carina/session/flights/key_frames.py": r"keys speed",
    "python/carina/track/names/assignment.py": r"go on",
    "python/carina/volume/grid_writing.py": r"unsigned char|endian: little",
    "python/carina/volume/header_nrrd.py": (
        r"((un)?signed )?(char|short|int|long( long)?)( int)?|space (directions|origin|units)|(data|line|byte|old) \w+"
    ),
}
"""Pattern by file of strings that contain two words but are not text for users: terms of a file format, sources."""
NEVER = ROOT / "tools" / "wrong_words.toml"
"""File of the words that must not occur in texts for users."""
RUST_ERROR = re.compile(r'#\[error\(\s*"((?:[^"\\]|\\.)*)"', re.DOTALL)
"""Pattern of the message of an error type in Rust."""

Found = dict[str, list[str]]


def is_prose(text: str) -> bool:
    """Return whether a string is a text for users: it contains two words and is neither markup nor a type."""
    bare = re.sub(r"\{[^}]*\}", "{x}", text)
    if re.search(r"\}[ ,;:%]* [a-z]{3,}\b|(^|\s)[a-z]{3,}[,:;]? \{", bare) and MARKUP.search(text) is None:
        return True
    return (
        PROSE.search(bare) is not None
        and MARKUP.search(text) is None
        and re.search(r"[a-z]{2}", bare.replace("{x}", "")) is not None
    )


def name_of(node: ast.expr) -> str:
    """Return the name of the placeholder for an expression in braces: the last identifier of the expression."""
    match node:
        case ast.Attribute(value=value, attr="__name__"):
            return "type" if isinstance(value, ast.Call) else name_of(value)
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return name.strip("_")
        case ast.Call(func=ast.Attribute(value=value), args=[ast.Constant(), *_]):
            return name_of(value)
        case ast.Call(args=[first, *_]):
            return name_of(first)
        case ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name)):
            return name
        case ast.Constant(value=value):
            return str(value)
        case ast.Subscript(slice=ast.Constant(value=str(name))):
            return name
        case ast.Subscript(value=value) | ast.Starred(value=value) | ast.UnaryOp(operand=value):
            return name_of(value)
        case ast.BinOp(left=left, right=right):
            return name_of(right) if isinstance(left, ast.Constant) else name_of(left)
        case ast.BoolOp(values=[value, *_]) | ast.IfExp(body=value):
            return name_of(value)
        case ast.Tuple(elts=elts) if elts:
            return ", ".join(map(name_of, elts))
        case ast.JoinedStr(values=values):
            return next((name_of(part.value) for part in values if isinstance(part, ast.FormattedValue)), "\u2026")
        case ast.GeneratorExp(generators=[first, *_]) | ast.ListComp(generators=[first, *_]):
            return name_of(first.iter)
        case _:
            return "\u2026"


Frame = tuple[list[str], list[str | int]]
"""Names of the parameters of a function, and the pieces of its sentence: texts, and indices of parameters."""
FRAMER = re.compile(r"_?(damaged|lying|refused?)")
"""Pattern of functions that build a sentence from their arguments; each call of one is collected as a sentence."""


WRAPPED: dict[str, tuple[list[str], str]] = {
    "disk_trouble": (["error", "doing", "where"], "{doing} {where}: {why}"),
    "write_whole": (["path", "content"], "cannot write {what} to {path}: {why}"),
    "Draft": (["path"], "cannot write {what} to {path}: {why}"),
    "drafted": (["path"], "cannot write {what} to {path}: {why}"),
    "make_folder": (["path"], "cannot create the folder for {what} at {path}: {why}"),
    "FeatureOff": (["what", "why"], "{what}: off, {why}"),
    "_Reason": (["code", "why", "advice"], "cannot write {what} to {path}: {why}; {advice}"),
    "_point": (["what", "value"], "{what}: expected a point x,y,z in LPS mm, found {value}"),
    "_number": (["what", "value"], "{what}: expected a number {limits}, found {value}"),
    "_change_key": (["key_id", "verb"], "{verb} key frame {number}"),
}
"""Parameters and final sentence of functions that build the sentence in several steps, by function name."""


def wrapped(text: str) -> Frame:
    """Return the parameters and the pieces of a sentence of :data:`WRAPPED`, which has placeholders in braces."""
    params, sentence = WRAPPED[text]
    names = re.findall(r"{(\w+)}", sentence)
    params = [*params, *(name for name in names if name not in params)]
    pieces = re.split(r"{(\w+)}", sentence)
    return params, [params.index(piece) if at % 2 else piece for at, piece in enumerate(pieces)]


def assigned_in(scope: ast.AST) -> dict[str, list[ast.expr]]:
    """Return the expressions that a function or module assigns to each plain name; inner functions are omitted."""
    found: dict[str, list[ast.expr]] = {}
    waiting = list(ast.iter_child_nodes(scope))
    while waiting:
        node = waiting.pop(0)
        if isinstance(node, ast.FunctionDef | ast.ClassDef | ast.Lambda):
            continue
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                found.setdefault(name, []).append(value)
            case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
                found.setdefault(name, []).append(value)
            case ast.Name(id=name, ctx=ast.Store()):
                # A loop or an augmented assignment sets the name, so it has several values.
                found.setdefault(name, []).append(node)
        waiting += [
            child
            for child in ast.iter_child_nodes(node)
            if not (isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(child, ast.Name))
        ]
    return {name: sorted(values, key=lambda value: value.lineno) for name, values in found.items()}


class Texts:
    """Strings of one function in the form that users read.

    Inserted values become placeholders in braces; text that depends on a condition is in brackets. ``used`` collects
    the positions of the strings that are part of a longer string.
    """

    def __init__(self, scope: dict[str, list[ast.expr]], module: dict[str, list[ast.expr]], used: set[int]) -> None:
        self.scope, self.module, self.used = scope, module, used

    def literal(self, node: ast.expr) -> str | None:
        """Return the text of a string literal; None for any other expression."""
        match node:
            case ast.Constant(value=str(value)):
                self.used.add(id(node))
                return value
            case ast.JoinedStr():
                self.used.add(id(node))
                return self.joined(node)
            case ast.IfExp():
                choices = self.choices(node)
                return None if choices is None else "[" + " | ".join(choices) + "]"
            case ast.BinOp(op=ast.Add(), left=left, right=right):
                both = self.literals(left, right)
                return None if both is None else "".join(both)
            case _:
                return None

    def choices(self, node: ast.IfExp) -> list[str] | None:
        """Return the alternatives of a conditional expression; None if no alternative is a literal."""
        found: list[str] = []
        is_written = False
        for side in (node.body, node.orelse):
            if isinstance(side, ast.IfExp):
                inner = self.choices(side)
                is_written |= inner is not None
                found += ["{" + name_of(side) + "}"] if inner is None else inner
            else:
                text = self.literal(side)
                is_written |= text is not None
                found.append("{" + name_of(side) + "}" if text is None else text)
        return list(dict.fromkeys(filter(None, found))) if is_written else None

    def literals(self, *nodes: ast.expr) -> list[str] | None:
        """Return the texts of several string literals; None if one of the expressions is not a literal."""
        used = set(self.used)
        texts = [self.literal(node) for node in nodes]
        found = [text for text in texts if text is not None]
        if len(found) < len(texts):
            self.used.intersection_update(used)
            return None
        return found

    def joined(self, node: ast.JoinedStr) -> str:
        """Return the text of an f-string with placeholders in place of its values."""
        return "".join(
            self.filled(part.value)
            if isinstance(part, ast.FormattedValue)
            else str(part.value)
            if isinstance(part, ast.Constant)
            else ""
            for part in node.values
        )

    def filled(self, node: ast.expr) -> str:
        """Return an expression's text in a sentence: a literal, alternatives in brackets, or a placeholder."""
        if isinstance(node, ast.Name):
            values = self.scope.get(node.id, [])
            if len(values) == 1 and isinstance(values[0], ast.IfExp | ast.JoinedStr | ast.Constant):
                text = self.literal(values[0])
                if text is not None:
                    return text
            given = self.module.get(node.id, []) if node.id not in self.scope else []
            if len(given) == 1 and isinstance(given[0], ast.Constant) and " " in str(given[0].value):
                return str(given[0].value)
        elif isinstance(node, ast.IfExp | ast.JoinedStr) or (
            isinstance(node, ast.Constant) and isinstance(node.value, str)
        ):
            text = self.literal(node)
            if text is not None:
                return text
        return "{" + name_of(node) + "}"

    def given(self, node: ast.expr, line: int) -> str | None:
        """Return the string that an argument of a call passes: a literal, or a name assigned before the call.

        Else None.
        """
        if isinstance(node, ast.Name):
            above = [value for value in self.scope.get(node.id, []) if value.lineno < line]
            if node.id not in self.scope:
                above = self.module.get(node.id, [])
            return self.literal(above[-1]) if above else None
        return self.literal(node)


def frame_of(node: ast.FunctionDef, used: set[int]) -> Frame | None:
    """Return the parameters and the pieces of the sentence that a function builds; None if it builds none."""
    params = [arg.arg for arg in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    for inner in ast.walk(node):
        if not isinstance(inner, ast.JoinedStr):
            continue
        texts = Texts(assigned_in(node), {}, used)
        parts: list[str | int] = []
        for part in inner.values:
            if isinstance(part, ast.FormattedValue):
                name = part.value.id if isinstance(part.value, ast.Name) else ""
                parts.append(params.index(name) if name in params else texts.filled(part.value))
            elif isinstance(part, ast.Constant):
                parts.append(str(part.value))
        shown = "".join(part if isinstance(part, str) else f"{{{params[part]}}}" for part in parts)
        if any(isinstance(part, int) for part in parts) and is_prose(shown):
            used.add(id(inner))
            return params, parts
    return None


class Reader(ast.NodeVisitor):
    """Visitor that collects the texts for users in a module.

    Docstrings do not count, except those of commands, which ``--help`` shows.
    """

    def __init__(self, tree: ast.Module, verbs: frozenset[str], frames: dict[str, Frame], used: set[int]) -> None:
        self.found_texts: list[tuple[int, int, str, int]] = []
        self.verbs, self.frames, self.used = verbs, frames, used
        self.module = assigned_in(tree)
        self.texts = Texts({}, self.module, used)

    @property
    def found(self) -> list[tuple[int, int, str]]:
        """Return the sentences with line and column, without the sentences that are part of another sentence."""
        return sorted((line, column, text) for line, column, text, node in self.found_texts if node not in self.used)

    def keep(self, node: ast.stmt | ast.expr, text: str, *, whole: bool = False) -> None:
        """Store a text with the position of its node.

        With ``whole`` it is stored even if it is part of another text.
        """
        tidy = " ".join(text.split()).removesuffix(";")
        if tidy:
            self.found_texts.append((node.lineno, node.col_offset, tidy, 0 if whole else id(node)))

    def visit_Expr(self, node: ast.Expr) -> None:
        """Collect the texts of an expression statement; a docstring is not collected."""
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Collect the docstring of a command, then the texts of the function's body."""
        if node.name in self.verbs and (docstring := ast.get_docstring(node)):
            for paragraph in docstring.split("\n\n"):
                self.keep(node, paragraph, whole=True)
        outside = self.texts
        self.texts = Texts(assigned_in(node), self.module, self.used)
        self.generic_visit(node)
        self.texts = outside

    def visit_Call(self, node: ast.Call) -> None:
        """Collect the sentence that a call builds, then the texts of its arguments."""
        name = name_of(node.func) if isinstance(node.func, ast.Name | ast.Attribute) else ""
        if name in UNREAD_CALLS:
            return
        frame = self.frames.get(node.func.id) if isinstance(node.func, ast.Name) else None
        if frame is None and isinstance(node.func, ast.Name | ast.Attribute):
            called = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
            frame = wrapped(called) if called in WRAPPED else None
        if frame is not None:
            self.keep_framed(node, frame)
        self.generic_visit(node)

    def keep_framed(self, node: ast.Call, frame: Frame) -> None:
        """Store the sentence that a call builds from its arguments, if one of them is a text."""
        params, parts = frame
        given = dict(zip(params, node.args, strict=False)) | {
            keyword.arg: keyword.value for keyword in node.keywords if keyword.arg is not None
        }
        texts: dict[str, str] = {}
        is_given = False
        for param, value in given.items():
            if param not in params or params.index(param) not in parts:
                continue
            if isinstance(value, ast.Constant) and value.value is None:
                texts[param] = ""
                continue
            text = self.texts.given(value, node.lineno)
            is_given |= text is not None
            texts[param] = "{" + name_of(value) + "}" if text is None else text
        if is_given:
            sentence = "".join(
                part if isinstance(part, str) else texts.get(params[part], "{" + params[part] + "}") for part in parts
            )
            self.keep(node, sentence.replace(" :", ":"), whole=True)

    def visit_Constant(self, node: ast.Constant) -> None:
        """Collect a string literal that is text for users."""
        if isinstance(node.value, str) and is_prose(node.value):
            self.keep(node, node.value)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Collect an f-string that is text for users, with placeholders for its values."""
        used = set(self.used)
        text = self.texts.joined(node)
        if is_prose(text):
            self.keep(node, text)
        else:
            # A concatenation is not an f-string: its parts are collected separately.
            self.used.intersection_update(used)
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                self.visit(part.value)


def verbs_of(tree: ast.Module) -> set[str]:
    """Return the names of the commands: functions decorated with ``app.command()``, or passed to it."""
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
    """Return the sentences of the Python packages by surface: command line and messages."""
    files = sorted([*(ROOT / "python" / "carina").rglob("*.py"), *ROOT.glob("packages/*/python/**/*.py")])
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in files}
    in_cli = {path for path in files if "cli" in path.relative_to(ROOT).parts}
    verbs = frozenset().union(*(verbs_of(trees[path]) for path in in_cli))
    found: dict[str, Found] = {"cli": {}, "messages": {}}
    used: set[int] = set()
    framers = {
        path: {
            node.name: frame
            for node in tree.body
            if isinstance(node, ast.FunctionDef)
            and FRAMER.fullmatch(node.name)
            and (frame := frame_of(node, used)) is not None
        }
        for path, tree in trees.items()
    }
    public = {name: frame for own in framers.values() for name, frame in own.items() if not name.startswith("_")}
    constants = {
        name: values[0]
        for tree in trees.values()
        for name, values in assigned_in(tree).items()
        if name.isupper() and len(values) == 1 and isinstance(values[0], ast.Constant)
    }
    for path, tree in trees.items():
        if path.relative_to(ROOT).as_posix() in PROGRAMS:
            continue
        imported = {
            alias.name: public[alias.name]
            for node in tree.body
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
            if alias.name in public
        }
        reader = Reader(tree, verbs if path in in_cli else frozenset(), imported | framers[path], used)
        for name in {alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}:
            if name in constants:
                reader.module.setdefault(name, [constants[name]])
        reader.visit(tree)
        tokens = re.compile(TOKENS.get(path.relative_to(ROOT).as_posix(), "$."))
        texts = [text for _, _, text in reader.found if tokens.fullmatch(text) is None]
        found["cli" if path in in_cli else "messages"][path.relative_to(ROOT).as_posix()] = texts
    return found


def from_rust() -> Found:
    """Return the error sentences of the Rust crates by file."""
    found = {}
    for path in sorted([*(ROOT / "crates").rglob("*.rs"), *ROOT.glob("packages/*/crates/**/*.rs")]):
        texts = [
            re.sub(r"\\?\s*\n\s*", " ", text).replace('\\"', '"')
            for text in RUST_ERROR.findall(path.read_text(encoding="utf-8"))
        ]
        found[path.relative_to(ROOT).as_posix()] = [" ".join(text.split()) for text in texts if is_prose(text)]
    return found


def from_web() -> dict[str, Found]:
    """Return the sentences of the window and of the phone page, by surface."""
    source = ROOT / "web" / "src"
    files = [
        path
        for path in sorted(source.rglob("*.ts*"))
        if ".test" not in path.name and "wire" not in path.relative_to(source).parts[:1]
    ]
    files.append(source / "wire" / "views.ts")
    ran = subprocess.run(
        ["node", str(ROOT / "tools" / "list_sentences.mjs"), str(ROOT / "web"), *map(str, files)],
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
    """Return the different sentences of each file, by where users read them (window, terminal) and by file."""
    found = {**from_web(), **from_python()}
    found["messages"].update(from_rust())
    return {
        surface: {name: list(dict.fromkeys(texts)) for name, texts in sorted(found[surface].items()) if texts}
        for surface in SURFACES
    }


def wrong(found: dict[str, Found]) -> list[str]:
    """Return a finding for each sentence with a forbidden phrase, with the replacement that the rule proposes."""
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
    """Check all sentences, or print some of them if requested; return 1 if a sentence contains a forbidden phrase."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--list", choices=sorted(SURFACES), help="print the sentences of one surface, by file")
    parser.add_argument("--draw", type=int, metavar="N", help="print a random sample of N sentences")
    parser.add_argument("--seed", type=int, default=13, help="seed of the random sample (default: 13)")
    options = parser.parse_args()
    found = collect()
    if options.list:
        print(f"# {SURFACES[options.list]}")
        print("# {value} is filled in; [text] is optional; [one | other] is one of both.")
        for name, texts in found[options.list].items():
            print("", f"## {name}", *texts, sep="\n")
        return 0
    everything = [
        (surface, name, text) for surface in found for name, texts in found[surface].items() for text in texts
    ]
    if options.draw:
        drawn = random.Random(options.seed).sample(everything, options.draw)
        print(f"{options.draw} of {len(everything)} sentences, seed {options.seed}\n")
        for surface, name, text in sorted(drawn):
            print(f"{surface}\t{name}\t{text}")
        return 0
    unwanted = wrong(found)
    for line in unwanted:
        print(line)
    if not unwanted:
        print(f"wording: {len(everything)} sentences, no wrong phrase")
    return 1 if unwanted else 0


if __name__ == "__main__":
    sys.exit(main())
