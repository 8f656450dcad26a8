"""Target of a plan: a nodule with a name, a priority, its location and the aims in it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.display import one_line
from carina.errors import UsageError
from carina.plan.targets.doubts import TargetDoubt, confirmed_codes
from carina.plan.targets.nodule import Nodule
from carina.plan.targets.region import WHERE_WORDS, Whereabouts
from carina.volume.mask_distances import ball_distance

Point = tuple[float, float, float]

TargetSource = Literal["click", "mask", "seg", "rtstruct", "sphere", "edited"]
"""Origin of a target's boundary. ``sphere``: set by the user where the CT shows none; ``edited``: changed by the
user."""

MAX_AIMS = 3
AIM_OFF_MM = 1.0
"""Maximum distance in mm at which an aim may be outside the boundary, because of the size of a voxel."""
PRIORITIES = (1, 9)
NAME_CHARS, NOTE_CHARS, ID_CHARS = 80, 2000, 64
EDGE_AIM = 0.65
"""Position of an aim in the periphery of a nodule: 0 is the middle, 1 the boundary."""
APART_MM = 3.0
"""Minimum distance in mm between two aims; needles are too inaccurate to distinguish nearer ones."""
RECORD_VERSION = 1
_PLAIN = re.compile(r"[^\x00-\x08\x0b-\x1f\x7f\ud800-\udfff]*")


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PlanTarget:
    """Target of a plan: nodule, name, priority, location and aims.

    Examples
    --------
    >>> import numpy as np
    >>> ball = np.linalg.norm(np.indices((13, 13, 13)) - 6, axis=0) < 5.0
    >>> nodule = Nodule((6.0, 6.0, 6.0), "solid", 515.0, 12.0, 9.8, 9.6, 0.4, 515.0, 30.0, (), ball, np.eye(4))
    >>> target = PlanTarget("t1", "nodule in RB3", nodule, (6.0, 6.0, 6.0), "click", "lung")
    >>> target.words
    'nodule in RB3: solid nodule, 9.8 x 9.6 mm, 0.52 ml, in the lung'
    >>> target.aims
    ((6.0, 6.0, 6.0),)
    """

    target_id: str
    """Identifier of the target: 1 to 64 letters, digits, hyphens and underscores."""
    name: str
    nodule: Nodule
    seed_lps: Point
    """Point that the user clicked, or the middle of a structure from a file, LPS mm."""
    source: TargetSource
    where: Whereabouts
    note: str = ""
    priority: int = 1
    """Priority of the target, 1 (first) to 9."""
    aims: tuple[Point, ...] = ()
    """One to three points in the nodule, LPS mm, in order of preference; its middle if none is given."""
    doubts: tuple[TargetDoubt, ...] = ()
    """Reasons for which the target may not be a nodule, as found when its boundary was made (`target_doubts`)."""
    confirmed: tuple[str, ...] = ()
    """Codes of the doubts that the user has confirmed; `plan_route` refuses a target with another doubt."""

    def __post_init__(self) -> None:
        """Check the fields, and set the aims to the nodule's middle if none is given."""
        confirmed_codes(self.confirmed)
        if not re.fullmatch(rf"[A-Za-z0-9_-]{{1,{ID_CHARS}}}", self.target_id):
            raise UsageError(
                f"target: expected an identifier of 1 to {ID_CHARS} letters, digits, - and _", code="plan.target"
            )
        for what, text, most in (("name", self.name, NAME_CHARS), ("note", self.note, NOTE_CHARS)):
            if len(text) > most or not _PLAIN.fullmatch(text):
                raise UsageError(
                    f"target: expected a {what} of at most {most} printable characters; found {len(text)}",
                    code="plan.target",
                )
        if isinstance(self.priority, bool) or not PRIORITIES[0] <= self.priority <= PRIORITIES[1]:
            raise UsageError(f"target: expected a priority of 1 to 9; found {self.priority}", code="plan.target")
        if self.source not in get_args(TargetSource) or self.where not in get_args(Whereabouts):
            raise UsageError(f"target: unknown source or place: {self.source}, {self.where}", code="plan.target")
        if not np.isfinite(np.array(self.seed_lps, dtype=np.float64).reshape(3)).all():
            raise UsageError("target: expected a point x,y,z in LPS mm", code="plan.point")
        object.__setattr__(self, "aims", _checked_aims(self.aims, self.nodule))

    @property
    def words(self) -> str:
        """Target as text, such as *nodule in RB3: solid nodule, 12.3 x 10.1 mm, 0.74 ml, beside the pleura*."""
        description = ", ".join([self.nodule.words, WHERE_WORDS[self.where]])
        return f"{self.name}: {description}" if self.name else description

    def with_nodule(self, nodule: Nodule, doubts: tuple[TargetDoubt, ...] = ()) -> PlanTarget:
        """Return the target with an edited nodule and its doubts; aims outside the new boundary are removed.

        If no aim is left, the middle of the nodule becomes the aim.
        """
        candidates = tuple(aim for aim in self.aims if nodule.distance_mm([aim])[0] <= AIM_OFF_MM)
        return replace(self, nodule=nodule, source="edited", aims=candidates, doubts=doubts)

    def to_json(self) -> dict[str, Any]:
        """Return the target as plain JSON types, without the mask."""
        return {**self._without_nodule(), "nodule": self.nodule.to_json()}

    def to_record(self) -> dict[str, Any]:
        """Return the whole target as plain JSON types for a file."""
        return {"version": RECORD_VERSION, **self._without_nodule(), "nodule": self.nodule.to_record()}

    def _without_nodule(self) -> dict[str, Any]:
        return {
            "target_id": self.target_id,
            "name": self.name,
            "note": self.note,
            "priority": self.priority,
            "source": self.source,
            "where": self.where,
            "seed_lps": list(self.seed_lps),
            "aims_lps": [list(aim) for aim in self.aims],
            "doubts": [doubt.to_json() for doubt in self.doubts],
            "confirmed": list(self.confirmed),
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> PlanTarget:
        """Return the target that `to_record` wrote.

        Raises
        ------
        UsageError
            If the record is not valid, or of a newer version (code ``plan.record``).
        """
        try:
            if record["version"] != RECORD_VERSION:
                raise ValueError(f"version {record['version']}, expected {RECORD_VERSION}")
            return cls(
                target_id=str(record["target_id"]),
                name=str(record["name"]),
                nodule=Nodule.from_record(record["nodule"]),
                seed_lps=_point(record["seed_lps"]),
                source=record["source"],
                where=record["where"],
                note=str(record["note"]),
                priority=int(record["priority"]),
                aims=tuple(_point(aim) for aim in record["aims_lps"]),
                # Records of earlier versions have no doubts; the plan finds them.
                doubts=tuple(TargetDoubt.from_json(one) for one in record.get("doubts", ())),
                confirmed=tuple(str(code) for code in record.get("confirmed", ())),
            )
        except (KeyError, TypeError, ValueError) as error:
            raise UsageError(f"reading a target: its record is not valid ({error})", code="plan.record") from None


def proposed_aims(nodule: Nodule, *, near_lps: ArrayLike | None = None) -> tuple[Point, ...]:
    """Propose up to three aims: the middle of a nodule, and its periphery at both ends of its longest axis.

    The middle of a large mass may be necrotic, and then a needle should sample the periphery. Aims nearer than 3 mm to
    another are left out, so that a small nodule has one.

    Parameters
    ----------
    nodule
        The nodule.
    near_lps
        (3,) position of the scope, LPS mm; the end of the axis nearer to it comes first.

    Returns
    -------
    tuple[Point, ...]
        Aims in LPS mm.
    """
    middle = np.array(nodule.middle_lps)
    matrix = nodule.lps_from_ijk
    points = np.argwhere(nodule.inside_zyx)[:, ::-1] @ matrix[:3, :3].T + matrix[:3, 3]
    off = points - middle
    _, axes = np.linalg.eigh(np.atleast_2d(np.cov(off.T)))
    ends = [_toward(nodule, points, off @ axes[:, 2] * sign, middle) for sign in (1.0, -1.0)]
    if near_lps is not None:
        near = np.asarray(near_lps, dtype=np.float64).reshape(3)
        ends.sort(key=lambda end: float(np.linalg.norm(end - near)))
    found = [middle]
    for end in ends:
        if all(np.linalg.norm(end - other) >= APART_MM for other in found):
            found.append(end)
    return tuple(_point(aim) for aim in found)


def _toward(
    nodule: Nodule, points: NDArray[np.float64], along: NDArray[np.float64], middle: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return a point of the nodule from its middle towards an end of an axis, deep below the boundary if possible."""
    goal = middle + EDGE_AIM * (points[int(np.argmax(along))] - middle)
    depth = ball_distance(nodule.inside_zyx, 1.0)[nodule.inside_zyx]
    allowed = (along > 0.0) & (depth >= 0.3 * depth.max())
    candidates = points[allowed] if allowed.any() else points
    found: NDArray[np.float64] = candidates[int(np.argmin(np.linalg.norm(candidates - goal, axis=1)))]
    return found


def _checked_aims(aims: tuple[Point, ...], nodule: Nodule) -> tuple[Point, ...]:
    if not aims:
        return (nodule.middle_lps,)
    if len(aims) > MAX_AIMS:
        raise UsageError(f"target: expected at most {MAX_AIMS} aims; found {len(aims)}", code="plan.aims")
    points = np.array(aims, dtype=np.float64).reshape(-1, 3)
    if not np.isfinite(points).all():
        raise UsageError("target: expected aims as points x,y,z in LPS mm", code="plan.aims")
    off = nodule.distance_mm(points)
    if off.max() > AIM_OFF_MM:
        raise UsageError(
            f"target: aim {int(np.argmax(off)) + 1} lies {off.max():.1f} mm outside the target; place it inside",
            code="plan.aims",
        )
    return tuple(_point(aim) for aim in points)


def _point(values: Any) -> Point:
    x, y, z = values
    return float(x), float(y), float(z)
