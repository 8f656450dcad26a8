"""Entry point of ``python -m carina.cli``."""

from carina.cli import main

main()
