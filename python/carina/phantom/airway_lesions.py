"""Lesions inside the airways of a phantom: tumour, mucus, blood, and a foreign body, with exact ground truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError

LESIONS = ("tumour", "mucus", "bleeding", "foreign-body")
"""Kinds of lesions that :func:`add_lesion` adds."""
AIR_HU = -1000.0
"""CT value of the air in an airway of the phantom, HU."""
LESION_HU = {"tumour": 45.0, "mucus": 15.0, "bleeding": 55.0, "foreign-body": 1200.0}
"""CT values of the lesions, HU; the foreign body is as dense as bone or a tooth."""
BRONCHI = {
    "tumour": ("RMB", "LMB", "BI", "RUL", "LUL", "LLL"),
    "mucus": ("RB6", "RB8", "RB9", "RB10", "LB6", "LB8", "LB9", "LB10"),
    "bleeding": ("RUL", "RML", "LUL", "RB6", "LB6", "RB10", "LB10"),
    "foreign-body": ("BI", "RMB", "LMB", "RB10", "LLL"),
}
"""Bronchi in which a lesion may lie; the seed chooses among those that the phantom has and that are long enough."""
END_MM = 1.5
"""Minimum distance of a lesion from both ends of its bronchus, mm."""
FINE = 4
"""Number of subcells along each edge of a voxel, by which the share of the lesion in a voxel is counted."""
STEP_MM = 0.2
"""Distance in mm between two sections along a bronchus."""
BEND_MM = 0.2
"""Distance in mm by which a section also reaches beyond its half, so that no place of a bend lies between two."""
WALL_HU = 40.0
"""CT value of the wall of an airway of the phantom, HU."""

Points = NDArray[np.float64]
IsPart = Callable[[NDArray[np.intp], Points], NDArray[np.bool_]]


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Part of a bronchus, as sections every ``STEP_MM``."""

    axis_lps: Points
    """(n, 3) centres of the sections, LPS mm."""
    radius_mm: Points
    """(n,) radii of the lumen, mm."""

    @property
    def direction(self) -> Points:
        """(n, 3) unit vectors along the axis."""
        along = np.gradient(self.axis_lps, axis=0)
        return np.asarray(along / np.linalg.norm(along, axis=1, keepdims=True))

    def heights(self, sections: NDArray[np.intp], offsets: Points) -> Points:
        """Return how far places (m, 3) lie posterior of the centres of their sections, from which they are given, mm.

        The section of a bronchus that runs backwards is no circle in an axial plane, so its height is corrected. Fluid
        collects there, because the patient lies on the back.
        """
        back = self.direction[sections, 1]
        return np.asarray(offsets[:, 1] / np.maximum(np.sqrt(1.0 - back**2), 1e-3))


def stretch_of(branch: dict[str, Any], from_mm: float, to_mm: float) -> Stretch:
    """Return the part of a branch of ``truth["branches"]`` between two distances from its origin, mm."""
    points, radius = np.array(branch["points"]), np.array(branch["radius"])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.arange(from_mm, to_mm, STEP_MM)
    axis = np.stack([np.interp(at, along, points[:, n]) for n in range(3)], axis=1)
    return Stretch(axis, np.interp(at, along, radius))


