"""A nodule grown from one click: its boundary, its volume and diameters, and how sure they are.

No weights. The boundary is where the CT is half-way between the nodule and the lung round it; vessels that enter are
cut off by an opening as wide as the nodule allows, and the pleura by the surface of the chest wall beside it. The
volume is the share of nodule in every voxel (partial volume), which blur does not change (docs/decisions/0064).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.display import one_line
from carina.errors import NoResultError, UsageError, check_type
from carina.plan.box import Box, ball_distance, beside, component_at, lung_median_hu, smoothed, uphill
from carina.plan.chest_wall import SHALLOW_MM, cut_at_wall
from carina.volume import Volume

__all__ = ["Nodule", "NoduleKind", "grow_nodule"]

NoduleKind = Literal["solid", "part-solid", "ground-glass"]
Mask = NDArray[np.bool_]

CLICK_MM = 4.0
"""A click this far from the densest place still means it."""
SMOOTH_MM = 0.7
SEED_SMOOTH_MM = 1.0
MEANT = 0.75
"""The nearest place to the click is meant that has this share of the greatest rise there."""
LEVEL_MM = 2.0
SOLID_HU = -250.0
"""Denser in its middle: solid. Ground glass is -750 to -300 HU."""
LEAST_RISE_HU = 110.0
"""A nodule stands out of the lung by this much."""
HALVES_MM = (22.0, 36.0, 60.0)
"""Half the side of the box that is looked at: the next one where the nodule comes near its faces."""
EDGE_MM = 4.0
MOST_CUT = 0.4
"""What the end of the CT cuts off on more than this share of its surface has no boundary."""
OPENINGS, OPENINGS_AT_WALL = (0.6, 0.7, 0.8), (0.4, 0.5, 0.6, 0.7, 0.8)
"""Radius of the ball that cuts vessels off, as a share of the largest ball in the nodule: the first that suffices. What
is flat on one side loses its edges to large ones."""
TAIL = 2.4
"""A part farther from the nodule's middle than this many of its radii is a vessel."""
RIM_MM = 1.6
"""Blur spreads a boundary this far."""
STUB_MM = 2.0
"""What the opening takes away and reaches no farther than this from the rest is no vessel: the nodule's own shape."""
FILLET_MM = 3.0
"""What is left nearer to the wall than this, where it was cut off, is neither nodule nor vessel."""
MOUTH_MM = 2.5
"""How uncertain the place of a cut through a vessel is."""
CORE_MM = 1.5
"""Deeper than this the edge's blur is not felt."""
RING_MM, RING_SHOWS, ALIKE = (0.8, 1.6), 0.9, 0.8
"""At this depth a nodule that is alike throughout shows 0.84 to 0.93 of its rise over the lung; one with a denser core
less."""
MOST_SHARE = 1.5
GLASS_RISE_HU, GLASS_MM, GLASS_SHARE = 120.0, (1.0, 1.7), 0.55
"""Round a core lies ground glass where, this deep in all that stands out of the lung, no more than this share of the
core's rise is seen."""
SMALLEST_PART_MM3 = 15.0
"""A denser part smaller than this (3 mm across) may be a vessel's end."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Nodule:
    """A nodule: where it is, how large, and how sure that is.

    Examples
    --------
    >>> import numpy as np
    >>> ball = np.linalg.norm(np.indices((13, 13, 13)) - 6, axis=0) < 5.0
    >>> nodule = Nodule((6.0, 6.0, 6.0), "solid", 515.0, 12.0, 9.8, 9.6, 0.4, 515.0, 30.0, (), ball, np.eye(4))
    >>> nodule.words
    'solid nodule, 9.8 x 9.6 mm, 0.52 ml'
    """

    centre_lps: tuple[float, float, float]
    """Centroid, LPS mm."""
    kind: NoduleKind
    volume_mm3: float
    volume_error_mm3: float
    """Half the width of the interval that holds the true volume nine times of ten."""
    long_mm: float
    """Longest diameter in the axial plane that shows it largest."""
    short_mm: float
    """The longest across ``long_mm`` in that plane."""
    diameter_error_mm: float
    """As ``volume_error_mm3``, for both diameters."""
    solid_mm3: float
    """Of which solid: all of it but in a part-solid or ground-glass nodule."""
    density_hu: float
    """Mean of its middle."""
    touches: tuple[str, ...]
    """What it was cut from: "pleura" (of wall, mediastinum or diaphragm: the CT shows no difference), "vessel"; "edge
    of the CT" where the scan ends in it."""
    inside_zyx: Mask
    """(nz, ny, nx) in a box of its own, true inside."""
    lps_from_ijk: NDArray[np.float64]
    """(4, 4) of that box; cubic voxels."""

    @property
    def equivalent_mm(self) -> float:
        """Diameter of the ball of its volume."""
        return float((6.0 * self.volume_mm3 / np.pi) ** (1.0 / 3.0))

    @property
    def mean_mm(self) -> float:
        """Mean of the two axial diameters, as guidelines measure (Fleischner 2017)."""
        return 0.5 * (self.long_mm + self.short_mm)

    @property
    def words(self) -> str:
        """solid nodule, 12.3 x 10.1 mm, 0.74 ml"""
        ml = self.volume_mm3 / 1000.0
        return f"{self.kind} nodule, {self.long_mm:.1f} x {self.short_mm:.1f} mm, {ml:.{2 if ml >= 0.1 else 3}f} ml"

    def to_json(self) -> dict[str, Any]:
        """Plain JSON types, without the mask."""
        return {
            "centre_lps": list(self.centre_lps),
            "kind": self.kind,
            "volume_mm3": self.volume_mm3,
            "volume_error_mm3": self.volume_error_mm3,
            "long_mm": self.long_mm,
            "short_mm": self.short_mm,
            "diameter_error_mm": self.diameter_error_mm,
            "solid_mm3": self.solid_mm3,
            "density_hu": self.density_hu,
            "touches": list(self.touches),
        }

    def distance_mm(self, points_lps: ArrayLike) -> NDArray[np.float64]:
        """How far points are from its boundary; 0 inside.

        Parameters
        ----------
        points_lps
            (n, 3) LPS mm.

        Returns
        -------
        numpy.ndarray
            (n,) mm, exact to half a voxel of its box.
        """
        points = np.atleast_2d(np.asarray(points_lps, dtype=np.float64))
        inside = (
            np.argwhere(_surface(self.inside_zyx))[:, ::-1] @ self.lps_from_ijk[:3, :3].T + self.lps_from_ijk[:3, 3]
        )
        off = np.array([float(np.min(((inside - point) ** 2).sum(axis=1))) ** 0.5 for point in points])
        half_mm = 0.5 * float(np.linalg.norm(self.lps_from_ijk[:3, 0]))
        return np.where(self.contains(points), 0.0, np.maximum(off - half_mm, 0.0))

    def contains(self, points_lps: ArrayLike) -> Mask:
        """Whether points (n, 3) LPS mm lie in it, by the nearest voxel of its box."""
        points = np.atleast_2d(np.asarray(points_lps, dtype=np.float64))
        ijk = np.rint((points - self.lps_from_ijk[:3, 3]) @ np.linalg.inv(self.lps_from_ijk[:3, :3]).T).astype(int)
        there = ((ijk >= 0) & (ijk < np.array(self.inside_zyx.shape[::-1]))).all(axis=1)
        found = np.zeros(len(points), dtype=bool)
        found[there] = self.inside_zyx[tuple(ijk[there].T[::-1])]
        return found


