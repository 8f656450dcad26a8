"""Reference renderer in numba: every sample of every ray in plain loops; its picture must equal Carina's.

The renderer follows the formulas (docs/algorithms.md) and uses none of Carina's code: it contains its own index
arithmetic, interpolation, gradient, table, light and rays. All arithmetic is in f64; the volume and the table are
stored in smaller types.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.render import TransferFunction
from carina.scopes import Pose
from carina.volume import Volume
from carina_bench.compared_scene import FOV_DEG, STOP_TRANSPARENCY, opacity_table

__all__ = ["numba_caster"]

_numba: Any = importlib.import_module("numba")


@_numba.njit(cache=False)
def _sample(values, x, y, z):
    """Return the value at a voxel position by trilinear interpolation, with indices clamped to the volume."""
    nz, ny, nx = values.shape
    x0, y0, z0 = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    tx, ty, tz = x - x0, y - y0, z - z0
    xa, xb = min(max(x0, 0), nx - 1), min(max(x0 + 1, 0), nx - 1)
    ya, yb = min(max(y0, 0), ny - 1), min(max(y0 + 1, 0), ny - 1)
    za, zb = min(max(z0, 0), nz - 1), min(max(z0 + 1, 0), nz - 1)
    near = (1 - ty) * ((1 - tx) * values[za, ya, xa] + tx * values[za, ya, xb]) + ty * (
        (1 - tx) * values[za, yb, xa] + tx * values[za, yb, xb]
    )
    far = (1 - ty) * ((1 - tx) * values[zb, ya, xa] + tx * values[zb, ya, xb]) + ty * (
        (1 - tx) * values[zb, yb, xa] + tx * values[zb, yb, xb]
    )
    return (1 - tz) * near + tz * far


@_numba.njit(cache=False)
def _cast(values, turn, origin, focal_px, size, step_mm, table, lo, light, metric, stop):
    """Cast one picture into an array (size, size, 3).

    ``turn`` is the matrix ijk_from_camera without its offset. ``metric`` is ijk_from_lps, so that gradients are per mm
    in LPS.
    """
    rgb = np.zeros((size, size, 3), np.uint8)
    nz, ny, nx = values.shape
    last = table.shape[0] - 1
    ambient, diffuse, specular, squarings = light[0], light[1], light[2], int(light[3])
    for row in range(size):
        for column in range(size):
            cx, cy = column + 0.5 - size / 2, row + 0.5 - size / 2
            scale = step_mm / np.sqrt(cx * cx + cy * cy + focal_px * focal_px)
            cx, cy, cz = cx * scale, cy * scale, focal_px * scale
            dx = turn[0, 0] * cx + turn[0, 1] * cy + turn[0, 2] * cz
            dy = turn[1, 0] * cx + turn[1, 1] * cy + turn[1, 2] * cz
            dz = turn[2, 0] * cx + turn[2, 1] * cy + turn[2, 2] * cz
            red, green, blue, through = 0.0, 0.0, 0.0, 1.0
            k = 0
            entered = False
            while True:
                t = k + 0.5
                k += 1
                x, y, z = origin[0] + t * dx, origin[1] + t * dy, origin[2] + t * dz
                inside = -0.5 <= x <= nx - 0.5 and -0.5 <= y <= ny - 0.5 and -0.5 <= z <= nz - 0.5
                if not inside:
                    # Outside, a ray that was in the volume ends; another goes on for at most 100,000 samples.
                    if entered or k > 100000:
                        break
                    continue
                entered = True
                # Positions are clamped to the volume: in the outer half of an edge voxel the value is that of the
                # voxel's centre.
                x, y, z = min(max(x, 0.0), nx - 1.0), min(max(y, 0.0), ny - 1.0), min(max(z, 0.0), nz - 1.0)
                n = int(np.floor(_sample(values, x, y, z) + 0.5)) - lo
                n = min(max(n, 0), last)
                alpha = table[n, 3]
                if alpha <= 0.0:
                    continue
                gx = 0.5 * (_sample(values, x + 1, y, z) - _sample(values, x - 1, y, z))
                gy = 0.5 * (_sample(values, x, y + 1, z) - _sample(values, x, y - 1, z))
                gz = 0.5 * (_sample(values, x, y, z + 1) - _sample(values, x, y, z - 1))
                square = 0.0
                for a in range(3):
                    g = gx * metric[0, a] + gy * metric[1, a] + gz * metric[2, a]
                    square += g * g
                along = abs(gx * dx + gy * dy + gz * dz)
                facing = min(along / (np.sqrt(square) * step_mm + 1e-6), 1.0)
                own = ambient + diffuse * facing
                shine = facing
                for _ in range(squarings):
                    shine *= shine
                white = specular * shine * alpha
                red += through * (own * table[n, 0] + white)
                green += through * (own * table[n, 1] + white)
                blue += through * (own * table[n, 2] + white)
                through *= 1.0 - alpha
                if through < stop:
                    break
            rgb[row, column, 0] = int(min(red * 255 + 0.5, 255.0))
            rgb[row, column, 1] = int(min(green * 255 + 0.5, 255.0))
            rgb[row, column, 2] = int(min(blue * 255 + 0.5, 255.0))
    return rgb


def numba_caster(volume: Volume, transfer: TransferFunction, *, step_vox: float, size: int) -> Any:
    """Return a function ``cast(pose) -> (size, size, 3) uint8`` that renders a square picture with shading."""
    step_mm = step_vox * float(min(volume.spacing_mm))
    lo, hi = int(volume.hu_zyx.min()), int(volume.hu_zyx.max())
    table = opacity_table(transfer, step_mm, lo, hi).astype(np.float64)
    ijk_from_lps = np.linalg.inv(volume.lps_from_ijk)
    focal_px = size / 2 / np.tan(np.deg2rad(FOV_DEG) / 2)
    shares = transfer.light
    light = np.array([shares.ambient, shares.diffuse, shares.specular, shares.shininess_log2], dtype=np.float64)

    def cast(pose: Pose) -> NDArray[np.uint8]:
        ijk_from_camera = ijk_from_lps @ pose.lps_from_camera
        turn, origin = np.ascontiguousarray(ijk_from_camera[:3, :3]), np.ascontiguousarray(ijk_from_camera[:3, 3])
        picture: NDArray[np.uint8] = _cast(
            volume.hu_zyx,
            turn,
            origin,
            focal_px,
            size,
            step_mm,
            table,
            lo,
            light,
            np.ascontiguousarray(ijk_from_lps[:3, :3]),
            STOP_TRANSPARENCY,
        )
        return picture

    return cast
