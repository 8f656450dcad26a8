"""Segmentation of a nodule in one box of a CT, by a threshold half-way between lung and nodule.

The method needs no trained weights. Vessels that enter the nodule are removed by a morphological opening as wide as the
nodule allows. The pleura is removed by the fitted surface of the chest wall (docs/decisions/0121).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.errors import NoResultError
from carina.plan.cubic_box import (
    Box,
    beside,
    component_at,
    components,
    enclosed,
    from_faces,
    lung_median_hu,
    smoothed,
    surface,
    uphill,
)
from carina.plan.targets.chest_wall import SHALLOW_MM, LungSide, cut_at_wall
from carina.volume.mask_distances import ball_distance, distance_from, extent

Mask = NDArray[np.bool_]

CLICK_MM = 4.0
"""Maximum distance in mm from a click to the nodule's densest voxel; farther away, the click selects no nodule."""
SMOOTH_MM = 0.7
SEED_SMOOTH_MM = 1.0
SEED_RISE_SHARE = 0.75
"""Minimum density of the seed voxel above lung, as a share of the greatest density above lung near the click.

The seed is the voxel nearest to the click that meets this limit; segmentation starts from it.
"""
LEVEL_MM = 2.0
SOLID_HU = -250.0
"""Density in HU above which the middle of a nodule is solid; ground glass is -750 to -300 HU."""
GLASS_TOP_HU = -200.0
"""Density in HU of a nodule's edge above which the edge is soft tissue and not ground glass.

A dense or calcified core does not change this limit.
"""
BRIGHTER_HU = 90.0
"""Minimum difference in HU between a nodule and bone or a vessel with contrast medium beside it."""
DENSEST_HU = 100.0
"""Upper limit in HU for the nodule's density; the segmentation threshold is half-way between it and lung.

Only calcification makes a nodule denser, and the edge of a calcified nodule is soft tissue.
"""
TISSUE_HU = 40.0
CAVITY_WALL_MM = 4.0
"""Distance in mm outside a cavity in which the cavity's wall is searched."""
RIM_DEEP_MM, RIM_BIN_MM, NUM_RIMS = (0.4, 2.8), 0.4, 2
"""Depth range and bin width in mm for measuring ground glass round a core, and the number of repetitions.

Each repetition measures the density inside the boundary that the previous repetition found.
"""
MIN_RING = 20
"""Minimum number of voxels of a region whose density is measured."""
CAVITY_MM, SMALLEST_CAVITY_MM3 = 0.9, 10.0
"""Least radius in mm of the largest ball inside a cavity, and least volume of a cavity; smaller hollows are noise."""
MIN_RISE_HU = 110.0
"""Difference in HU from the lung below which a click has no nodule."""
HALVES_MM = (22.0, 36.0, 60.0)
"""Half side lengths in mm of the boxes that are searched in turn, the smallest first.

The next larger box is used if the nodule comes near the faces of the present box.
"""
EDGE_MM = 4.0
MAX_CUT = 0.4
"""Maximum share of a nodule's surface that the edge of the CT may cut off."""
OPENINGS, OPENINGS_AT_WALL = (0.6, 0.7, 0.8), (0.4, 0.5, 0.6, 0.7, 0.8)
"""Radii of the opening that removes vessels, as shares of the radius of the largest ball in the nodule.

The radii are tried in turn, until the nodule contains no long tail (`MAX_TAIL_RADII`). A nodule at the wall begins with
smaller shares, because large balls remove the edges of a nodule with a flat side.
"""
WIDE_OPENINGS_MM = (4.0, 5.5, 7.5)
"""Radii in mm of the openings that are tried first in a large nodule; few vessels in the lung are wider."""
MAX_TAIL_RADII = 2.4
"""Maximum distance of a part of a nodule from the nodule's middle, in radii; a part farther away is a vessel."""
WIDE_OFF_MM = 0.5
"""Minimum uncertainty in mm of the wall's position behind a nodule with a wide contact."""
MIN_FREE = 0.35
"""Minimum share of the surface of a nodule with a wide contact that faces the lung."""
RIM_MM = 1.6
"""Distance in mm from a sharp edge over which the blur of a CT spreads the edge."""
STUB_MM = 2.0
"""Maximum length in mm of a removed part that still belongs to the nodule; longer removed parts are vessels."""
FILM_MM = 1.1
"""Radius in mm of the largest ball below which tissue on the wall is unevenness of the wall, not a nodule."""
FILLET_MM = 3.0
"""Distance in mm from a removed chest wall within which a remaining part is neither nodule nor vessel."""
GLASS_RISE_HU, GLASS_MM, GLASS_SHARE = 120.0, (1.0, 1.7), 0.55
"""Limits that identify ground glass round a denser core: threshold in HU, depths in mm, share of the core.

The first number is the rise over lung of the threshold for the outer boundary. Ground glass is present if, at these
depths, the rise over lung is at most this share of the core's rise.
"""


