"""Pose of the scope's tip, which is the pose of the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.argument_checks import check_arguments, check_fields, instance, numbers_within
from carina.breathing import ChestDeformation
from carina.display import as_words
from carina.errors import UsageError

ANTERIOR_LPS = np.array([0.0, -1.0, 0.0])
SUPERIOR_LPS = np.array([0.0, 0.0, 1.0])
FAR_MM = 1e40
"""Maximum absolute coordinate of a pose, mm: a camera far outside the volume is allowed and shows the background."""


def upright(forward_lps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the up direction for an operator at the patient's head: anterior, or superior in an antero-posterior view.

    Parameters
    ----------
    forward_lps
        Viewing direction, unit length.

    Returns
    -------
    numpy.ndarray
        Unit vector perpendicular to ``forward_lps``.
    """
    # Within 8 degrees of the anterior axis, "anterior up" is not well defined.
    up = ANTERIOR_LPS if abs(float(forward_lps @ ANTERIOR_LPS)) < 0.99 else SUPERIOR_LPS
    across = up - float(up @ forward_lps) * forward_lps
    return np.asarray(across / np.linalg.norm(across), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A rigid pose ``lps_from_camera`` (4x4 float64, row-major, mm): +x right, +y down, +z forward along the scope.

    Examples
    --------
    >>> import carina
    >>> carina.Pose.looking((10, 0, -20), (0, 0, -1))
    Pose(position_lps=(10, 0, -20), forward_lps=(0, 0, -1))
    """

    lps_from_camera: NDArray[np.float64]

    def __post_init__(self) -> None:
        """Check the matrix and store a copy as float64."""
        check_fields(self, lps_from_camera=numbers_within(FAR_MM))
        m = np.array(self.lps_from_camera, dtype=np.float64)
        if m.shape != (4, 4) or not np.isfinite(m).all():
            found = f"shape {m.shape}" if m.shape != (4, 4) else f"{m.ravel().tolist()}"
            raise UsageError(f"a pose must be a 4x4 matrix of finite numbers; found {found}")
        if not np.array_equal(m[3], [0.0, 0.0, 0.0, 1.0]):
            raise UsageError(f"the last row of a pose must be 0, 0, 0, 1; found {m[3].tolist()}")
        r = m[:3, :3]
        # Tolerance 1e-6: rounding in JSON and many small rotations stays below it.
        if np.abs(r.T @ r - np.eye(3)).max() > 1e-6 or np.linalg.det(r) < 0:
            lengths = ", ".join(f"{v:g}" for v in np.linalg.norm(r, axis=0))
            raise UsageError(
                "the axes of a pose must be unit vectors at right angles, right-handed (determinant 1); found lengths "
                f"{lengths} and determinant {np.linalg.det(r):g}"
            )
        m.flags.writeable = False
        object.__setattr__(self, "lps_from_camera", m)

    def __repr__(self) -> str:
        """Return a one-line description of this `Pose` for the Python interpreter."""
        at, look = (as_words(tuple(np.round(self.lps_from_camera[:3, n], 3).tolist())) for n in (3, 2))
        return f"Pose(position_lps={at}, forward_lps={look})"

    @classmethod
    @check_arguments(
        at_lps=numbers_within(FAR_MM), look_lps=numbers_within(FAR_MM), up_lps=numbers_within(FAR_MM, optional=True)
    )
    def looking(cls, at_lps: ArrayLike, look_lps: ArrayLike, up_lps: ArrayLike | None = None) -> Pose:
        """Return the pose at a point, looking along a direction, with ``up`` as near the picture's top as possible.

        Parameters
        ----------
        at_lps
            Tip position, LPS mm.
        look_lps
            Viewing direction (any length above 0).
        up_lps
            Direction that should appear up. Default: anterior (operator at the head end), or superior if the view is
            along the antero-posterior axis.

        Raises
        ------
        UsageError
            If a direction has length 0, or ``up`` is parallel to ``look``.
        """
        at = np.asarray(at_lps, dtype=np.float64)
        look = np.asarray(look_lps, dtype=np.float64)
        with np.errstate(under="ignore"):
            norm = float(np.linalg.norm(look))
        if at.shape != (3,) or look.shape != (3,) or not np.isfinite(at).all() or not np.isfinite(norm) or norm < 1e-9:
            raise UsageError(
                "a pose needs a position of three finite numbers and a viewing direction longer than 0; "
                f"found position {at.tolist()}, direction {look.tolist()}"
            )
        forward = look / norm
        up = upright(forward) if up_lps is None else np.asarray(up_lps, dtype=np.float64)
        if up.shape != (3,) or not np.isfinite(up).all():
            raise UsageError(f"the up direction must be three finite numbers; found {up.tolist()}")
        down = -(up - float(up @ forward) * forward)
        length = float(np.linalg.norm(down))
        if not length > 1e-6 * max(1.0, float(np.linalg.norm(up))):
            raise UsageError(
                "the up direction must be longer than 0 and not parallel to the viewing direction; "
                f"found up {up.tolist()}, viewing direction {look.tolist()}"
            )
        down /= length
        right = np.cross(down, forward)
        m = np.eye(4)
        m[:3, :3] = np.column_stack([right, down, forward])
        m[:3, 3] = at
        return cls(m)

    @check_arguments(deformation=instance(ChestDeformation, "get one from carina.breathing.Breathing.at"))
    def carried_by(self, deformation: ChestDeformation) -> Pose:
        """Return the pose of a tip that the tissue round it carries along, from the CT at rest to the moved patient.

        The viewing direction follows the airway, and the picture is not rolled about it more than the tissue is.

        Examples
        --------
        >>> import numpy as np
        >>> import carina
        >>> moved = carina.breathing.ChestDeformation(np.diag([1.0, 1.0, 0.9, 1.0]))
        >>> Pose.looking((10, 0, -20), (0, 0, -1)).carried_by(moved)
        Pose(position_lps=(10, 0, -18), forward_lps=(0, 0, -1))
        """
        if deformation.is_rest:
            return self
        moved = deformation.lps_from_rest[:3, :3] @ self.lps_from_camera[:3, :3]
        return Pose.looking(deformation.points(self.position_lps)[0], moved[:, 2], -moved[:, 1])

    @property
    def position_lps(self) -> NDArray[np.float64]:
        """Tip position (3,), LPS mm."""
        return self.lps_from_camera[:3, 3]

    @property
    def forward_lps(self) -> NDArray[np.float64]:
        """Viewing direction (3,), LPS, unit length."""
        return self.lps_from_camera[:3, 2]

    @property
    def right_lps(self) -> NDArray[np.float64]:
        """Direction (3,) that appears to the right in the picture, LPS."""
        return self.lps_from_camera[:3, 0]

    @property
    def down_lps(self) -> NDArray[np.float64]:
        """Direction (3,) that appears at the bottom of the picture, LPS."""
        return self.lps_from_camera[:3, 1]


def pose_of_valid_matrix(lps_from_camera: NDArray[np.float64]) -> Pose:
    """Return the pose of a matrix (4, 4) that is known to be valid, without checks and without a copy.

    Simulated drives make many poses, and the checks took a tenth of their time.
    """
    pose = object.__new__(Pose)
    lps_from_camera.flags.writeable = False
    object.__setattr__(pose, "lps_from_camera", lps_from_camera)
    return pose
