"""Share of needles that hit a nodule within the needle's position errors, by numerical quadrature."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import any_number, check_fields
from carina.display import one_line
from carina.errors import UsageError
from carina.plan.targets.grow_nodule import Nodule

Points = NDArray[np.float64]

STEP_MM = 0.5
NUM_RINGS, NUM_ROUND = 14, 24
NUM_WAYS, NUM_SHELLS = 96, 6
NUM_ON_LINE, FEW_WAYS, FEW_SHELLS = 6, 32, 3
FEW_RINGS, FEW_ROUND = 4, 8
TIPS_AT_ONCE = 32


@one_line
@dataclass(frozen=True, slots=True)
class NeedleErrors:
    """Standard deviations of the needle's direction and position around the planned values.

    The defaults are common knowledge, not measured.
    """

    angle_deg: float = 4.0
    """Standard deviation of the needle's direction in degrees, on each of the two axes across the needle."""
    tip_mm: float = 0.7
    """Standard deviation of the position of the scope's tip in mm, on each of the two axes across the needle."""

    def __post_init__(self) -> None:
        """Raise an error if a field of this `NeedleErrors` has an invalid value."""
        check_fields(self, angle_deg=any_number(), tip_mm=any_number())
        for name, value, most in (("angle_deg", self.angle_deg, 45.0), ("tip_mm", self.tip_mm, 20.0)):
            if not (math.isfinite(value) and 0.0 <= value <= most):
                raise UsageError(f"{name}: expected 0 to {most:g}; found {value}", code="plan.errors")


def hit_share(
    nodule: Nodule,
    tip_lps: Points,
    aim_lps: Points,
    reach_mm: float,
    errors: NeedleErrors,
    *,
    moved_mm: float = 0.0,
    shift_lps: tuple[float, float, float] | None = None,
) -> float:
    """Return the share of needle positions that go through the nodule within their reach.

    Parameters
    ----------
    nodule
        The target.
    tip_lps, aim_lps
        (3,) LPS mm: point where the needle leaves the scope, and point that it is aimed at.
    reach_mm
        Length of the needle beyond the tip.
    errors
        Gaussian errors of direction and position, combined at the distance of the aim.
    moved_mm
        Radius of the ball round its place in the CT in which the nodule may be; the needle is not aimed again.
    shift_lps
        Shift of the nodule: the middle of the ball may be anywhere from its place in the CT to this shift.

    Returns
    -------
    float
        Share, 0 to 1.
    """
    along = aim_lps - tip_lps
    distance = float(np.linalg.norm(along))
    if distance < 1e-6:
        return 1.0
    along = along / distance
    sigma = math.hypot(math.radians(errors.angle_deg), errors.tip_mm / distance)
    if moved_mm <= 0.0 and shift_lps is None:
        return _share(nodule, tip_lps[None], _cone(along, sigma, NUM_RINGS, NUM_ROUND), reach_mm)
    num_ways, num_shells = (NUM_WAYS, NUM_SHELLS) if shift_lps is None else (FEW_WAYS, FEW_SHELLS)
    ball = fibonacci_sphere(num_ways)
    # The shells have equal volumes, so each shell has equal weight.
    radii = moved_mm * ((np.arange(num_shells) + 0.5) / num_shells) ** (1.0 / 3.0)
    shifts = (radii[:, None, None] * ball).reshape(-1, 3)
    if shift_lps is not None:
        line = (np.arange(NUM_ON_LINE) + 0.5)[:, None] / NUM_ON_LINE * np.array(shift_lps)
        shifts = (line[:, None] + shifts).reshape(-1, 3)
    return _share(nodule, tip_lps - shifts, _cone(along, sigma, FEW_RINGS, FEW_ROUND), reach_mm)


def ball_hit_shares(
    distance_mm: NDArray[np.float64],
    off_rad: NDArray[np.float64],
    radius_mm: float,
    reach_mm: float,
    errors: NeedleErrors,
) -> NDArray[np.float64]:
    """Return the shares of needles that hit a ball, as `hit_share` does for a nodule.

    Parameters
    ----------
    distance_mm, off_rad
        (n,) distances of the ball's centre from the tip, and angles between the needle and the direction to the centre.
    radius_mm
        Radius of the ball.
    reach_mm, errors
        As for `hit_share`.

    Returns
    -------
    numpy.ndarray
        (n,) shares, 0 to 1.
    """
    needle = np.array([0.0, 0.0, 1.0])
    centre = distance_mm[:, None] * np.stack([np.sin(off_rad), np.zeros(len(off_rad)), np.cos(off_rad)], axis=1)
    found = np.ones(len(distance_mm))
    for n in np.flatnonzero(distance_mm > 1e-6):
        sigma = math.hypot(math.radians(errors.angle_deg), errors.tip_mm / float(distance_mm[n]))
        ways = _cone(needle, sigma, NUM_RINGS, NUM_ROUND)
        along = np.clip(ways @ centre[n], 0.0, reach_mm)
        found[n] = (np.linalg.norm(along[:, None] * ways - centre[n], axis=1) <= radius_mm).mean()
    return found


def _cone(along: Points, sigma_rad: float, num_rings: int, num_round: int) -> Points:
    """Return directions (n, 3) that each represent an equal share of a Gaussian distribution round an axis."""
    across, up = axes_across(along)
    share = (np.arange(num_rings) + 0.5) / num_rings
    # The angle of a two-dimensional Gaussian has a Rayleigh distribution.
    off = np.minimum(sigma_rad * np.sqrt(-2.0 * np.log1p(-share)), 1.5)
    turn = 2.0 * np.pi * (np.arange(num_round)[None] + 0.5 * (np.arange(num_rings)[:, None] % 2)) / num_round
    side = np.cos(turn)[..., None] * across + np.sin(turn)[..., None] * up
    found: Points = np.cos(off)[:, None, None] * along + np.sin(off)[:, None, None] * side
    return found.reshape(-1, 3)


def _share(nodule: Nodule, tips: Points, ways: Points, reach_mm: float) -> float:
    at = np.arange(0.0, reach_mm + 1e-9, STEP_MM)
    lines = at[None, :, None] * ways[:, None, :]
    num = 0
    for first in range(0, len(tips), TIPS_AT_ONCE):
        points = tips[first : first + TIPS_AT_ONCE, None, None] + lines
        num += int(nodule.contains(points.reshape(-1, 3)).reshape(-1, len(at)).any(axis=1).sum())
    return num / (len(tips) * len(ways))


def axes_across(along: Points) -> tuple[Points, Points]:
    """Return two unit vectors (..., 3) perpendicular to directions (..., 3) and to each other."""
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along), axis=-1)])
    across /= np.sqrt((across * across).sum(axis=-1, keepdims=True))
    return across, np.cross(along, across)


@cache
def fibonacci_sphere(num: int) -> Points:
    """Return unit vectors (num, 3) spread evenly over the sphere."""
    n = np.arange(num)
    z = 1.0 - (2.0 * n + 1.0) / num
    across = np.sqrt(1.0 - z * z)
    turn = np.pi * (3.0 - math.sqrt(5.0)) * n
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
