"""Airway landmarks of lymph node stations for endobronchial ultrasound; nodes are not segmented and have no volumes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.errors import check_type
from carina.plan.routes.main_carina import DistanceOrigin, axes_origin, carina_words
from carina.plan.turns.fork_view import hours_of, turned_hours
from carina.scopes import upright
from carina.track import AirwayTree, Branch, name_words

Points = NDArray[np.float64]
Side = Literal["R", "L"]
DirectionBasis = Literal["tree", "k"]
"""Origin of a landmark's direction: ``tree``, two bronchi of this tree; ``k``, common knowledge for every chest."""

STATION_SOURCE = "Rusch et al., J Thorac Oncol 2009;4:568-577 (IASLC map)"
EBUS_LIMITS = (
    "Airway landmarks only. Lymph nodes are not looked for and have no volumes here; the vessels that bound the "
    "stations are not seen without contrast. Check each place on the CT."
)

TRACHEA_MM = 15.0
"""Distance in mm above the main carina at which station 4R is examined (site 3 on Wang's map for needles).

The point is at the second to fourth space between cartilages; the distance is common knowledge.
"""
TRACHEA_LEFT_MM = 6.0
"""Distance in mm above the main carina at which station 4L is examined (site 4 on Wang's map for needles).

The point is at the first or second space between cartilages; the distance is common knowledge.
"""
MAIN_SHARE = 0.6
"""Position on a main bronchus at which stations 7 and 10 are examined, as a share of the bronchus's length."""
BEYOND_MM = 4.0
"""Distance in mm beyond a fork, in its lower bronchus, at which station 11 is examined."""
ANGLE_MM = 10.0
"""Distance in mm from a fork to one point on each of its bronchi; the ultrasound probe is aimed between these
points."""
AXIS_MM = 3.0
"""Distance in mm to both sides of a point over which the direction of a bronchus is measured."""

_BORDERS = {
    "4R": "from where the left brachiocephalic vein crosses the trachea down to the lower border of the azygos vein, "
    "as far left as the trachea's left edge",
    "4L": "left of the trachea's left edge, from the top of the aortic arch to the upper rim of the left main "
    "pulmonary artery",
    "7": "below the carina, down to the upper border of the lower lobe bronchus on the left and the lower border of "
    "the bronchus intermedius on the right",
    "10R": "next to the right main bronchus and the hilar vessels, from the lower rim of the azygos vein down to the "
    "interlobar region",
    "10L": "next to the left main bronchus and the hilar vessels, from the upper rim of the pulmonary artery down to "
    "the interlobar region",
    "11Rs": "between the upper lobe bronchus and the bronchus intermedius",
    "11Ri": "between the middle and the lower lobe bronchus",
    "11L": "between the origins of the lobar bronchi",
}
_MIRRORED = "the chest is mirrored: the map is drawn for the usual anatomy, and the vessels that bound it lie mirrored"


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Landmark:
    """Place in the airways from which a lymph node station is examined, and the direction of the probe there."""

    station: str
    """Name of the station: 4R, 4L, 7, 10R, 10L, 11Rs, 11Ri, 11L; in a mirrored chest 11R, 11Ls, 11Li."""
    seen_from: str
    """Name of the airway from which the lymph node station is examined."""
    branch_id: int | None
    """ID of the branch from which the station is examined.

    None if the tree lacks the airways that define the landmark.
    """
    point_lps: tuple[float, float, float] | None
    """Point on the centreline of the airway from which the station is examined, LPS mm; None without this airway."""
    from_carina_mm: float | None
    """Distance of the point from the main carina along the airways, mm; below 0 if the point is above the carina.

    The origin is that of `ebus_landmarks`: the ridge of the carina, if it was given.
    """
    direction_lps: tuple[float, float, float] | None
    """Unit vector across the airway, LPS, towards the wall behind which the station is."""
    clock_head: float | None
    """Clock hour of the station in the levelled picture for an operator at the head, 0 < hours <= 12; error about 1."""
    clock_facing: float | None
    """Clock hour of the station for an operator who faces the patient, 0 < hours <= 12; None without this airway."""
    direction_basis: DirectionBasis
    borders: str
    """Anatomical borders of the station on the IASLC map, as text."""
    words: str
    doubts: tuple[str, ...]
    """Doubts, as texts, about the airways that define the landmark."""

    def to_json(self) -> dict[str, Any]:
        """Return the landmark as plain JSON types."""
        return {
            "station": self.station,
            "seen_from": self.seen_from,
            "branch_id": self.branch_id,
            "point_lps": None if self.point_lps is None else list(self.point_lps),
            "from_carina_mm": self.from_carina_mm,
            "direction_lps": None if self.direction_lps is None else list(self.direction_lps),
            "clock_head": self.clock_head,
            "clock_facing": self.clock_facing,
            "direction_basis": self.direction_basis,
            "borders": self.borders,
            "source": STATION_SOURCE,
            "words": self.words,
            "doubts": list(self.doubts),
        }


