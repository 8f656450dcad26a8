"""CT values on planes across an axis: the edge of the lumen, and the outer border of a bronchus against the lung."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina._core import Enclosures
from carina.track.intensity_levels import AirScale, air_scale
from carina.volume.model import Volume

Points = NDArray[np.float64]
Floats = NDArray[np.float64]

NUM_RAYS = 32
HALF_HU = -500.0
LUNG_HU = -650.0
"""Maximum value of lung, in HU; the values fall below it beyond a bronchus's outer border (fat is brighter)."""
BORDER_MM = 1.5
"""Distance in mm beyond the outer border within which the values must fall to ``LUNG_HU``."""
NUM_CENTRED = 5
MIN_SEEN = 0.4
"""Minimum share of the sides of a bronchus on which its outer border must be visible."""
MIN_OCTANTS = 5
ROUND = 0.15
"""Maximum distance of a border point from the fitted circle, as a share of the radius; farther points are outliers."""
CORE_MM = 0.8
"""Radius in mm of the disc over which values on an axis are averaged."""


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """CT values on a square grid perpendicular to an axis."""

    values: Floats
    """(n, n) values of the plane, in the units of the volume."""
    off_mm: Floats
    """(n, n, 2) offset of each sample from the centre of the plane, in mm along ``across``."""
    step_mm: float
    """Distance in mm between neighbouring samples of the plane."""
    across: Points
    """(2, 3) unit vectors that span the plane, LPS."""


class CrossSampler:
    """Sampler of a volume on rays and planes perpendicular to an axis.

    Parameters
    ----------
    volume
        The CT.
    """

    def __init__(self, volume: Volume) -> None:
        self._values = Enclosures(volume.hu_zyx, volume.lps_from_ijk)
        self.scale: AirScale = air_scale(volume)
        self.half = float(self.scale.level(HALF_HU))
        """Voxel value half-way between air and soft tissue, at which a border is located."""
        self.lung = float(self.scale.level(LUNG_HU))
        self.step_mm = 0.5 * float(min(volume.spacing_mm))

    def values_at(self, points_lps: Points) -> Floats:
        """Return (...,) trilinear values at (..., 3) points (LPS, mm)."""
        flat = self._values.values_at(np.ascontiguousarray(points_lps.reshape(-1, 3), dtype=np.float64))
        return np.asarray(flat, dtype=np.float64).reshape(points_lps.shape[:-1])

    def along(self, points_lps: Points, direction: Points) -> Floats:
        """Return (n,) mean values over a small disc across the axis, at each of (n, 3) points (LPS, mm)."""
        across = _perpendicular_vectors(direction)
        ring = 2.0 * np.pi * np.arange(6) / 6
        off = CORE_MM * (np.cos(ring)[:, None] * across[0] + np.sin(ring)[:, None] * across[1])
        places = points_lps[:, None, :] + np.concatenate([np.zeros((1, 3)), off])[None]
        result: Floats = self.values_at(places).mean(axis=1)
        return result

    def share_of_tissue(self, points_lps: Points, direction: Points, radius_mm: float) -> float:
        """Return the share of tissue in discs of the given radius round (n, 3) points (LPS, mm)."""
        across = _perpendicular_vectors(direction)
        ring = 2.0 * np.pi * np.arange(12) / 12
        sides = np.cos(ring)[:, None] * across[0] + np.sin(ring)[:, None] * across[1]
        off = np.concatenate([np.zeros((1, 3)), 0.6 * radius_mm * sides, radius_mm * sides])
        return float((self.values_at(points_lps[:, None, :] + off[None]) >= self.half).mean())

    def rays(self, centre_lps: Points, direction: Points, reach_mm: float) -> Floats:
        """Return (32, n) values on rays across an axis, one value per ``step_mm``; ray i is opposite to ray i + 16."""
        across = _perpendicular_vectors(direction)
        angle = 2.0 * np.pi * np.arange(NUM_RAYS) / NUM_RAYS
        sides = np.cos(angle)[:, None] * across[0] + np.sin(angle)[:, None] * across[1]
        off = np.arange(0.0, reach_mm + self.step_mm, self.step_mm)
        return self.values_at(centre_lps + sides[:, None, :] * off[None, :, None])

    def inner_mm(self, rays: Floats, least_rise: float) -> Floats:
        """Return (32,) distances in mm at which each ray from a lumen has risen half-way to its wall.

        The distance is NaN where the ray rises by less than ``least_rise``.
        """
        own = float(rays[:, 0].mean())
        peak = rays.max(axis=1)
        half = 0.5 * (own + np.minimum(peak, self.scale.level(0.0)))
        return np.where(peak - own >= least_rise, _first_crossing_mm(rays - half[:, None], self.step_mm), np.nan)

    def outer_mm(self, rays: Floats) -> Floats:
        """Return (32,) distances in mm from the axis of the last change from tissue to lung on each ray.

        The distance is NaN if the ray does not leave tissue, or leaves it too close to the end of the ray.
        """
        tissue = rays >= self.half
        size = rays.shape[1]
        last = size - 1 - np.argmax(tissue[:, ::-1], axis=1)
        reach = max(round(BORDER_MM / self.step_mm), 1)
        # A border is only recognised if the ray continues far enough beyond it.
        seen = tissue.any(axis=1) & (last + reach < size)
        at = np.minimum(last, size - 2)
        place = np.arange(len(rays))
        here, there = rays[place, at], rays[place, at + 1]
        low = np.stack([rays[place, np.minimum(at + n, size - 1)] for n in range(1, reach + 1)]).min(axis=0)
        share = np.clip((here - self.half) / np.maximum(here - there, 1e-9), 0.0, 1.0)
        return np.where(seen & (low <= self.lung), (at + share) * self.step_mm, np.nan)

    def middle(self, centre_lps: Points, direction: Points, reach_mm: float) -> tuple[Points, float] | None:
        """Return the centre of a solid cord (LPS, mm) and its outer width in mm, from a point inside the cord.

        The result is a circle through the border of the cord against the lung; vessels beside the cord are left out.
        Returns None if too little of the border is visible, or if the border is not round.
        """
        across = _perpendicular_vectors(direction)
        angle = 2.0 * np.pi * np.arange(NUM_RAYS) / NUM_RAYS
        sides = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        centre = np.array(centre_lps, dtype=np.float64)
        found = None
        for _ in range(NUM_CENTRED):
            outer = self.outer_mm(self.rays(centre, direction, reach_mm))
            seen = np.isfinite(outer)
            found = _circle(outer[seen, None] * sides[seen], self.step_mm)
            if found is None:
                return None
            shift, radius = found
            centre += np.clip(shift, -0.5 * radius, 0.5 * radius) @ across
            if float(np.linalg.norm(shift)) < 0.2 * self.step_mm:
                break
        return None if found is None else (centre, 2.0 * found[1])

    def plane(self, centre_lps: Points, direction: Points, reach_mm: float) -> Plane:
        """Return the values on a square across an axis that extends ``reach_mm`` to each side of the centre."""
        across = _perpendicular_vectors(direction)
        count = int(np.ceil(reach_mm / self.step_mm))
        at = np.arange(-count, count + 1) * self.step_mm
        off = np.stack(np.meshgrid(at, at, indexing="ij"), axis=-1)
        return Plane(self.values_at(centre_lps + off @ across), off, self.step_mm, across)