def grow_nodule(volume: Volume, at_lps: ArrayLike) -> Nodule:
    """The nodule at a place in the lung.

    Parameters
    ----------
    volume
        A chest CT, HU.
    at_lps
        A point in the nodule, LPS mm; within 4 mm of its densest part.

    Returns
    -------
    Nodule
        Its boundary, and what is measured of it. Spicules and vessels are not part of it.

    Raises
    ------
    UsageError
        If the point is no point, or outside the CT.
    NoResultError
        If nothing there stands out of the lung (code ``plan.no-nodule``), or what does has no end within 5 cm: a
        consolidation, the chest wall, the heart (``plan.no-boundary``).

    Examples
    --------
    >>> import carina
    >>> made = carina.generate_phantom(seed=4, spacing_mm=1.0, nodule=True, box_lps=((-130, 15, -60), (-72, 75, -2)))
    >>> nodule = grow_nodule(made.volume, made.truth["nodule"]["center_lps"])
    >>> nodule.kind
    'solid'

    References
    ----------
    Opening and partial volumes: Kuhnigk et al., IEEE Trans Med Imaging 2006;25:417 (the idea; the steps are our own).
    """
    check_type("grow_nodule", "volume", volume, Volume, "open a volume with carina.open_volume")
    try:
        point = np.asarray(at_lps, dtype=np.float64).reshape(3)
    except (TypeError, ValueError):
        raise UsageError(f"nodule: expected a point x,y,z in LPS mm; found {at_lps!r}", code="plan.point") from None
    if not np.isfinite(point).all() or not volume.contains_lps(point):
        place = ", ".join(f"{v:g}" for v in point)
        raise UsageError(f"nodule: the point {place} lies outside the CT", code="plan.point")
    for half_mm in HALVES_MM:
        grown = _Grown(Box.around(volume, point, half_mm), point, max(volume.spacing_mm))
        if not grown.is_near_faces:
            return grown.nodule(max(volume.spacing_mm))
    raise _no_boundary()


