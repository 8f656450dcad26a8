"""Checks of random scope drives: depth of tip and shaft in the wall, measured independently of the product."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from lumen_cells import LumenCells, SignedMm
from numpy.typing import NDArray
from random_drive_inputs import kind_of, random_samples, scope_of

from carina.scopes import ScopeDrive, WallField

EDGE_MM = 0.6
RIGID_MM = 10.0
NUM_ROUND = 48

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Shaft:
    """Points (n, 3) on the axis of a shaft in LPS mm, with the unit direction and radius (mm) at each point."""

    points: Floats
    into: Floats
    radii: Floats

    def only(self, mask: NDArray[np.bool_]) -> Shaft:
        """Return the points of the shaft that the mask ``mask`` selects."""
        return Shaft(self.points[mask], self.into[mask], self.radii[mask])


def joined(shafts: list[Shaft]) -> Shaft:
    """Return one shaft with the points of several shafts."""
    return Shaft(*(np.concatenate([getattr(s, name) for s in shafts]) for name in ("points", "into", "radii")))


@dataclass(frozen=True)
class Seen:
    """Points (LPS mm) of the tip's surface and of the shaft in all states of a drive that are checked."""

    tips: Floats
    shaft: Shaft
    description: str


ShaftDepths = Callable[[Shaft], Floats]


@dataclass(frozen=True)
class Lumen:
    """An airway lumen in which scopes are driven, with the functions that measure depth in its wall."""

    wall: WallField
    start_path: Floats
    routes: list[Floats]
    """Paths from the root to each end of the tree, LPS mm."""
    cells: LumenCells
    shaft_mm: ShaftDepths
    """Function that returns the depth of each point of a shaft in the wall, mm."""


@dataclass
class Worst:
    """Largest depth in the wall among the checked points of one kind, with a description of the point."""

    mm: float = -np.inf
    description: str = ""

    def take(self, depths: Floats, points: Floats, label: str) -> None:
        """Store the largest of these depths, with its point and description, if it exceeds the stored depth."""
        if len(depths) and not depths.max() <= self.mm:
            n = int(depths.argmax())
            self.mm, self.description = (
                float(depths[n]),
                f"{depths[n]:.3f} mm {label} at {np.round(points[n], 2).tolist()}",
            )


@dataclass
class Findings:
    """Results of several checked drives: largest depths of tip and shaft in the wall."""

    tip: Worst = field(default_factory=Worst)
    shaft: Worst = field(default_factory=Worst)
    num_drives: int = 0
    num_touched: int = 0
    num_looked_at: int = 0
    travels_mm: list[float] = field(default_factory=list)
    limits: Counter[str] = field(default_factory=Counter)

    def check(self) -> None:
        """Assert the limits of `docs/decisions/0125`, and that the drives led along walls."""
        print(self.summary())
        assert self.tip.mm <= 0.1, self.tip.description
        assert self.shaft.mm <= 0.5, self.shaft.description
        # These assertions show that the scopes moved, came near the walls and pressed against them.
        assert self.tip.mm > -1.0
        assert self.num_touched > 0.5 * self.num_drives
        assert np.median(self.travels_mm) > 5.0
        assert {"none", "wall", "narrow"} <= set(self.limits)

    def summary(self) -> str:
        """Return a summary of the results as text."""
        return "\n".join(
            [
                f"{self.num_drives} drives, {self.num_looked_at} states looked at, {self.num_touched} drives touched",
                f"deepest: tip {self.tip.description}; shaft {self.shaft.description}",
                f"median travel {np.median(self.travels_mm):.0f} mm, limits {dict(self.limits)}",
            ]
        )


def check_drives(lumen: Lumen, runs: Iterable[int], *, num_samples: int, every: int) -> Findings:
    """Drive each run, and check every ``every``-th state and the last one.

    The number of the first checked state depends on the run.
    """
    found = Findings()
    waiting = list(runs)
    while waiting:
        # Points of 20 drives are measured at once, because the exact lumen takes a third of a second for any number of
        # points.
        some, waiting = waiting[:20], waiting[20:]
        seen = [drive_and_look(lumen, run, found, num_samples=num_samples, every=every) for run in some]
        tips = lumen.cells.depths_mm(np.concatenate([s.tips for s in seen]))
        shafts = lumen.shaft_mm(joined([s.shaft for s in seen]))
        for s in seen:
            found.tip.take(tips[: len(s.tips)], s.tips, s.description)
            found.shaft.take(shafts[: len(s.shaft.points)], s.shaft.points, s.description)
            tips, shafts = tips[len(s.tips) :], shafts[len(s.shaft.points) :]
    return found