def ebus_landmarks(tree: AirwayTree, *, origin: DistanceOrigin | None = None) -> tuple[Landmark, ...]:
    """Return the landmarks of the stations 4R, 4L, 7, 10 and 11 in the airways, from the trachea outwards.

    A station whose airways are missing in the tree is returned without a point; the usual anatomy is never assumed.
    Station 7 has two landmarks, one in each main bronchus.

    Parameters
    ----------
    tree
        Named airways (`carina.find_airways`).
    origin
        Origin of the distances, the ridge of the main carina (`carina.plan.distance_origin`). If None, distances are
        measured from the point where the axes of the main bronchi meet, about a tracheal radius above the ridge.

    Returns
    -------
    tuple[Landmark, ...]
        Nine landmarks.

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(spacing_mm=4.0, generations=4)
    >>> marks = ebus_landmarks(carina.AirwayTree.from_json(made.truth))
    >>> [mark.station for mark in marks]
    ['4R', '4L', '7', '7', '10R', '10L', '11Rs', '11Ri', '11L']
    >>> round(marks[1].clock_head)
    9

    References
    ----------
    Stations: Rusch et al., J Thorac Oncol 2009;4:568. Which of Wang's places for needles belong to which station: Xia
    et al., Thorac Cancer 2015;6:464. Hours of 4 and 10 are common knowledge; those of 7 and 11 follow from the tree.
    """
    check_type("ebus_landmarks", "tree", tree, AirwayTree, "take the tree of carina.find_airways")
    return _Finder(tree, axes_origin(tree) if origin is None else origin).all()


def clock_hours(forward_lps: Points, direction_lps: Points) -> tuple[float, float]:
    """Return the clock hours of a direction in the levelled picture, for an operator at the head and for one who faces.

    Anterior is at 12 o'clock at the head, superior where the view is antero-posterior (docs/conventions.md).

    Parameters
    ----------
    forward_lps, direction_lps
        (3,) direction of the view, and the direction whose hours are returned; unit vectors, LPS.

    Returns
    -------
    head, facing
        Hours, 0 < hours <= 12.
    """
    up = upright(forward_lps)
    right = np.cross(forward_lps, up)
    head = hours_of(float(direction_lps @ right), -float(direction_lps @ up))
    return head, turned_hours(head)


