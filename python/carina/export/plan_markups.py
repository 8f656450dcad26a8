"""Export of a plan as 3D Slicer markups: one ``.mrk.json`` with all targets, routes, needles and scope positions.

Slicer creates a node for each entry of the list ``markups``, so that one file shows the whole plan. Slicer reads the
descriptions of control points only, not of a markup, so the texts of the plan are attached to points.

References
----------
3D Slicer markups schema 1.0.3; ``vtkMRMLMarkupsJsonStorageNode``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from carina.disk import write_whole
from carina.errors import UsageError
from carina.export.header_notes import badge_lines, lasting
from carina.export.plan_content import DrawnRoute, DrawnTarget, drawn_plans
from carina.plan import Plan
from carina.track import AirwayTree
from carina.volume import Note

PLAN_MARKUPS_SUFFIX: Final = ".mrk.json"
_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
_RGB = tuple[float, float, float]
# Colours that readers with any colour vision can distinguish; red is only for doubts.
_TARGET_RGB: _RGB = (0.94, 0.89, 0.26)
_BEST_RGB: _RGB = (0.0, 0.62, 0.45)
_OTHER_RGB: _RGB = (0.34, 0.71, 0.91)
_DOUBTFUL_RGB: _RGB = (0.85, 0.15, 0.15)
_NEEDLE_RGB: _RGB = (0.80, 0.47, 0.65)
# Orientation of a control point: Slicer's own axes (RAS), written in LPS.
_UPRIGHT = [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 1.0]


def write_plan_markups(
    path: Path | str, plan: Plan | Mapping[str, Plan], tree: AirwayTree, *, badges: Sequence[Note] = ()
) -> Path:
    """Write plans as 3D Slicer markups in LPS, mm.

    The markups: a point list *Targets*; for each target the lists *Scope positions* (final positions of the scope's
    tip) and *Needle entries* (where the needle enters the airway's wall); for each route a curve along the airways to
    the scope's position and a line from there to the aim. A route with doubts is red, and its name states this.

    Parameters
    ----------
    path
        File to be written; it must end in ``.mrk.json``.
    plan
        A plan, or several by the names of their targets.
    tree
        The airway tree of the plan.
    badges
        Lasting notes of the case (``carina.volume.badges_of``), written at each target.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    UsageError
        If the suffix is wrong, there is no target, or the tree is another one.
    DiskError
        If the file cannot be written; a former file stays unchanged.
    """
    if not Path(path).name.lower().endswith(PLAN_MARKUPS_SUFFIX):
        raise UsageError(
            f"saving the plan for 3D Slicer: expected a file name that ends in {PLAN_MARKUPS_SUFFIX}; found "
            f"{Path(path).name!r}"
        )
    targets = drawn_plans(plan, tree)
    notes = lasting(tree, badges)
    several = len(targets) > 1
    markups = [_target_list(targets, notes)]
    for target in targets:
        of = f" to {target.name}" if several else ""
        if target.routes:
            markups += [_tip_list(target, of), _entry_list(target, of)]
        for n, route in enumerate(target.routes):
            markups += [_curve(route, of, is_best=n == 0), _line(route, target, of)]
    document = {"@schema": _SCHEMA, "markups": markups}
    return write_whole(path, (json.dumps(document, allow_nan=False) + "\n").encode(), what="the plan")


def _target_list(targets: Sequence[DrawnTarget], notes: Sequence[Note]) -> dict[str, Any]:
    points = [
        _point(n, target.plan.nodule.centre_lps, target.name, _with_notes(target, notes))
        for n, target in enumerate(targets, 1)
    ]
    return _markup("Fiducial", "Targets", points, _TARGET_RGB, glyph_mm=6.0, has_labels=True)


def _with_notes(target: DrawnTarget, notes: Sequence[Note]) -> str:
    """Return the description of a target, with the case's notes that its plan does not contain."""
    more = badge_lines([note for note in notes if note.words not in target.plan.notes])
    return " ".join([target.words, *(f"{line}." for line in more)])


def _tip_list(target: DrawnTarget, of: str) -> dict[str, Any]:
    points = [
        _point(n, route.route.leg.tip_lps, f"Scope tip, {_title_with_doubt(route)}", route.words)
        for n, route in enumerate(target.routes, 1)
    ]
    return _markup("Fiducial", f"Scope positions{of}", points, _BEST_RGB, glyph_mm=3.0, has_labels=True)


def _entry_list(target: DrawnTarget, of: str) -> dict[str, Any]:
    points = [
        _point(n, route.route.leg.entry_lps, f"Needle entry, {_title_with_doubt(route)}", route.words)
        for n, route in enumerate(target.routes, 1)
    ]
    return _markup("Fiducial", f"Needle entries{of}", points, _NEEDLE_RGB, glyph_mm=2.0, has_labels=False)


def _curve(route: DrawnRoute, of: str, *, is_best: bool) -> dict[str, Any]:
    points = [_point(n, place, "", "") for n, place in enumerate(route.way_lps, 1)]
    points[-1]["label"], points[-1]["description"] = f"Scope tip, {_title_with_doubt(route)}", route.words
    points[0]["description"] = route.words
    colour = _DOUBTFUL_RGB if route.is_doubtful else _BEST_RGB if is_best else _OTHER_RGB
    return _markup(
        "Curve", f"{_title_with_doubt(route)}{of}", points, colour, glyph_mm=1.2, has_labels=False, words=route.words
    )


def _line(route: DrawnRoute, target: DrawnTarget, of: str) -> dict[str, Any]:
    leg = route.route.leg
    points = [
        _point(1, leg.tip_lps, "Scope tip", route.words),
        _point(2, leg.aim_lps, f"Aim in {target.name}", target.words),
    ]
    colour = _DOUBTFUL_RGB if route.is_doubtful else _NEEDLE_RGB
    name = f"Needle, {_title_with_doubt(route)}{of}"
    return _markup("Line", name, points, colour, glyph_mm=1.5, has_labels=False, words=route.words)


def _title_with_doubt(route: DrawnRoute) -> str:
    return f"{route.title} (DOUBTFUL)" if route.is_doubtful else route.title


def _point(number: int, place: Sequence[float] | NDArray[np.float64], label: str, words: str) -> dict[str, Any]:
    return {
        "id": str(number),
        "label": label,
        "description": words,
        "associatedNodeID": "",
        "position": [float(v) for v in place],
        "orientation": _UPRIGHT,
        "selected": True,
        "locked": True,
        "visibility": True,
        "positionStatus": "defined",
    }


def _markup(
    kind: str,
    name: str,
    points: list[dict[str, Any]],
    colour: _RGB,
    *,
    glyph_mm: float,
    has_labels: bool,
    words: str = "",
) -> dict[str, Any]:
    return {
        "type": kind,
        "name": name,
        # The description is for users who read the file; Slicer ignores it.
        "description": words,
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "fixedNumberOfControlPoints": False,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": len(points),
        "controlPoints": points,
        "measurements": [],
        "display": {
            "visibility": True,
            "opacity": 1.0,
            "color": list(colour),
            "selectedColor": list(colour),
            "propertiesLabelVisibility": kind != "Fiducial",
            "pointLabelsVisibility": has_labels,
            "textScale": 3.0,
            "glyphType": "Sphere3D",
            "useGlyphScale": False,
            "glyphSize": glyph_mm,
            "sliceProjection": True,
            "lineThickness": 0.8,
        },
    }
