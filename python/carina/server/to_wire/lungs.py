"""Conversion of the lung map (vessels, fissures, lobes, reach) of a case to a wire message."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from carina.plan import EBUS_LIMITS
from carina.server.to_wire.thin_points import thinned
from carina.server.wire import messages as wire
from carina.session import LungsInfo

if TYPE_CHECKING:
    from carina.plan import Landmark, ReachAtlas
    from carina.plan.lungs.lung_map import LungMap
    from carina.plan.lungs.vessels import VesselTree

NO_MEDIASTINUM = "Vessels of the mediastinum and the hila are not shown: without contrast the CT does not show them."
MIN_SHARE = 0.05
"""Minimum visible share (0..1) of a fissure's lobe borders that is stated as a number; below: *hardly any seen*."""
MIN_LINE_MM = 6.0
"""Minimum length in mm of a vessel branch without children; shorter ones are noise and are not sent."""
VESSEL_POINT_EVERY_MM = 2.5
NO_DRIVE = (
    "Judged by diameter and bend along the way and by the directions that the tip can take. No drive was simulated, "
    "and breathing may move the target."
)


def lungs_message(info: LungsInfo) -> wire.Lungs:
    """Return the wire message of the lung map for the steps *Target* and *Route*."""
    lungs, reach = info.lungs, info.reach
    layers = (*(() if lungs is None else _lung_layers(lungs)), *(() if reach is None else (_reach_layer(reach),)))
    failed = tuple(words for words in (info.problem, info.reach_problem) if words is not None)
    return wire.Lungs(
        standing=info.standing,
        reach_standing=info.reach_standing,
        layers=layers,
        vessels=() if lungs is None or lungs.vessel_tree is None else tuple(_vessel_lines(lungs.vessel_tree)),
        stations=tuple(_station(one) for one in info.stations),
        station_limits=EBUS_LIMITS,
        problems=(*failed, *(() if lungs is None else lungs.problems)),
        outdated=info.outdated,
    )


def _lung_layers(lungs: LungMap) -> Iterator[wire.MappedLayer]:
    if lungs.vessels is not None:
        yield wire.MappedLayer(
            "vessels",
            f"{lungs.vessels.ml:.0f} ml in both lungs",
            (
                NO_MEDIASTINUM,
                "Arteries and veins are not distinguished, and vessels thinner than about 1 mm are seen in part; "
                "none is shown in the outermost 3 mm of the lungs, "
                "and round the airway tree none that runs along their edge.",
                "Dashed: less sure. Scars and airways that were not found may look like vessels.",
            ),
            (),
        )
    if lungs.fissures is not None:
        seen = lungs.fissures.inside_zyx.any()
        yield wire.MappedLayer(
            "fissures",
            _fissures_seen(lungs.fissure_shares) if seen else "none seen",
            ("Where none is shown there may be one, it may be fused, or the CT is too blurred for it.",),
            (),
        )
    if lungs.lobes:
        missing = f"No bronchus of {', '.join(lungs.missing_lobes)} is on the tree: its lung is counted to the others."
        yield wire.MappedLayer(
            "lobes",
            "estimated borders",
            (
                f"About {', '.join(f'{name} {mask.ml:.0f} ml' for name, mask in lungs.lobes)}.",
                "The borders are estimated from the airways, and lie on a fissure only where one is shown.",
                *((missing,) if lungs.missing_lobes else ()),
            ),
            tuple(name for name, _ in lungs.lobes),
        )


def _fissures_seen(shares: tuple[float | None, float | None] | None) -> str:
    sides = zip(("right", "left"), shares or (), strict=False)
    known = [(side, share) for side, share in sides if share is not None]
    if not known:
        return "as far as the CT shows them"
    if max(share for _, share in known) < MIN_SHARE:
        return "hardly any seen"
    # The borders are estimated, so the shares are rounded to the nearest 10 %.
    texts = [f"{10.0 * round(10.0 * share):.0f} % of the borders on the {side}" for side, share in known]
    return f"seen along about {' and '.join(texts)}"


def _vessel_lines(tree: VesselTree) -> Iterator[wire.VesselLine]:
    from carina.plan.lungs.lung_map import SURE  # slow import; needed only if there is a map

    left = {branch.parent for branch in tree.branches}
    for number, branch in enumerate(tree.branches):
        points = branch.points_lps
        length_mm = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        if length_mm < MIN_LINE_MM and number not in left:
            continue
        yield wire.VesselLine(
            points_lps=tuple(
                (float(x), float(y), float(z)) for x, y, z in np.round(thinned(points, VESSEL_POINT_EVERY_MM), 1)
            ),
            diameter_mm=round(2.0 * float(np.median(branch.radius_mm)), 1),
            sure=branch.sure >= SURE,
        )


def _reach_layer(reach: ReachAtlas) -> wire.MappedLayer:
    what = f"{reach.scope.title} with {reach.tool.title}"
    return wire.MappedLayer(
        "reach",
        f"{what}: a target of {reach.target_mm:.0f} mm in {100.0 * reach.share:.0f} % of the lungs",
        (*(() if reach.why is None else (f"{reach.why}.",)), NO_DRIVE, "Dashed: may reach."),
        (),
    )


def _station(mark: Landmark) -> wire.Station:
    return wire.Station(mark.station, mark.words, mark.point_lps, mark.direction_lps, mark.borders, mark.doubts)
