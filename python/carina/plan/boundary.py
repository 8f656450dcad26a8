"""Where a nodule ends in one box of a CT: half-way to the lung, without vessels and without the wall beside it.

No weights. Vessels that enter are cut off by an opening as wide as the nodule allows, and the pleura by the surface of
the chest wall beside it (docs/decisions/0121).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.plan.box import (
    Box,
    ball_distance,
    component_at,
    distance_from,
    enclosed,
    lung_median_hu,
    smoothed,
    surface,
    uphill,
)
from carina.plan.chest_wall import SHALLOW_MM, cut_at_wall

__all__ = ["HALVES_MM", "SMOOTH_MM", "SOLID_HU", "Boundary", "no_boundary"]

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
GLASS_TOP_HU = -200.0
"""What is denser than this behind its edge is soft tissue, however dense its core: lime."""
DENSEST_HU = 100.0
"""The edge of what is denser is soft tissue too: lime lies in it."""
TISSUE_HU = 40.0
CAVITY_WALL_MM = 4.0
"""A cavity's wall is looked for this far outside of it."""
RIM_DEEP_MM, RIM_BIN_MM, NUM_RIMS = (0.4, 2.8), 0.4, 2
"""There ground glass round a core is read again, once its boundary is known, and once more."""
LEAST_RING = 20
"""Fewer voxels say nothing of a density."""
CAVITY_MM, SMALLEST_CAVITY_MM3 = 0.9, 10.0
"""Radius of the ball that a cavity has room for, and its volume: less is noise."""
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
FILM_MM = 1.1
"""Radius of the largest ball in a nodule on the wall."""
FILLET_MM = 3.0
"""What is left nearer to the wall than this, where it was cut off, is neither nodule nor vessel."""
GLASS_RISE_HU, GLASS_MM, GLASS_SHARE = 120.0, (1.0, 1.7), 0.55
"""Round a core lies ground glass where, this deep in all that stands out of the lung, no more than this share of the
core's rise is seen."""


def no_boundary() -> NoResultError:
    return NoResultError(
        f"no boundary was found within {HALVES_MM[-1] - EDGE_MM:.0f} mm: this looks like consolidation, the chest "
        "wall, the heart or the diaphragm rather than a nodule; click in the middle of the nodule, or set "
        "a sphere there by hand",
        code="plan.no-boundary",
    )


