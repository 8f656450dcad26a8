"""Mutation tests: change one operator or number in the code, and check whether a test fails.

A mutant is one of: a comparison reversed (``<`` to ``>=``), a number changed by one (``n > 3`` to ``n > 4``), ``and``
and ``or`` exchanged, a sign reversed. A seed selects the mutants from the present files. The checkout is never changed:
each mutant exists only in a copy of the package that the tests import::

    python tools/mutants.py                  # 40 mutants, seed 1
    python tools/mutants.py --list           # list the mutants without running tests
    python tools/mutants.py --only 7 --only 12
    python tools/mutants.py --seed 2 --parts server

The tests of a mutant are the test files that name its module, then those of the neighbouring parts; with ``--thorough``
a surviving mutant is tested by all other tests too, including browser tests. A mutant survives if a test is missing or
if the changed program is equivalent; a developer must decide which.
"""

from __future__ import annotations

import argparse
import ast
import bisect
import io
import itertools
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "python" / "carina"
"""Folder of the Python package whose code is changed."""
TESTS = ROOT / "tests"
"""Folder of the tests that run on the changed code."""
NEAR = {
    "session": ("session", "server", "contract", "navigate"),
    "server": ("server", "contract", "session"),
    "track": ("track", "session", "export", "phantom"),
    "volume": ("volume",),
}
"""Test folders for each part of the package, in the order in which they run."""
QUICK = "not soak and not ray and not browser and not data and not gpu"
"""Marker expression of the tests that run first."""
THOROUGH = "not soak and not gpu"
"""Marker expression of all tests that run with ``--thorough``."""

COMPARISONS = {
    "<": ">=",
    "<=": ">",
    ">": "<=",
    ">=": "<",
    "==": "!=",
    "!=": "==",
    "in": "not in",
    "not in": "in",
    "is": "is not",
    "is not": "is",
}
"""Operator by which each comparison is replaced."""
BOUNDING = {"min", "max", "minimum", "maximum", "clip", "range"}
"""Names of functions whose numeric arguments are limits, which a mutant changes."""
TURNS = ("comparison", "bound", "comparison", "bound", "and-or", "comparison", "bound", "sign")
"""Kinds of mutants in the order in which they are drawn; comparisons and bounds are drawn more often."""
Position = tuple[int, int]
"""Position in a file: line (from 1) and column (from 0)."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """Mutation of one line of code: file, position, old and new text; columns count characters from 0, lines from 1."""

    kind: str
    path: Path
    line: int
    column: int
    before: str
    after: str

    @property
    def place(self) -> str:
        """Return the position of the change as ``path:line:column``, which editors can open."""
        return f"{self.path.relative_to(ROOT)}:{self.line}:{self.column + 1}"

    def text(self) -> str:
        """Return the text of the file with the mutation."""
        lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
        line = lines[self.line - 1]
        assert line[self.column :].startswith(self.before), self
        lines[self.line - 1] = line[: self.column] + self.after + line[self.column + len(self.before) :]
        return "".join(lines)

    def summary(self) -> str:
        """Return a line of text with the position, the change and the changed line of code."""
        line = self.path.read_text(encoding="utf-8").splitlines()[self.line - 1].strip()
        return f"{self.place}: {self.before!r} to {self.after!r} in: {line}"


class Source:
    """Tokens and syntax tree of a source file, with positions in characters for both."""

    def __init__(self, path: Path) -> None:
        self.path = path
        text = path.read_text(encoding="utf-8")
        self.tree = ast.parse(text)
        self._lines = text.splitlines()
        skipped = {tokenize.NL, tokenize.NEWLINE, tokenize.COMMENT, tokenize.INDENT, tokenize.DEDENT}
        self._tokens = [t for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.type not in skipped]

    def _at(self, line: int, byte: int) -> Position:
        """Return the position in characters for a position of the syntax tree, which counts bytes."""
        return line, len(self._lines[line - 1].encode()[:byte].decode())

    def start(self, node: ast.expr) -> Position:
        """Return the position of the first character of an expression."""
        return self._at(node.lineno, node.col_offset)

    def end(self, node: ast.expr) -> Position:
        """Return the position after the last character of an expression."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._at(node.end_lineno, node.end_col_offset)

    def text(self, node: ast.expr) -> str:
        """Return the source text of an expression, which must be on one line."""
        (line, first), (_, last) = self.start(node), self.end(node)
        return self._lines[line - 1][first:last]

    def operator(self, left: ast.expr, right: ast.expr) -> tuple[Position, str] | None:
        """Return position and text of the operator between two operands; None if it continues over two lines."""
        first, last = self.end(left), self.start(right)
        begins = bisect.bisect_left(self._tokens, first, key=lambda token: token.start)
        ends = bisect.bisect_left(self._tokens, last, key=lambda token: token.start)
        between = [token for token in self._tokens[begins:ends] if token.string not in "()"]
        if not between or between[0].start[0] != between[-1].end[0]:
            return None
        return between[0].start, " ".join(t.string for t in between)


