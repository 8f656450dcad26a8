"""The command line: ``carina open|demo|info|track|render|phantom|doctor``. Wires the parts; nobody imports it."""

import sys

__all__ = ["main"]


def main() -> None:
    """Entry point of the ``carina`` command."""
    try:
        # Here, and not above: the libraries take a second to load, and Ctrl-C may come in it.
        from carina.cli.app import main as run
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        raise SystemExit(130) from None
    run()
