"""The command line: ``carina open|demo|info|track|render|phantom|doctor``. Wires the parts; nobody imports it."""

from carina.cli.app import app, main

__all__ = ["app", "main"]
