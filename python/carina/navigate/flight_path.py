"""Flight path: a smooth curve along an airway, with a steady camera at every position."""

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


class PathPoints(Protocol):
    """Path from a search, such as :class:`carina.track.Route` or :class:`carina.track.TrackedPath`."""

    @property
    def points_lps(self) -> NDArray[np.float64]:
        """Points (n, 3) of the path, LPS mm, from root to tip."""


def _check_points(where: str, name: str, value: object) -> None:
    """Raise an error unless a path consists of finite numbers or has points."""
    numbers_within()(where, name, getattr(value, "points_lps", value))


class FlightPath:
    """Smooth curve along a tracked path, with camera frames that do not rotate about the viewing direction.

    Positions along the path are measured in mm along the polyline of *the given points*, so ``forks_mm`` and
    generations that were found on these points stay valid.

    Parameters
    ----------
    points_lps
        A route (:class:`carina.track.Route`), a tracked path, or points ``(n, 3)``, LPS mm, root to tip; at least two
        different points. The steps of a voxel path are smoothed.
    up_lps
        Direction that appears up at the start. Default: anterior (operator at the head end), or superior if the path
        starts along the antero-posterior axis. Later frames rotate as little as possible about the viewing direction.
    forks_mm
        Positions of the forks. Default: those of the route.
    lookouts_mm
        Positions where :meth:`next_fork_mm` and :meth:`previous_fork_mm` stop: in front of the forks, with all openings
        in view. Default: the forks themselves.
    max_deviation_mm
        Largest distance of the curve from the polyline, 0.2 to 10 mm.

    Raises
    ------
    UsageError
        If the points make no path, ``up_lps`` is parallel to its start, or a number is out of range.

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
        self._forks_mm = self._clamped_positions("forks", forks_mm)
        self._lookouts_mm = self._forks_mm if lookouts_mm is None else self._clamped_positions("look-outs", lookouts_mm)

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
        """Create a path from the :attr:`made_from` of a checked path; compute its curve when it is first needed.

        The history of a case contains hundreds of routes, of which one is shown, so most curves are never computed.

        Raises
        ------
        UsageError
            When the curve is first needed, if the points make no path.
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
            # No lock: two threads that compute the curve at the same time get equal curves.
            curve = self._made_curve = _core.FlightCurve(self._source_lps, self._up_lps, self._max_deviation_mm)
        return curve

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the arguments of the path for pickle; the curve is computed again."""
        values = (self._source_lps, self._up_lps, self._forks_mm, self._lookouts_mm, self._max_deviation_mm)
        return _path_of, values

    def __repr__(self) -> str:
        """Return a one-line description of this `FlightPath` for the Python interpreter."""
        return f"FlightPath(length_mm={self.length_mm:.1f}, num_forks={len(self._forks_mm)})"

    @property
    def length_mm(self) -> float:
        """Length in mm of the polyline through the given points."""
        return self._curve.length_mm

    @property
    def forks_mm(self) -> tuple[float, ...]:
        """Positions of the forks along the path, mm, ascending."""
        return self._forks_mm

    @property
    def lookouts_mm(self) -> tuple[float, ...]:
        """Positions in front of the forks along the path, mm, ascending."""
        return self._lookouts_mm

    @property
    def points_lps(self) -> NDArray[np.float64]:
        """Points that define the smooth curve, ``(m, 3)``, LPS mm, at even distances along the path (a copy)."""
        return self._curve.knots_lps()

    @property
    def source_lps(self) -> NDArray[np.float64]:
        """Points from which the path was created, ``(n, 3)``, LPS mm; the caller must not modify them."""
        return self._source_lps

    def made_from(self) -> dict[str, Any]:
        """Arguments for :meth:`made_before`, which makes an identical path from them, bit for bit."""
        return {
            "points_lps": tuple(map(tuple, self._source_lps.tolist())),
            "up_lps": self._up_lps,
            "forks_mm": self._forks_mm,
            "lookouts_mm": self._lookouts_mm,
            "max_deviation_mm": self._max_deviation_mm,
        }

    @check_arguments(path_mm=number_from(-COORDINATE_MM, COORDINATE_MM, unit="mm"))
    def pose_at(self, path_mm: float) -> Pose:
        """Return the pose of a camera at a position, looking ahead along the path.

        Positions are clamped to the ends.
        """
        return Pose(self._curve.pose_at(float(path_mm)))

    def frames(self) -> PathFrames:
        """Return the plane perpendicular to the path at each knot; +z is the tangent of the path, not the gaze."""
        found = self._frames
        if found is None:
            # No lock: two threads that compute the frames at the same time get equal frames.
            frames = self._curve.tangent_frames()
            found = self._frames = PathFrames(np.linspace(0.0, self.length_mm, len(frames)), frames)
        return found

    @check_arguments(point_lps=numbers_within())
    def nearest_mm(self, point_lps: ArrayLike) -> float:
        """Return the position along the path (mm) that is nearest to a point (LPS mm)."""
        return self.nearest(point_lps)[0]

    @check_arguments(point_lps=numbers_within())
    def nearest(self, point_lps: ArrayLike) -> tuple[float, float]:
        """Return the position along the path (mm) that is nearest to a point (LPS mm), and its distance in mm."""
        point = np.asarray(point_lps, dtype=np.float64)
        if point.shape != (3,) or not np.isfinite(point).all():
            raise UsageError("a point needs three finite numbers")
        return self._curve.nearest((float(point[0]), float(point[1]), float(point[2])))

    @check_arguments(path_mm=number_from(-COORDINATE_MM, COORDINATE_MM, unit="mm"))
    def next_fork_mm(self, path_mm: float) -> float:
        """Return the position in mm of the first stop before a fork beyond a position of the path.

        The path's end if there is none.
        """
        # The tolerance of 0.01 mm ensures that the following look-out is returned at a look-out, despite rounding.
        return next((f for f in self._lookouts_mm if f > path_mm + 0.01), self.length_mm)

    @check_arguments(path_mm=number_from(-COORDINATE_MM, COORDINATE_MM, unit="mm"))
    def previous_fork_mm(self, path_mm: float) -> float:
        """Return the position in mm of the last stop before a fork that precedes a position of the path.

        The path's start if there is none.
        """
        return next((f for f in reversed(self._lookouts_mm) if f < path_mm - 0.01), 0.0)

    def _clamped_positions(self, what: str, places_mm: Sequence[float]) -> tuple[float, ...]:
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
    """Return the flight path of pickled arguments; its curve is computed when it is first needed."""
    return FlightPath.made_before(
        source_lps, up_lps=up_lps, forks_mm=forks_mm, lookouts_mm=lookouts_mm, max_deviation_mm=max_deviation_mm
    )
