"""Entry point of ``python -m carina``, which is the command ``carina``."""

from carina.cli import main

main()