def _no_boundary() -> NoResultError:
    return NoResultError(
        f"no boundary was found within {HALVES_MM[-1] - EDGE_MM:.0f} mm: this looks like consolidation, the chest "
        "wall, the heart or the diaphragm rather than a nodule; click in the middle of the nodule",
        code="plan.no-boundary",
    )


class _Grown:
    """A nodule in one box."""

    def __init__(self, box: Box, point: NDArray[np.float64], coarsest_mm: float) -> None:
        self.box = box
        # Thick slices blur as well.
        self.blur = max(1.0, coarsest_mm / 1.5)
        self.smooth = smoothed(box.hu_zyx, SMOOTH_MM / box.step_mm)
        very = smoothed(box.hu_zyx, SEED_SMOOTH_MM / box.step_mm)
        self.lung_hu = lung_median_hu(self.smooth)
        off = box.offsets_mm(point)
        near = off <= CLICK_MM
        # The nearest place that is dense: the densest may lie in the chest wall behind it.
        densest = float(very[near].max())
        if densest < self.lung_hu + LEAST_RISE_HU:
            raise NoResultError(
                f"there is no nodule at this point: within {CLICK_MM:.0f} mm nothing is denser than {densest:.0f} HU, "
                f"and the lung around it is {self.lung_hu:.0f} HU; click in the middle of the nodule",
                code="plan.no-nodule",
            )
        meant = near & (very >= self.lung_hu + MEANT * (densest - self.lung_hu))
        self.seed = _first(np.where(meant, off, np.inf).argmin(), off.shape)
        level = float(very[meant & (self.box.steps_from(self.seed) * box.step_mm <= LEVEL_MM)].max())
        self.is_glass = False
        self._grow(level)
        glass = self._glass_hu()
        self._grow(level if glass is None else glass)
        self.is_glass = glass is not None or level <= SOLID_HU

    def _grow(self, level: float) -> None:
        """The part round the seed that is denser than half-way to ``level``, without what enters it."""
        self.bar_hu = 0.5 * (self.lung_hu + level)
        self.dense = self.smooth > self.bar_hu
        self.dense[self.seed] = True
        whole = component_at(self.dense, self.seed)
        self.touches: list[str] = []
        self.wall = np.zeros_like(whole)
        if self._reaches_faces(whole):
            cut, wall = cut_at_wall(self.box, self.smooth, whole, self.seed)
            if wall is not None:
                if wall[self.seed]:
                    self._leave_the_wall(cut)
                self.wall = wall
                whole = component_at(cut | _only(self.seed, cut.shape), self.seed)
        depth = ball_distance(whole, self.box.step_mm)
        # The middle of the largest ball.
        peak = uphill(depth, self.seed)
        radius = float(depth[peak])
        whole_mm = np.inf
        for share in OPENINGS_AT_WALL if self.wall.any() else OPENINGS:
            core = component_at(depth > share * radius, peak)
            off = self.box.steps_from(peak)[core] * self.box.step_mm
            whole_mm = float(off.max()) + share * radius
            if whole_mm <= TAIL * radius:
                break
        reach = ball_distance(~core, self.box.step_mm)
        self.inside = whole & (reach <= share * radius + 0.5 * self.box.step_mm)
        self.inside |= core
        self.cut, own = self._parted(whole)
        self.inside |= own
        self.others = self.dense & ~self.inside
        if (self.wall & self._rim(self.inside, 2.0 * self.box.step_mm)).sum() > 8:
            self.touches.append("pleura")
        if (self._rim(self.inside, 1.1 * self.box.step_mm) & ~self.box.known).any():
            self.touches.append("edge of the CT")
        if self.cut.any():
            self.touches.append("vessel")

    def _leave_the_wall(self, cut: Mask) -> None:
        """The seed of a nodule that lies flat on the wall may fall into its edge."""
        off = np.where(cut, self.box.steps_from(self.seed) * self.box.step_mm, np.inf)
        if float(off.min()) > SHALLOW_MM:
            raise _no_boundary()
        self.seed = _first(off.argmin(), off.shape)

    def _parted(self, whole: Mask) -> tuple[Mask, Mask]:
        """What the opening took away: vessels, and what is only the nodule's shape."""
        away = ball_distance(~self.inside, self.box.step_mm)
        left = whole & ~self.inside
        cut, own = np.zeros_like(left), np.zeros_like(left)
        # Along the wall, where it was cut off, a film of it is left and a fillet: neither of the two.
        from_wall = ball_distance(~self.wall, self.box.step_mm) if self.wall.any() else np.full_like(away, np.inf)
        own |= left & (from_wall > 1.5 * self.box.step_mm)
        left = own.copy()
        far = left & (away > STUB_MM)
        while far.any():
            piece = component_at(left, _first(far.argmax(), far.shape))
            if float(from_wall[piece].max()) > FILLET_MM:
                cut |= piece
            own &= ~piece
            far &= ~piece
        return cut, own

    def _rim(self, inside: Mask, mm: float) -> Mask:
        return (ball_distance(~inside, self.box.step_mm) <= mm) & ~inside

    def _reaches_faces(self, mask: Mask) -> bool:
        return any(mask.take(end, axis=axis).any() for axis in range(3) for end in (0, -1))

    def _glass_hu(self) -> float | None:
        """How dense the ground glass is round a denser core; None where there is none."""
        self._grow(self.lung_hu + 2.0 * GLASS_RISE_HU)
        if self.is_near_faces:
            return None
        depth = ball_distance(self.inside, self.box.step_mm)
        ring = (depth >= self.blur * GLASS_MM[0]) & (depth <= self.blur * GLASS_MM[1])
        if ring.sum() < 20:
            return None
        level = float(np.median(self.smooth[ring]))
        densest = float(np.percentile(self.smooth[self.inside], 98.0))
        if level - self.lung_hu > GLASS_SHARE * (densest - self.lung_hu):
            return None
        return level

    @property
    def is_near_faces(self) -> bool:
        margin = int(np.ceil(EDGE_MM / self.box.step_mm))
        inner = np.zeros_like(self.inside)
        inner[margin:-margin, margin:-margin, margin:-margin] = True
        if (self.inside & ~inner & self.box.known).any():
            return True
        # Half of it may be missing, but not more.
        ends = self._rim(~self.box.known, 1.1 * self.box.step_mm) & self.inside
        return float(ends.sum()) > MOST_CUT * float(_surface(self.inside).sum())

    def nodule(self, coarsest_mm: float) -> Nodule:
        step = self.box.step_mm
        inside = self.inside
        depth = ball_distance(inside, step)
        away = ball_distance(~inside, step)
        other = ball_distance(~(self.others | self.wall), step) if (self.others | self.wall).any() else None
        free = np.ones_like(inside) if other is None else other > RIM_MM
        shell = (away > RIM_MM) & (away <= RIM_MM + 4.0) & free & (self.smooth < self.bar_hu)
        lung_hu = float(self.box.hu_zyx[shell].mean()) if shell.sum() > 50 else self.lung_hu
        core = depth > CORE_MM
        if core.sum() < 20:
            core = depth >= 0.6 * float(depth.max())
        core_hu = float(self.box.hu_zyx[core].mean())
        solid_voxels = inside & (self.smooth > SOLID_HU)
        kind: NoduleKind = "solid"
        if self.is_glass:
            is_part = solid_voxels.sum() * step**3 > SMALLEST_PART_MM3
            kind = "part-solid" if is_part else "ground-glass"
        counted = float(inside.sum()) * step**3
        # Beside a cut a voxel belongs to the nodule or not; elsewhere it does by its share.
        rim_hu = self._rim_hu(depth, lung_hu, core_hu)
        zone = (away <= RIM_MM) & free
        share = (self.box.hu_zyx - lung_hu) / ((core_hu if rim_hu is None else rim_hu) - lung_hu)
        if rim_hu is not None:
            # A denser core says nothing of where the edge is.
            share = np.where(depth > CORE_MM, 1.0, np.minimum(share, MOST_SHARE))
        surface = _surface(inside)
        # How much too far inside the boundary of the smoothed CT lies: seen where the nodule is free.
        open_air = ~(self.dense | self.wall)
        faces = surface & beside(open_air)
        gained = float(share[zone].sum() - (inside & free).sum())
        more = float((faces & ~free).sum()) * gained / max(float((faces & free).sum()), 1.0)
        voxels_mm3 = float(share[zone].sum() + (inside & ~free).sum() + max(more, 0.0)) * step**3
        cut_share = float((surface & ~free).sum() / max(surface.sum(), 1))
        area_mm2 = float(surface.sum()) * step**2 * 1.2
        noise = self._noise(lung_hu)
        error = self._error(
            mm3=voxels_mm3,
            area_mm2=area_mm2,
            cut_share=cut_share,
            noise=noise,
            rise=core_hu - lung_hu,
            kind=kind,
            coarsest_mm=coarsest_mm,
            is_alike=rim_hu is None,
        )
        if self.cut.any():
            # How long a stump of a vessel is left on it, or how much of it went with the vessel.
            mouth_mm2 = float((self.cut & (ball_distance(~inside, step) <= step)).sum()) * step**2
            error = float(np.hypot(error, MOUTH_MM * mouth_mm2))
        long_mm, short_mm = _diameters(inside, step)
        kjis = np.argwhere(inside)
        lo = np.maximum(kjis.min(axis=0) - 2, 0)
        hi = kjis.max(axis=0) + 3
        matrix = self.box.lps_from_ijk.copy()
        matrix[:3, 3] = matrix[:3, :3] @ lo[::-1] + matrix[:3, 3]
        centre = self.box.lps_from_ijk[:3, :3] @ kjis.mean(axis=0)[::-1] + self.box.lps_from_ijk[:3, 3]
        scale = (voxels_mm3 / max(counted, 1e-6)) ** (1.0 / 3.0)
        found = Nodule(
            centre_lps=(float(centre[0]), float(centre[1]), float(centre[2])),
            kind=kind,
            volume_mm3=voxels_mm3,
            volume_error_mm3=error,
            long_mm=long_mm * min(max(scale, 0.8), 1.2),
            short_mm=short_mm * min(max(scale, 0.8), 1.2),
            diameter_error_mm=0.5 * step + error / max(area_mm2, 1e-6),
            solid_mm3=voxels_mm3,
            density_hu=core_hu,
            touches=tuple(self.touches),
            inside_zyx=inside[lo[0] : hi[0], lo[1] : hi[1], lo[2] : hi[2]].copy(),
            lps_from_ijk=matrix,
        )
        if kind != "solid":
            found = replace(found, solid_mm3=float(solid_voxels.sum()) * step**3)
        return found

    def _rim_hu(self, depth: NDArray[np.float32], lung_hu: float, core_hu: float) -> float | None:
        """How dense a nodule is near its edge that is denser in its middle; None for one that is alike throughout."""
        ring = (depth >= RING_MM[0]) & (depth <= RING_MM[1])
        if ring.sum() < 20:
            return None
        level = float(np.median(self.smooth[ring]))
        if (level - lung_hu) / (core_hu - lung_hu) >= ALIKE:
            return None
        return lung_hu + (level - lung_hu) / RING_SHOWS

    def _noise(self, lung_hu: float) -> float:
        """Standard deviation of lung, HU."""
        dark = self.box.hu_zyx[np.abs(self.box.hu_zyx - lung_hu) < 200.0]
        return float(dark.std()) if dark.size > 100 else 50.0

    def _error(
        self,
        *,
        mm3: float,
        area_mm2: float,
        cut_share: float,
        noise: float,
        rise: float,
        kind: str,
        coarsest_mm: float,
        is_alike: bool,
    ) -> float:
        step = self.box.step_mm
        edge_mm = (0.6 if not is_alike else 0.05 if kind == "solid" else 0.25) * max(coarsest_mm, 0.8)
        free = (1.0 - cut_share) * area_mm2 * edge_mm
        cut = cut_share * area_mm2 * 0.5 * coarsest_mm
        # Noise is alike over some 4 voxels.
        grain = 1.645 * noise / max(rise, 50.0) * step**1.5 * np.sqrt(8.0 * max(mm3, 1.0))
        return float(np.sqrt(free**2 + cut**2 + grain**2) + 0.02 * mm3)


