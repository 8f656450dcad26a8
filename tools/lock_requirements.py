"""Export the lock files (exact versions and hashes) from pyproject.toml, or check that they are current.

``requirements-run.lock`` lists the packages that Carina needs to run (``make run``), ``requirements.lock`` those for
development. ``requirements-cluster.lock`` adds Ray and its dependencies for the tests of the cluster: 76 MB that other
users need not download. ``requirements-docs.lock`` lists only the packages that build the documentation
(``make docs``), ``requirements-wheels.lock`` only those that build wheels (``make wheels``).

``uv.lock`` is not committed, because it contains the hosts of the registry. The exported files contain no hosts.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS = "requirements-docs.lock"
"""Lock file of the packages that build the documentation."""
WHEELS = "requirements-wheels.lock"
"""Lock file of the packages that build wheels for other machines."""
RUN = "requirements-run.lock"
"""Lock file of the packages that Carina needs to run, without the development tools."""
LOCKS: dict[str, tuple[str, ...]] = {
    RUN: ("--no-dev",),
    "requirements.lock": (),
    "requirements-cluster.lock": ("--extra", "cluster"),
    DOCS: ("--only-group", "docs"),
    WHEELS: ("--only-group", "wheels"),
}
"""Arguments of `uv export` by lock file."""
MARK = "# pyproject: "
"""Start of the line of a lock file that contains the hash of the dependency tables in pyproject.toml."""


def _fingerprint(name: str) -> str:
    """Return a hash of the inputs of a lock file: of the dependency tables in pyproject.toml."""
    import tomllib

    data = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = data["project"]
    groups = data["dependency-groups"]
    relevant = [
        project["requires-python"],
        sorted(project["dependencies"]),
        sorted(groups["dev"]),
        sorted(project["optional-dependencies"]["cluster"]),
    ]
    if name == RUN:
        relevant = [project["requires-python"], sorted(project["dependencies"])]
    if name == DOCS:
        relevant = [project["requires-python"], sorted(groups["docs"])]
    if name == WHEELS:
        relevant = [project["requires-python"], sorted(groups["wheels"])]
    return hashlib.sha256(repr(relevant).encode()).hexdigest()[:16]


def export(uv: str, name: str) -> str:
    """Return the text that the lock file ``name`` must contain."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "requirements.txt"
        # The lock file contains all dependencies for all platforms, but not the project, which is built.
        command = [uv, "export", "-q", "--no-emit-project", "--no-header", "--no-annotate", "-o", str(out)]
        command += LOCKS[name]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        body = out.read_text(encoding="utf-8")
    use = f"# Exported by tools/lock_requirements.py (make lock). Install with: uv pip sync --require-hashes {name}"
    return f"{use}\n{MARK}{_fingerprint(name)}\n{body}"


def main() -> int:
    """Write the lock files, or check that they are current; return 1 if one is not."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="fail if the lock does not match pyproject.toml")
    parser.add_argument("--uv", default="uv", help="the uv to use")
    arguments = parser.parse_args()
    if not arguments.check:
        for name in LOCKS:
            (ROOT / name).write_text(export(arguments.uv, name), encoding="utf-8")
        return 0
    for name in LOCKS:
        path = ROOT / name
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        if f"{MARK}{_fingerprint(name)}\n" not in text:
            print(f"{name} does not match the dependencies in pyproject.toml; run: make lock")
            return 1
        if "://" in text:
            print(f"{name} names a host; it must hold versions and hashes only; run: make lock")
            return 1
    print(f"lock: {', '.join(LOCKS)} match pyproject.toml")
    return 0


if __name__ == "__main__":
    sys.exit(main())
