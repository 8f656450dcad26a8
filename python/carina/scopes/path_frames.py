"""Frames along a path, from which curved pictures of an airway are made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import array_of, check_arguments, check_fields
from carina.display import one_line
from carina.errors import UsageError


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PathFrames:
    """Positions along a path, with the plane perpendicular to the path at each.

    Parameters
    ----------
    path_mm
        (n,) mm along the route, strictly increasing; at least two.
    lps_from_frame
        (n, 4, 4), rigid: +z is the tangent of the path, +x and +y span the plane perpendicular to the path, the origin
        lies on the path (LPS mm). Neighbouring frames should rotate about +z as little as possible.

    Raises
    ------
    UsageError
        If the shapes do not fit or a number is not finite.
    """

    path_mm: NDArray[np.float64]
    lps_from_frame: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Convert the fields to float64 arrays and check them."""
        check_fields(self, path_mm=array_of(None), lps_from_frame=array_of(None, 4, 4))
        object.__setattr__(self, "path_mm", np.asarray(self.path_mm, dtype=np.float64))
        object.__setattr__(self, "lps_from_frame", np.asarray(self.lps_from_frame, dtype=np.float64))
        num = len(self.path_mm)
        if num < 2 or self.path_mm.shape != (num,) or self.lps_from_frame.shape != (num, 4, 4):
            found = f"{self.path_mm.shape} and {self.lps_from_frame.shape}"
            raise UsageError(f"a path needs positions (n,) and frames (n, 4, 4), n at least 2; found {found}")
        if not (np.isfinite(self.lps_from_frame).all() and np.isfinite(self.path_mm).all()):
            raise UsageError("a path's frames must be finite numbers")
        if not (np.diff(self.path_mm) > 0).all():
            raise UsageError("positions along a path must increase")

    @property
    def length_mm(self) -> float:
        """Length in mm of the path from its first position to its last."""
        return float(self.path_mm[-1] - self.path_mm[0])

    @property
    def points_lps(self) -> NDArray[np.float64]:
        """Points of the path, (n, 3), LPS mm."""
        return self.lps_from_frame[:, :3, 3]

    @check_arguments(path_mm=array_of(None))
    def at(self, path_mm: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return points (m, 3) and axes (m, 3, 3: columns right, down, along) at positions.

        Straight beyond the ends.
        """
        inside = np.clip(path_mm, self.path_mm[0], self.path_mm[-1])
        place = np.interp(inside, self.path_mm, np.arange(len(self.path_mm), dtype=np.float64))
        first = np.minimum(place.astype(np.int64), len(self.path_mm) - 2)
        t = (place - first)[:, None, None]
        mixed = (1.0 - t) * self.lps_from_frame[first] + t * self.lps_from_frame[first + 1]
        # Neighbouring frames differ by little, so orthonormalized interpolation is a rotation between them.
        along = _unit(mixed[:, :3, 2])
        down = mixed[:, :3, 1]
        down = _unit(down - np.einsum("ij,ij->i", down, along)[:, None] * along)
        axes = np.stack([np.cross(down, along), down, along], axis=2)
        return mixed[:, :3, 3] + (path_mm - inside)[:, None] * along, axes


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1)[:, None])