def _perpendicular_vectors(direction: Points) -> Points:
    """Return two unit vectors (2, 3) across a direction and perpendicular to each other."""
    along = direction / max(float(np.linalg.norm(direction)), 1e-9)
    one = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    one /= np.linalg.norm(one)
    return np.stack([one, np.cross(along, one)])


def _first_crossing_mm(above: Floats, step_mm: float) -> Floats:
    """Return the distance in mm at which each row of values first reaches 0 from below; NaN where no value does."""
    reached = above >= 0.0
    first = np.maximum(reached.argmax(axis=1), 1)
    place = np.arange(len(above))
    before, at = above[place, first - 1], above[place, first]
    share = np.clip(-before / np.maximum(at - before, 1e-9), 0.0, 1.0)
    return np.where(reached.any(axis=1), step_mm * (first - 1 + share), np.nan)


def _circle(points: Floats, step_mm: float) -> tuple[Floats, float] | None:
    """Return centre and radius in mm of the circle through most of (n, 2) points round the origin (Kasa 1976).

    Returns None if the points cover too few sides or are not round.
    """
    remaining = np.ones(len(points), dtype=bool)
    for _ in range(4):
        own = points[remaining]
        octants = np.unique(np.floor(np.arctan2(own[:, 1], own[:, 0]) / (0.25 * np.pi)))
        if len(own) < MIN_SEEN * NUM_RAYS or len(octants) < MIN_OCTANTS:
            return None
        design = np.column_stack([2.0 * own, np.ones(len(own))])
        (x, y, rest), *_ = np.linalg.lstsq(design, (own * own).sum(axis=1), rcond=None)
        squared = rest + x * x + y * y
        if squared <= 0.0:
            return None
        middle, radius = np.array([x, y]), float(np.sqrt(squared))
        off = np.abs(np.linalg.norm(points - middle, axis=1) - radius)
        # Keep at least 40 % of the points: a vessel beside the cord makes the first circle too wide.
        limit = max(ROUND * radius, 0.5 * step_mm, float(np.quantile(off, 0.4)))
        if np.array_equal(remaining, off <= limit):
            break
        remaining = off <= limit
    is_round = np.abs(np.linalg.norm(points[remaining] - middle, axis=1) - radius) <= max(ROUND * radius, step_mm)
    return (middle, radius) if is_round.sum() >= MIN_SEEN * NUM_RAYS else None