def drive_and_look(lumen: Lumen, run: int, found: Findings, *, num_samples: int, every: int) -> Seen:
    """Perform one drive and return the points that are to be checked."""
    rng = np.random.default_rng([5, run])
    scope, kind = scope_of(run), kind_of(run)
    drive = ScopeDrive(lumen.wall, scope, lumen.start_path)
    route = lumen.routes[rng.integers(len(lumen.routes))]
    # Two of five drives begin at the greatest depth at which the scope can be placed.
    deep = 400.0 if rng.uniform() < 0.4 else rng.uniform(0.0, 260.0)
    label = f"{scope.name}, {kind}, run {run}"
    states = [drive.place(route, deep)]
    tips: list[Floats] = []
    shafts: list[Shaft] = []

    def look() -> None:
        shaft = shaft_of(drive)
        tips.append(tip_surface_lps(drive))
        shafts.append(shaft.only(~lumen.cells.holds_balls(shaft.points, shaft.radii)))

    look()
    for n, state in enumerate(random_samples(kind, drive, rng, num_samples)):
        assert np.isfinite(state.pose.lps_from_camera).all(), label
        assert 0.0 <= state.red_out <= 1.0, label
        states.append(state)
        found.limits[state.limit] += 1
        if (n + run) % every == 0 or n + 1 == num_samples:
            look()
    found.num_drives += 1
    found.num_looked_at += len(tips)
    found.num_touched += any(state.contact is not None for state in states[1:])
    places = np.array([state.pose.position_lps for state in states])
    found.travels_mm.append(float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()))
    return Seen(np.concatenate(tips), joined(shafts), label)


def tip_surface_lps(drive: ScopeDrive) -> Floats:
    """Return (n, 3) points on the rigid tip's surface: a cylinder with a flat face and an edge rounded by 0.6 mm."""
    r = drive.scope.tip_mm / 2.0
    edge = min(EDGE_MM, r / 2.0)
    outline = [(across, 0.0) for across in np.linspace(0.0, r - edge, 5)]
    outline += [(r - edge + edge * np.sin(a), edge - edge * np.cos(a)) for a in np.linspace(0.2, np.pi / 2, 6)]
    outline += [(r, behind) for behind in np.arange(edge, RIGID_MM, 0.35)]
    turns = np.linspace(0.0, 2.0 * np.pi, NUM_ROUND, endpoint=False)
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


def shaft_of(drive: ScopeDrive) -> Shaft:
    """Return the points of the shaft at intervals of 0.5 mm."""
    nodes = drive.shaft_lps()[::-1]
    if len(nodes) < 2:
        # The scope is withdrawn to the entry, so no part of its shaft is inside.
        return Shaft(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    steps = np.linspace(0.0, 1.0, 4, endpoint=False)[:, None]
    points = np.concatenate([a + steps * (b - a) for a, b in itertools.pairwise(nodes)])
    into = np.repeat(np.diff(nodes, axis=0), 4, axis=0)
    behind = 0.5 * np.arange(len(points))
    scope = drive.scope
    radii = np.where(behind < 50.0, scope.tip_mm / 2.0, (scope.tube_mm or scope.tip_mm) / 2.0)
    # The rigid tip is omitted, because it is checked as a solid. The last node is at the entry or less than one node
    # before it.
    mask = (behind >= RIGID_MM) & (np.linalg.norm(into, axis=1) > 1e-9)
    return Shaft(points[mask], into[mask] / np.linalg.norm(into[mask], axis=1)[:, None], radii[mask])


def by_surface(cells: LumenCells) -> ShaftDepths:
    """Return a function that measures the depth of a shaft at 24 points of its surface around each axis point.

    It is used for walls whose distance is known only near the wall.
    """

    def depths_mm(shaft: Shaft) -> Floats:
        across = np.cross(shaft.into, np.eye(3)[np.abs(shaft.into).argmin(axis=1)])
        across /= np.linalg.norm(across, axis=1)[:, None]
        other = np.cross(across, shaft.into)
        turns = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)[:, None]
        out = np.cos(turns) * across[:, None] + np.sin(turns) * other[:, None]
        places = shaft.points[:, None] + shaft.radii[:, None, None] * out
        return cells.depths_mm(places.reshape(-1, 3)).reshape(-1, 24).max(axis=1)

    return depths_mm


def by_balls(signed_mm: SignedMm) -> ShaftDepths:
    """Return a function that computes the depth of a shaft from the distance between its axis and the wall.

    It is used for walls whose distance is known everywhere.
    """
    return lambda shaft: signed_mm(shaft.points) + shaft.radii


def _inside(drive: ScopeDrive, points: Floats) -> Floats:
    """Return the points beyond the plane through which the scope enters.

    The larynx is behind that plane and not in the scan.
    """
    nodes = drive.shaft_lps()
    # A scope that is withdrawn to the entry has only one node, so its direction is that of the camera.
    into = nodes[min(3, len(nodes) - 1)] - nodes[0] if len(nodes) > 1 else drive.state.pose.lps_from_camera[:3, 2]
    depth = (points - nodes[0]) @ (into / float(np.linalg.norm(into)))
    return points[depth >= 0.0]
