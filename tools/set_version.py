"""Write a new version number into every file that states it; the version in ``Cargo.toml`` is the source.

Run: ``python tools/set_version.py 0.2.0``, then ``cargo update --workspace`` for ``Cargo.lock``. A test compares all
files (``tests/installation/test_versions.py``).
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PLACES = {
    "Cargo.toml": r'^version = "{}"$',
    "pyproject.toml": r'^version = "{}"$',
    "packages/carina-haptics/pyproject.toml": r'^version = "{}"$|"carina=={}"',
    "python/carina/version.py": r'^VERSION = "{}"$',
    "web/package.json": r'^  "version": "{}",$',
    "web/package-lock.json": r'\A.*?"version": "{}",.*?"packages": \{{.*?"version": "{}",',
}
"""Pattern of the lines with the version by file; the braces stand for the number."""


def current(root: Path = ROOT) -> str:
    """Return the version in ``Cargo.toml``."""
    found = re.search(r'^version = "([^"]+)"$', (root / "Cargo.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    return found[1]


def change(version: str, root: Path = ROOT) -> None:
    """Replace the current version by another one in all files."""
    before = re.escape(current(root))
    for name, pattern in PLACES.items():
        path = root / name
        text = path.read_text(encoding="utf-8")
        here = pattern.replace("{}", before).replace("{{", "{").replace("}}", "}")
        path.write_text(
            re.sub(here, lambda found: re.sub(before, version, found[0]), text, flags=re.MULTILINE | re.DOTALL),
            encoding="utf-8",
        )


def main() -> int:
    """Change the version to the argument; without an argument print the current one."""
    if len(sys.argv) == 1:
        print(current())
        return 0
    if len(sys.argv) != 2 or not re.fullmatch(r"\d+\.\d+\.\d+((a|b|rc)\d+)?", sys.argv[1]):
        print("expected a version such as 0.2.0", file=sys.stderr)
        return 2
    change(sys.argv[1])
    return 0


if __name__ == "__main__":
    sys.exit(main())
