"""Measures of a nodule with a known boundary: volume, diameters, density and their errors.

The volume is the sum of the nodule's share of each voxel (partial volume), which blur does not change
(docs/decisions/0121).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from carina.plan.cubic_box import Box, beside, surface
from carina.plan.targets.boundary import RIM_MM, SOLID_HU, WIDE_OFF_MM, Boundary
from carina.plan.targets.nodule import Nodule, NoduleKind
from carina.volume.mask_distances import ball_distance, distance_from

Mask = NDArray[np.bool_]

SHELL_MM = 4.0
"""Thickness in mm of the shell of lung beyond the rim, from which the density of the lung is measured."""
MOUTH_MM = 2.5
"""Uncertainty in mm of the position at which a vessel is cut off from a nodule."""
CORE_MM = 1.5
"""Depth in mm below a nodule's boundary beyond which the edge's blur has no effect on the density."""
RING_MM, RING_SHOWS, ALIKE = (0.8, 1.6), 0.97, 0.8
"""Depth range in mm below the boundary, and two shares of the nodule's rise over lung at this depth.

A uniform nodule has 0.84 to 0.93 of its rise at this depth because of blur; a nodule with a denser core has less.
"""
MAX_SHARE = 1.5
SMALL_MM, SMALL_OFF = 2.4, 0.2
"""Maximum radius in mm of a small nodule (its largest ball), and the error of its boundary in slice distances."""
FAINT_SHARE, FAINT_HU, FAINT_MM, FAINT_SLICES_MM = 0.22, 80.0, 1.5, 1.5
"""Limits for thin vessels that leave a nodule: share of the nodule's rise, rise in HU, length in mm, spacing in mm.

In slices thinner than the last number, the blur of the nodule itself stays below the first limit.
"""
THIN_OFF = 0.25
"""Error in slice distances of the boundary of a cavity's thin wall."""
DOUBT_SHARE = 0.25
"""Minimum relative error of the volume at which a note names the places where the boundary is uncertain."""
PLACES = {
    "pleura": "the chest wall, the mediastinum or the diaphragm",
    "vessel": "a vessel",
    "edge of the CT": "the edge of the CT",
}
SMALLEST_PART_MM3 = 15.0
"""Minimum volume in mm3 of a denser part (3 mm across); a smaller one may be the end of a vessel."""


