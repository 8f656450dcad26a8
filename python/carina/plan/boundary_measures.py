"""What is measured of a nodule whose boundary is known: volume, diameters, density, and how sure they are.

The volume is the share of nodule in every voxel (partial volume), which blur does not change (docs/decisions/0121).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from carina.plan.boundary import RIM_MM, SOLID_HU, Boundary
from carina.plan.box import Box, ball_distance, beside, distance_from, surface
from carina.plan.nodule_value import Nodule, NoduleKind

__all__ = ["cut_out", "diameters", "measured"]

Mask = NDArray[np.bool_]

SHELL_MM = 4.0
"""Lung that the nodule is compared with, beyond its rim."""
MOUTH_MM = 2.5
"""How uncertain the place of a cut through a vessel is."""
CORE_MM = 1.5
"""Deeper than this the edge's blur is not felt."""
RING_MM, RING_SHOWS, ALIKE = (0.8, 1.6), 0.97, 0.8
"""At this depth a nodule that is alike throughout shows 0.84 to 0.93 of its rise over the lung; one with a denser core
less."""
MOST_SHARE = 1.5
SMALL_MM, SMALL_OFF = 2.4, 0.2
"""Radius of the largest ball in a small nodule, and how far its boundary may be off, in slices."""
FAINT_SHARE, FAINT_HU, FAINT_MM, FAINT_SLICES_MM = 0.22, 80.0, 1.5, 1.5
"""Beyond its rim the nodule's own blur has less than this share of its rise; in thick slices it has not."""
THIN_OFF = 0.25
"""How far the boundary of a cavity's wall may be off, in slices."""
SMALLEST_PART_MM3 = 15.0
"""A denser part smaller than this (3 mm across) may be a vessel's end."""


def measured(grown: Boundary, coarsest_mm: float) -> Nodule:
    """The nodule in a boundary.

    Parameters
    ----------
    grown
        Voxels of the nodule, and of what it was cut from.
    coarsest_mm
        Largest spacing of the CT.
    """
    step = grown.box.step_mm
    inside = grown.inside
    depth = ball_distance(inside, step)
    from_cavity = distance_from(grown.cavity, step, RIM_MM)
    tissue_depth = np.minimum(depth, from_cavity)
    away = distance_from(inside, step, RIM_MM + SHELL_MM)
    others = grown.others | grown.wall
    if coarsest_mm <= FAINT_SLICES_MM:
        others |= _faint(grown, away)
    free = (distance_from(others, step, RIM_MM) > RIM_MM) & ~others
    shell = (away > RIM_MM) & (away <= RIM_MM + SHELL_MM) & free & (grown.smooth < grown.bar_hu)
    lung_hu = float(grown.box.hu_zyx[shell].mean()) if shell.sum() > 50 else grown.lung_hu
    core = (tissue_depth > CORE_MM) & ~grown.cavity
    if core.sum() < 20:
        core = (tissue_depth >= 0.6 * float(tissue_depth[~grown.cavity].max())) & ~grown.cavity
    # A bubble or a grain of lime in it is not how dense it is.
    values = grown.box.hu_zyx[core]
    core_hu = float(values.mean() if grown.has_glass else np.median(values))
    solid_voxels = inside & (grown.smooth > SOLID_HU)
    kind: NoduleKind = "solid"
    # Blur makes a small solid nodule look like ground glass where it was clicked; in its middle it is denser.
    if grown.has_glass or core_hu <= SOLID_HU:
        is_part = solid_voxels.sum() * step**3 > SMALLEST_PART_MM3
        kind = "part-solid" if is_part else "ground-glass"
    counted = float(inside.sum()) * step**3
    # Beside a cut a voxel belongs to the nodule or not; elsewhere it does by its share.
    rim_hu = _rim_hu(grown, np.where(from_cavity > RIM_MM, depth, 0.0), lung_hu, core_hu)
    zone = (inside | (away <= RIM_MM)) & free
    share = (grown.box.hu_zyx - lung_hu) / ((core_hu if rim_hu is None else rim_hu) - lung_hu)
    if rim_hu is not None:
        share = np.minimum(share, MOST_SHARE)
    # A denser core, lime or a bubble say nothing of where the edge is.
    share = np.where(depth > CORE_MM, 1.0, share)
    if grown.cavity.any():
        # The nodule's volume is that of its outer surface.
        share = np.where((from_cavity <= RIM_MM) & (depth > 0.5 * RIM_MM), 1.0, share)
    edge = surface(inside)
    # How much too far inside the boundary of the smoothed CT lies: seen where the nodule is free.
    open_air = ~(grown.dense | grown.wall)
    faces = edge & beside(open_air)
    gained = float(share[zone].sum() - (inside & free).sum())
    more = float((faces & ~free).sum()) * gained / max(float((faces & free).sum()), 1.0)
    voxels_mm3 = float(share[zone].sum() + (inside & ~free).sum() + max(more, 0.0)) * step**3
    cut_share = float((edge & ~free).sum() / max(edge.sum(), 1))
    area_mm2 = float(edge.sum()) * step**2 * 1.2
    noise = _noise(grown.box, lung_hu)
    error = _error(
        step=step,
        mm3=voxels_mm3,
        area_mm2=area_mm2,
        cut_share=cut_share,
        noise=noise,
        rise=core_hu - lung_hu,
        kind=kind,
        coarsest_mm=coarsest_mm,
        is_alike=rim_hu is None,
    )
    if float(depth.max()) < SMALL_MM:
        # Blur reaches its middle: how dense it is, and so its share of each voxel, is not seen well.
        error = float(np.hypot(error, SMALL_OFF * max(coarsest_mm, 0.8) * area_mm2))
    if grown.cavity.any():
        # In a thin wall the density of what is blurred on both sides is not seen.
        error = float(np.hypot(error, THIN_OFF * coarsest_mm * area_mm2))
    if grown.cut.any():
        # How long a stump of a vessel is left on it, or how much of it went with the vessel.
        mouth_mm2 = float((grown.cut & (away <= step)).sum()) * step**2
        error = float(np.hypot(error, MOUTH_MM * mouth_mm2))
    long_mm, short_mm = diameters(inside, step)
    tissue = inside & ~grown.cavity
    cavity_mm3 = float(grown.cavity.sum()) * step**3
    # A needle finds tissue in the wall alone; where the nodule is, its outer surface says.
    _, _, centre = cut_out(inside, grown.box.lps_from_ijk)
    cropped, matrix, _ = cut_out(tissue, grown.box.lps_from_ijk)
    scale = (voxels_mm3 / max(counted, 1e-6)) ** (1.0 / 3.0)
    found = Nodule(
        centre_lps=centre,
        kind=kind,
        volume_mm3=voxels_mm3,
        volume_error_mm3=min(error, voxels_mm3),
        long_mm=long_mm * min(max(scale, 0.8), 1.2),
        short_mm=short_mm * min(max(scale, 0.8), 1.2),
        diameter_error_mm=0.5 * step + error / max(area_mm2, 1e-6),
        solid_mm3=max(voxels_mm3 - cavity_mm3, 0.0),
        density_hu=core_hu,
        touches=tuple(grown.touches),
        notes=(f"with a cavity of {cavity_mm3 / 1000.0:.2g} ml",) if cavity_mm3 > 0.0 else (),
        inside_zyx=cropped,
        lps_from_ijk=matrix,
    )
    if kind != "solid":
        found = replace(found, solid_mm3=float(solid_voxels.sum()) * step**3)
    return found


