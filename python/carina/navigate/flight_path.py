"""A path to fly on: a smooth curve with a steady camera at every place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina import _core
from carina.argument_checks import (
    COORDINATE_MM,
    any_number,
    array_of,
    check_arguments,
    direction,
    each,
    lps_points,
    number_from,
    numbers_within,
)
from carina.errors import UsageError
from carina.scopes import PathFrames, Pose

__all__ = ["FlightPath", "PathPoints"]


class PathPoints(Protocol):
    """A path that was found, such as :class:`carina.track.Route` or :class:`carina.track.TrackedPath`."""

    @property
    def points_lps(self) -> NDArray[np.float64]:
        """(n, 3) LPS mm, root to tip."""


def _check_points(where: str, name: str, value: object) -> None:
    """Refuse anything but finite numbers and a path with points."""
    numbers_within()(where, name, getattr(value, "points_lps", value))


class FlightPath:
    """A smooth curve along a tracked path, with camera frames that do not spin.

    Places are counted in mm *of the given points* (the sum of their distances), so ``forks_mm`` and generations found
    there keep their numbers.

    Parameters
    ----------
    points_lps
        A route (:class:`carina.track.Route`), a tracked path, or points ``(n, 3)``, LPS mm, root to tip. Two different
        points at least; the stairs of a voxel path are smoothed.
    up_lps
        What appears up at the start. Anterior unless told (operator at the head end), or superior where the path starts
        along the antero-posterior axis. Frames further on turn as little as can be about the viewing direction.
    forks_mm
        Places of the bifurcations; those of a route unless given.
    lookouts_mm
        Where :meth:`next_fork_mm` and :meth:`previous_fork_mm` stop: in front of the forks, with all openings in view.
        The forks themselves unless given.
    max_deviation_mm
        The curve stays within this distance of the points' polyline, 0.2 to 10 mm.

    Raises
    ------
    UsageError
        If the points make no path, ``up_lps`` lies along its start, or a number is out of range.

    References
    ----------
    Frames: Wang, Juettler, Zheng, Liu, "Computation of rotation minimizing frames", ACM TOG 27(1), 2008.

    Examples
    --------
    >>> path = FlightPath([[0.0, 0.0, 100.0], [0.0, 0.0, 0.0]])
    >>> path.pose_at(40.0).position_lps.round(6).tolist()
    [0.0, 0.0, 60.0]

    A route has its forks:

    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> tree = carina.find_airways(phantom.volume).tree
    >>> route = tree.route_to(tree.tips()[0].id)
    >>> len(carina.FlightPath(route).forks_mm) == len(route.forks_mm)
    True
    """

    __slots__ = (
        "_forks_mm",
        "_frames",
        "_lookouts_mm",
        "_made_curve",
        "_max_deviation_mm",
        "_source_lps",
        "_up_lps",
    )

    @check_arguments(
        points_lps=_check_points,
        up_lps=array_of(3, optional=True),
        forks_mm=each(any_number(), optional=True),
        lookouts_mm=each(any_number(), optional=True),
        max_deviation_mm=any_number(),
    )
    def __init__(
        self,
        points_lps: PathPoints | ArrayLike,
        *,
        up_lps: Sequence[float] | None = None,
        forks_mm: Sequence[float] | None = None,
        lookouts_mm: Sequence[float] | None = None,
        max_deviation_mm: float = 0.5,
    ) -> None:
        if forks_mm is None:
            forks_mm = getattr(points_lps, "forks_mm", ())
        points = np.ascontiguousarray(getattr(points_lps, "points_lps", points_lps), dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise UsageError(f"a path needs points of shape (n, 3); found {points.shape}", code="navigate.path")
        up = None if up_lps is None else tuple(float(v) for v in up_lps)
        if up is not None and len(up) != 3:
            raise UsageError(f"the up direction needs three numbers; found {len(up)}", code="navigate.up")
        self._source_lps = points.copy()
        self._up_lps = up
        self._max_deviation_mm = float(max_deviation_mm)
        self._frames: PathFrames | None = None
        self._made_curve: _core.FlightCurve | None = _core.FlightCurve(points, up, float(max_deviation_mm))
        self._forks_mm = self._on_path("forks", forks_mm)
        self._lookouts_mm = self._forks_mm if lookouts_mm is None else self._on_path("look-outs", lookouts_mm)

    @classmethod
    @check_arguments(
        points_lps=lps_points(),
        up_lps=direction(optional=True),
        forks_mm=each(number_from(-COORDINATE_MM, COORDINATE_MM, unit="mm")),
        lookouts_mm=each(number_from(-COORDINATE_MM, COORDINATE_MM, unit="mm")),
        max_deviation_mm=number_from(0.2, 10.0, unit="mm"),
    )
    def made_before(
        cls,
        points_lps: NDArray[np.float64],
        *,
        up_lps: tuple[float, float, float] | None,
        forks_mm: tuple[float, ...],
        lookouts_mm: tuple[float, ...],
        max_deviation_mm: float,
    ) -> FlightPath:
        """Make a path from the :meth:`made_from` of a checked one; its curve is computed when it is needed.

        A case has hundreds of routes in its history, and shows one.

        Raises
        ------
        UsageError
            When its curve is needed, if the points make no path.
        """
        path = cls.__new__(cls)
        path._source_lps, path._up_lps = points_lps, up_lps
        path._max_deviation_mm = max_deviation_mm
        path._forks_mm, path._lookouts_mm = forks_mm, lookouts_mm
        path._frames = path._made_curve = None
        return path

    @property
    def _curve(self) -> _core.FlightCurve:
        curve = self._made_curve
        if curve is None:
            # Two threads may both make it: they make the same.
            curve = self._made_curve = _core.FlightCurve(self._source_lps, self._up_lps, self._max_deviation_mm)
        return curve

    def __reduce__(self) -> tuple[Any, ...]:
        values = (self._source_lps, self._up_lps, self._forks_mm, self._lookouts_mm, self._max_deviation_mm)
        return _path_of, values

    def __repr__(self) -> str:
        return f"FlightPath(length_mm={self.length_mm:.1f}, num_forks={len(self._forks_mm)})"

    @property
    def length_mm(self) -> float:
        """Length of the given points' polyline."""
        return self._curve.length_mm

    @property
    def forks_mm(self) -> tuple[float, ...]:
        """Places of the bifurcations, ascending."""
        return self._forks_mm

    @property
    def lookouts_mm(self) -> tuple[float, ...]:
        """Places in front of the bifurcations, ascending."""
        return self._lookouts_mm

    @property
    def points_lps(self) -> NDArray[np.float64]:
        """Knots of the smooth curve, ``(m, 3)``, evenly spaced in mm of the path (a copy)."""
        return self._curve.knots_lps()

    @property
    def source_lps(self) -> NDArray[np.float64]:
        """The given points, ``(n, 3)``; not to be changed."""
        return self._source_lps

    def made_from(self) -> dict[str, Any]:
        """Return the arguments that make this path again, to the last bit."""
        return {
            "points_lps": tuple(map(tuple, self._source_lps.tolist())),
            "up_lps": self._up_lps,
            "forks_mm": self._forks_mm,
            "lookouts_mm": self._lookouts_mm,
            "max_deviation_mm": self._max_deviation_mm,
        }

    @check_arguments(path_mm=number_from(-COORDINATE_MM, COORDINATE_MM, unit="mm"))
    def pose_at(self, path_mm: float) -> Pose:
        """Return the camera at a place, looking along the path ahead; clamped to the ends."""
        return Pose(self._curve.pose_at(float(path_mm)))

    def frames(self) -> PathFrames:
        """Return the plane across the path at each knot: +z is the path's own direction, not the gaze."""
        found = self._frames
        if found is None:
            # Two threads may both find them: they find the same.
            frames = self._curve.tangent_frames()
            found = self._frames = PathFrames(np.linspace(0.0, self.length_mm, len(frames)), frames)
        return found

    @check_arguments(point_lps=numbers_within())
    def nearest_mm(self, point_lps: ArrayLike) -> float:
        """Return the place nearest to a point (LPS mm)."""
        return self.nearest(point_lps)[0]

    @check_arguments(point_lps=numbers_within())
    def nearest(self, point_lps: ArrayLike) -> tuple[float, float]:
        """Return the place nearest to a point (LPS mm), and the distance to it in mm."""
        point = np.asarray(point_lps, dtype=np.float64)
        if point.shape != (3,) or not np.isfinite(point).all():
            raise UsageError("a point needs three finite numbers")
        return self._curve.nearest((float(point[0]), float(point[1]), float(point[2])))

    @check_arguments(path_mm=number_from(-COORDINATE_MM, COORDINATE_MM, unit="mm"))
    def next_fork_mm(self, path_mm: float) -> float:
        """Return the first look-out beyond a place, or the end of the path."""
        # 0.01 mm: a person at a fork means the one after it, whatever the rounding of the way here.
        return next((f for f in self._lookouts_mm if f > path_mm + 0.01), self.length_mm)

    @check_arguments(path_mm=number_from(-COORDINATE_MM, COORDINATE_MM, unit="mm"))
    def previous_fork_mm(self, path_mm: float) -> float:
        """Return the last look-out before a place, or the start of the path."""
        return next((f for f in reversed(self._lookouts_mm) if f < path_mm - 0.01), 0.0)

    def _on_path(self, what: str, places_mm: Sequence[float]) -> tuple[float, ...]:
        places = sorted(float(mm) for mm in places_mm)
        if not all(-1e-6 <= mm <= self.length_mm + 1e-6 for mm in places):
            msg = f"{what} must lie on the path, between 0 and {self.length_mm:.3f} mm; found {places}"
            raise UsageError(msg, code="navigate.path")
        return tuple(places)


def _path_of(
    source_lps: NDArray[np.float64],
    up_lps: tuple[float, float, float] | None,
    forks_mm: tuple[float, ...],
    lookouts_mm: tuple[float, ...],
    max_deviation_mm: float,
) -> FlightPath:
    """Return the path that a pickle holds; its curve is computed when it is needed."""
    return FlightPath.made_before(
        source_lps, up_lps=up_lps, forks_mm=forks_mm, lookouts_mm=lookouts_mm, max_deviation_mm=max_deviation_mm
    )
