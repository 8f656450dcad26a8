"""Tests of a bare ``import carina``: every part and public name is available and listed, and nothing slow is loaded."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import carina

ROOT = Path(__file__).resolve().parents[2]
PAGES = {page.stem for page in (ROOT / "docs" / "api").glob("*.md")}
# Packages that depend on Carina have pages in the same documentation but are not part of Carina.
DOCUMENTED = sorted(PAGES - {path.name for path in ROOT.glob("packages/*/python/*")})


def printed(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.strip()


def test_dir_of_the_package_lists_every_documented_subpackage_and_every_public_name() -> None:
    listed = set(dir(carina))
    assert set(DOCUMENTED) <= listed
    assert set(carina.__all__) <= listed
    assert {"track", "render", "find_airways", "measure_tree", "FlightPath"} <= listed
    assert not [name for name in listed if name.startswith("_") and name != "__version__"]


def test_every_listed_name_is_available_after_a_bare_import() -> None:
    code = "import carina; print(*(name for name in dir(carina) if getattr(carina, name, None) is None))"
    assert printed(code) == ""
    assert printed("import carina; print(carina.track.lumen_mesh.__name__, carina.errors.UsageError.code)") == (
        "lumen_mesh usage"
    )


def test_unknown_name_raises_an_attribute_error() -> None:
    assert not hasattr(carina, "no_such_part")
    assert not hasattr(carina, "_web")


def test_bare_import_loads_no_subpackage_and_no_library() -> None:
    code = "import sys, carina; print(*sorted(n for n in sys.modules if n.startswith(('carina', 'numpy', 'msgspec'))))"
    assert printed(code).split() == ["carina", "carina.version"]
    assert "carina.track" not in printed("import sys, carina; dir(carina); print(*sys.modules)").split()