def _faint(grown: Boundary, away: NDArray[np.float32]) -> Mask:
    """Thin vessels that go on from the nodule: darker than its boundary, and no blur of it."""
    rise = max(FAINT_SHARE * 2.0 * (grown.bar_hu - grown.lung_hu), FAINT_HU)
    found: Mask = (away > RIM_MM) & (away <= RIM_MM + FAINT_MM) & (grown.smooth > grown.lung_hu + rise)
    return found & ~grown.dense


def _rim_hu(grown: Boundary, depth: NDArray[np.float32], lung_hu: float, core_hu: float) -> float | None:
    """How dense a nodule is near its edge that is denser in its middle; None for one that is alike throughout."""
    ring = (depth >= RING_MM[0]) & (depth <= RING_MM[1])
    if ring.sum() < 20:
        return None
    level = float(np.median(grown.smooth[ring]))
    if (level - lung_hu) / (core_hu - lung_hu) >= ALIKE:
        return None
    # Not smoothed any more, less of the core is seen there.
    return lung_hu + (float(np.median(grown.box.hu_zyx[ring])) - lung_hu) / RING_SHOWS


def _noise(box: Box, lung_hu: float) -> float:
    """Standard deviation of lung, HU."""
    dark = box.hu_zyx[np.abs(box.hu_zyx - lung_hu) < 200.0]
    return float(dark.std()) if dark.size > 100 else 50.0


def _error(
    *,
    step: float,
    mm3: float,
    area_mm2: float,
    cut_share: float,
    noise: float,
    rise: float,
    kind: str,
    coarsest_mm: float,
    is_alike: bool,
) -> float:
    edge_mm = (0.6 if not is_alike else 0.05 if kind == "solid" else 0.25) * max(coarsest_mm, 0.8)
    free = (1.0 - cut_share) * area_mm2 * edge_mm
    cut = cut_share * area_mm2 * 0.5 * coarsest_mm
    # Noise is alike over some 4 voxels.
    grain = 1.645 * noise / max(rise, 50.0) * step**1.5 * np.sqrt(8.0 * max(mm3, 1.0))
    return float(np.sqrt(free**2 + cut**2 + grain**2) + 0.02 * mm3)


def cut_out(
    inside: Mask, lps_from_ijk: NDArray[np.float64]
) -> tuple[Mask, NDArray[np.float64], tuple[float, float, float]]:
    """The voxels of a mask with two empty ones round them, the place of that box, and their centroid, LPS mm."""
    zyx = np.argwhere(inside)
    low = np.maximum(zyx.min(axis=0) - 2, 0)
    high = zyx.max(axis=0) + 3
    matrix = lps_from_ijk.copy()
    matrix[:3, 3] += matrix[:3, :3] @ low[::-1]
    x, y, z = lps_from_ijk[:3, :3] @ zyx.mean(axis=0)[::-1] + lps_from_ijk[:3, 3]
    cropped = inside[low[0] : high[0], low[1] : high[1], low[2] : high[2]].copy()
    return cropped, matrix, (float(x), float(y), float(z))


def diameters(inside: Mask, step_mm: float) -> tuple[float, float]:
    """The longest diameter in the largest axial slice, and the longest across it."""
    best = inside[int(np.argmax(inside.sum(axis=(1, 2))))]
    # The edge in the plane alone: of a mass all voxels would be millions of pairs.
    rows = np.argwhere(surface(np.stack([best] * 3))[1]).astype(float) * step_mm
    off = rows[:, None, :] - rows[None, :, :]
    square = (off**2).sum(axis=2)
    a, b = np.unravel_index(int(np.argmax(square)), square.shape)
    long_mm = float(np.sqrt(square[a, b]))
    along = off[a, b] / max(long_mm, 1e-9)
    across = rows @ np.array([-along[1], along[0]])
    # Centres of voxels lie half a voxel inside, and the farthest of many lie a little too far out.
    return long_mm + 0.5 * step_mm, float(across.max() - across.min()) + 0.5 * step_mm
