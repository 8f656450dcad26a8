"""Times of path requests, measured inside the compiled module without the cost of Python calls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina._core import LumenTracker, time_lumen_paths
from carina.track.find.result import Airways
from carina.track.paths.tracker import SNAP_MM, PathTracker, as_point

__all__ = ["time_paths", "unsolved_tracker"]


def unsolved_tracker(airways: Airways) -> LumenTracker:
    """Return a tracker over the lumen of airways, with their root, in which no path has been computed."""
    return LumenTracker(
        airways.tracker.volume.hu_zyx,
        airways.tracker.grid.lps_from_ijk,
        airways.tracker.lumen_zyx,
        levels=None,
        root_lps=as_point(airways.root_lps),
        reach_mm=SNAP_MM,
    )


def time_paths(
    tracker: PathTracker | LumenTracker, nodes: Sequence[int] | NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the time in ns and the number of voxels of the path to each node.

    The number is 0 for a node to which no path has been computed.
    """
    core = tracker.core if isinstance(tracker, PathTracker) else tracker
    return time_lumen_paths(core, np.asarray(nodes, dtype=np.uint32))
