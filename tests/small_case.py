"""Small case for tests of the session and the server: real volume and navigation, replacements of all slow parts.

The grid is anisotropic and oblique. The airways are a trachea that divides into a right branch with two generations and
a left branch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from carina.commands import OpenPath
from carina.errors import CancelledError, NoResultError, VolumeImportError
from carina.plan.routes.main_carina import axes_origin
from carina.session import Parts, Session
from carina.track import Airways, AirwayTree, Branch, CtAssessment, CtProperty, TrackedPath, edit_airways
from carina.volume import Finding, Note, Quality, SeriesInfo, Volume, VolumeSource

SMALL_ASSESSMENT = CtAssessment(
    (Finding("spacing", "slices are 2.0 mm apart"),),
    Quality((), 5, 1.0),
    None,
    (CtProperty("noise", "20 HU in soft tissue", False), CtProperty("slices", "slices are 2.0 mm apart", True)),
)
SPACING_MM = (1.5, 1.75, 2.0)
SHAPE_ZYX = (40, 28, 32)


def oblique_matrix() -> np.ndarray:
    """Return ``lps_from_ijk`` of a grid that is rotated by 7 degrees about z and by 4 degrees about x."""
    a, b = np.deg2rad(7.0), np.deg2rad(4.0)
    about_z = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    matrix = np.eye(4)
    matrix[:3, :3] = about_z @ about_x @ np.diag(SPACING_MM)
    matrix[:3, 3] = (-21.0, 12.5, -140.0)
    return matrix


def small_volume(*, title: str = "Thorax 1.5", is_hu: bool = True) -> Volume:
    """Return a volume of tissue with air along the branches."""
    values = np.full(SHAPE_ZYX, 40 if is_hu else 200, dtype=np.int16)
    values[small_lumen() != 0] = -980 if is_hu else 10
    return Volume(
        values,
        oblique_matrix(),
        is_hu=is_hu,
        not_hu_reason=None if is_hu else "the values run from 10 to 200: 8-bit data",
        source=VolumeSource(
            format="array",
            title=title,
            other_series=(SeriesInfo("2", "CT", "Scout", 2, refused="too few slices"),),
            notes=(Note("import.lossy", "a test", badge=True),),
        ),
    )


BRANCHES_IJK = {
    0: (None, [(16.0, 14.0, 37.0), (16.0, 14.0, 22.0)]),
    1: (0, [(16.0, 14.0, 22.0), (8.0, 13.0, 14.0)]),
    2: (0, [(16.0, 14.0, 22.0), (25.0, 13.0, 13.0)]),
    3: (1, [(8.0, 13.0, 14.0), (4.0, 12.0, 5.0)]),
}


def _densely(points: list[tuple[float, float, float]]) -> np.ndarray:
    a, b = (np.array(p) for p in points)
    return a + np.linspace(0, 1, 12)[:, None] * (b - a)


def small_lumen() -> np.ndarray:
    lumen = np.zeros(SHAPE_ZYX, dtype=np.uint8)
    for _, points in BRANCHES_IJK.values():
        for i, j, k in np.rint(_densely(points)).astype(int):
            lumen[k - 1 : k + 2, j - 1 : j + 2, i - 1 : i + 2] = 1
    return lumen


def small_lps(ijk: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the LPS point (mm) of voxel coordinates of the small volume."""
    x, y, z = (float(v) for v in small_volume().to_lps(np.array(ijk)))
    return x, y, z


LEFT_TIP = small_lps(BRANCHES_IJK[2][1][1])
RIGHT_TIP = small_lps(BRANCHES_IJK[3][1][1])
OUTSIDE_LUMEN = small_lps((28.0, 3.0, 30.0))


def small_tree(matrix: np.ndarray) -> AirwayTree:
    """Return the tree of :data:`BRANCHES_IJK`; a child begins exactly at the last point of its parent."""
    generation = {0: 0, 1: 1, 2: 1, 3: 2}
    names = {0: "Trachea", 1: "RMB", 2: "LMB", 3: None}
    branches: dict[int, Branch] = {}
    for n, (parent, ends) in BRANCHES_IJK.items():
        points = _densely(ends) @ matrix[:3, :3].T + matrix[:3, 3]
        if parent is not None:
            points[0] = branches[parent].points[-1]
        branches[n] = Branch(
            id=n,
            parent=parent,
            children=tuple(m for m, (p, _) in BRANCHES_IJK.items() if p == n),
            generation=generation[n],
            name=names[n],
            kind="tracked",
            points=points,
            radius=np.full(12, 6.0 - generation[n]),
            cost=1.0,
        )
    return AirwayTree(tuple(branches.values()))


