"""Worker process that runs one section of a benchmark: ``python -m carina_bench.worker REQUEST``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Any

from carina.disk import disk_trouble, write_whole
from carina.errors import CarinaError

__all__ = ["child_environment", "run_section"]


def child_environment() -> dict[str, str]:
    """Return environment variables with which a child process can import this package, which is not installed."""
    found = str(Path(__file__).resolve().parent.parent)
    others = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": os.pathsep.join([found, others] if others else [found])}


def run_section(function: str, request: dict[str, Any], *, threads: int | None = None) -> Any:
    """Run ``module:function`` with a request in a new process and return the function's result.

    Parameters
    ----------
    function
        Function in this package, such as ``render:frames``.
    request
        Argument of the function, as JSON values.
    threads
        Number of threads of the compiled module; default: all cores.

    Raises
    ------
    CarinaError
        The error of the section (code, message and exit code), or an error that states that the process died.
    """
    with tempfile.TemporaryDirectory(prefix="carina-bench-") as scratch:
        result = Path(scratch) / "result.json"
        message = json.dumps({"function": function, "request": request, "result": str(result)})
        environment = child_environment()
        if threads is not None:
            environment["RAYON_NUM_THREADS"] = str(threads)
        command = [sys.executable, "-m", "carina_bench.worker", message]
        # The output of libraries goes to stderr, because stdout contains only the report.
        done = subprocess.run(command, env=environment, stdout=sys.stderr, check=False)
        if done.returncode == CANCELLED:
            raise KeyboardInterrupt
        if not result.exists():
            raise CarinaError(f"the benchmark {function} ended with code {done.returncode}", code="machine.benchmark")
        document = json.loads(result.read_text(encoding="utf-8"))
    if "error" in document:
        error = CarinaError(document["error"]["message"], code=document["error"]["code"])
        error.exit_code = document["error"]["exit_code"]
        raise error
    return document["rows"]


CANCELLED = 130
"""Exit code of a process that was cancelled."""


def _main() -> int:
    message = json.loads(sys.argv[1])
    module, _, name = message["function"].partition(":")
    try:
        rows = getattr(import_module(f"carina_bench.{module}"), name)(message["request"])
        document = {"rows": rows}
    except KeyboardInterrupt:
        return CANCELLED
    except CarinaError as error:
        document = {"error": {"code": error.code, "message": str(error), "exit_code": error.exit_code}}
    except OSError as error:
        disk_error = disk_trouble(error, "the benchmark cannot read or write a file", error.filename)
        document = {"error": {"code": disk_error.code, "message": str(disk_error), "exit_code": disk_error.exit_code}}
    write_whole(message["result"], json.dumps(document, allow_nan=False).encode(), what="the measurements")
    return 0


if __name__ == "__main__":
    sys.exit(_main())
