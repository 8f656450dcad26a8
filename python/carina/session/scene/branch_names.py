"""Selection and positions of the branch names in a saved picture of a view."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from carina.breathing import ChestDeformation
from carina.render import LEAD_VIEW, VIEWS, PathSpan, Picture
from carina.render.saved_picture import NamedPlace, PictureMarks, finish_picture
from carina.track import Airways, AirwayTree, Branch, kind_words
from carina.track.tree.branch_at_point import branch_at_point
from carina.track.tree.branch_labels import branch_label

if TYPE_CHECKING:
    from carina.case.routes import ChosenRoute, RouteSpan
    from carina.volume import Volume

AHEAD_MM = 45.0
"""Distance ahead of the lens, mm, up to which names are written in the airway view."""
ALONG_MM = 15.0
"""Length in mm of a branch's beginning in which the position of its name in the airway view is searched."""
STEP_MM = 0.5
"""Step in mm along the line from the lens to a point in the test whether a wall hides the point."""

Points = NDArray[np.float64]


def finish_case_picture(
    picture: Picture,
    marks: PictureMarks,
    *,
    volume: Volume,
    airways: Airways | None,
    route: ChosenRoute | None,
    tip_lps: Points | None,
) -> Picture:
    """Return a copy of a picture of a case with its marks, as the command line and the window save it.

    Parameters
    ----------
    picture
        The picture as rendered.
    marks
        Marks that the user selected.
    volume, airways
        The CT and its airways, with all edits; None without airways.
    route
        Route of a view along a path; None for other views.
    tip_lps
        Position of the tip, LPS mm; None if no position was selected.
    """
    row = VIEWS[picture.view]
    extra: dict[str, Any] = {}
    if route is not None and picture.lines is not None:
        extra = {"spans": path_spans(route, airways), "radius_mm": (route.cumulative_mm, route.radius_mm)}
    elif marks.names and row.named and airways is not None:
        branch = _branch_at_lens(picture, airways.tree)
        extra = {
            "places": _places(picture, volume, airways, without=None if branch is None else branch.name),
            "title": None if branch is None else branch_label(branch),
        }
    return finish_picture(picture, marks, tip_lps=tip_lps, **extra)


def path_spans(route: ChosenRoute, airways: Airways | None) -> list[PathSpan]:
    """Return the branches along a route with the names that a view along the path shows."""
    branches = {} if airways is None else {branch.id: branch for branch in airways.tree.branches}

    def name(span: RouteSpan) -> str:
        branch = branches.get(span.branch_id)
        own = span.name or f"generation {span.generation}"
        return kind_words(span.kind) or (
            branch_label(branch) if branch is not None and branch.name == span.name else own
        )

    return [PathSpan(name(s), s.from_mm, s.to_mm, drawn=s.kind != "tracked") for s in route.spans]


def _places(picture: Picture, volume: Volume, airways: Airways, *, without: str | None) -> list[NamedPlace]:
    """Return the names for a picture except ``without``, and their places, large branches first; each name once."""
    named = sorted(
        (b for b in airways.tree.branches if b.name and b.name != without), key=lambda b: -float(np.median(b.radius))
    )
    found: dict[str, NamedPlace] = {}
    for branch in named:
        if branch.name in found:
            continue
        point = _place(picture, branch, volume, airways)
        if point is not None:
            x, y, z = (float(v) for v in point)
            found[str(branch.name)] = NamedPlace(branch_label(branch), (x, y, z), doubtful=branch.kind != "tracked")
    return list(found.values())


def _place(picture: Picture, branch: Branch, volume: Volume, airways: Airways) -> Points | None:
    """Return the point of a branch at which a picture shows its name; None if the picture does not show the branch."""
    points = np.asarray(branch.points, dtype=np.float64)
    if picture.lps_from_pixel is not None:
        return next(_crossings(points, picture.lps_from_pixel), None)
    if picture.lps_from_camera is None:
        return None
    if picture.view != LEAD_VIEW:
        middle: Points = points[len(points) // 2]
        return middle
    place = _place_ahead(points, _lens_at_rest(picture), volume, airways)
    if place is None or picture.lps_from_rest is None:
        return place
    moved: Points = ChestDeformation(picture.lps_from_rest).points(place)[0]
    return moved


def _lens_at_rest(picture: Picture) -> Points:
    """Return the position of the lens in the CT at rest, where the airways are."""
    assert picture.lps_from_camera is not None
    lens: Points = picture.lps_from_camera[:3, 3]
    return lens if picture.lps_from_rest is None else ChestDeformation(picture.lps_from_rest).rest_points(lens)[0]


def _crossings(points: Points, lps_from_pixel: Points) -> Iterator[Points]:
    """Yield the points at which a centreline crosses the plane of a picture."""
    depth = np.linalg.solve(lps_from_pixel[:3, :3], (points - lps_from_pixel[:3, 3]).T)[2]
    for n in np.flatnonzero(np.diff(np.signbit(depth))):
        part = depth[n] / (depth[n] - depth[n + 1])
        yield points[n] + part * (points[n + 1] - points[n])


def _place_ahead(points: Points, lens_lps: Points, volume: Volume, airways: Airways) -> Points | None:
    """Return the farthest point of the beginning of a branch that the lens sees through the lumen."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    for n in np.flatnonzero(along <= ALONG_MM)[::-1]:
        away_mm = float(np.linalg.norm(points[n] - lens_lps))
        if away_mm <= AHEAD_MM and _is_seen(points[n], lens_lps, volume, airways):
            return np.asarray(points[n])
    return None


def _is_seen(point: Points, lens_lps: Points, volume: Volume, airways: Airways) -> bool:
    """Return whether the line from the lens to a point stays in the lumen."""
    steps = max(int(np.linalg.norm(point - lens_lps) / STEP_MM), 2)
    line = lens_lps + np.linspace(0.0, 1.0, steps + 1)[:, None] * (point - lens_lps)
    ijk = np.rint(volume.to_ijk(line)).astype(int)
    shape = np.array(volume.shape_zyx[::-1])
    if (ijk < 0).any() or (ijk >= shape).any():
        return False
    return bool((airways.lumen_zyx[ijk[:, 2], ijk[:, 1], ijk[:, 0]] != 0).all())


def _branch_at_lens(picture: Picture, tree: AirwayTree) -> Branch | None:
    """Return the named branch that contains the lens of an airway view; None without one."""
    if picture.view != LEAD_VIEW or picture.lps_from_camera is None:
        return None
    found = branch_at_point(tree, _lens_at_rest(picture))
    return None if found is None or found[0].name is None else found[0]
