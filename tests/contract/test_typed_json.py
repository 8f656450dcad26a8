"""Tests that one module reads typed values, and that only one thread at a time prepares a type."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import carina

PACKAGE = Path(carina.__file__).parent
TYPED_READING = PACKAGE / "typed_reading.py"

FIRST_USE_IN_FOUR_THREADS = """
import sys, threading, types
from carina.typed_reading import read_plain

NUM_INNER = 8
lines = ["from __future__ import annotations", "import msgspec", "from typing import Annotated, Optional"]
for outer in range(20):
    for inner in range(NUM_INNER):
        lines.append(f"class Inner{outer}_{inner}(msgspec.Struct):")
        lines += [f"    f{n}: Optional[Annotated[int, msgspec.Meta(ge=0)]] = 0" for n in range(10)]
    lines.append(f"class Outer{outer}(msgspec.Struct):")
    lines += [f"    f{n}: Inner{outer}_{n}" for n in range(NUM_INNER)]
module = sys.modules["made"] = types.ModuleType("made")
exec("\\n".join(lines), module.__dict__)

# A thread is interrupted as often as possible.
sys.setswitchinterval(1e-6)
plain = {f"f{n}": {"f0": 1} for n in range(NUM_INNER)}
for outer in range(20):
    cls = getattr(module, f"Outer{outer}")
    together = threading.Barrier(4)

    def read():
        together.wait()
        for _ in range(20):
            assert read_plain(plain, cls).f7.f0 == 1

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
print("read")
"""


def reading_calls(path: Path) -> list[str]:
    """Return the calls in a file that read typed values with msgspec."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            name = ast.unparse(node.func)
            is_typed = name != "msgspec.json.decode" or len(node.args) > 1 or bool(node.keywords)
            if is_typed and name in {"msgspec.convert", "msgspec.json.decode", "msgspec.json.Decoder"}:
                found.append(f"{path.relative_to(PACKAGE)}:{node.lineno}: {name}")
    return found


def test_json_type_is_prepared_by_one_thread_at_a_time() -> None:
    # With msgspec.convert in place of read_plain the process ends with a segmentation fault.
    command = [sys.executable, "-X", "faulthandler", "-c", FIRST_USE_IN_FOUR_THREADS]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "read\n"), done.stderr[-2000:]


def test_only_one_module_reads_typed_json_values() -> None:
    found = [call for path in PACKAGE.rglob("*.py") if path != TYPED_READING for call in reading_calls(path)]
    assert not found, "read with the functions of carina.typed_reading"
    assert len(reading_calls(TYPED_READING)) == 4
