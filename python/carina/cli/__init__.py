"""The command line ``carina``, with the subcommands ``open``, ``demo``, ``info``, ``track``, ``render`` and others.

This package combines all other parts; no other part imports it.
"""

import sys

__all__ = ["main"]


def main() -> None:
    """Entry point of the ``carina`` command."""
    try:
        # Imported here because the imports take a second, in which the user may press Ctrl-C.
        from carina.cli.app import main as run
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        raise SystemExit(130) from None
    run()
