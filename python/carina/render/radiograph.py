"""Digitally reconstructed radiographs: geometry of the C-arm, attenuation from HU, and tone of the picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.errors import RenderError
from carina.render import geometry
from carina.render.views import DrrView, Picture, RenderStats
from carina.volume import Volume

# Attenuation of water for fluoroscopy of a chest, about 50 keV effective. Up to soft tissue HU are proportional to
# attenuation; above it a CT of some 70 keV understates bone. Attenuation of cortical bone (1.92 g/cm3, about 1330 HU)
# and water at 50 keV: Hubbell and Seltzer, NISTIR 5632 (1995), tables 3 and 4: 0.4242 * 1.92 = 0.8145 against 0.2269
# per cm, 3.59 times.
WATER_PER_MM = 0.02269
BONE_FROM_HU = 100.0
BONE_GAIN = (3.59 - 1.1) / (1330.0 - BONE_FROM_HU) * 1000.0 - 1.0
# Percentiles of the rays that meet tissue: the window reaches from the lungs to the densest part that is not metal.
DARKEST, BRIGHTEST = 2.0, 99.5
# A ray through less than this much water has met only air, clothes or the edge of the table.
TISSUE_MM = 8.0


def cast_drr(volume: Volume, view: DrrView, *, rows: tuple[int, int] | None = None, simd: str | None = None) -> Picture:
    """Return the radiograph of a volume, or a strip of its rows.

    Raises
    ------
    RenderError
        If ``rows`` is given for a picture whose window is fitted to the whole picture.
    """
    if rows is not None and view.window_mm is None:
        msg = "fitting the window of a radiograph needs the whole image, not only some of its rows; pass window_mm"
        raise RenderError(msg, code="render.setting")
    centre = volume.centre_lps
    detector = geometry.orbit_pose(centre, view.primary_deg, view.secondary_deg, view.sid_mm - view.sod_mm)
    right, down, to_source = detector.lps_from_camera[:3, :3].T
    magnification = 1.0 if view.parallel else view.sid_mm / view.sod_mm
    mm_per_px = (view.mm_per_px or _fitting_mm_per_px(volume, view)) * magnification
    matrix = geometry.plane_matrix(detector.position_lps, (right, down, to_source), mm_per_px, view.width, view.height)
    source = centre + view.sod_mm * to_source
    low, high = (float(v) for v in np.percentile(volume.hu_zyx[::4, ::4, ::4], (0.5, 99.5)))
    water_mm = _core.radiograph(
        volume.hu_zyx,
        volume.lps_from_ijk,
        matrix,
        width=view.width,
        height=view.height,
        rows=rows,
        source_lps=None if view.parallel else (float(source[0]), float(source[1]), float(source[2])),
        # Uncalibrated values only order thin and dense material.
        air=-1000.0 if volume.is_hu else low,
        bone=BONE_FROM_HU if volume.is_hu else high,
        bone_gain=BONE_GAIN if volume.is_hu else 0.0,
        simd=simd,
    )
    rgb = np.repeat(_with_tone(water_mm, view)[:, :, None], 3, axis=2)
    count = view.width * rgb.shape[0]
    stats = RenderStats("radiograph", view.width, rgb.shape[0], count, 0, 0, 0, 0, 0, 0, 0.0)
    if view.parallel:
        return Picture(rgb=rgb, view="drr", stats=stats, lps_from_pixel=matrix)
    camera = np.eye(4)
    camera[:3, 0], camera[:3, 1], camera[:3, 2], camera[:3, 3] = right, down, -to_source, source
    half_mm = min(view.width, view.height) / 2 * mm_per_px
    fov_deg = 2 * float(np.rad2deg(np.arctan(half_mm / view.sid_mm)))
    return Picture(rgb=rgb, view="drr", stats=stats, lps_from_camera=camera, fov_deg=fov_deg)


def _fitting_mm_per_px(volume: Volume, view: DrrView) -> float:
    """Return the pixel size in mm at which the box of a volume fits the radiograph at primary angles 0 and 90.

    The size does not depend on the angle, so the picture keeps its scale while the C-arm turns.
    """
    extent = np.ptp(geometry.box_corners_lps(volume), axis=0)
    # Parts nearer to the source appear larger on the detector; the front of the box is nearer by half its size.
    across, half = float(max(extent[0], extent[1])), float(max(extent[0], extent[1])) / 2
    nearer = 1.0 if view.parallel else view.sod_mm / max(view.sod_mm - half, view.sod_mm / 2)
    return max(across / view.width, float(extent[2]) / view.height) * nearer


def _with_tone(water_mm: NDArray[np.float32], view: DrrView) -> NDArray[np.uint8]:
    if view.window_mm is not None:
        width, level = view.window_mm
        low, high = level - width / 2, level + width / 2
    else:
        tissue = water_mm[water_mm > TISSUE_MM]
        low, high = (0.0, 1.0) if tissue.size == 0 else np.percentile(tissue, (DARKEST, BRIGHTEST))
        high = max(high, low + 1.0)
    if view.tone == "radiograph":
        shade = (water_mm - low) / (high - low)
    else:
        thin, dense = np.exp(-WATER_PER_MM * low), np.exp(-WATER_PER_MM * high)
        # Gamma 2.2 for the screen, as in displays of linear detectors.
        shade = np.clip((np.exp(-WATER_PER_MM * water_mm) - dense) / (thin - dense), 0.0, 1.0) ** (1 / 2.2)
    return np.asarray(np.clip(shade, 0.0, 1.0) * 255.0 + 0.5, dtype=np.uint8)