GROWN = ("bar_hu", "dense", "touches", "wall", "wall_off_mm", "is_chord", "inside", "cut", "cavity", "others", "seed")
"""Attributes of a `Boundary` that depend on the threshold."""


def no_boundary() -> NoResultError:
    """Return the error for a click without a nodule boundary."""
    return NoResultError(
        f"no boundary was found within {HALVES_MM[-1] - EDGE_MM:.0f} mm: this looks like consolidation, the chest "
        "wall, the heart or the diaphragm rather than a nodule; click in the middle of the nodule, or set "
        "a sphere there by hand",
        code="plan.no-boundary",
    )


class Boundary:
    """Boundary of one nodule, as voxel masks in a box.

    The constructor does the segmentation. The attribute ``inside`` is the mask of the nodule, ``cavity`` its air,
    ``wall`` the chest wall, ``cut`` the removed vessels and ``others`` all other dense voxels. ``wall_off_mm`` is the
    additional uncertainty of the wall behind the nodule, and ``is_chord`` states that the wall there is a mere chord.

    Parameters
    ----------
    box
        Part of the CT that is searched.
    point
        (3,) clicked point, LPS mm.
    coarsest_mm
        Largest spacing of the CT.
    look
        Called before each step; it may raise CancelledError.

    Raises
    ------
    NoResultError
        If there is no nodule at the point, or the nodule has no boundary.
    """

    def __init__(self, box: Box, point: NDArray[np.float64], coarsest_mm: float, look: Callable[[], None]) -> None:
        self.box = box
        self._look = look
        """Callback before each step; it may raise CancelledError."""
        # Slices thicker than 1.5 mm blur the boundary more.
        self.blur = max(1.0, coarsest_mm / 1.5)
        self.smooth = smoothed(box.hu_zyx, SMOOTH_MM / box.step_mm)
        very = smoothed(box.hu_zyx, SEED_SMOOTH_MM / box.step_mm)
        self.lung_hu = lung_median_hu(self.smooth)
        self.seed, level = self._selected_voxel(very, point)
        self._lung_sides: dict[tuple[int, ...], LungSide] = {}
        self._grow(min(level, DENSEST_HU))
        solid = self._state()
        # The lower threshold of ground glass gives a larger boundary, which would also be near the faces.
        glass = None if self.is_near_faces else self._glass_hu()
        if glass is None:
            self._restore(solid)
        else:
            self._grow(glass)
        self.rim_hu: float | None = None
        if glass is not None:
            for _ in range(NUM_RIMS):
                # Each repetition uses the density inside the previous boundary, which was larger, so the core affects
                # it less.
                self.rim_hu = self._rim_hu()
                if self.rim_hu is None:
                    break
                self._grow(self.rim_hu)
        self.has_glass = glass is not None
        """Whether ground glass surrounds a denser part (a part-solid nodule)."""

    def _state(self) -> dict[str, Any]:
        """Return the attributes that `_grow` sets, so that they can be restored."""
        return {name: getattr(self, name) for name in GROWN}

    def _restore(self, state: dict[str, Any]) -> None:
        """Set the attributes of this boundary to the values that `_state` returned earlier."""
        for name, value in state.items():
            setattr(self, name, value)

    def _selected_voxel(self, very: NDArray[np.float32], point: NDArray[np.float64]) -> tuple[tuple[int, ...], float]:
        """Return the voxel of the nodule that a click selects, and the density of the nodule there in HU.

        The voxel is the nearest dense one, not the densest one, because the densest one may belong to the chest wall.
        """
        box = self.box
        off = box.offsets_mm(point)
        near = self._round_cavity(off)
        if not near.any():
            near = off <= CLICK_MM
        densest = float(very[near].max())
        if densest < self.lung_hu + MIN_RISE_HU:
            raise NoResultError(
                f"there is no nodule at this point: within {CLICK_MM:.0f} mm nothing is denser than {densest:.0f} HU, "
                f"and the lung around it is {self.lung_hu:.0f} HU; click in the middle of the nodule",
                code="plan.no-nodule",
            )
        candidates = near & (very >= self.lung_hu + SEED_RISE_SHARE * (densest - self.lung_hu))
        seed = _first(np.where(candidates, off, np.inf).argmin(), off.shape)
        level = float(very[candidates & (box.steps_from(seed) * box.step_mm <= LEVEL_MM)].max())
        return seed, level

    def _round_cavity(self, off: NDArray[np.float64]) -> Mask:
        """Return the mask of the wall round the cavity that contains the clicked point.

        The mask is empty if the click is in lung, or in an airway that reaches the faces of the box. ``off`` is the
        distance of each voxel from the click.
        """
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
        """Segment the nodule round the seed by a threshold, and remove vessels and wall from it.

        Parameters
        ----------
        level
            Density of the nodule in HU; the threshold is half-way between it and the lung.
        """
        self._look()
        self.bar_hu = 0.5 * (self.lung_hu + level)
        self.dense = self.smooth > self.bar_hu
        self.dense &= ~self._brighter(level)
        self.dense[self.seed] = True
        whole = component_at(self.dense, self.seed)
        hollow = enclosed(whole)
        whole |= hollow
        self.touches: list[str] = []
        self.wall = np.zeros_like(whole)
        self.wall_off_mm, self.is_chord = 0.0, False
        if self.reaches_faces(whole):
            if self.seed not in self._lung_sides:
                self._lung_sides[self.seed] = LungSide(self.box, self.smooth, self.seed)
            found = cut_at_wall(self._lung_sides[self.seed], whole)
            if found.wall is not None:
                if found.wall[self.seed]:
                    self._leave_the_wall(found.inside)
                self.wall = found.wall
                self.wall_off_mm, self.is_chord = found.off_mm, found.is_chord
                whole = component_at(found.inside | _only(self.seed, whole.shape), self.seed)
        self._look()
        depth = ball_distance(whole, self.box.step_mm)
        # The ascent from the seed ends at the centre of the locally largest ball inside the mask.
        peak = uphill(depth, self.seed)
        radius = float(depth[peak])
        for opening_mm in self._openings_mm(radius):
            core = component_at(depth > opening_mm, peak)
            off = self.box.steps_from(peak)[core] * self.box.step_mm
            whole_mm = float(off.max()) + opening_mm
            if whole_mm <= MAX_TAIL_RADII * radius:
                break
        back_mm = opening_mm + 0.5 * self.box.step_mm
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

    def _openings_mm(self, radius_mm: float) -> list[float]:
        """Return the radii in mm of the morphological openings to try; ``radius_mm`` is that of the largest ball."""
        shares = OPENINGS_AT_WALL if self.wall.any() else OPENINGS
        usual = [share * radius_mm for share in shares]
        # The vessels of a mass are thin compared with it, but its lobes are not.
        return [mm for mm in WIDE_OPENINGS_MM if mm < usual[0]] + usual

    def _large_hollow(self, hollow: Mask) -> Mask:
        """Return the hollows of a nodule if they form a cavity, else an empty mask; small hollows are noise."""
        if float(hollow.sum()) * self.box.step_mm**3 < SMALLEST_CAVITY_MM3:
            return np.zeros_like(hollow)
        deep = ball_distance(hollow, self.box.step_mm, CAVITY_MM)
        return hollow if float(deep.max()) >= CAVITY_MM else np.zeros_like(hollow)

    def _brighter(self, level: float) -> Mask:
        """Return the mask of bone and contrast-filled vessels: voxels brighter than the nodule that go beyond it."""
        bright = self.smooth > max(level, float(self.smooth[self.seed])) + BRIGHTER_HU
        return from_faces(bright) if bright.any() else bright

    def _leave_the_wall(self, cut: Mask) -> None:
        """Move a seed that lies just inside the wall to the nearest voxel outside the wall.

        Raises
        ------
        NoResultError
            If the seed lies deeper in the wall than `SHALLOW_MM`.
        """
        off = np.where(cut, self.box.steps_from(self.seed) * self.box.step_mm, np.inf)
        if float(off.min()) > SHALLOW_MM:
            raise no_boundary()
        self.seed = _first(off.argmin(), off.shape)

    def _parted(self, whole: Mask) -> tuple[Mask, Mask]:
        """Divide the voxels that the opening removed into a mask of vessels and a mask of parts of the nodule."""
        away = distance_from(self.inside, self.box.step_mm, STUB_MM)
        left = whole & ~self.inside
        cut, own = np.zeros_like(left), np.zeros_like(left)
        # A film and a fillet of the removed wall remain along the wall; they are neither nodule nor vessel.
        from_wall = distance_from(self.wall, self.box.step_mm, FILLET_MM)
        own |= left & (from_wall > 1.5 * self.box.step_mm)
        far = own & (away > STUB_MM)
        if far.any():
            part = extent(own, 0)
            pieces = components(own[part])
            is_long = np.bincount(pieces[far[part]], minlength=int(pieces.max()) + 1) > 0
            is_free = np.bincount(pieces[own[part] & (from_wall[part] > FILLET_MM)], minlength=is_long.size) > 0
            cut[part] = (is_long & is_free)[pieces]
            own[part] &= ~is_long[pieces]
        return cut, own

    def rim(self, inside: Mask, mm: float) -> Mask:
        """Return the mask of the voxels outside a mask that are at most a given distance in mm from it.

        Parameters
        ----------
        inside
            (nz, ny, nx) mask.
        mm
            Largest distance from the mask.
        """
        return (distance_from(inside, self.box.step_mm, mm) <= mm) & ~inside

    def reaches_faces(self, mask: Mask) -> bool:
        """Return whether a mask touches the faces of the box."""
        return any(mask.take(end, axis=axis).any() for axis in range(3) for end in (0, -1))

    def _glass_hu(self) -> float | None:
        """Return the density in HU of the ground glass round a denser core of the nodule; None if there is none."""
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
        """Return the density in HU of ground glass at the depth where lung and core affect it least, or None.

        The depth is the one at which the density changes least with depth. The result is None if the layer of ground
        glass is too thin.
        """
        depth = ball_distance(self.inside, self.box.step_mm)
        at, level = [], []
        for first in np.arange(RIM_DEEP_MM[0], RIM_DEEP_MM[1], RIM_BIN_MM):
            ring = (depth >= first) & (depth < first + RIM_BIN_MM)
            if ring.sum() >= MIN_RING:
                at.append(float(depth[ring].mean()))
                level.append(float(np.median(self.box.hu_zyx[ring])))
        if len(at) < 2:
            return None
        n = int(np.argmin(np.diff(level) / np.diff(at)))
        return 0.5 * (level[n] + level[n + 1])

    @property
    def is_embedded(self) -> bool:
        """Whether a mass on the wall has too little surface towards the lung for a boundary."""
        edge = surface(self.inside)
        free = edge & beside(~(self.dense | self.wall | self.inside))
        return self.wall_off_mm > WIDE_OFF_MM and float(free.sum()) < MIN_FREE * float(edge.sum())

    @property
    def is_film(self) -> bool:
        """Whether the nodule on the wall is so thin that it is unevenness of the wall."""
        return "pleura" in self.touches and float(ball_distance(self.inside, self.box.step_mm, FILM_MM).max()) < FILM_MM

    @property
    def is_near_faces(self) -> bool:
        """Whether the nodule is near the faces of the box, or the edge of the CT cuts too much of it."""
        margin = int(np.ceil(EDGE_MM / self.box.step_mm))
        inner = np.zeros_like(self.inside)
        inner[margin:-margin, margin:-margin, margin:-margin] = True
        if (self.inside & ~inner & self.box.known).any():
            return True
        # The edge of the CT may cut off up to MAX_CUT of the nodule's surface.
        ends = self.rim(~self.box.known, 1.1 * self.box.step_mm) & self.inside
        return float(ends.sum()) > MAX_CUT * float(surface(self.inside).sum())


def _first(flat: Any, shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(int(k) for k in np.unravel_index(int(flat), shape))


def _only(at: tuple[int, ...], shape: tuple[int, ...]) -> Mask:
    mask = np.zeros(shape, dtype=bool)
    mask[at] = True
    return mask