def mutants_of(path: Path) -> Iterator[Mutant]:
    """Yield every possible mutant of the file at ``path``."""
    source = Source(path)

    def change(kind: str, at: Position, before: str, after: str) -> Mutant:
        return Mutant(kind, path, *at, before, after)

    for node in code_of(source.tree):
        bounds: list[ast.expr] = []
        if isinstance(node, ast.Compare):
            operands = [node.left, *node.comparators]
            for left, right in itertools.pairwise(operands):
                found = source.operator(left, right)
                if found is not None and found[1] in COMPARISONS:
                    yield change("comparison", *found, COMPARISONS[found[1]])
            bounds += operands
        elif isinstance(node, ast.Call) and name_of(node.func) in BOUNDING:
            bounds += node.args
        elif isinstance(node, ast.BoolOp):
            after = "or" if isinstance(node.op, ast.And) else "and"
            for left, right in itertools.pairwise(node.values):
                found = source.operator(left, right)
                if found is not None and found[1] in {"and", "or"}:
                    yield change("and-or", *found, after)
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
            found = source.operator(node.left, node.right)
            if found is not None and not is_joined(node.left) and not is_joined(node.right):
                yield change("sign", *found, "-" if found[1] == "+" else "+")
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            yield change("sign", source.start(node), "-", "+")
        for bound in bounds:
            if isinstance(bound, ast.Constant) and type(bound.value) in {int, float}:
                number = source.text(bound)
                yield change("bound", source.start(bound), number, moved(number))


def name_of(function: ast.expr) -> str:
    """Return the last identifier of a function's name: ``clip`` of ``np.clip``."""
    return (
        function.attr if isinstance(function, ast.Attribute) else function.id if isinstance(function, ast.Name) else ""
    )


def is_joined(side: ast.expr) -> bool:
    """Return whether an operand is a text or a list: ``+`` concatenates such operands and does not add them."""
    return isinstance(side, ast.JoinedStr | ast.List | ast.Tuple) or (
        isinstance(side, ast.Constant) and isinstance(side.value, str)
    )


def moved(number: str) -> str:
    """Return a number increased by one in its last digit: 500 to 501, 3.0 to 4.0, 0.05 to 0.06, 1e-9 to 2e-9."""
    found = re.fullmatch(r"([\d_]+)(?:\.([\d_]*))?(e[+-]?\d+)?", number)
    if found is None:
        return f"{number} + 1"
    whole, part, power = found.group(1), found.group(2), found.group(3) or ""
    if part is None:
        return f"{int(whole) + 1}{power}"
    places = len(part.rstrip("0"))
    return f"{float(f'{whole}.{part}') + 10.0**-places:.{max(places, 1)}f}{power}"


