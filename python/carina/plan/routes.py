"""Ways to a target that lies outside the airways: where the scope stands, and the last leg through the wall.

Every point of the centrelines from which the tool may reach is looked at; of each branch the best place is kept, and
the routes are ranked by a score whose parts are told (docs/decisions/0065).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.display import one_line
from carina.errors import CancelledError, UsageError, check_type
from carina.plan.last_leg import LastLeg, NeedleScene, last_leg, where_it_may_have_moved
from carina.plan.needle import NeedleErrors
from carina.plan.nodule import Nodule, grow_nodule
from carina.plan.surroundings import surroundings
from carina.plan.tools import DEFAULT_TOOL, Tool
from carina.plan.tools import tool as tool_named
from carina.scopes import ScopePreset, WallField, scope_preset
from carina.track import Airways, AirwayTree, Branch, branch_side_and_lobe, wall_field
from carina.volume import Volume

__all__ = ["PLANNED_SCOPE", "BronchusSign", "Plan", "PlannedRoute", "ScoreWeights", "plan_route"]

Points = NDArray[np.float64]
BronchusSign = Literal["into", "beside", "none"]

PLANNED_SCOPE = "thin"
"""The thinnest whose channel takes a needle of 1.8 mm; unless another is chosen."""
MOST_ANGLE_DEG = 100.0
"""A needle that leaves at more than this from the airway's axis comes back at the scope."""
DEEP_MM = 8.0
"""So much of a needle's way in the target is enough for a sample."""
PLACES_MM = 0.7
"""Places nearer to one another on a centreline are one."""
MOST_ROUTES = 5
APART_MM = 4.0
"""Routes that stand nearer to one another are one."""
INTO_MM, BESIDE_MM = 0.8, 2.0
"""A lumen this near to the nodule leads into it, or lies against it."""
DOUBTFUL = 0.5
"""Below this confidence a branch is doubtful."""
LOWER_LOBE_MM, ELSEWHERE_MM = 20.0, 15.0
"""How far a nodule may lie from where the CT at full inspiration shows it: 17.6 mm on average, more than 20 mm in the
lower lobes (85 lesions: Chen et al., Chest 2015;147:1275; s); 15 mm elsewhere (k)."""
BOX_MM = 14.0
"""Room round target and tip that is looked at."""
MOST_BOX_MM = 60.0


@one_line
@dataclass(frozen=True, slots=True)
class ScoreWeights:
    """What each part of a route's score counts. A part is 0 at its best and 1 where it is as bad as can be."""

    misses: float = 0.25
    """Needle positions that miss."""
    way: float = 0.15
    """Way outside the lumen, of the tool's reach."""
    angle: float = 0.15
    """Angle between needle and airway, of 90 degrees."""
    narrow: float = 0.3
    """What the narrowest place on the way lacks for the scope, of the scope's own size; 1 where it lacks a quarter."""
    vessels: float = 0.1
    """What the nearest vessel lacks of the margin."""
    shallow: float = 0.15
    """What the needle's way in the target lacks of 8 mm, or of the target's own length."""

    def __post_init__(self) -> None:
        values = [getattr(self, name) for name in self.__slots__]
        if not all(math.isfinite(v) and v >= 0.0 for v in values) or sum(values) <= 0.0:
            raise UsageError(f"weights: expected numbers from 0 up, not all 0; found {values}", code="plan.weights")


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PlannedRoute:
    """A way along the airways to where the scope stands, and from there into the target."""

    branch_id: int
    """Where the scope stands."""
    branch_name: str
    along_mm: float
    """From the root, where the tip stands."""
    from_carina_mm: float | None
    """The same from the main carina; None where the tree shows none on the way."""
    forward: tuple[float, float, float]
    """The airway's direction there."""
    narrowest_mm: float
    """Diameter of the largest ball that passes on the way."""
    fits: bool
    """The scope with its margin is no larger than that."""
    leg: LastLeg
    parts: dict[str, float]
    """Of the score, each 0 to 1 (`ScoreWeights`)."""
    score: float
    """0 to 1, 1 the best."""
    doubts: tuple[str, ...]
    """What must be said of this route wherever it is shown: branches drawn by hand, bridges, doubtful ones."""

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "branch_id": self.branch_id,
            "branch_name": self.branch_name,
            "along_mm": self.along_mm,
            "from_carina_mm": self.from_carina_mm,
            "forward": list(self.forward),
            "narrowest_mm": self.narrowest_mm,
            "fits": self.fits,
            "leg": self.leg.to_json(),
            "parts": self.parts,
            "score": self.score,
            "doubts": list(self.doubts),
        }


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A target and the ways to it, the best first.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> plan = carina.plan_route(made.volume, carina.find_airways(made.volume), made.truth["nodule"]["center_lps"])
    >>> plan.why is None, plan.to_json()["format"]
    (True, 'carina-plan')
    """

    nodule: Nodule
    scope: ScopePreset
    tool: Tool
    bronchus_sign: BronchusSign
    sign_branch: str | None
    """The airway that shows it."""
    sign_lps: tuple[float, float, float] | None
    """Where it does: the slices through this place prove it."""
    moved_mm: float
    routes: tuple[PlannedRoute, ...]
    why: str | None
    """Why there is no route, and what would help; None where there is one."""
    notes: tuple[str, ...] = field(default=())

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types."""
        return {
            "format": "carina-plan",
            "version": 1,
            "space": "LPS",
            "unit": "mm",
            "target": self.nodule.to_json(),
            "scope": self.scope.name,
            "tool": self.tool.name,
            "bronchus_sign": self.bronchus_sign,
            "sign_branch": self.sign_branch,
            "sign_lps": None if self.sign_lps is None else list(self.sign_lps),
            "moved_mm": self.moved_mm,
            "routes": [route.to_json() for route in self.routes],
            "why": self.why,
            "notes": list(self.notes),
        }