def shares_of_lumen(
    lps_from_ijk: Points,
    shape_zyx: tuple[int, ...],
    stretch: Stretch,
    is_part: IsPart,
) -> tuple[tuple[slice, slice, slice], Points]:
    """Return the share of each voxel that lies in a part of a bronchus's lumen.

    Parameters
    ----------
    lps_from_ijk, shape_zyx
        The grid of the voxels.
    stretch
        Sections of the bronchus.
    is_part
        Function of the numbers (m,) of sections and of places (m, 3) in these sections, relative to their centres, LPS
        mm; it returns which of these places belong to the part.

    Returns
    -------
    box : tuple of slice
        The part of the grid (z, y, x) with such voxels.
    shares : ndarray
        Shares, 0 to 1, of the voxels of ``box``.
    """
    axis, radius = stretch.axis_lps, stretch.radius_mm
    spacing = np.linalg.norm(lps_from_ijk[:3, :3], axis=0)
    ijk = (axis - lps_from_ijk[:3, 3]) @ np.linalg.inv(lps_from_ijk[:3, :3]).T
    reach = np.ceil(radius.max() / spacing) + 2
    shape = np.array(shape_zyx[::-1])
    low = np.clip(np.floor(ijk.min(axis=0) - reach).astype(int), 0, shape)
    high = np.clip(np.ceil(ijk.max(axis=0) + reach).astype(int) + 1, low, shape)
    box = (slice(low[2], high[2]), slice(low[1], high[1]), slice(low[0], high[0]))
    grid = np.stack(np.meshgrid(*(np.arange(low[a], high[a]) for a in (2, 1, 0)), indexing="ij"), axis=-1)
    voxels = grid.reshape(-1, 3)[:, ::-1].astype(np.float64)
    shares = np.zeros(len(voxels))
    cells = (np.arange(FINE) + 0.5) / FINE - 0.5
    subcells = np.stack(np.meshgrid(cells, cells, cells, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = voxels @ lps_from_ijk[:3, :3].T + lps_from_ijk[:3, 3]
    least, _ = _nearest(centres, axis)
    for number in np.array_split(np.flatnonzero(least <= radius.max() + float(np.linalg.norm(spacing))), 64):
        fine = (voxels[number][:, None, :] + subcells).reshape(-1, 3)
        places = fine @ lps_from_ijk[:3, :3].T + lps_from_ijk[:3, 3]
        _, section = _nearest(places, axis)
        offsets = places - axis[section]
        ahead = (offsets * stretch.direction[section]).sum(axis=1)
        offsets -= ahead[:, None] * stretch.direction[section]
        inside = (np.abs(ahead) <= 0.5 * STEP_MM + BEND_MM) & ((offsets**2).sum(axis=1) <= radius[section] ** 2)
        inside[inside] = is_part(section[inside], offsets[inside])
        shares[number] = inside.reshape(len(number), FINE**3).mean(axis=1)
    return box, shares.reshape(grid.shape[:3])


def _nearest(places: Points, axis: Points) -> tuple[Points, NDArray[np.intp]]:
    """Return the distance in mm of each place (m, 3) from the nearest of the points (n, 3), and the number of that."""
    squares = (places**2).sum(axis=1)[:, None] - 2.0 * places @ axis.T + (axis**2).sum(axis=1)
    nearest = squares.argmin(axis=1)
    return np.sqrt(np.maximum(squares[np.arange(len(places)), nearest], 0.0)), nearest


def fill(
    hu_zyx: NDArray[np.int16], lps_from_ijk: Points, stretch: Stretch, is_part: IsPart, value_hu: float
) -> tuple[tuple[slice, slice, slice], Points]:
    """Replace the air in a part of a bronchus's lumen by a material in place; the noise of the CT remains.

    `value_hu` is the CT value of the material. The other arguments and the result are those of
    :func:`shares_of_lumen`.
    """
    box, shares = shares_of_lumen(lps_from_ijk, hu_zyx.shape, stretch, is_part)
    hu = hu_zyx[box].astype(np.float64)
    # The generator counts the lumen in a voxel of the wall in another way: no more than the air that it left is filled.
    air = np.clip((WALL_HU - hu) / (WALL_HU - AIR_HU), 0.0, 1.0)
    taken = np.where(shares < 1.0, np.minimum(shares, air), 1.0)
    hu_zyx[box] = np.rint(hu + taken * (value_hu - AIR_HU)).astype(np.int16)
    return box, shares


def add_lesion(made: dict[str, Any], kind: str, seed: int) -> dict[str, Any]:
    """Add a lesion to the arrays of a generated chest in place, and return its truth.

    Parameters
    ----------
    made
        Generated chest: ``hu_zyx``, ``lumen_zyx``, ``lps_from_ijk`` and ``branches``.
    kind
        One of :data:`LESIONS`.
    seed
        Seed of the bronchus, the position and the size.

    Returns
    -------
    dict
        ``kind``, ``branch_id``, ``branch``, ``centre_lps`` (LPS mm), ``from_mm`` and ``to_mm`` (distances from the
        bronchus's origin), ``diameter_mm`` (of the tumour or the foreign body; None for fluid), and ``filled``: the
        largest share of a section of the lumen that the lesion takes.

    Raises
    ------
    UsageError
        If the phantom has no bronchus that is long enough.
    """
    rng = np.random.default_rng([seed, LESIONS.index(kind)])
    branches = {str(branch["name"]): branch for branch in made["branches"]}
    names = [name for name in BRONCHI[kind] if name in branches]
    rng.shuffle(names)
    for name in names:
        branch = branches[name]
        length_mm = float(np.linalg.norm(np.diff(np.array(branch["points"]), axis=0), axis=1).sum())
        radius_mm = float(np.median(branch["radius"]))
        half_mm = _half_length_mm(kind, radius_mm, rng)
        if 2.0 * (half_mm + END_MM) <= length_mm:
            break
    else:
        raise UsageError(
            f"lesion: expected a chest with one of the bronchi {', '.join(BRONCHI[kind])}, long enough for {kind}; "
            "found none; choose another seed or lesion",
            code="phantom.option",
        )
    centre_mm = float(rng.uniform(half_mm + END_MM, length_mm - half_mm - END_MM))
    stretch = stretch_of(branch, centre_mm - half_mm, centre_mm + half_mm)
    is_part, diameter_mm, centre = _shape(kind, stretch, rng)
    lps_from_ijk = np.array(made["lps_from_ijk"], dtype=np.float64)
    box, shares = fill(made["hu_zyx"], lps_from_ijk, stretch, is_part, LESION_HU[kind])
    made["lumen_zyx"][box][shares > 0.5] = 0
    return {
        "kind": kind,
        "branch_id": branch["id"],
        "branch": name,
        "centre_lps": [float(v) for v in centre],
        "from_mm": centre_mm - half_mm,
        "to_mm": centre_mm + half_mm,
        "diameter_mm": diameter_mm,
        "filled": _filled(stretch, is_part),
    }


def _half_length_mm(kind: str, radius_mm: float, rng: np.random.Generator) -> float:
    """Return half of the length of the part of a bronchus in which a lesion lies, mm."""
    if kind == "tumour":
        return float(rng.uniform(0.75, 1.0)) * radius_mm
    if kind == "foreign-body":
        return float(rng.uniform(0.9, 1.4)) * radius_mm
    return float(rng.uniform(3.0, 6.0) if kind == "mucus" else rng.uniform(2.0, 7.0))


def _shape(kind: str, stretch: Stretch, rng: np.random.Generator) -> tuple[IsPart, float | None, Points]:
    """Return the test for places of a lesion, its diameter (None for fluid) and its centre, LPS mm."""
    middle = len(stretch.axis_lps) // 2
    half_mm = 0.5 * STEP_MM * len(stretch.axis_lps)
    along, radius_mm = stretch.direction[middle], float(stretch.radius_mm[middle])
    back = np.array([0.0, 1.0, 0.0]) - along[1] * along
    back /= max(float(np.linalg.norm(back)), 1e-9)
    if kind in {"mucus", "bleeding"}:
        share = float(rng.uniform(0.7, 1.0) if kind == "mucus" else rng.uniform(0.25, 0.45))

        def is_fluid(sections: NDArray[np.intp], offsets: Points) -> NDArray[np.bool_]:
            lowest_mm = stretch.radius_mm[sections] * (1.0 - 2.0 * share)
            return np.asarray(stretch.heights(sections, offsets) >= lowest_mm)

        return is_fluid, None, stretch.axis_lps[middle] + (1.0 - share) * radius_mm * back
    if kind == "tumour":
        # A ball whose centre lies half-way between the axis and the wall, on any side.
        side = _across(along, float(rng.uniform(0.0, 2.0 * np.pi)))
        centre, ball_mm, long_mm = stretch.axis_lps[middle] + 0.5 * radius_mm * side, half_mm, half_mm
    else:
        # An ellipsoid along the bronchus that lies on the posterior wall.
        ball_mm, long_mm = float(rng.uniform(0.55, 0.75)) * radius_mm, half_mm
        centre = stretch.axis_lps[middle] + (radius_mm - ball_mm) * back

    def is_inside(sections: NDArray[np.intp], offsets: Points) -> NDArray[np.bool_]:
        off = offsets + stretch.axis_lps[sections] - centre
        ahead = off @ along
        beside = (off * off).sum(axis=1) - ahead**2
        return np.asarray(beside / ball_mm**2 + (ahead / long_mm) ** 2 <= 1.0)

    return is_inside, 2.0 * ball_mm, centre


def _across(along: Points, angle: float) -> Points:
    """Return the unit vector across a direction at an angle."""
    helper = np.eye(3)[int(np.argmin(np.abs(along)))]
    one = np.cross(along, helper)
    one /= np.linalg.norm(one)
    return np.asarray(np.cos(angle) * one + np.sin(angle) * np.cross(along, one))


def _filled(stretch: Stretch, is_part: IsPart) -> float:
    """Return the largest share of a section of the lumen that a lesion takes."""
    grid = np.linspace(-1.0, 1.0, 41)
    flat = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    flat = flat[(flat * flat).sum(axis=1) <= 1.0]
    most = 0.0
    for n in range(0, len(stretch.axis_lps), 5):
        along = stretch.direction[n]
        across = np.stack([_across(along, 0.0), _across(along, 0.5 * np.pi)])
        places = stretch.radius_mm[n] * flat @ across
        most = max(most, float(is_part(np.full(len(places), n), places).mean()))
    return most