def code_of(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield the syntax nodes of a module that run; annotations, assertions and code for type checkers are omitted."""
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Assert) or (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
            continue
        yield node
        for name, value in ast.iter_fields(node):
            if name not in {"annotation", "returns", "type_params"}:
                waiting += [v for v in (value if isinstance(value, list) else [value]) if isinstance(v, ast.AST)]


def draw(parts: list[str], seed: int, number: int) -> list[Mutant]:
    """Return ``number`` random mutants of the parts; the same seed and files give the same mutants."""
    paths = sorted(path for part in parts for path in (PACKAGE / part).rglob("*.py"))
    every = sorted((m for path in paths for m in mutants_of(path)), key=lambda m: (m.path, m.line, m.column, m.after))
    random.Random(seed).shuffle(every)
    of_kind = {kind: [m for m in every if m.kind == kind] for kind in sorted(set(TURNS))}
    drawn: list[Mutant] = []
    for kind in itertools.islice(itertools.cycle(TURNS), number):
        drawn += of_kind[kind][:1]
        del of_kind[kind][:1]
    return drawn


def part_of(path: Path) -> str:
    """Return the part of a module: its folder in the package."""
    return path.relative_to(PACKAGE).parts[0]


def test_steps(path: Path, *, thorough: bool) -> list[tuple[str, list[str]]]:
    """Return the steps in which a module's mutant is tested: marker expression and test files of each step."""
    near = [file for folder in NEAR[part_of(path)] for file in sorted((TESTS / folder).glob("test_*.py"))]
    named = re.compile(rf"\b{re.escape(path.stem)}\b") if path.stem != "__init__" else None
    words = {file: file.read_text(encoding="utf-8") for file in near}
    close = [file for file in near if named is not None and (named.search(words[file]) or path.stem in file.stem)]
    steps = [(QUICK, close), (QUICK, [file for file in near if file not in close])]
    if thorough:
        steps.append((THOROUGH, [TESTS]))
    return [(marks, [str(file) for file in files]) for marks, files in steps if files]


class Bench:
    """Copy of the package in which mutants are tested one at a time."""

    def __init__(self, folder: Path, workers: int, limit_s: float) -> None:
        self._python = folder / "python"
        self._workers, self._limit_s = workers, limit_s
        big = shutil.ignore_patterns("__pycache__", "_web", "*.so", "*.pyd")
        shutil.copytree(PACKAGE, self._python / "carina", ignore=big)
        for path in [PACKAGE / "_web", *PACKAGE.glob("_core*")]:
            copy = self._python / "carina" / path.name
            if not copy.exists():
                copy.symlink_to(path)

    def kills(self, mutant: Mutant, *, thorough: bool) -> str | None:
        """Return the first test that fails with the mutant; None if all tests pass, so that the mutant survives."""
        copy = self._python / mutant.path.relative_to(PACKAGE.parent)
        for text, done in ((mutant.text(), False), (mutant.path.read_text(encoding="utf-8"), True)):
            # Python's bytecode cache cannot distinguish two sources of equal size within one second.
            for cached in (copy.parent / "__pycache__").glob(f"{copy.stem}.*"):
                cached.unlink()
            copy.write_text(text, encoding="utf-8")
            if not done:
                try:
                    killer = self._first_failure(test_steps(mutant.path, thorough=thorough))
                except BaseException:
                    copy.write_text(mutant.path.read_text(encoding="utf-8"), encoding="utf-8")
                    raise
        return killer

    def _first_failure(self, steps: list[tuple[str, list[str]]]) -> str | None:
        for marks, files in steps:
            killer = self.run(marks, files)
            if killer is not None:
                return killer
        return None

    def run(self, marks: str, files: list[str]) -> str | None:
        """Return the first test that fails among these markers and files; None if all pass."""
        command = [sys.executable, "-m", "pytest", "-q", "-x", "--no-header", "--tb=no", "-p", "no:cacheprovider"]
        command += ["-m", marks, "-n", str(self._workers), "--dist", "loadscope", "--no-loadscope-reorder", *files]
        environment = {**os.environ, "PYTHONPATH": str(self._python)}
        with tempfile.TemporaryFile("w+", encoding="utf-8") as output:
            process = subprocess.Popen(
                command, cwd=ROOT, env=environment, stdout=output, stderr=subprocess.STDOUT, start_new_session=True
            )
            try:
                code = process.wait(self._limit_s)
            except BaseException as error:
                # The process group includes the workers and their children, which would continue to run if the mutant
                # hangs.
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                if isinstance(error, subprocess.TimeoutExpired):
                    return f"nothing: it hangs for {self._limit_s:g} s"
                raise
            output.seek(0)
            log = output.read()
        if code in {0, 5}:  # 0: all passed; 5: no tests were collected for these markers.
            return None
        failed = re.search(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", log, re.MULTILINE)
        return failed.group(1) if failed else "the run itself: " + " ".join(log.split())[-300:]


def main() -> int:
    """Test the mutants and print a result for each; return 1 if one survives."""
    words = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    words.add_argument("--seed", type=int, default=1)
    words.add_argument("--number", type=int, default=40, help="how many are drawn")
    words.add_argument("--parts", nargs="+", choices=sorted(NEAR), default=sorted(NEAR))
    words.add_argument("--only", type=int, action="append", metavar="N", help="this one of the draw; may be repeated")
    words.add_argument("--list", action="store_true", help="tell what is drawn, and run nothing")
    words.add_argument("--thorough", action="store_true", help="what is left meets all tests")
    words.add_argument("--trust", action="store_true", help="do not run the tests without a mutant first")
    words.add_argument("--workers", type=int, default=2)
    words.add_argument(
        "--limit", type=float, default=1200.0, metavar="S", help="seconds before a run counts as hanging"
    )
    arguments = words.parse_args()

    drawn = list(enumerate(draw(arguments.parts, arguments.seed, arguments.number), start=1))
    chosen = [(n, mutant) for n, mutant in drawn if arguments.only is None or n in arguments.only]
    if arguments.list:
        for n, mutant in chosen:
            print(f"{n:3d} {mutant.summary()}")
        return 0
    lives: list[str] = []
    with tempfile.TemporaryDirectory(prefix="carina-mutants-") as folder:
        bench = Bench(Path(folder), arguments.workers, arguments.limit)
        for part in [] if arguments.trust else sorted({part_of(mutant.path) for _, mutant in chosen}):
            files = [str(TESTS / folder) for folder in NEAR[part]]
            broken = bench.run(QUICK, files)
            if broken is not None:
                sys.exit(f"the tests of {part} are red without a mutant: {broken}")
        for n, mutant in chosen:
            began_s = time.monotonic()
            killer = bench.kills(mutant, thorough=arguments.thorough)
            took = f"{time.monotonic() - began_s:.0f} s"
            print(f"{n:3d} {'LIVES' if killer is None else 'died '} {took:>6} {mutant.summary()}", flush=True)
            if killer is None:
                lives.append(mutant.place)
            else:
                print(f"    by {killer}", flush=True)
    print(f"{len(chosen) - len(lives)} of {len(chosen)} died" + "".join(f"\nlives: {place}" for place in lives))
    return 1 if lives else 0


if __name__ == "__main__":
    sys.exit(main())
