"""The scope as a solid, built anew from its pose and axis: what the wall's own field is checked against."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from carina.scopes import ScopeDrive

EDGE_MM = 0.6
RIGID_MM = 10.0


def tip_surface_lps(drive: ScopeDrive) -> NDArray[np.float64]:
    """(n, 3) points of the rigid tip's surface: a cylinder with a flat face and an edge rounded by 0.6 mm."""
    r = drive.scope.tip_mm / 2.0
    edge = min(EDGE_MM, r / 2.0)
    outline = [(across, 0.0) for across in np.linspace(0.0, r - edge, 5)]
    outline += [(r - edge + edge * np.sin(a), edge - edge * np.cos(a)) for a in np.linspace(0.2, np.pi / 2, 6)]
    outline += [(r, behind) for behind in np.arange(edge, RIGID_MM, 0.35)]
    turns = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    across, behind = np.array(outline).T
    local = np.stack(
        [
            np.outer(across, np.cos(turns)).ravel(),
            np.outer(across, np.sin(turns)).ravel(),
            np.repeat(-behind, len(turns)),
        ],
        axis=1,
    )
    matrix = drive.state.pose.lps_from_camera
    return _inside(drive, local @ matrix[:3, :3].T + matrix[:3, 3])


def shaft_balls(drive: ScopeDrive) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (n, 3) of the shaft's axis every 0.5 mm and the scope's radius there."""
    nodes = drive.shaft_lps()[::-1]
    if len(nodes) < 2:
        # Drawn back to the entry: nothing of it is inside.
        return np.zeros((0, 3)), np.zeros(0)
    steps = np.linspace(0.0, 1.0, 4, endpoint=False)[:, None]
    points = np.concatenate([a + steps * (b - a) for a, b in itertools.pairwise(nodes)])
    behind = 0.5 * np.arange(len(points))
    scope = drive.scope
    radius = np.where(behind < 50.0, scope.tip_mm / 2.0, (scope.tube_mm or scope.tip_mm) / 2.0)
    # The rigid tip is looked at as a solid.
    return points[behind >= RIGID_MM], radius[behind >= RIGID_MM]


def _inside(drive: ScopeDrive, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Those beyond the plane through which the scope enters: behind it is the larynx, which no scan has."""
    nodes = drive.shaft_lps()
    # Drawn back to the entry the scope is one point there, and straight.
    into = nodes[min(3, len(nodes) - 1)] - nodes[0] if len(nodes) > 1 else drive.state.pose.lps_from_camera[:3, 2]
    depth = (points - nodes[0]) @ (into / float(np.linalg.norm(into)))
    return points[depth >= 0.0]