@dataclass
class SmallTracker:
    """Tracker whose paths end at the tip of the nearest branch, within the distance up to which targets are moved."""

    tree: AirwayTree
    grid: Any
    """Grid with the CT, as far as paths without the lumen use it."""
    lumen_zyx: Any

    def path_to(self, point_lps: Any, *, snap_mm: float = 5.0) -> Any:
        branch, _, distance = self.tree.nearest_branch(point_lps)
        if distance > snap_mm:
            msg = f"no airway within {snap_mm:g} mm: the nearest lumen is {distance:.1f} mm away"
            raise NoResultError(msg)
        route = self.tree.route_to(branch.id)
        return TrackedPath(
            points_lps=route.points_lps,
            radius_mm=route.radius_mm,
            wall_mm=route.radius_mm,
            length_mm=route.length_mm,
            cost=1.0,
            generation=route.generation,
            branch_ids=route.branch_ids,
            voxel_path_lps=route.points_lps,
            target_node=0,
            snapped_mm=0.0 if distance < 1e-9 else distance,
        )

    @property
    def core(self) -> Any:
        return SimpleNamespace(radius_mm=lambda points: np.full(len(points), 2.0))

    def calibres(self, points_lps: Any, _branch_ids: Any) -> Any:
        return np.full(len(points_lps), 2.0)

    def inside(self, points_lps: Any) -> Any:
        return np.array([self.tree.nearest_branch(point)[2] <= 3.0 for point in points_lps])

    def branch_at(self, point_lps: Any) -> int:
        return self.tree.nearest_branch(point_lps)[0].id

    def live_path(self, point_lps: Any) -> Any:
        branch, _, distance = self.tree.nearest_branch(point_lps)
        if distance > 5.0:
            return SimpleNamespace(
                points_lps=np.empty((0, 3)),
                length_mm=0.0,
                min_radius_mm=None,
                confidence=None,
                snapped_mm=None,
                new_mm=None,
                joins_branch_id=None,
                problem=f"the nearest airway is {distance:.1f} mm away",
            )
        route = self.tree.route_to(branch.id)
        return SimpleNamespace(
            points_lps=route.points_lps,
            length_mm=route.length_mm,
            min_radius_mm=float(route.radius_mm.min()),
            confidence=0.75,
            snapped_mm=distance,
            new_mm=0.0,
            joins_branch_id=branch.id,
            problem=None,
        )


def small_airways(volume: Volume, *, root_lps: Any = None, note: str = "three branches") -> Any:
    """Return the airways of :func:`small_volume`, without a search."""
    tree = small_tree(volume.lps_from_ijk)
    return SimpleNamespace(
        lumen_zyx=small_lumen(),
        root_lps=np.asarray(tree.branches[0].points[0] if root_lps is None else root_lps),
        tree=tree,
        tracker=SmallTracker(
            tree,
            SimpleNamespace(ct=volume, shape_zyx=volume.shape_zyx, lps_from_ijk=volume.lps_from_ijk),
            small_lumen(),
        ),
        report=[note],
        uncertain=(),
        absent=(),
        badges=(),
        threshold=-800.0,
        wall_levels=None,
    )


@dataclass
class SmallRenderer:
    """Renderer that returns grey pictures of the requested size and records the requests."""

    volume: Volume
    transfer: Any
    views: list[Any] = field(default_factory=list)
    lumen: Any = None
    prepared: int = 0
    on_render: Callable[[Any], None] = lambda _view: None
    hit: Any = None
    """Wall point that a pick returns; None if the pick finds none."""
    grey: int = 90
    """Grey level of all pixels of the pictures, 0 to 255."""
    rays_s: float | None = None
    """CPU time of a picture's rays that the renderer reports, seconds, or None."""
    picks: list[Any] = field(default_factory=list)
    on_prepare: Callable[[], None] = lambda: None

    def pick(self, view: Any, column: int, row: int) -> Any:
        self.picks.append((view, column, row))
        return self.hit

    def render(self, view: Any, *, stop: Any = None) -> Any:
        self.views.append(view)
        self.on_render(view)
        if stop is not None and stop.cancelled and type(view).__name__ == "AirwayView":
            raise CancelledError("given up")
        planar = type(view).__name__ != "AirwayView"
        return SimpleNamespace(
            rgb=np.full((view.height, view.width, 3), self.grey, dtype=np.uint8),
            view=type(view).__name__,
            lps_from_pixel=np.eye(4) if planar else None,
            lines=None,
            lps_from_camera=None if planar else view.pose.lps_from_camera,
            lps_from_rest=None,
            fov_deg=None if planar else 90.0,
            optics=None,
            decorated=(),
            stats=SimpleNamespace(method="brute", rays_s=self.rays_s),
        )

    def set_transfer(self, transfer: Any) -> None:
        self.transfer = transfer

    def set_lumen(self, lumen_zyx: Any, tree: Any = None) -> None:
        self.lumen, self.tree = lumen_zyx, tree

    def prepare(self, progress: Any = None, cancel: Any = None) -> None:
        self.on_prepare()
        if cancel is not None and cancel():
            raise CancelledError("stopped")
        self.prepared += 1