def plan_route(
    volume: Volume,
    airways: Airways,
    target: Nodule | ArrayLike,
    *,
    scope: ScopePreset | str = PLANNED_SCOPE,
    tool: Tool | str = DEFAULT_TOOL,
    vessel_margin_mm: float = 3.0,
    moved_mm: float | None = None,
    errors: NeedleErrors | None = None,
    weights: ScoreWeights | None = None,
    wall: WallField | None = None,
    progress: Callable[[float], None] | None = None,
    cancel: Callable[[], bool] | None = None,
) -> Plan:
    """Ways to a nodule: where a scope stands, and the needle's way from there.

    Parameters
    ----------
    volume, airways
        The CT and the airways in it.
    target
        A nodule, or a point in one, LPS mm (`grow_nodule`).
    scope, tool
        Instruments or their names in the libraries. The tool must go through a wall; what a scope can reach is told
        by its drive.
    vessel_margin_mm
        A vessel nearer to the needle than this counts against a route.
    moved_mm
        How far the target may have moved since the CT; by lobe unless told.
    errors, weights
        Of the needle, and of the score.
    wall
        The airways' wall where it is at hand (`carina.wall_field`); else it is made.
    progress, cancel
        Told the share done; asked whether to stop.

    Returns
    -------
    Plan
        With no route, and the reason in words, where no tool gets to the target from an airway that was found.

    Raises
    ------
    UsageError
        If a number is out of range or a name unknown.
    NoResultError
        If there is no nodule at the point (`grow_nodule`).
    CancelledError
        If ``cancel()`` said so.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.2, generations=5, nodule=True)
    >>> found = carina.find_airways(made.volume)
    >>> plan = carina.plan_route(made.volume, found, made.truth["nodule"]["center_lps"])
    >>> plan.routes[0].leg.reaches
    True
    """
    check_type("plan_route", "volume", volume, Volume, "open a volume with carina.open_volume")
    check_type("plan_route", "airways", airways, Airways, "get airways from carina.find_airways")
    preset = scope_preset(scope) if isinstance(scope, str) else scope
    used = tool_named(tool) if isinstance(tool, str) else tool
    if not used.pierces:
        raise UsageError(
            f"{used.title} cannot pass through an airway wall; choose a needle for a target outside the airways",
            code="plan.tool",
        )
    for name, value, most in (("vessel_margin_mm", vessel_margin_mm, 50.0), ("moved_mm", moved_mm or 0.0, 60.0)):
        if not (math.isfinite(value) and 0.0 <= value <= most):
            raise UsageError(f"{name}: expected 0 to {most:g}; found {value}", code="plan.range")
    say = _Steps(progress, cancel)
    nodule = target if isinstance(target, Nodule) else grow_nodule(volume, target)
    say(0.1)
    wall = wall_field(volume, airways, cancel=cancel) if wall is None else wall
    say(0.5)
    places = _Places(airways.tree, nodule)
    moved = places.moved_mm() if moved_mm is None else moved_mm
    sign, sign_branch, sign_lps = places.bronchus_sign()
    candidates = places.within_reach(used)
    best: dict[int, PlannedRoute] = {}
    kept: tuple[PlannedRoute, ...] = ()
    if candidates.size:
        centre = np.array(nodule.centre_lps)
        half = float(places.distance[candidates].max()) + 0.5 * nodule.long_mm + BOX_MM
        around = surroundings(volume, centre, min(half, MOST_BOX_MM), nodule, wall)
        scene = NeedleScene(nodule, wall, around, used, errors or NeedleErrors())
        judge = _Judge(preset, vessel_margin_mm, weights or ScoreWeights(), used)
        for step, n in enumerate(candidates):
            say(0.6 + 0.35 * step / len(candidates))
            leg = last_leg(scene, places.points[n], places.forward[n])
            if not leg.reaches:
                continue
            route = places.route(int(n), leg, judge)
            known = best.get(route.branch_id)
            if known is None or route.score > known.score:
                best[route.branch_id] = route
        kept = tuple(
            replace(route, leg=where_it_may_have_moved(scene, route.leg, moved))
            for route in standing_apart(sorted(best.values(), key=lambda route: (-route.score, route.branch_id)))
        )
    say(1.0)
    return Plan(
        nodule=nodule,
        scope=preset,
        tool=used,
        bronchus_sign=sign,
        sign_branch=sign_branch,
        sign_lps=sign_lps,
        moved_mm=moved,
        routes=kept,
        why=None if kept else places.why_none(used),
        notes=(*(note.words for note in airways.badges), *_channel_note(preset, used)),
    )


