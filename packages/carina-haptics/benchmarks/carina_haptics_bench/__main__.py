"""Command line of the timing benchmark."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from carina_haptics_bench.force_timing import report


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark and return its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m carina_haptics_bench",
        description="Measure the force loop while 512x512 pictures are rendered 30 times a second.",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("carina-bench"), help="folder for haptics.json; created if missing"
    )
    parser.add_argument("--quick", action="store_true", help="8 s instead of 60 s for each row")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    given = parser.parse_args(arguments)
    return report(folder=given.output, quick=given.quick, as_json=given.json)


if __name__ == "__main__":
    sys.exit(main())
