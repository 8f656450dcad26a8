"""Random drives of the scope as a solid, looked at by a geometry that is not the product's."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from drive_hands import kind_of, random_samples, scope_of
from lumen_cells import LumenCells, SignedMm
from numpy.typing import NDArray

from carina.scopes import ScopeDrive, WallField

EDGE_MM = 0.6
RIGID_MM = 10.0
NUM_ROUND = 48

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Shaft:
    """Places of the shaft's axis (n, 3), its direction there, and the scope's radius."""

    points: Floats
    into: Floats
    radii: Floats

    def only(self, kept: NDArray[np.bool_]) -> Shaft:
        """Some of them."""
        return Shaft(self.points[kept], self.into[kept], self.radii[kept])


def joined(shafts: list[Shaft]) -> Shaft:
    """One after the other."""
    return Shaft(*(np.concatenate([getattr(s, name) for s in shafts]) for name in ("points", "into", "radii")))


@dataclass(frozen=True)
class Seen:
    """Of a drive: places of the tip's surface in all states that were looked at, and of the shaft."""

    tips: Floats
    shaft: Shaft
    told: str


ShaftDepths = Callable[[Shaft], Floats]


@dataclass(frozen=True)
class Lumen:
    """Where a scope is driven, and what looks at it."""

    wall: WallField
    start_path: Floats
    routes: list[Floats]
    """From the root to each end."""
    cells: LumenCells
    shaft_mm: ShaftDepths
    """How deep the shaft is in the wall at some places."""


@dataclass
class Worst:
    """The deepest of a kind of place."""

    mm: float = -np.inf
    told: str = ""

    def take(self, depths: Floats, points: Floats, told: str) -> None:
        """Remember the deepest, if it is."""
        if len(depths) and not depths.max() <= self.mm:
            n = int(depths.argmax())
            self.mm, self.told = float(depths[n]), f"{depths[n]:.3f} mm {told} at {np.round(points[n], 2).tolist()}"


@dataclass
class Findings:
    """What became of some drives."""

    tip: Worst = field(default_factory=Worst)
    shaft: Worst = field(default_factory=Worst)
    num_drives: int = 0
    num_touched: int = 0
    num_looked_at: int = 0
    travels_mm: list[float] = field(default_factory=list)
    limits: Counter[str] = field(default_factory=Counter)

    def check(self) -> None:
        """The bounds of `docs/decisions/0125`, and that these were drives along walls."""
        print(self.told())
        assert self.tip.mm <= 0.1, self.tip.told
        assert self.shaft.mm <= 0.5, self.shaft.told
        # The scope was near walls, went somewhere, and was pressed at walls.
        assert self.tip.mm > -1.0
        assert self.num_touched > 0.5 * self.num_drives
        assert np.median(self.travels_mm) > 5.0
        assert {"none", "wall", "narrow"} <= set(self.limits)

    def told(self) -> str:
        """For people."""
        return "\n".join(
            [
                f"{self.num_drives} drives, {self.num_looked_at} states looked at, {self.num_touched} drives touched",
                f"deepest: tip {self.tip.told}; shaft {self.shaft.told}",
                f"median travel {np.median(self.travels_mm):.0f} mm, limits {dict(self.limits)}",
            ]
        )


def check_drives(lumen: Lumen, runs: Iterable[int], *, num_samples: int, every: int) -> Findings:
    """Drive, and look at every so many states (at others in every run) and at the last."""
    found = Findings()
    waiting = list(runs)
    while waiting:
        # The exact lumen takes a third of a second for any number of points.
        some, waiting = waiting[:20], waiting[20:]
        seen = [drive_and_look(lumen, run, found, num_samples=num_samples, every=every) for run in some]
        tips = lumen.cells.depths_mm(np.concatenate([s.tips for s in seen]))
        shafts = lumen.shaft_mm(joined([s.shaft for s in seen]))
        for s in seen:
            found.tip.take(tips[: len(s.tips)], s.tips, s.told)
            found.shaft.take(shafts[: len(s.shaft.points)], s.shaft.points, s.told)
            tips, shafts = tips[len(s.tips) :], shafts[len(s.shaft.points) :]
    return found


