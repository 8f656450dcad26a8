"""Build the documentation: ``make docs``. A warning makes the build fail.

The Python reference imports Carina from ``.venv``; Sphinx comes from ``.venv-docs``, which contains only Sphinx and its
dependencies.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "build" / "docs"
"""Folder to which Sphinx writes the HTML pages."""


def main() -> int:
    """Run Sphinx; return 1 if a page has a warning."""
    found = sorted((ROOT / ".venv-docs").glob("lib/python3*/site-packages")) + sorted(
        (ROOT / ".venv-docs").glob("Lib/site-packages")
    )
    if not found:
        sys.exit("Sphinx is not installed; run: make docs")
    # With -E and -a Sphinx rebuilds every page. Without them it skips unchanged pages after a failed run, and so their
    # warnings.
    options = ["-W", "--keep-going", "-q", "-E", "-a"]
    command = [sys.executable, "-m", "sphinx", *options, "-b", "html", "docs", str(OUT)]
    # The path has Carina's packages before those of Sphinx, so that the reference describes the tested package.
    sources = [ROOT / "python", *sorted(ROOT.glob("packages/*/python"))]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, [*sources, found[0]]))}
    ran = subprocess.run(command, cwd=ROOT, env=environment, check=False)
    if not ran.returncode:
        print(f"docs: {OUT.relative_to(ROOT)}/index.html")
    return ran.returncode


if __name__ == "__main__":
    sys.exit(main())