def _first(flat: Any, shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(int(k) for k in np.unravel_index(int(flat), shape))


def _only(at: tuple[int, ...], shape: tuple[int, ...]) -> Mask:
    mask = np.zeros(shape, dtype=bool)
    mask[at] = True
    return mask


def _surface(inside: Mask) -> Mask:
    """Voxels with a face to the outside."""
    padded = np.pad(inside, 1)
    deep = inside.copy()
    for axis in range(3):
        for shift in (-1, 1):
            deep &= np.roll(padded, shift, axis=axis)[1:-1, 1:-1, 1:-1]
    return inside & ~deep


def _diameters(inside: Mask, step_mm: float) -> tuple[float, float]:
    """The longest diameter in the largest axial slice, and the longest across it."""
    best = int(np.argmax(inside.sum(axis=(1, 2))))
    rows = np.argwhere(_surface(inside[best][None])[0]).astype(float) * step_mm
    off = rows[:, None, :] - rows[None, :, :]
    square = (off**2).sum(axis=2)
    a, b = np.unravel_index(int(np.argmax(square)), square.shape)
    long_mm = float(np.sqrt(square[a, b]))
    along = off[a, b] / max(long_mm, 1e-9)
    across = rows @ np.array([-along[1], along[0]])
    # Centres of voxels lie half a voxel inside, and the farthest of many lie a little too far out.
    return long_mm + 0.5 * step_mm, float(across.max() - across.min()) + 0.5 * step_mm
