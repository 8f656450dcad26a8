"""Airway lumen, least-cost paths and the airway tree (paper 6)."""

from carina.track.airways import Airways, TargetResult, TrackResult, find_airways, track_paths
from carina.track.levels import lumen_threshold_from_histogram
from carina.track.paths import PathTracker, TrackedPath
from carina.track.tree import AirwayTree, Branch, Route

__all__ = [
    "AirwayTree",
    "Airways",
    "Branch",
    "PathTracker",
    "Route",
    "TargetResult",
    "TrackResult",
    "TrackedPath",
    "find_airways",
    "lumen_threshold_from_histogram",
    "track_paths",
]
