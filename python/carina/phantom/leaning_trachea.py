"""Phantom with a leaning trachea: the slices above the carina are shifted in their planes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["MAX_LEAN_DEG", "lean_chest", "moved_mm"]

MAX_LEAN_DEG = 35.0
# Height above and below the carina over which the trachea bends.
BEND_MM = 10.0
# Value of voxels that are shifted in from outside the volume: air, far from any airway.
AIR_HU = -1000.0
FAR_MM = 5.0


def moved_mm(lean_deg: Sequence[float], z_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the displacement (n, 2) along x and y at heights above the carina; it is 0 well below the carina."""
    bend = np.clip(z_mm + BEND_MM, 0.0, 2.0 * BEND_MM) ** 2 / (4.0 * BEND_MM)
    height = np.where(z_mm > BEND_MM, z_mm, bend)
    return height[:, None] * np.tan(np.radians(np.asarray(lean_deg, dtype=np.float64)))


def lean_chest(made: dict[str, Any], lean_deg: Sequence[float], beside: tuple[int, ...]) -> None:
    """Lean a chest in place: the voxels and the ground truth that ``carina._core.generate_chest`` returned.

    ``made`` must include the distance to the lumen, which this function removes.

    Parameters
    ----------
    made
        Dictionary that ``carina._core.generate_chest`` returned; it is modified.
    lean_deg
        Angles to the patient's left and to the back, degrees.
    beside
        Number of voxels along x and y that are cut off on each side after the shift.
    """
    matrix = np.array(made["lps_from_ijk"], dtype=np.float64)
    heights = matrix[2, 3] + matrix[2, 2] * np.arange(made["hu_zyx"].shape[0])
    steps = moved_mm(lean_deg, heights) / np.array([matrix[0, 0], matrix[1, 1]])
    inner = tuple(slice(n, -n if n else None) for n in reversed(beside))
    # The distance to the lumen's surface can be interpolated between voxels; a mask cannot.
    distance = made.pop("lumen_distance_mm")
    sources = {"hu_zyx": (made["hu_zyx"], AIR_HU), "lumen_zyx": (distance, FAR_MM)}
    if "upper_airway_zyx" in made:
        sources["upper_airway_zyx"] = (made["upper_airway_zyx"], 0.0)
    of_value: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = {
        "hu_zyx": np.rint,
        "lumen_zyx": lambda distance: distance < 0.0,
        "upper_airway_zyx": lambda share: share >= 0.5,
    }
    for key, (values, outside) in sources.items():
        out = np.empty((values.shape[0], *values[0][inner].shape), dtype=made[key].dtype)
        for k, (x, y) in enumerate(steps):
            moved = values[k]
            if x or y:
                moved = _moved(_moved(moved.astype(np.float32), x, 1, outside), y, 0, outside)
            out[k] = of_value[key](moved[inner])
        made[key] = out
    matrix[:2, 3] += np.array(beside) * np.array([matrix[0, 0], matrix[1, 1]])
    made["lps_from_ijk"] = matrix.tolist()
    made["lean_deg"] = [float(angle) for angle in lean_deg]
    _lean_truth(made, lean_deg)


def _moved(slice_yx: NDArray[np.float32], steps: float, axis: int, outside: float) -> NDArray[np.float32]:
    """Return a slice shifted by a number of voxels, with cubic (Catmull-Rom) interpolation, which blurs little."""
    whole = int(np.floor(steps))
    t = steps - whole
    weights = (
        (2, -0.5 * t**2 + 0.5 * t**3),
        (1, 0.5 * t + 2.0 * t**2 - 1.5 * t**3),
        (0, 1.0 - 2.5 * t**2 + 1.5 * t**3),
        (-1, -0.5 * t + t**2 - 0.5 * t**3),
    )
    size = slice_yx.shape[axis]
    out = np.zeros_like(slice_yx)
    for further, weight in weights:
        source = np.arange(size) - whole - further
        taken = np.take(slice_yx, np.clip(source, 0, size - 1), axis=axis)
        missing = (source < 0) | (source >= size)
        if axis == 0:
            taken[missing, :] = outside
        else:
            taken[:, missing] = outside
        out += np.float32(weight) * taken
    return out


def _lean_truth(made: dict[str, Any], lean_deg: Sequence[float]) -> None:
    """Lean the centrelines and the points of the truth in place."""

    def leaned(points: Any) -> NDArray[np.float64]:
        out = np.array(points, dtype=np.float64).reshape(-1, 3)
        out[:, :2] += moved_mm(lean_deg, out[:, 2])
        return out

    for branch in made["branches"]:
        before = np.array(branch["points"], dtype=np.float64)
        after = leaned(before)
        # A shear keeps volumes: a tube that becomes longer becomes narrower.
        longer = np.linalg.norm(np.gradient(after, axis=0), axis=1) / np.linalg.norm(
            np.gradient(before, axis=0), axis=1
        )
        branch["points"] = after.tolist()
        branch["radius"] = (np.array(branch["radius"]) / np.sqrt(longer)).tolist()
    if made.get("cricoid_lps") is not None:
        made["cricoid_lps"] = leaned(made["cricoid_lps"])[0].tolist()
    if made.get("stenosis") is not None:
        made["stenosis"]["center_lps"] = leaned(made["stenosis"]["center_lps"])[0].tolist()
    if made.get("tube") is not None:
        tip = leaned(made["tube"]["tip_lps"])[0]
        trachea = np.array(made["branches"][0]["points"])
        below = trachea[int(np.argmin(np.linalg.norm(trachea - tip, axis=1))) :]
        made["tube"]["tip_lps"] = tip.tolist()
        made["tube"]["above_carina_mm"] = float(np.linalg.norm(np.diff(below, axis=0), axis=1).sum())
