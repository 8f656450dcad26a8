"""Questions about the case while the user points at an image; they are answered at once and change nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from carina import commands as c
from carina.errors import NoResultError, UsageError
from carina.session.command_registry import CommandHandlers, answers
from carina.session.state.snapshot import PointedPath, WallPoint

if TYPE_CHECKING:
    from numpy.typing import NDArray


NO_AIRWAYS = "the airways have not been segmented yet: wait, or mark the trachea"


class CaseQuestions(CommandHandlers):
    """Questions about the scan and its airways."""

    @answers(c.VoxelAt)
    def voxel_at(self, question: c.VoxelAt) -> int | None:
        """Return the value of the voxel that contains a point; None outside the volume."""
        volume = self.core.needed_case().info.volume
        point = np.asarray(question.lps, dtype=np.float64)
        if not volume.contains_lps(point):
            return None
        nz, ny, nx = volume.shape_zyx
        # Clipped, because a point on the outermost face of the volume rounds to an index beyond the last voxel.
        i, j, k = np.clip(np.rint(volume.to_ijk(point)).astype(int), 0, (nx - 1, ny - 1, nz - 1))
        return int(volume.hu_zyx[k, j, i])

    @answers(c.WallAt)
    def wall_at(self, question: c.WallAt) -> WallPoint:
        """Return the voxel value and the nearest branch of a point on the wall."""
        lps = question.lps
        value = self.voxel_at(c.VoxelAt(lps))
        with self.core.lock:
            index = self.core.needed_case().index
        branch = None if index is None else index.nearest(np.asarray(lps, dtype=np.float64))[0]
        return WallPoint(lps, value, branch)

    @answers(c.LivePathTo)
    def live_path(self, question: c.LivePathTo) -> PointedPath:
        """Return the path from the root to a point, from the shortest paths that the tracker has already computed."""
        with self.core.lock:
            planning, airways = self.core.needed_case().planning, self._airways()
        path = airways.tracker.live_path(question.lps)
        if path.problem is not None or path.joins_branch_id is None:
            return PointedPath(path, None)
        points = np.asarray(path.points_lps, dtype=np.float64)
        if bool(airways.tracker.inside(points[-1:])[0]):
            # In the lumen the distance is that to the place beside the point on the centreline, as for a target. Both
            # use the branch to whose lumen the point belongs, because the nearest centreline at a fork may be another.
            branch_id = airways.tracker.branch_at(points[-1])
            if branch_id is None:
                return PointedPath(path, None)
            with self.core.lock:
                return PointedPath(path, planning.place_from_carina_mm(airways, branch_id, points[-1], 0.0))
        to_end = np.concatenate([np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)[::-1])[::-1], [0.0]])
        leaves = points[int(np.argmin(np.abs(to_end - path.new_mm)))]
        with self.core.lock:
            past_mm = planning.place_from_carina_mm(airways, path.joins_branch_id, leaves, path.new_mm)
        return PointedPath(path, past_mm)

    @answers(c.PreviewOf)
    def preview_of(self, question: c.PreviewOf) -> Any:
        """Return the preview of an edit, computed by the same code as the edit."""
        with self.core.lock:
            volume, airways = self.core.needed_case().info.volume, self._airways()
        return self.core.parts.preview_edit(volume, airways, question.edit, with_names=question.with_names)

    @answers(c.AirwaysQuery)
    def airways_to_take_away(self, _question: c.AirwaysQuery) -> tuple[Any, Any]:
        """Return the volume and the airways, both immutable, for an export."""
        with self.core.lock:
            return self.core.needed_case().info.volume, self._airways()

    @answers(c.PictureFacts)
    def picture_facts(self, question: c.PictureFacts) -> Any:
        """Return the state of the case for a saved picture."""
        return self.core.picture_state(question.window)

    @answers(c.LumenBeforeWall)
    def lumen_before_wall(self, question: c.LumenBeforeWall) -> tuple[float, float, float]:
        """Return the lumen point before a wall point on a ray, found in steps of half a voxel.

        Without airways, return the point on the ray one voxel before the wall.
        """
        case = self.core.needed_case()
        airways = case.document.airways
        step_mm = 0.5 * float(min(case.info.volume.spacing_mm))
        wall, lens = np.array(question.wall_lps), np.array(question.lens_lps)
        if airways is None:
            away_mm = float(np.linalg.norm(lens - wall))
            x, y, z = wall + (lens - wall) * (min(2.0 * step_mm / away_mm, 1.0) if away_mm > 0.0 else 0.0)
        else:
            x, y, z = lumen_before_wall(airways.tracker, wall, lens, step_mm)
        return float(x), float(y), float(z)

    @answers(c.MeasuresOf)
    def measures_of(self, question: c.MeasuresOf) -> Any:
        """Return the newest measurements of a branch; None if the current tree has not been measured."""
        airways = self._airways()
        if all(branch.id != question.branch_id for branch in airways.tree.branches):
            raise UsageError(f"the tree has no branch {question.branch_id}", code="session.branch")
        measures = self.core.snapshot().measures
        return None if measures is None else measures.of(question.branch_id)

    def _airways(self) -> Any:
        with self.core.lock:
            airways = self.core.needed_case().document.airways
        if airways is None:
            raise NoResultError(NO_AIRWAYS, code="track.no-airways")
        return airways


def lumen_before_wall(
    tracker: Any, wall_lps: NDArray[np.float64], lens_lps: NDArray[np.float64], step_mm: float
) -> NDArray[np.float64]:
    """Return the last lumen point on a ray before the wall.

    Parameters
    ----------
    tracker
        Object whose ``inside((n, 3) points)`` returns which points are in a lumen voxel.
    wall_lps, lens_lps
        The wall point and the start of the ray, in LPS mm.
    step_mm
        Step of the search along the ray.

    Returns
    -------
    numpy.ndarray
        (3,) LPS mm. The wall point itself if the ray crosses no lumen; the path search then moves it into the lumen.
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
    # Voxels at the wall are barely lumen; a point one voxel further in keeps the path away from the wall.
    first = int(np.argmax(inside))
    deeper = min(first + 2, len(ray) - 1)
    point: NDArray[np.float64] = ray[deeper if inside[deeper] else first]
    return point