def _channel_note(scope: ScopePreset, tool: Tool) -> tuple[str, ...]:
    """That the tool does not go through the scope, where that is known."""
    if scope.channel_mm is None or tool.passes(scope.channel_mm):
        return ()
    return (
        f"{tool.title} ({tool.outer_mm:g} mm) does not fit the working channel of {scope.title} "
        f"({scope.channel_mm:g} mm)",
    )


class _Steps:
    """Progress and cancel between steps."""

    def __init__(self, progress: Callable[[float], None] | None, cancel: Callable[[], bool] | None) -> None:
        self._progress, self._cancel = progress, cancel

    def __call__(self, share: float) -> None:
        if self._cancel is not None and self._cancel():
            raise CancelledError("planning was cancelled")
        if self._progress is not None:
            self._progress(share)


@dataclass(frozen=True, slots=True)
class _Judge:
    """By what a route is judged."""

    scope: ScopePreset
    margin_mm: float
    weights: ScoreWeights
    tool: Tool

    def parts(self, leg: LastLeg, narrowest_mm: float, nodule: Nodule) -> dict[str, float]:
        """Of the score, each 0 to 1 (`ScoreWeights`)."""
        near = 0.0 if self.margin_mm <= 0.0 or leg.vessel_mm is None else 1.0 - leg.vessel_mm / self.margin_mm
        found = {
            "misses": 1.0 - leg.hit_share,
            "way": leg.outside_mm / self.tool.reach_mm,
            "angle": leg.angle_deg / 90.0,
            "narrow": 4.0 * (1.0 - narrowest_mm / self.scope.fit_mm),
            "vessels": near,
            "shallow": 1.0 - leg.in_target_mm / min(DEEP_MM, 0.9 * nodule.short_mm),
        }
        return {name: float(np.clip(part, 0.0, 1.0)) for name, part in found.items()}

    def score(self, parts: dict[str, float]) -> float:
        """0 to 1, 1 the best."""
        total = sum(getattr(self.weights, name) for name in parts)
        lost = sum(getattr(self.weights, name) * part for name, part in parts.items())
        return 1.0 - float(lost) / float(total)


