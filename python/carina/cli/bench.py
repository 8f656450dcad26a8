"""``carina bench``: the benchmarks of a checkout (``benchmarks/carina_bench``), which wheels do not contain."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import carina
from carina.errors import CarinaError

PACKAGE = "carina_bench"


def run_benchmarks(arguments: list[str]) -> Any:
    """Run a subcommand of ``carina bench``; the options are defined in the package ``carina_bench``.

    The package is imported from Python's module path, so that a wheel can be measured with ``PYTHONPATH=benchmarks``,
    else from the folder ``benchmarks`` of the checkout that contains this module.

    Parameters
    ----------
    arguments
        Command-line arguments after ``carina bench``.

    Raises
    ------
    CarinaError
        If the benchmarks are not found; the command then ends with exit code 1.
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
