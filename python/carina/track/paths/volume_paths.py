"""Least-cost paths through a whole volume of weights, without a graph in memory (paper 6, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from carina._core import FieldTracker, aimed_field_path
from carina.display import one_line
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import GeometryError, NoResultError, UsageError
from carina.track.paths.tracker import as_point, words
from carina.track.progress import Cancel
from carina.volume.model import Volume
from carina.volume.point_check import check_in_volume

Box = tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
CALCULATING = "calculating the paths"


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class FieldPath:
    """Least-cost path through a volume of weights."""

    points_lps: NDArray[np.float64]
    """Voxel centres (n, 3) from the root to the target, LPS in mm."""
    voxels_ijk: NDArray[np.int64]
    """Voxels (n, 3) of the path as i, j, k."""
    cost: float
    """Cost of the path, correct within 0.5 %; exact if the weights are whole numbers and the cost is ``enter``."""
    num_settled: int
    """Total number of voxels whose steps had been examined when the path was found."""


class FieldPaths:
    """Least-cost paths from one root through every voxel of a volume of weights, with 26 neighbours each.

    Voxels that were settled for one target are reused for the next; for a single target `aimed_path` is faster. No
    graph is built: the memory is 1.13 bytes per voxel with the cost ``enter`` and 5.13 with ``mean``, plus some
    tenths of a byte for the queue. `solve_all` processes the volume in tiles, with 5.13 bytes per voxel while it
    runs.

    Parameters
    ----------
    volume
        Defines the grid: spacing and position.
    field_zyx
        (nz, ny, nx) float32, C order, weights on the grid of the volume; not copied, so it must not be changed while
        this object exists. A voxel whose weight is not finite is a wall.
    root_lps
        Start of all paths, LPS in mm.
    cost
        ``mean``: a step costs its length in mm times the mean of the weights at its two ends; the weights must be
        above 0. ``enter``: a step costs the weight of the voxel that it enters, whatever its length (the problem of
        ``dijkstra3d``); the weights must be at least 0.
    region_ijk
        First voxel and one past the last, on i, j and k. Paths stay in this box, and memory is used for it alone.
    mask_zyx
        (nz, ny, nx) uint8, C order: paths stay in voxels that are not 0.

    Raises
    ------
    UsageError
        If a weight is negative (for ``mean``: or 0), or the root or the region is outside.
    GeometryError
        If the field or the mask is not on the grid of the volume.
    NoResultError
        If the root is in a wall.
    TrackingError
        If the most expensive step costs more than 32,000 times the cheapest; or, later, if the cost of a path
        exceeds the counter.

    Notes
    -----
    Costs are counted in whole quanta, 128 for the cheapest step (1 per unit if ``enter`` weights are whole numbers),
    and equal those of Dijkstra's algorithm on the same quanta. Dial, CACM 12 (1969) 632; Dinitz 1978 for buckets as
    wide as the cheapest step; docs/decisions/0118.

    Examples
    --------
    >>> import numpy as np
    >>> from carina.volume import Volume
    >>> volume = Volume(np.zeros((5, 6, 7), np.int16), np.diag([1.0, 1.0, 2.0, 1.0]))
    >>> paths = FieldPaths(volume, np.ones((5, 6, 7), np.float32), (0.0, 0.0, 0.0))
    >>> round(paths.path_to((3.0, 0.0, 0.0)).cost, 2)
    3.0
    """

    __slots__ = ("_core", "_volume")

    def __init__(
        self,
        volume: Volume,
        field_zyx: NDArray[np.float32],
        root_lps: Sequence[float] | NDArray[np.float64],
        *,
        cost: Literal["mean", "enter"] = "mean",
        region_ijk: Box | None = None,
        mask_zyx: NDArray[np.uint8] | None = None,
    ) -> None:
        _check(volume, field_zyx, mask_zyx)
        self._volume = volume
        self._core = FieldTracker(
            field_zyx,
            volume.lps_from_ijk,
            _voxel(volume, root_lps, "root"),
            cost=cost,
            region_ijk=region_ijk,
            mask_zyx=mask_zyx,
        )

    def __repr__(self) -> str:
        """Return one line with the numbers of open and settled voxels."""
        return f"FieldPaths(num_open={self._core.num_open}, num_settled={self._core.num_settled})"

    @property
    def num_settled(self) -> int:
        """Number of voxels whose steps were examined."""
        return self._core.num_settled

    @property
    def num_open(self) -> int:
        """Number of voxels of the region whose weight is finite (no wall)."""
        return self._core.num_open

    @property
    def quantum(self) -> float:
        """Unit of the integer path costs; every cost is a whole multiple of it."""
        return self._core.quantum

    @property
    def num_bytes(self) -> tuple[int, int]:
        """Memory in bytes for the voxels and for the queue."""
        return self._core.num_bytes

    @property
    def core(self) -> FieldTracker:
        """Compiled tracker that computes the paths."""
        return self._core

    @shows_progress
    def solve_all(self, *, progress: ProgressChoice = None, cancel: Cancel | None = None) -> None:
        """Settle every voxel that a path can reach.

        Parameters
        ----------
        progress
            False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook;
            False shows none. The fraction is None while the progress is unknown.
        cancel
            Function that is called often; the calculation stops when it returns True.

        Raises
        ------
        CancelledError
            If ``cancel()`` returned True; another call continues from there.
        """
        self._core.solve_all(cancel=cancel, progress=fraction_callback(progress_function(progress), CALCULATING))

    @shows_progress
    def path_to(
        self,
        target_lps: Sequence[float] | NDArray[np.float64],
        *,
        progress: ProgressChoice = None,
        cancel: Cancel | None = None,
    ) -> FieldPath:
        """Return the least-cost path from the root to the voxel that contains a point.

        Parameters
        ----------
        target_lps
            End of the path, LPS in mm.
        progress
            False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook;
            False shows none. The fraction is None while the progress is unknown.
        cancel
            Function that is called often; the calculation stops when it returns True.

        Raises
        ------
        UsageError
            If the point is not in the volume, or not in the region.
        NoResultError
            If the target is in a wall, or no path leads to it.
        CancelledError
            If ``cancel()`` returned True; another call continues from there.
        """
        voxel = _voxel(self._volume, target_lps, "target")
        on_progress = fraction_callback(progress_function(progress), CALCULATING)
        if not self._core.solve_to(voxel, cancel=cancel, progress=on_progress):
            raise _no_path(target_lps)
        voxels, cost = self._core.path(voxel), self._core.cost(voxel)
        assert voxels is not None
        assert cost is not None
        return FieldPath(self._volume.to_lps(voxels.astype(np.float64)), voxels, cost, self.num_settled)


@shows_progress
def aimed_path(
    volume: Volume,
    field_zyx: NDArray[np.float32],
    root_lps: Sequence[float] | NDArray[np.float64],
    target_lps: Sequence[float] | NDArray[np.float64],
    *,
    cost: Literal["mean", "enter"] = "mean",
    region_ijk: Box | None = None,
    mask_zyx: NDArray[np.uint8] | None = None,
    progress: ProgressChoice = None,
    cancel: Cancel | None = None,
) -> FieldPath:
    """Return the least-cost path to a single target, searched in the direction of the target (A*).

    The cost equals that of the path of `FieldPaths`, to the quantum; of several paths with this cost it may be
    another one. No result is stored: for several targets from one root use `FieldPaths`. The search uses eight bytes
    for each voxel that it reaches; if there is no path, these are all voxels that the root can reach.

    Parameters
    ----------
    volume, field_zyx, root_lps, cost, region_ijk, mask_zyx
        As for `FieldPaths`.
    target_lps
        End of the path, LPS in mm.
    progress
        False, True, None or ``f(what, fraction)``. True and None show a progress bar in a terminal or a notebook; False
        shows none. The fraction is that of the open voxels that were settled.
    cancel
        Function that is called often; the calculation stops when it returns True.

    Raises
    ------
    UsageError, GeometryError, TrackingError
        As for `FieldPaths`.
    NoResultError
        If the root or the target is in a wall, or no path leads from one to the other.
    CancelledError
        If ``cancel()`` returned True.

    Notes
    -----
    Hart, Nilsson and Raphael, IEEE Trans. SSC 4 (1968) 100, with a bound in whole quanta: the least weight times the
    number of steps along the longest axis (``enter``), or times the length of the straight line (``mean``);
    docs/decisions/0118.

    Examples
    --------
    >>> import numpy as np
    >>> from carina.volume import Volume
    >>> volume = Volume(np.zeros((5, 6, 7), np.int16), np.diag([1.0, 1.0, 2.0, 1.0]))
    >>> field = np.ones((5, 6, 7), np.float32)
    >>> aimed_path(volume, field, (0.0, 0.0, 0.0), (3.0, 2.0, 0.0), cost="enter").cost
    3.0
    """
    _check(volume, field_zyx, mask_zyx)
    found = aimed_field_path(
        field_zyx,
        volume.lps_from_ijk,
        _voxel(volume, root_lps, "root"),
        _voxel(volume, target_lps, "target"),
        cost=cost,
        region_ijk=region_ijk,
        mask_zyx=mask_zyx,
        cancel=cancel,
        progress=fraction_callback(progress_function(progress), CALCULATING),
    )
    if found is None:
        raise _no_path(target_lps)
    voxels, least, num_settled = found
    return FieldPath(volume.to_lps(voxels.astype(np.float64)), voxels, least, num_settled)


def _check(volume: Volume, field_zyx: NDArray[np.float32], mask_zyx: NDArray[np.uint8] | None) -> None:
    for what, array in (("field", field_zyx), ("mask", mask_zyx)):
        if array is not None and array.shape != volume.shape_zyx:
            msg = f"the {what} must be on the volume's grid: expected {volume.shape_zyx}, found {array.shape}"
            raise GeometryError(msg, code="geometry.shape")
    if field_zyx.dtype != np.float32 or (mask_zyx is not None and mask_zyx.dtype != np.uint8):
        raise UsageError("expected a float32 field and a uint8 mask")


def _voxel(volume: Volume, point_lps: Sequence[float] | NDArray[np.float64], what: str) -> tuple[int, int, int]:
    point = as_point(point_lps)
    check_in_volume(volume, point, f"the {what}")
    i, j, k = np.floor(volume.to_ijk(np.array(point)) + 0.5).astype(int)
    nz, ny, nx = volume.shape_zyx
    return min(max(int(i), 0), nx - 1), min(max(int(j), 0), ny - 1), min(max(int(k), 0), nz - 1)


def _no_path(target_lps: Sequence[float] | NDArray[np.float64]) -> NoResultError:
    msg = (
        f"no path leads to {words(as_point(target_lps))}: the point is in a wall or beyond one; choose a point "
        "inside the lumen, or paint lumen through the wall"
    )
    return NoResultError(msg, code="track.no-path")