class Boundary:
    """A nodule in one box."""

    def __init__(self, box: Box, point: NDArray[np.float64], coarsest_mm: float, look: Callable[[], None]) -> None:
        self.box = box
        self._look = look
        """Called before each of its steps; it may raise CancelledError."""
        # Thick slices blur as well.
        self.blur = max(1.0, coarsest_mm / 1.5)
        self.smooth = smoothed(box.hu_zyx, SMOOTH_MM / box.step_mm)
        very = smoothed(box.hu_zyx, SEED_SMOOTH_MM / box.step_mm)
        self.lung_hu = lung_median_hu(self.smooth)
        self.seed, level = self._meant(very, point)
        self._grow(min(level, DENSEST_HU))
        glass = self._glass_hu()
        self._grow(min(level, DENSEST_HU) if glass is None else glass)
        self.rim_hu: float | None = None
        if glass is not None:
            for _ in range(NUM_RIMS):
                # Nearer to its edge less of the core is seen, and the boundary that follows lies farther out.
                self.rim_hu = self._rim_hu()
                if self.rim_hu is None:
                    break
                self._grow(self.rim_hu)
        self.has_glass = glass is not None
        """Round a denser part."""

    def _meant(self, very: NDArray[np.float32], point: NDArray[np.float64]) -> tuple[tuple[int, ...], float]:
        """The voxel that a click means, and how dense the nodule is there.

        The nearest place that is dense: the densest may lie in the chest wall behind it.
        """
        box = self.box
        off = box.offsets_mm(point)
        near = self._round_cavity(off)
        if not near.any():
            near = off <= CLICK_MM
        densest = float(very[near].max())
        if densest < self.lung_hu + LEAST_RISE_HU:
            raise NoResultError(
                f"there is no nodule at this point: within {CLICK_MM:.0f} mm nothing is denser than {densest:.0f} HU, "
                f"and the lung around it is {self.lung_hu:.0f} HU; click in the middle of the nodule",
                code="plan.no-nodule",
            )
        meant = near & (very >= self.lung_hu + MEANT * (densest - self.lung_hu))
        seed = _first(np.where(meant, off, np.inf).argmin(), off.shape)
        level = float(very[meant & (box.steps_from(seed) * box.step_mm <= LEVEL_MM)].max())
        return seed, level

    def _round_cavity(self, off: NDArray[np.float64]) -> Mask:
        """The wall of the cavity that a click lies in; nothing where it lies in lung or in an airway that goes on."""
        air = self.smooth <= 0.5 * (self.lung_hu + TISSUE_HU)
        at = _first(off.argmin(), off.shape)
        if not air[at]:
            return np.zeros_like(air)
        hollow = component_at(air, at)
        if self.reaches_faces(hollow):
            return np.zeros_like(air)
        wall = distance_from(hollow, self.box.step_mm, CAVITY_WALL_MM)
        return (wall <= CAVITY_WALL_MM) & ~hollow

    def _grow(self, level: float) -> None:
        """The part round the seed that is denser than half-way to ``level``, without what enters it."""
        self._look()
        self.bar_hu = 0.5 * (self.lung_hu + level)
        self.dense = self.smooth > self.bar_hu
        self.dense[self.seed] = True
        whole = component_at(self.dense, self.seed)
        hollow = enclosed(whole)
        whole |= hollow
        self.touches: list[str] = []
        self.wall = np.zeros_like(whole)
        if self.reaches_faces(whole):
            cut, wall = cut_at_wall(self.box, self.smooth, whole, self.seed)
            if wall is not None:
                if wall[self.seed]:
                    self._leave_the_wall(cut)
                self.wall = wall
                whole = component_at(cut | _only(self.seed, cut.shape), self.seed)
        self._look()
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
        back_mm = share * radius + 0.5 * self.box.step_mm
        self.inside = core | (whole & (distance_from(core, self.box.step_mm, back_mm) <= back_mm))
        self.cut, own = self._parted(whole)
        self.inside |= own
        self.cavity = self._large_hollow(hollow & self.inside)
        self.others = self.dense & ~self.inside
        if (self.wall & self.rim(self.inside, 2.0 * self.box.step_mm)).sum() > 8:
            self.touches.append("pleura")
        if (self.rim(self.inside, 1.1 * self.box.step_mm) & ~self.box.known).any():
            self.touches.append("edge of the CT")
        if self.cut.any():
            self.touches.append("vessel")

    def _large_hollow(self, hollow: Mask) -> Mask:
        """What of the hollows is a cavity: noise makes small ones, above all in ground glass."""
        if float(hollow.sum()) * self.box.step_mm**3 < SMALLEST_CAVITY_MM3:
            return np.zeros_like(hollow)
        deep = ball_distance(hollow, self.box.step_mm)
        return hollow if float(deep.max()) >= CAVITY_MM else np.zeros_like(hollow)

    def _leave_the_wall(self, cut: Mask) -> None:
        """The seed of a nodule that lies flat on the wall may fall into its edge."""
        off = np.where(cut, self.box.steps_from(self.seed) * self.box.step_mm, np.inf)
        if float(off.min()) > SHALLOW_MM:
            raise no_boundary()
        self.seed = _first(off.argmin(), off.shape)

    def _parted(self, whole: Mask) -> tuple[Mask, Mask]:
        """What the opening took away: vessels, and what is only the nodule's shape."""
        away = distance_from(self.inside, self.box.step_mm, STUB_MM)
        left = whole & ~self.inside
        cut, own = np.zeros_like(left), np.zeros_like(left)
        # Along the wall, where it was cut off, a film of it is left and a fillet: neither of the two.
        from_wall = distance_from(self.wall, self.box.step_mm, FILLET_MM)
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

    def rim(self, inside: Mask, mm: float) -> Mask:
        return (distance_from(inside, self.box.step_mm, mm) <= mm) & ~inside

    def reaches_faces(self, mask: Mask) -> bool:
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
        if level > GLASS_TOP_HU:
            return None
        densest = min(float(np.percentile(self.smooth[self.inside], 98.0)), DENSEST_HU)
        if level - self.lung_hu > GLASS_SHARE * (densest - self.lung_hu):
            return None
        return float(np.median(self.box.hu_zyx[ring]))

    def _rim_hu(self) -> float | None:
        """How dense the ground glass is where it is least touched by the lung and by the core; None in a thin one.

        There the values change least with depth: a thin faint rim shows its own density nowhere else.
        """
        depth = ball_distance(self.inside, self.box.step_mm)
        at, level = [], []
        for first in np.arange(RIM_DEEP_MM[0], RIM_DEEP_MM[1], RIM_BIN_MM):
            ring = (depth >= first) & (depth < first + RIM_BIN_MM)
            if ring.sum() >= LEAST_RING:
                at.append(float(depth[ring].mean()))
                level.append(float(np.median(self.box.hu_zyx[ring])))
        if len(at) < 2:
            return None
        n = int(np.argmin(np.diff(level) / np.diff(at)))
        return 0.5 * (level[n] + level[n + 1])

    @property
    def is_film(self) -> bool:
        """What is thinner where it was cut from the wall is the wall's own unevenness."""
        return "pleura" in self.touches and float(ball_distance(self.inside, self.box.step_mm).max()) < FILM_MM

    @property
    def is_near_faces(self) -> bool:
        margin = int(np.ceil(EDGE_MM / self.box.step_mm))
        inner = np.zeros_like(self.inside)
        inner[margin:-margin, margin:-margin, margin:-margin] = True
        if (self.inside & ~inner & self.box.known).any():
            return True
        # Half of it may be missing, but not more.
        ends = self.rim(~self.box.known, 1.1 * self.box.step_mm) & self.inside
        return float(ends.sum()) > MOST_CUT * float(surface(self.inside).sum())


def _first(flat: Any, shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(int(k) for k in np.unravel_index(int(flat), shape))


def _only(at: tuple[int, ...], shape: tuple[int, ...]) -> Mask:
    mask = np.zeros(shape, dtype=bool)
    mask[at] = True
    return mask