class _Places:
    """All points of a tree's branches as places where a scope may stand, against one nodule."""

    def __init__(self, tree: AirwayTree, nodule: Nodule) -> None:
        self._tree, self._nodule = tree, nodule
        branches = [branch for branch in tree.branches if branch.parent is not None and len(branch.points) > 1]
        self._row = {branch.id: branch for branch in tree.branches}
        along, narrowest = _on_the_way(tree)
        self.points = np.concatenate([b.points for b in branches]) if branches else np.empty((0, 3))
        self.forward = np.concatenate([_tangents(b.points) for b in branches]) if branches else np.empty((0, 3))
        self.branch = np.concatenate([np.full(len(b.points), b.id) for b in branches]) if branches else np.empty(0)
        self.along_mm = np.concatenate([along[b.id] for b in branches]) if branches else np.empty(0)
        self.narrowest_mm = np.concatenate([narrowest[b.id] for b in branches]) if branches else np.empty(0)
        self.radius = np.concatenate([b.wall_distance for b in branches]) if branches else np.empty(0)
        off = np.array(nodule.centre_lps) - self.points
        self.distance = np.linalg.norm(off, axis=1)
        cosine = (off * self.forward).sum(axis=1) / np.maximum(self.distance, 1e-9)
        self.angle_deg = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def within_reach(self, tool: Tool) -> NDArray[np.intp]:
        """Places from which the tool may reach the nodule forwards."""
        near = self.distance <= tool.reach_mm + self._nodule.long_mm
        edge = np.full(len(self.distance), np.inf)
        if near.any():
            edge[near] = self._nodule.distance_mm(self.points[near])
        may = np.flatnonzero((edge <= tool.reach_mm) & (self.angle_deg <= MOST_ANGLE_DEG))
        kept: list[int] = []
        for n in may:
            last = kept[-1] if kept else None
            if (
                last is None
                or self.branch[last] != self.branch[n]
                or self.along_mm[n] - self.along_mm[last] >= PLACES_MM
            ):
                kept.append(int(n))
        return np.array(kept, dtype=np.intp)

    def route(self, n: int, leg: LastLeg, judge: _Judge) -> PlannedRoute:
        """A place with its last leg, judged."""
        branch = self._row[int(self.branch[n])]
        narrowest = float(self.narrowest_mm[n])
        parts = judge.parts(leg, narrowest, self._nodule)
        carina_mm = self._carina_mm(branch)
        return PlannedRoute(
            branch_id=branch.id,
            branch_name=branch_title(branch),
            along_mm=float(self.along_mm[n]),
            from_carina_mm=None if carina_mm is None else float(self.along_mm[n]) - carina_mm,
            forward=(float(self.forward[n][0]), float(self.forward[n][1]), float(self.forward[n][2])),
            narrowest_mm=narrowest,
            fits=narrowest >= judge.scope.fit_mm,
            leg=leg,
            parts=parts,
            score=judge.score(parts),
            doubts=self._doubts(branch),
        )

    def bronchus_sign(self) -> tuple[BronchusSign, str | None, tuple[float, float, float] | None]:
        """Whether an airway leads into the nodule or lies beside it, which one, and where."""
        near = np.flatnonzero(self.distance <= self._nodule.long_mm + 6.0)
        if not near.size:
            return "none", None, None
        gap = self._nodule.distance_mm(self.points[near])
        # An airway that leads there points there; one that passes by does not.
        into = (gap - self.radius[near] <= INTO_MM) & ((self.angle_deg[near] <= 60.0) | (gap <= 0.0))
        beside = gap - self.radius[near] <= BESIDE_MM
        for sign, which in (("into", into), ("beside", beside)):
            if which.any():
                n = int(near[which][np.argmin(gap[which])])
                place = self.points[n]
                name = branch_title(self._row[int(self.branch[n])])
                return sign, name, (float(place[0]), float(place[1]), float(place[2]))  # type: ignore[return-value]
        return "none", None, None

    def moved_mm(self) -> float:
        """How far the nodule may have moved, by the lobe of the airway that is nearest."""
        branch, _, _ = self._tree.nearest_branch(self._nodule.centre_lps)
        lobe = branch_side_and_lobe(self._tree)[branch.id]
        # Where the lobe is not known, the larger of the two.
        return LOWER_LOBE_MM if lobe in {"RLL", "LLL", None} else ELSEWHERE_MM

    def why_none(self, tool: Tool) -> str:
        """Why there is no route, and what would help."""
        if not len(self.points):
            return "no route: the airway tree has no branches; find the airways first"
        gap = self._nodule.distance_mm(self.points[[int(np.argmin(self.distance))]])[0]
        nearest = branch_title(self._row[int(self.branch[int(np.argmin(self.distance))])])
        if gap > tool.reach_mm:
            return (
                f"no route: the nearest airway found is {nearest}, {gap:.0f} mm from the nodule; {tool.title} reaches "
                f"{tool.reach_mm:.0f} mm. If the CT shows a closer airway, add it to the tree and plan again; "
                "otherwise consider a longer needle or percutaneous access"
            )
        return (
            f"no route: {nearest} passes {gap:.0f} mm from the nodule, but a needle cannot be advanced forwards into "
            "the nodule from any point along it; consider another access"
        )

    def _carina_mm(self, branch: Branch) -> float | None:
        lineage = self._tree.lineage(branch.id)
        if len(lineage) < 2:
            return None
        inside = 0.0
        for one in lineage:
            if one.name in {"RMB", "LMB"}:
                return inside
            inside += one.length_mm
        return None

    def _doubts(self, branch: Branch) -> tuple[str, ...]:
        return tuple(words for one in self._tree.lineage(branch.id) for words in branch_doubts(one))