def drive_and_look(lumen: Lumen, run: int, found: Findings, *, num_samples: int, every: int) -> Seen:
    """One drive, and the places of it that are to be looked at."""
    rng = np.random.default_rng([5, run])
    scope, kind = scope_of(run), kind_of(run)
    drive = ScopeDrive(lumen.wall, scope, lumen.start_path)
    route = lumen.routes[rng.integers(len(lumen.routes))]
    # Many begin as deep as they can.
    deep = 400.0 if rng.uniform() < 0.4 else rng.uniform(0.0, 260.0)
    told = f"{scope.name}, {kind}, run {run}"
    states = [drive.place(route, deep)]
    tips: list[Floats] = []
    shafts: list[Shaft] = []

    def look() -> None:
        shaft = shaft_of(drive)
        tips.append(tip_surface_lps(drive))
        shafts.append(shaft.only(~lumen.cells.holds_balls(shaft.points, shaft.radii)))

    look()
    for n, state in enumerate(random_samples(kind, drive, rng, num_samples)):
        assert np.isfinite(state.pose.lps_from_camera).all(), told
        assert 0.0 <= state.red_out <= 1.0, told
        states.append(state)
        found.limits[state.limit] += 1
        if (n + run) % every == 0 or n + 1 == num_samples:
            look()
    found.num_drives += 1
    found.num_looked_at += len(tips)
    found.num_touched += any(state.contact is not None for state in states[1:])
    places = np.array([state.pose.position_lps for state in states])
    found.travels_mm.append(float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum()))
    return Seen(np.concatenate(tips), joined(shafts), told)


def tip_surface_lps(drive: ScopeDrive) -> Floats:
    """(n, 3) points of the rigid tip's surface: a cylinder with a flat face and an edge rounded by 0.6 mm."""
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
    """The shaft every 0.5 mm."""
    nodes = drive.shaft_lps()[::-1]
    if len(nodes) < 2:
        # Drawn back to the entry: nothing of it is inside.
        return Shaft(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    steps = np.linspace(0.0, 1.0, 4, endpoint=False)[:, None]
    points = np.concatenate([a + steps * (b - a) for a, b in itertools.pairwise(nodes)])
    into = np.repeat(np.diff(nodes, axis=0), 4, axis=0)
    behind = 0.5 * np.arange(len(points))
    scope = drive.scope
    radii = np.where(behind < 50.0, scope.tip_mm / 2.0, (scope.tube_mm or scope.tip_mm) / 2.0)
    # The rigid tip is looked at as a solid; the last node lies at the entry, or less than a node before it.
    kept = (behind >= RIGID_MM) & (np.linalg.norm(into, axis=1) > 1e-9)
    return Shaft(points[kept], into[kept] / np.linalg.norm(into[kept], axis=1)[:, None], radii[kept])


def by_surface(cells: LumenCells) -> ShaftDepths:
    """The shaft's depth by 24 places round each of its axis' points, for a wall that tells distances near it only."""

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
    """The shaft's depth by the distance of its axis, for a wall that tells distances anywhere."""
    return lambda shaft: signed_mm(shaft.points) + shaft.radii


def _inside(drive: ScopeDrive, points: Floats) -> Floats:
    """Those beyond the plane through which the scope enters: behind it is the larynx, which no scan has."""
    nodes = drive.shaft_lps()
    # Drawn back to the entry the scope is one point there, and straight.
    into = nodes[min(3, len(nodes) - 1)] - nodes[0] if len(nodes) > 1 else drive.state.pose.lps_from_camera[:3, 2]
    depth = (points - nodes[0]) @ (into / float(np.linalg.norm(into)))
    return points[depth >= 0.0]