class _Finder:
    def __init__(self, tree: AirwayTree, origin: DistanceOrigin) -> None:
        self._tree, self._origin = tree, origin
        self._by_id = {branch.id: branch for branch in tree.branches}
        names = {branch.name for branch in tree.branches}
        self._mirrored = "LML" in names or (tree.root.variant or "").startswith("mirrored")
        trachea = [branch for branch in tree.branches if branch.name == "Trachea"]
        self._trachea_mm = sum(branch.length_mm for branch in trachea)
        self._has_carina = bool(trachea) and bool({"RMB", "LMB"} & names)

    def all(self) -> tuple[Landmark, ...]:
        three: Side = "L" if self._mirrored else "R"
        two: Side = "R" if self._mirrored else "L"
        return (
            self._paratracheal(three, TRACHEA_MM, 45.0),
            self._paratracheal(two, TRACHEA_LEFT_MM, 90.0),
            self._subcarinal("R"),
            self._subcarinal("L"),
            self._hilar("R"),
            self._hilar("L"),
            self._interlobar(f"11{three}s", "11Rs", f"{three}UL", "BI"),
            self._interlobar(f"11{three}i", "11Ri", f"{three}ML", f"{three}LL"),
            self._interlobar(f"11{two}", "11L", f"{two}UL", f"{two}LL"),
        )

    def _paratracheal(self, side: Side, above_mm: float, turn_deg: float) -> Landmark:
        station = f"4{side}"
        like = station if not self._mirrored else {"4R": "4L", "4L": "4R"}[station]
        blank = _blank(station, "trachea", _BORDERS[like], "k")
        pieces = self._pieces("Trachea")
        if not pieces or not self._has_carina:
            return self._absent(blank, "the main carina is not on the tree")
        at = self._trachea_mm - above_mm
        if at < 0.0:
            return self._absent(blank, f"less than {above_mm:.0f} mm of the trachea is in the CT")
        return self._landmark(blank, pieces, at, _aside(side, turn_deg))

    def _subcarinal(self, side: Side) -> Landmark:
        name, other = f"{side}MB", "LMB" if side == "R" else "RMB"
        blank = _blank("7", _long(name), _BORDERS["7"], "tree")
        pieces, across = self._pieces(name), self._pieces(other)
        if not pieces or not across:
            return self._absent(blank, f"the {_long(name if not pieces else other)} is not on the tree")
        far = min(MAIN_SHARE * _length(pieces), MAIN_SHARE * _length(across))
        towards = _place(across, far)[0] - _place(pieces, far)[0]
        return self._landmark(blank, pieces, far, towards, also=across)

    def _hilar(self, side: Side) -> Landmark:
        station = f"10{side}"
        like = station if not self._mirrored else {"10R": "10L", "10L": "10R"}[station]
        blank = _blank(station, _long(f"{side}MB"), _BORDERS[like], "k")
        pieces = self._pieces(f"{side}MB")
        if not pieces:
            return self._absent(blank, f"the {_long(f'{side}MB')} is not on the tree")
        return self._landmark(blank, pieces, MAIN_SHARE * _length(pieces), _aside(side, 45.0))

    def _interlobar(self, station: str, like: str, upper: str, lower: str) -> Landmark:
        """Return the landmark of a lymph node station between two bronchi, examined from the lower bronchus."""
        blank = _blank(station, _long(lower), _BORDERS[like], "tree")
        pieces = self._pieces(lower)
        if not pieces:
            return self._absent(blank, f"the {_long(lower)} is not on the tree")
        beside = [self._by_id[child] for child in self._siblings(pieces[0]) if self._lobe(self._by_id[child]) == upper]
        if not beside:
            return self._absent(blank, f"no bronchus of the {_lobe_words(upper)} leaves the fork above it")
        other = max(beside, key=lambda branch: float(np.median(branch.radius)))
        towards = 0.5 * (_place((other,), ANGLE_MM)[0] + _place(pieces, ANGLE_MM)[0]) - pieces[0].points[0]
        # The second term directs the vector to the side of the other bronchus even if this bronchus is curved.
        towards = towards + (_place((other,), ANGLE_MM)[0] - _place(pieces, ANGLE_MM)[0])
        return self._landmark(blank, pieces, min(BEYOND_MM, 0.5 * _length(pieces)), towards, also=(other,))

    def _landmark(
        self, blank: Landmark, pieces: tuple[Branch, ...], at_mm: float, towards: Points, also: tuple[Branch, ...] = ()
    ) -> Landmark:
        point, forward, branch = _place(pieces, at_mm)
        across = towards - float(towards @ forward) * forward
        across = across / np.linalg.norm(across)
        head, facing = clock_hours(forward, across)
        from_carina = self._from_carina_mm(pieces[0], at_mm)
        level = ""
        if from_carina is not None:
            level = f", {carina_words(from_carina)}"
        words = f"{blank.station} from the {blank.seen_from}{level}: towards {_spoken(head)} o'clock"
        return replace(
            blank,
            branch_id=branch.id,
            point_lps=_tuple(point),
            from_carina_mm=from_carina,
            direction_lps=_tuple(across),
            clock_head=head,
            clock_facing=facing,
            words=words,
            doubts=self._doubts((*pieces, *also)),
        )

    def _absent(self, blank: Landmark, why: str) -> Landmark:
        return replace(blank, words=f"{blank.station}: no landmark; {why}", doubts=self._doubts(()))

    def _doubts(self, rests_on: tuple[Branch, ...]) -> tuple[str, ...]:
        found = [_MIRRORED] if self._mirrored else []
        for branch in rests_on:
            name = branch.name or f"branch {branch.id}"
            if branch.kind == "manual":
                found.append(f"{name} was drawn by hand")
            elif branch.kind == "bridge":
                found.append(f"{name} is a bridge across an obstruction")
            elif branch.variant is not None and branch.parent is not None:
                found.append(f"{name}: {branch.variant}")
        return tuple(dict.fromkeys(found))

    def _from_carina_mm(self, first: Branch, at_mm: float) -> float | None:
        if not self._has_carina:
            return None
        inside = 0.0
        for branch in self._tree.lineage(first.id)[:-1]:
            inside += branch.length_mm
        return self._origin.from_carina_mm(inside + at_mm)

    def _pieces(self, name: str) -> tuple[Branch, ...]:
        """Return the branches that have the name of a bronchus (side branches divide it), in tree order."""
        found: list[Branch] = []
        for branch in self._tree.branches:
            if branch.name == name and (not found or branch.parent == found[-1].id):
                found.append(branch)
        return tuple(found)

    def _siblings(self, branch: Branch) -> tuple[int, ...]:
        if branch.parent is None:
            return ()
        return tuple(child for child in self._by_id[branch.parent].children if child != branch.id)

    def _lobe(self, branch: Branch) -> str | None:
        words = None if branch.name is None else name_words(branch.name)
        return None if words is None else words.lobe


