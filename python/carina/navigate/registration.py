"""Registration of a tracker's space to the patient, from pairs of corresponding points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.display import one_line
from carina.errors import UsageError

MIN_PAIRS = 3
# Points on one line leave the rotation about the line undefined, so their second-largest spread must exceed this.
MIN_SPREAD_MM = 2.0


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Registration:
    """Rigid transform from tracker space to the patient (LPS).

    Parameters
    ----------
    lps_from_tracker
        (4, 4), rigid, mm.
    residuals_mm
        Residual distance of each pair; empty if the transform was set without pairs.
    """

    lps_from_tracker: NDArray[np.float64]
    residuals_mm: tuple[float, ...] = ()

    @property
    def rms_mm(self) -> float | None:
        """Root mean square of the residuals, mm: the fiducial registration error."""
        return float(np.sqrt(np.mean(np.square(self.residuals_mm)))) if self.residuals_mm else None


def fit_registration(tracker_mm: ArrayLike, patient_lps: ArrayLike) -> Registration:
    """Fit the rigid transform that brings points in tracker space nearest to the same points in the patient.

    Parameters
    ----------
    tracker_mm
        ``(n, 3)``, n at least 3: positions of the pen in tracker space, mm.
    patient_lps
        ``(n, 3)``, LPS mm: the points that the pen touched, in the same order.

    Raises
    ------
    UsageError
        ``navigate.registration``: fewer than three pairs, numbers that are not finite, or points on one line.

    References
    ----------
    Arun, Huang, Blostein, "Least-squares fitting of two 3-D point sets", PAMI 9(5), 1987; reflections as Umeyama, 1991.

    Examples
    --------
    >>> corners = [[0.0, 0, 0], [10, 0, 0], [0, 20, 0]]
    >>> round(fit_registration(corners, [[1.0, 2, 3], [11, 2, 3], [1, 22, 3]]).rms_mm, 6)
    0.0
    """
    source, target = (np.asarray(points, dtype=np.float64) for points in (tracker_mm, patient_lps))
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or len(source) < MIN_PAIRS:
        raise UsageError(
            f"a calibration needs at least {MIN_PAIRS} pairs of points, as two (n, 3) arrays; found {source.shape} and "
            f"{target.shape}",
            code="navigate.registration",
        )
    if not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise UsageError("the points of a calibration must be finite numbers", code="navigate.registration")
    for points, whose in ((source, "tracker"), (target, "patient")):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
        if spread[1] < MIN_SPREAD_MM:
            raise UsageError(
                f"the points in {whose} space are too close together or almost in a straight line (expected a spread "
                f"of at least {MIN_SPREAD_MM:g} mm across the line through them, found {spread[1]:.1f} mm); choose "
                "points that are farther apart and not in a line",
                code="navigate.registration",
            )
    u, _, vt = np.linalg.svd((target - target.mean(axis=0)).T @ (source - source.mean(axis=0)))
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = target.mean(axis=0) - rotation @ source.mean(axis=0)
    away = np.linalg.norm(source @ rotation.T + matrix[:3, 3] - target, axis=1)
    return Registration(matrix, tuple(float(v) for v in away))


def as_registration(matrix: Sequence[float]) -> Registration:
    """Return the registration that a matrix of 16 numbers, row by row, defines.

    Raises
    ------
    UsageError
        ``navigate.registration``: if the matrix is not rigid.
    """
    m = np.asarray(matrix, dtype=np.float64)
    if m.shape != (16,) or not np.isfinite(m).all():
        raise UsageError(
            "a calibration must be a 4x4 matrix, given as 16 finite numbers row by row", code="navigate.registration"
        )
    m = m.reshape(4, 4)
    r = m[:3, :3]
    rigid = np.abs(r.T @ r - np.eye(3)).max() < 1e-6 and np.linalg.det(r) > 0 and np.array_equal(m[3], [0, 0, 0, 1])
    if not rigid:
        raise UsageError(
            "a calibration must be a rotation and a translation, without scaling or reflection",
            code="navigate.registration",
        )
    return Registration(m)
