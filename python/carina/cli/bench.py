"""``carina bench``: the benchmarks of a checkout (``benchmarks/carina_bench``), which wheels do not contain."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import carina
from carina.errors import CarinaError

__all__ = ["PACKAGE", "run_benchmarks"]

PACKAGE = "carina_bench"


def run_benchmarks(arguments: list[str]) -> Any:
    """Run the verbs below ``carina bench``, whose options are defined beside the benchmarks.

    Looked for where Python looks (so a wheel can be measured with ``PYTHONPATH=benchmarks``), then in the checkout that
    this package runs from.

    Parameters
    ----------
    arguments
        What followed ``carina bench``.

    Raises
    ------
    CarinaError
        If this is no checkout; exit code 1, as where an extra is missing.
    """
    if find_spec(PACKAGE) is None:
        folder = Path(carina.__file__).resolve().parents[2] / "benchmarks"
        if not (folder / PACKAGE / "app.py").is_file():
            msg = (
                "the installed package does not include the benchmarks, which are in the folder benchmarks/ of "
                "Carina's source; run carina bench in a checkout after `make setup`, or add that folder to PYTHONPATH"
            )
            raise CarinaError(msg, code="machine.benchmarks-missing")
        sys.path.append(str(folder))
    return import_module(f"{PACKAGE}.app").bench(arguments, prog_name="carina bench", standalone_mode=False)