def _blank(station: str, seen_from: str, borders: str, basis: DirectionBasis) -> Landmark:
    return Landmark(station, seen_from, None, None, None, None, None, None, basis, borders, "", ())


def _aside(side: Side, turn_deg: float) -> Points:
    """Return the anterior direction (LPS unit vector), turned by an angle towards a side of the patient."""
    turn = math.radians(turn_deg)
    return np.array([math.sin(turn) * (-1.0 if side == "R" else 1.0), -math.cos(turn), 0.0])


def _length(pieces: tuple[Branch, ...]) -> float:
    return sum(branch.length_mm for branch in pieces)


def _place(pieces: tuple[Branch, ...], at_mm: float) -> tuple[Points, Points, Branch]:
    """Return point, direction and branch at a distance along consecutive branches, clamped to their two ends."""
    points = np.concatenate([pieces[0].points, *(branch.points[1:] for branch in pieces[1:])])
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])

    def at(mm: float) -> Points:
        return np.array([np.interp(mm, run, points[:, axis]) for axis in range(3)])

    along = min(max(at_mm, 0.0), float(run[-1]))
    ahead = at(along + AXIS_MM) - at(along - AXIS_MM)
    left = along
    for branch in pieces:
        if left <= branch.length_mm + 1e-9:
            break
        left -= branch.length_mm
    return at(along), ahead / np.linalg.norm(ahead), branch


def _long(name: str) -> str:
    words = name_words(name)
    return name if words is None else words.long


def _lobe_words(lobe: str) -> str:
    return {"UL": "upper lobe", "ML": "middle lobe", "LL": "lower lobe"}[lobe[1:]]


def _spoken(hours: float) -> str:
    """Return clock hours as text, rounded to half an hour, such as 10:30."""
    half = round(2.0 * hours)
    hour = (half // 2 - 1) % 12 + 1
    return f"{hour}:30" if half % 2 else f"{hour}"


def _tuple(values: Points) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