def measured(grown: Boundary, coarsest_mm: float) -> Nodule:
    """Measure the nodule inside a boundary.

    Parameters
    ----------
    grown
        Masks of the nodule and of the structures that were cut from it.
    coarsest_mm
        Largest spacing of the CT.

    Returns
    -------
    Nodule
        Volume, diameters, density and errors of the nodule, with its mask.
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
    # The median ignores air bubbles and calcifications in a core without ground glass.
    values = grown.box.hu_zyx[core]
    core_hu = float(values.mean() if grown.has_glass else np.median(values))
    solid_voxels = inside & (grown.smooth > SOLID_HU)
    kind: NoduleKind = "solid"
    # Blur makes the seed of a small solid nodule as faint as ground glass, so the density of the core decides.
    if grown.has_glass or core_hu <= SOLID_HU:
        is_part = solid_voxels.sum() * step**3 > SMALLEST_PART_MM3
        kind = "part-solid" if is_part else "ground-glass"
    counted = float(inside.sum()) * step**3
    # Near a cut the nodule has no blurred edge, so a voxel counts fully or not at all; elsewhere by its share of
    # nodule.
    rim_hu = _rim_hu(grown, np.where(from_cavity > RIM_MM, depth, 0.0), lung_hu, core_hu)
    zone = (inside | (away <= RIM_MM)) & free
    share = (grown.box.hu_zyx - lung_hu) / ((core_hu if rim_hu is None else rim_hu) - lung_hu)
    if rim_hu is not None:
        share = np.minimum(share, MAX_SHARE)
    # Deep voxels count fully: the density of core, calcification or bubbles does not show where the edge is.
    share = np.where(depth > CORE_MM, 1.0, share)
    if grown.cavity.any():
        # The nodule's volume is the volume inside its outer surface.
        share = np.where((from_cavity <= RIM_MM) & (depth > 0.5 * RIM_MM), 1.0, share)
    edge = surface(inside)
    # Smoothing moves the boundary inwards; this distance is measured on the surface that faces lung.
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
        # Blur reaches the middle of a small nodule, so its density and the shares of its voxels are uncertain.
        error = float(np.hypot(error, SMALL_OFF * max(coarsest_mm, 0.8) * area_mm2))
    if grown.cavity.any():
        # Blur from both sides hides the density of a thin wall.
        error = float(np.hypot(error, THIN_OFF * coarsest_mm * area_mm2))
    if grown.cut.any():
        # The stump of a vessel may be left on the nodule, or a part of the nodule may be removed with the vessel.
        mouth_mm2 = float((grown.cut & (away <= step)).sum()) * step**2
        error = float(np.hypot(error, MOUTH_MM * mouth_mm2))
    if grown.wall_off_mm > 0.0:
        contact_mm2 = float((edge & beside(grown.wall)).sum()) * step**2
        error = float(np.hypot(error, grown.wall_off_mm * contact_mm2))
    long_mm, short_mm = diameters(inside, step)
    tissue = inside & ~grown.cavity
    cavity_mm3 = float(grown.cavity.sum()) * step**3
    # The mask for the needle is tissue without the cavity; the centre is that of the outer surface.
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
        notes=(
            *((f"with a cavity of {cavity_mm3 / 1000.0:.2g} ml",) if cavity_mm3 > 0.0 else ()),
            *_doubts(grown, error / max(voxels_mm3, 1e-6)),
        ),
        inside_zyx=cropped,
        lps_from_ijk=matrix,
    )
    if kind != "solid":
        found = replace(found, solid_mm3=float(solid_voxels.sum()) * step**3)
    return found


def _doubts(grown: Boundary, error_share: float) -> tuple[str, ...]:
    """Return a note that names the structures at which the boundary is uncertain; empty if there are none."""
    places = [text for touched, text in PLACES.items() if touched in grown.touches]
    if not places or (error_share < DOUBT_SHARE and grown.wall_off_mm < WIDE_OFF_MM):
        return ()
    listed = " and ".join(places)
    percent = 100.0 * min(error_share, 1.0)
    return (
        f"the boundary is uncertain where the nodule touches {listed} (volume \u00b1 {percent:.0f} %); check it there, "
        "and correct it with the brush",
    )


def _faint(grown: Boundary, away: NDArray[np.float32]) -> Mask:
    """Return the mask of thin vessels that leave the nodule, fainter than its boundary but brighter than its blur."""
    rise = max(FAINT_SHARE * 2.0 * (grown.bar_hu - grown.lung_hu), FAINT_HU)
    found: Mask = (away > RIM_MM) & (away <= RIM_MM + FAINT_MM) & (grown.smooth > grown.lung_hu + rise)
    return found & ~grown.dense


def _rim_hu(grown: Boundary, depth: NDArray[np.float32], lung_hu: float, core_hu: float) -> float | None:
    """Return the density in HU near the edge of a nodule with a denser middle; None for a uniform nodule.

    ``depth`` is the depth of each voxel below the boundary in mm.
    """
    ring = (depth >= RING_MM[0]) & (depth <= RING_MM[1])
    if ring.sum() < 20:
        return None
    level = float(np.median(grown.smooth[ring]))
    if (level - lung_hu) / (core_hu - lung_hu) >= ALIKE:
        return None
    # The unsmoothed voxels are used, because smoothing would add density of the core.
    return lung_hu + (float(np.median(grown.box.hu_zyx[ring])) - lung_hu) / RING_SHOWS


def _noise(box: Box, lung_hu: float) -> float:
    """Return the standard deviation of the density of lung in a box, HU."""
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
    # Noise is correlated over about 4 voxels, hence the factor 8 in the error of the volume.
    grain = 1.645 * noise / max(rise, 50.0) * step**1.5 * np.sqrt(8.0 * max(mm3, 1.0))
    return float(np.sqrt(free**2 + cut**2 + grain**2) + 0.02 * mm3)


def cut_out(
    inside: Mask, lps_from_ijk: NDArray[np.float64]
) -> tuple[Mask, NDArray[np.float64], tuple[float, float, float]]:
    """Return a mask cropped to two empty voxels round it, the transform of the crop, and the centroid in LPS mm.

    Parameters
    ----------
    inside, lps_from_ijk
        (nz, ny, nx) mask, not empty, and (4, 4) transform of its grid.
    """
    zyx = np.argwhere(inside)
    low = np.maximum(zyx.min(axis=0) - 2, 0)
    high = zyx.max(axis=0) + 3
    matrix = lps_from_ijk.copy()
    matrix[:3, 3] += matrix[:3, :3] @ low[::-1]
    x, y, z = lps_from_ijk[:3, :3] @ zyx.mean(axis=0)[::-1] + lps_from_ijk[:3, 3]
    cropped = inside[low[0] : high[0], low[1] : high[1], low[2] : high[2]].copy()
    return cropped, matrix, (float(x), float(y), float(z))


def diameters(inside: Mask, step_mm: float) -> tuple[float, float]:
    """Return the longest diameter in the largest axial slice and the longest diameter perpendicular to it, in mm.

    Parameters
    ----------
    inside
        (nz, ny, nx) mask of cubic voxels along LPS.
    step_mm
        Voxel size.
    """
    best = inside[int(np.argmax(inside.sum(axis=(1, 2))))]
    # Only edge voxels of the slice: all voxels of a mass would give millions of pairs.
    rows = np.argwhere(surface(np.stack([best] * 3))[1]).astype(float) * step_mm
    off = rows[:, None, :] - rows[None, :, :]
    square = (off**2).sum(axis=2)
    a, b = np.unravel_index(int(np.argmax(square)), square.shape)
    long_mm = float(np.sqrt(square[a, b]))
    along = off[a, b] / max(long_mm, 1e-9)
    across = rows @ np.array([-along[1], along[0]])
    # Voxel centres lie half a voxel inside the surface at each end; the maximum over many pairs is a little too large.
    return long_mm + 0.5 * step_mm, float(across.max() - across.min()) + 0.5 * step_mm