def branch_doubts(branch: Branch) -> tuple[str, ...]:
    """What must be said of a branch wherever a route over it is shown."""
    if branch.kind == "bridge":
        return (f"{branch_title(branch)} is a bridge across an obstruction: the CT shows no airway there",)
    if branch.kind == "manual":
        return (f"{branch_title(branch)} was drawn by hand",)
    if branch.confidence is not None and branch.confidence < DOUBTFUL:
        sure = f"{100 * branch.confidence:.0f} % confidence that it is an airway"
        return (f"{branch_title(branch)} is doubtful: {sure}",)
    return ()


def _on_the_way(tree: AirwayTree) -> tuple[dict[int, Points], dict[int, Points]]:
    """For the points of each branch the way from the root, mm, and the diameter of the ball that gets there, mm."""
    along: dict[int, Points] = {}
    narrowest: dict[int, Points] = {}
    # Parents come first.
    for branch in tree.branches:
        steps = np.linalg.norm(np.diff(branch.points, axis=0), axis=1)
        own = np.concatenate([[0.0], np.cumsum(steps)])
        room = np.minimum.accumulate(2.0 * branch.wall_distance)
        if branch.parent is None:
            # Where the trachea begins, the CT may end.
            room = np.full(len(own), float(np.median(2.0 * branch.wall_distance)))
        else:
            own = own + along[branch.parent][-1]
            room = np.minimum(room, narrowest[branch.parent][-1])
        along[branch.id], narrowest[branch.id] = own, room
    return along, narrowest


def _tangents(points: Points) -> Points:
    ahead = np.gradient(points, axis=0)
    length = np.linalg.norm(ahead, axis=1, keepdims=True)
    found: Points = ahead / np.maximum(length, 1e-9)
    return found


def branch_title(branch: Branch) -> str:
    return branch.name or f"branch {branch.id}"


def standing_apart(routes: list[PlannedRoute]) -> tuple[PlannedRoute, ...]:
    """The best, without those that stand where a better one does."""
    kept: list[PlannedRoute] = []
    for route in routes:
        place = np.array(route.leg.tip_lps)
        if all(float(np.linalg.norm(place - np.array(one.leg.tip_lps))) > APART_MM for one in kept):
            kept.append(route)
        if len(kept) == MOST_ROUTES:
            break
    return tuple(kept)
