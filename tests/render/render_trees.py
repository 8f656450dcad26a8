"""The airway phantom as line segments, and as a tree for the decoration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

TRACHEA = ((0.0, 0.0, 60.0), (0.0, 0.0, 0.0), 7.0)
"""Start and end (LPS mm) and radius (mm) of the trachea."""
RIGHT = ((0.0, 0.0, 0.0), (-22.0, 4.0, -34.0), 5.5)
"""Start and end (LPS mm) and radius (mm) of the right main bronchus."""
LEFT = ((0.0, 0.0, 0.0), (30.0, 6.0, -26.0), 4.0)
"""Start and end (LPS mm) and radius (mm) of the left main bronchus."""


@dataclass(frozen=True)
class Branch:
    """Branch with the attributes that the decoration reads."""

    id: int
    parent: int | None
    children: tuple[int, ...]
    name: str | None
    points: np.ndarray
    radius: np.ndarray
    kind: str = "tracked"
    confidence: float | None = None


@dataclass(frozen=True)
class Tree:
    """Tree with the attributes that the decoration reads."""

    branches: tuple[Branch, ...]


def straight(number, parent, children, name, line, **more) -> Branch:
    """Return a straight branch of constant radius, with a point every mm."""
    start, end, radius = line
    steps = int(np.linalg.norm(np.subtract(end, start))) + 1
    points = np.linspace(start, end, steps)
    return Branch(number, parent, children, name, points, np.full(steps, radius), **more)


def forked(**trachea) -> Tree:
    """Return the tree of the phantom in the fixture ``airway``; arguments change its trachea."""
    return Tree((
        straight(0, None, (1, 2), "Trachea", TRACHEA, **trachea),
        straight(1, 0, (), "RMB", RIGHT),
        straight(2, 0, (), "LMB", LEFT),
    ))  # fmt: skip