class Background:
    """Queue of submitted work that a test runs in its thread."""

    def __init__(self) -> None:
        self.waiting: list[Callable[[], None]] = []

    def __call__(self, work: Callable[[], None]) -> None:
        self.waiting.append(work)

    def run_next(self) -> None:
        self.waiting.pop(0)()

    def run_all(self) -> None:
        while self.waiting:
            self.run_next()


class Clock:
    """Clock in seconds that only the test advances."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    def advance(self, seconds: float) -> None:
        self.now_s += seconds


def small_transfer(name: str = "endoscopic", unit: str = "HU") -> Any:
    """Return a replacement of a transfer function with a name and a unit of values."""
    return SimpleNamespace(name=name, unit=unit, to_json=lambda: {"format": "carina-transfer", "version": 1})


def small_parts(**replaced: Any) -> Parts:
    """Return replacements of all slow parts, which answer at once.

    Paths that end in ``bad`` are refused, ``other`` gives another title, and ``raw`` values that are not HU.
    """
    transfers = {name: small_transfer(name) for name in ("endoscopic", "ct-grey")}

    def open_volume(path: str, progress: Any, cancel: Any) -> Volume:
        progress("reading", 0.5)
        if cancel():
            raise CancelledError("stopped")
        if path.endswith("bad"):
            raise VolumeImportError(f"{path} holds no images: choose a DICOM folder", code="import.no-images")
        return small_volume(title="Other" if path.endswith("other") else "Thorax 1.5", is_hu=not path.endswith("raw"))

    def find_airways(volume: Volume, *, root_lps: Any, lumen_threshold: Any, progress: Any, cancel: Any) -> Any:
        progress("growing", 0.2)
        if cancel():
            raise CancelledError("stopped")
        if root_lps is not None and volume.to_ijk(np.asarray(root_lps))[2] < 2.0:
            raise NoResultError("no airway at this point")
        return small_airways(volume, root_lps=root_lps)

    def target_from_click(_volume: Volume, _at_lps: Any, **_options: Any) -> Any:
        raise NoResultError("no boundary was found", code="plan.no-boundary")

    parts: dict[str, Any] = {
        "target_from_click": target_from_click,
        "open_volume": open_volume,
        "open_demo": lambda name, progress, cancel: small_volume(title=f"Demo {name}"),
        "quality_words": lambda volume: ("slices are 2.0 mm apart",),
        "assess_ct": lambda volume, airways: SMALL_ASSESSMENT,
        "find_airways": find_airways,
        "distance_origin": lambda _volume, airways: axes_origin(airways.tree),
        "transfer_preset": transfers.__getitem__,
        "transfer_from_json": lambda document: small_transfer("custom", document.get("unit", "HU")),
        "transfer_from_histogram": lambda volume: (small_transfer("from histogram", "raw"), 105.0),
        "presets": ("endoscopic", "ct-grey"),
    }
    return Parts(**(parts | replaced))


@dataclass
class SessionFixture:
    """Session with a background and a clock that the test controls, and all events of the session."""

    session: Session
    background: Background
    clock: Clock
    events: list[Any]
    renderers: list[SmallRenderer]

    def open(self, path: str = "case") -> None:
        self.session.do(OpenPath(path))
        self.background.run_all()

    def of_type(self, kind: type) -> list[Any]:
        return [e for e in self.events if isinstance(e, kind)]


def session_fixture(*, store: Any = None, **replaced: Any) -> SessionFixture:
    """Return a session over the replacements of the slow parts, with its background and clock."""
    background, clock = Background(), Clock()
    renderers: list[SmallRenderer] = []

    def factory(volume: Volume, transfer: Any) -> SmallRenderer:
        renderers.append(SmallRenderer(volume, transfer))
        return renderers[-1]

    session = Session(
        factory,
        parts=small_parts(**replaced),
        store=store,
        submit=background,
        clock=clock,
        today=lambda: "2026-01-31",
    )
    events: list[Any] = []
    session.subscribe(events.append)
    return SessionFixture(session, background, clock, events, renderers)


def edit_session_fixture(volume: Volume, airways: Airways) -> SessionFixture:
    """Return a session that has opened a volume with these airways and makes real edits of them."""
    made = session_fixture(
        open_volume=lambda _path, _progress, _cancel: volume,
        find_airways=lambda _volume, **_options: airways,
        edit_airways=edit_airways,
    )
    made.open()
    return made
