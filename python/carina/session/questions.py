"""What is asked about the airways while a person points at something: answered at once, and nothing changes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from carina.errors import NoResultError, UsageError
from carina.session.core import SessionCore
from carina.session.document import Point

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carina.track import AddBranch, Bridge, EditPreview, MoveFork

__all__ = ["AirwayQuestions", "lumen_before_wall"]

NO_AIRWAYS = "the airways are not found yet: wait for them, or set the root"


class AirwayQuestions(SessionCore):
    """The questions of :class:`carina.session.Session`."""

    def live_path(self, lps: Point) -> Any:
        """The way from the root to a point under the cursor (paper 6.3), from what the tracker has solved already.

        Returns
        -------
        carina.track.LivePath
            With the reason in words in ``problem`` where no way leads there.

        Raises
        ------
        NoResultError
            If the case has no airways.
        """
        return self._airways().tracker.live_path(lps)

    def preview_edit(self, edit: AddBranch | Bridge | MoveFork) -> EditPreview:
        """The very lines that an edit would make, at once and without making it.

        Returns
        -------
        carina.track.EditPreview
            With the reason in words in ``problem`` where it cannot be made.

        Raises
        ------
        NoResultError
            If the case has no airways.
        """
        with self._lock:
            volume, airways = self._needed_case().info.volume, self._airways()
        return self._parts.preview_edit(volume, airways, edit)

    def airways_to_take_away(self) -> tuple[Any, Any]:
        """The volume and its airways as they are now (both immutable), for a file.

        Returns
        -------
        tuple
            :class:`carina.volume.Volume` and :class:`carina.track.Airways`.

        Raises
        ------
        NoResultError
            If the case has no airways.
        """
        with self._lock:
            return self._needed_case().info.volume, self._airways()

    def lumen_before_wall(self, wall_lps: Point, lens_lps: Point) -> Point:
        """The point that a click on a wall means: the lumen in front of it (paper 6.3, Figure 14).

        Raises
        ------
        NoResultError
            If the case has no airways.
        """
        airways = self._airways()
        step_mm = 0.5 * float(min(self._needed_case().info.volume.spacing_mm))
        x, y, z = lumen_before_wall(airways.tracker, np.array(wall_lps), np.array(lens_lps), step_mm)
        return float(x), float(y), float(z)

    def branch_measures(self, branch_id: int) -> Any:
        """What was measured along a branch (:class:`carina.track.BranchMeasures`); None until it is ready.

        Raises
        ------
        NoResultError
            If the case has no airways.
        UsageError
            If the tree has no such branch.
        """
        airways = self._airways()
        if all(branch.id != branch_id for branch in airways.tree.branches):
            raise UsageError(f"the tree has no branch {branch_id}", code="session.branch")
        measures = getattr(self.snapshot(), "measures", None)
        return None if measures is None else measures.of(branch_id)

    def _airways(self) -> Any:
        with self._lock:
            airways = self._needed_case().document.airways
        if airways is None:
            raise NoResultError(NO_AIRWAYS, code="track.no-airways")
        return airways


def lumen_before_wall(
    tracker: Any, wall_lps: NDArray[np.float64], lens_lps: NDArray[np.float64], step_mm: float
) -> NDArray[np.float64]:
    """The middle of the lumen that a ray crossed last before it met a wall.

    Parameters
    ----------
    tracker
        Tells with ``inside((n, 3) points)`` which points lie in a lumen voxel.
    wall_lps, lens_lps
        Where the ray met the wall, and where it came from, LPS mm.
    step_mm
        How finely the ray is gone back.

    Returns
    -------
    numpy.ndarray
        (3,) LPS mm. The wall itself where the ray passes through no lumen: then the path is snapped as from a slice.
    """
    back = lens_lps - wall_lps
    depth_mm = float(np.linalg.norm(back))
    if depth_mm < step_mm:
        return lens_lps
    away_mm = np.arange(step_mm, depth_mm + step_mm, step_mm)
    ray = wall_lps + np.minimum(away_mm, depth_mm)[:, None] * (back / depth_mm)
    inside = np.asarray(tracker.inside(ray), dtype=bool)
    if not inside.any():
        return wall_lps
    # The voxels next to the wall are lumen by a hair: one voxel further in, the path does not cling to the wall.
    first = int(np.argmax(inside))
    deeper = min(first + 2, len(ray) - 1)
    point: NDArray[np.float64] = ray[deeper if inside[deeper] else first]
    return point
