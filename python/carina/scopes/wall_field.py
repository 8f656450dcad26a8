"""Signed distance to the lumen's wall, which constrains the scope."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina import _core
from carina.argument_checks import (
    COORDINATE_MM,
    array_of,
    check_arguments,
    check_fields,
    coordinates,
    function,
    instance,
    lps_points,
    number_from,
)
from carina.breathing import ChestDeformation
from carina.display import one_line
from carina.display.progress import ProgressChoice, fraction_callback, progress_function, shows_progress
from carina.errors import UsageError, refuse_pickle

STEP_MM = 0.6
"""Distance in mm from a point to its probes; larger than the diagonal of a square of grid samples."""
BEYOND_MM = 0.3
"""Maximum distance in mm behind a wall at which a probe may lie, since another lumen may be near."""
INSIDE_MM = 4.5
AT_ONCE = 4096


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class WallField:
    """Signed distance to the wall in mm, positive in the lumen; `carina.track.wall_field` computes it from airways.

    Distances are limited to -2.5 mm outside (also where nothing is known) and 4.5 mm inside.

    Examples
    --------
    >>> import numpy as np
    >>> import carina
    >>> k, j, i = np.indices((21, 21, 21)) - 10.0
    >>> ball = 4.0 - np.sqrt(i * i + j * j + k * k)
    >>> wall = carina.WallField.from_distances(ball.astype(np.float32), np.eye(4))
    >>> round(float(wall.distance_mm(np.array([[10.0, 10.0, 8.0]]))[0]), 1)
    2.0
    """

    core: _core.WallField

    def __post_init__(self) -> None:
        """Raise an error if a field of this `WallField` has an invalid value."""
        check_fields(self, core=instance(_core.WallField, "make one with carina.wall_field"))

    @classmethod
    @check_arguments(distance_mm_zyx=array_of(None, None, None), lps_from_ijk=array_of(4, 4))
    def from_distances(cls, distance_mm_zyx: NDArray[np.float32], lps_from_ijk: NDArray[np.float64]) -> WallField:
        """Create a wall field from signed distances on a grid.

        Parameters
        ----------
        distance_mm_zyx
            (nz, ny, nx) mm, positive in the lumen, at voxel centres.
        lps_from_ijk
            (4, 4), geometry of the grid.

        Raises
        ------
        UsageError
            If a value is NaN or the distances contain no wall (code ``scope.wall``).
        """
        values = np.ascontiguousarray(distance_mm_zyx, dtype=np.float32)
        return cls(_core.WallField.from_distances(values, np.asarray(lps_from_ijk, dtype=np.float64)))

    @classmethod
    @shows_progress
    @check_arguments(
        vertices_lps=lps_points(),
        triangles=array_of(None, 3, largest=2**32 - 1, what="triangles (m, 3): indices of vertices"),
        spacing_mm=number_from(0.1, 0.6, unit="mm"),
        cancel=function,
    )
    def from_mesh(
        cls,
        vertices_lps: NDArray[np.float64],
        triangles: NDArray[np.uint32],
        *,
        spacing_mm: float = 0.4,
        progress: ProgressChoice = None,
        cancel: Callable[[], bool] | None = None,
    ) -> WallField:
        """Create a wall field from a closed mesh of the wall, with exact values at the samples.

        Parameters
        ----------
        vertices_lps
            (n, 3) LPS mm.
        triangles
            (m, 3), counterclockwise from outside the lumen.
        spacing_mm
            Spacing of the samples, 0.1 to 0.6. Between samples, values are interpolated trilinearly: a wall with a
            radius of curvature r has an error of up to ``spacing_mm**2 / (8 r)``, 0.013 mm at 0.4 mm in an airway of 3
            mm.
        progress
            False, True or ``f(what, fraction)``. True and None show a bar in a terminal or a notebook. The fraction is
            None where it is unknown.
        cancel
            Function that is called often; the work stops when it returns True.

        Raises
        ------
        UsageError
            If the mesh is empty or broken (code ``scope.wall``).
        CancelledError
            If ``cancel()`` returned True.
        """
        made = _core.WallField.from_mesh(
            np.ascontiguousarray(vertices_lps, dtype=np.float64),
            np.ascontiguousarray(triangles, dtype=np.uint32),
            spacing_mm,
            cancel=cancel,
            progress=fraction_callback(progress_function(progress), "measuring the distance to the wall"),
        )
        return cls(made)

    def __copy__(self) -> WallField:
        """Return an independent copy of this `WallField`."""
        return self

    def __deepcopy__(self, _memo: object) -> WallField:
        """Return an independent copy of this `WallField`."""
        return self

    def __reduce__(self) -> NoReturn:
        """Raise an error, because a `WallField` is bound to its process and cannot be pickled."""
        refuse_pickle(
            self, "pickle the airways, and make the wall from them with carina.wall_field in the other process"
        )

    @property
    def num_bytes(self) -> int:
        """Memory that the samples of the field occupy, bytes."""
        return self.core.num_bytes

    @check_arguments(
        axis_lps=coordinates(COORDINATE_MM), radius_mm=array_of(None), excess_mm=array_of(None, optional=True)
    )
    def with_tube(self, axis_lps: ArrayLike, radius_mm: ArrayLike, *, excess_mm: ArrayLike | None = None) -> WallField:
        """Return a field whose lumen also contains a tube; the tube replaces one of an earlier call.

        The wall of the tube is computed, not sampled, so a narrow tube has its full radius on its axis. The samples are
        shared with this field.

        Parameters
        ----------
        axis_lps
            (n, 3) points of the tube's axis, LPS mm, two or more.
        radius_mm
            (n,) radii above 0 at the points; they change linearly in between.
        excess_mm
            (n,) distances of 0 or more in mm by which the sampled wall is moved inwards near the points, because the
            sampled lumen is too wide there. The tube is not narrowed. None: 0.

        Raises
        ------
        UsageError
            If the numbers of points, radii and excesses differ, or a value is out of range (code ``scope.wall``).
        """
        axis = np.ascontiguousarray(np.atleast_2d(np.asarray(axis_lps, dtype=np.float64)))
        radius = np.asarray(radius_mm, dtype=np.float64)
        excess = np.zeros(len(radius)) if excess_mm is None else np.asarray(excess_mm, dtype=np.float64)
        return WallField(self.core.with_tube(axis, radius.tolist(), excess.tolist()))

    @check_arguments(deformation=instance(ChestDeformation, "get one from carina.breathing.Breathing.at"))
    def deformed(self, deformation: ChestDeformation) -> WallField:
        """Return the field of this wall in the moved patient; the samples are shared.

        A distance is that at rest times the factor by which the deformation changes the distance to a plane wall with
        the direction of the nearest wall. The error is 0 at the wall (docs/decisions/0155). The limits of the distances
        are multiplied by the smallest factor.

        Parameters
        ----------
        deformation
            Deformation of the chest; one that moves nothing returns this field.

        Raises
        ------
        UsageError
            If the field is already deformed (code ``scope.wall``).

        Examples
        --------
        >>> import carina
        >>> k, j, i = np.indices((21, 21, 21)) - 10.0
        >>> ball = 4.0 - np.sqrt(i * i + j * j + k * k)
        >>> wall = WallField.from_distances(ball.astype(np.float32), np.eye(4))
        >>> half = wall.deformed(carina.breathing.ChestDeformation(np.diag([0.5, 0.5, 0.5, 1.0])))
        >>> round(float(half.distance_mm([[5.0, 5.0, 4.0]])[0]), 1)
        1.0
        """
        return self if deformation.is_rest else WallField(self.core.deformed(deformation.lps_from_rest))

    @check_arguments(
        plates_lps=array_of(None, 3, 3, what="plates (n, 3, 3): middle, and the vectors to two of its edges"),
        half_mm=number_from(0.01, 4.0, unit="mm"),
    )
    def with_ridges(self, plates_lps: ArrayLike, *, half_mm: float) -> WallField:
        """Return a field whose wall also contains plates of tissue; they replace those of an earlier call.

        A plate is a ridge between two branches that the CT does not show. It belongs to the wall also inside a tube.

        Parameters
        ----------
        plates_lps
            (n, 3, 3) plates, 32 at most: the middle of each, LPS mm, and the two perpendicular vectors from the middle
            to its edges, mm.
        half_mm
            Half of the thickness of the plates, mm.

        Raises
        ------
        UsageError
            If there are too many plates, the sides of one are not perpendicular, or the field is deformed (code
            ``scope.wall``).
        """
        plates = np.ascontiguousarray(np.asarray(plates_lps, dtype=np.float64))
        return WallField(self.core.with_ridges(plates, float(half_mm)))

    def to_bytes(self) -> bytes:
        """Return grid and samples as bytes (a copy), for compiled modules of other packages.

        The bytes are not a file format: only a package of the same version reads them.

        Raises
        ------
        UsageError
            If the field has a tube or ridges, or is deformed (code ``scope.wall``).
        """
        if not self.core.is_sampled:
            raise UsageError(
                "to_bytes: a wall with a tube or ridges has no bytes; use the wall without them", code="scope.wall"
            )
        if self.core.is_deformed:
            raise UsageError("to_bytes: a deformed wall has no bytes; use the wall at rest", code="scope.wall")
        return self.core.to_bytes()

    def digest(self) -> str:
        """Identification of the field: equal for fields whose samples are equal bit for bit."""
        return self.core.digest()

    @check_arguments(points_lps=coordinates(COORDINATE_MM))
    def distance_mm(self, points_lps: ArrayLike) -> NDArray[np.float64]:
        """Return the signed distances (n,) in mm from points (n, 3), LPS mm, to the wall; positive in the lumen."""
        return self.core.distance_mm(np.atleast_2d(np.asarray(points_lps, dtype=np.float64)))

    @check_arguments(points_lps=coordinates(COORDINATE_MM))
    def ball_mm(self, points_lps: ArrayLike) -> NDArray[np.float64]:
        """Return the radius of the largest ball around each point that touches no wall, for measurements.

        Outside the lumen the result equals `distance_mm`.

        The distance has a ridge along the middle of a lumen, which interpolation between samples cuts off: by
        `distance_mm` a tube is 0.4 mm too narrow there, up to 0.56 mm, at any width. Beside the ridge the interpolated
        distance is right. Therefore this method probes points around each point, and adds their distance to the
        smallest distance found. Tubes of 1 to 6 mm are then 0.06 mm too narrow, 0.1 mm at most (docs/decisions/0125).
        The method takes 65 times as long.

        Parameters
        ----------
        points_lps
            (n, 3) LPS mm.

        Returns
        -------
        numpy.ndarray
            (n,) mm, up to 4.5.
        """
        points = np.atleast_2d(np.asarray(points_lps, dtype=np.float64))
        found = self.distance_mm(points)
        for first in range(0, len(points), AT_ONCE):
            own = first + np.flatnonzero(found[first : first + AT_ONCE] > 0.0)
            step = np.minimum(found[own] + BEYOND_MM, STEP_MM)
            round_it = points[own, None] + step[:, None, None] * _DIRECTIONS
            least = self.distance_mm(round_it.reshape(-1, 3)).reshape(len(own), len(_DIRECTIONS)).min(axis=1)
            found[own] = np.clip(least + step, found[own], INSIDE_MM)
        return found


def _sphere_directions(num: int) -> NDArray[np.float64]:
    """Return evenly distributed directions on the sphere, (num, 3)."""
    n = np.arange(num)
    z = 1.0 - (2.0 * n + 1.0) / num
    turn = np.pi * (3.0 - np.sqrt(5.0)) * n
    across = np.sqrt(1.0 - z * z)
    found: NDArray[np.float64] = np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
    return found


_DIRECTIONS = _sphere_directions(64)
