"""First wall at every pixel of the airway view: depth, position and normal."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carina.disk import drafted
from carina.display import one_line
from carina.errors import RenderError
from carina.scopes import Pose
from carina.volume import Note


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Hit:
    """First wall at one pixel.

    ``depth_mm`` is the distance along the ray from the camera's centre. ``position_lps`` (3,) is in LPS mm;
    ``normal_lps`` (3,) is a unit vector that points into the lumen, towards the camera.
    """

    depth_mm: float
    position_lps: NDArray[np.float64]
    normal_lps: NDArray[np.float64]


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """First wall of every pixel of an airway view: the point of a ray where the transparency falls below one half.

    ``depth_mm`` (h, w) float32 is measured along the ray from the camera's centre, not along the camera's axis.
    ``position_lps`` (h, w, 3) float64 is in LPS mm. ``normal_lps`` (h, w, 3) float32 is a unit vector towards the
    camera, from a gradient over 0.9 mm. All are NaN where a ray meets no wall. Row 0 is the first rendered row.
    """

    depth_mm: NDArray[np.float32]
    position_lps: NDArray[np.float64]
    normal_lps: NDArray[np.float32]
    pose: Pose
    fov_deg: float

    def save(self, path: str | os.PathLike[str], *, badges: Sequence[Note] = ()) -> Path:
        """Write a NumPy archive and return its path; an existing file is replaced completely or not at all.

        The archive contains ``depth_mm``, ``position_lps``, ``normal_lps``, ``lps_from_camera`` (4, 4) and ``fov_deg``;
        if the case has notes of doubt, also ``badges`` (n,), one text each.

        Raises
        ------
        RenderError
            If the name does not end in ``.npz``.
        DiskError
            If the folder does not exist or is not writable, or the disk is full.
        """
        badge_arrays: dict[str, Any] = (
            {"badges": np.array([f"{badge.code}: {badge.words}" for badge in badges])} if badges else {}
        )
        target = Path(path)
        if target.suffix.lower() != ".npz":
            raise RenderError(f"saving a surface: expected a file name that ends in .npz; found {target.name!r}")
        with drafted(target, what="the surface", needed_bytes=self.position_lps.nbytes) as file:
            np.savez_compressed(
                file,
                depth_mm=self.depth_mm,
                position_lps=self.position_lps,
                normal_lps=self.normal_lps,
                lps_from_camera=self.pose.lps_from_camera,
                fov_deg=np.float64(self.fov_deg),
                **badge_arrays,
            )
        return target
