"""Check that a point that the user gives lies inside the scan."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from carina.errors import UsageError
from carina.volume.model import Volume


def check_in_volume(
    volume: Volume, lps: Sequence[float] | NDArray[np.float64], what: str, *, code: str = "usage"
) -> None:
    """Refuse a point outside a volume.

    Parameters
    ----------
    volume
        The volume.
    lps
        The point (3,), LPS in mm.
    what
        What the point is, for the message: ``the target``.
    code
        Code of the error.

    Raises
    ------
    UsageError
        If a coordinate is not finite, or the point is not in the volume. The message states where the volume lies,
        and whether the point would be inside in RAS coordinates, which 3D Slicer and NIfTI programs show.

    Examples
    --------
    >>> import carina
    >>> volume = carina.generate_phantom(spacing_mm=3.0, generations=3).volume
    >>> check_in_volume(volume, volume.centre_lps, "the target")
    >>> try:
    ...     check_in_volume(volume, (0.0, -500.0, 0.0), "the target")
    ... except carina.CarinaError as error:
    ...     print(str(error)[:42])
    the target 0,-500,0 lies outside the scan,
    """
    point = np.asarray(lps, dtype=np.float64)
    if np.isfinite(point).all() and volume.contains_lps(point):
        return
    nz, ny, nx = volume.shape_zyx
    corners = volume.to_lps(np.array(list(itertools.product((-0.5, nx - 0.5), (-0.5, ny - 0.5), (-0.5, nz - 0.5)))))
    low, high = corners.min(axis=0), corners.max(axis=0)
    sides = ", ".join(f"{axis} {a:.5g} to {b:.5g}" for axis, a, b in zip("xyz", low, high, strict=True))
    message = f"{what} {_text(point)} lies outside the scan, which lies within {sides} mm (LPS)"
    turned = point * (-1.0, -1.0, 1.0)
    if np.isfinite(point).all() and volume.contains_lps(turned):
        message += f"; if the point is in RAS coordinates, as in 3D Slicer, give {_text(turned)}"
    raise UsageError(message, code=code)


def _text(point: NDArray[np.float64]) -> str:
    # Adding zero changes -0 to 0.
    return ",".join(f"{value + 0.0:g}" for value in np.round(point, 1))
