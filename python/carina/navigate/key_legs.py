"""Legs between key frames: curves through space or along an airway, with the directions of the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carina.display import one_line
from carina.errors import UsageError
from carina.navigate.flight_path import FlightPath
from carina.navigate.rotation import orthonormal, rotation_from_vector, vector_from_rotation
from carina.scopes import upright
from carina.scopes.pose import ANTERIOR_LPS

Points = NDArray[np.float64]

STEP_MM = 0.5
MAX_SAMPLES = 400
# Lengths below this count as zero: two equal poses can differ by this much after they were saved and read.
ZERO_LENGTH_MM = 1e-6
# Angle in radians between two legs above which the flight stops at the key frame between them.
BEND_RAD = math.radians(40.0)
# Half the length of the airway over which the direction of the camera is averaged, so that the camera turns smoothly
# into a fork.
DIRECTION_MEAN_MM = 8.0
# The path moves from a key frame to the centreline over four times their distance, and over at least EASE_MM.
EASE, EASE_MM = 4.0, 4.0
# Maximum distance of the rounded path from the corner of the centrelines at a fork, where both lumens are one.
ROUND_MM = 1.0
CORNER_MM = 2.0
# Cosine of the angle to the anterior axis above which "anterior up" is unstable.
LEVEL_LIMIT = 0.9


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class AirwayWay:
    """Centreline of the airways between the positions of two key frames.

    Parameters
    ----------
    points_lps
        ``(n, 3)``, LPS mm, two or more, in the direction of the flight.
    apex
        Index of the point nearest to the root: before it the flight withdraws, after it the flight advances.

    Raises
    ------
    UsageError
        ``navigate.keys``: if the points or the index are invalid.
    """

    points_lps: Points
    apex: int

    def __post_init__(self) -> None:
        """Convert the points to float64 and check the fields."""
        points = np.array(self.points_lps, dtype=np.float64)
        if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 2 or not np.isfinite(points).all():
            raise UsageError(
                "a path through airways needs at least two points, each of three numbers", code="navigate.keys"
            )
        if not 0 <= self.apex < len(points):
            raise UsageError(f"a path of {len(points)} points has no point number {self.apex}", code="navigate.keys")
        object.__setattr__(self, "points_lps", points)


@dataclass(slots=True, eq=False)
class Leg:
    """Leg, the part of a flight from one key frame to the next.

    Positions depend on the distance flown; directions depend on the distance and the fraction of the time.
    """

    start: Points
    """Pose ``lps_from_camera`` (4, 4) at the start of the leg."""
    end: Points
    place_mm: NDArray[np.float64]
    points_lps: Points
    tangents: Points
    """Unit tangents (n, 3) of the path at the leg's points; zeros for a leg of no length."""
    frames: Points | None = None
    """Directions of the airway at the points, ``(n, 3, 3)``, distal forward.

    With None the directions are interpolated between the two ends.
    """
    rest_mm: float | None = None
    """Position in mm of a rest, where the path turns sharply from one bronchus into its sibling.

    The value is None without a rest.
    """

    @property
    def length_mm(self) -> float:
        """Length in mm of the leg, the part of a flight between two key frames."""
        return float(self.place_mm[-1])

    @property
    def turn_rad(self) -> float:
        """Angle in radians between the camera's axes at the start and at the end of the leg."""
        return float(np.linalg.norm(vector_from_rotation(orthonormal(self.start[:3, :3].T @ self.end[:3, :3]))))

    def position(self, mm: float) -> Points:
        """Return the point (3,), LPS mm, at a distance in mm from the start of the leg.

        Cubic interpolation with tangents makes the velocity continuous.
        """
        n, t, length = self._knot_interval(mm)
        if length == 0.0:
            return np.asarray(self.points_lps[n])
        t2, t3 = t * t, t * t * t
        return np.asarray(
            (2 * t3 - 3 * t2 + 1) * self.points_lps[n]
            + (t3 - 2 * t2 + t) * length * self.tangents[n]
            + (3 * t2 - 2 * t3) * self.points_lps[n + 1]
            + (t3 - t2) * length * self.tangents[n + 1]
        )

    def rotation(self, mm: float, share: float) -> Points:
        """Return the camera's axes (3, 3) at a distance from the start of the leg and a fraction of its time.

        The offset of a key frame's direction from the airway's direction decreases along the leg.
        """
        eased = share * share * (3.0 - 2.0 * share)
        a, b = self.start[:3, :3], self.end[:3, :3]
        if self.frames is None:
            return _turned_level(a, b, eased)
        n, t, _ = self._knot_interval(mm)
        here = orthonormal((1.0 - t) * self.frames[n] + t * self.frames[n + 1])
        off_a, off_b = orthonormal(self.frames[0].T @ a), orthonormal(self.frames[-1].T @ b)
        return orthonormal(here @ off_a @ rotation_from_vector(eased * vector_from_rotation(off_a.T @ off_b)))

    def _knot_interval(self, mm: float) -> tuple[int, float, float]:
        n = min(max(int(np.searchsorted(self.place_mm, mm, side="right")) - 1, 0), len(self.place_mm) - 2)
        length = float(self.place_mm[n + 1] - self.place_mm[n])
        return n, (0.0 if length == 0.0 else min(max((mm - float(self.place_mm[n])) / length, 0.0), 1.0)), length


def build_legs(poses: Sequence[Points], ways: Sequence[AirwayWay | None]) -> tuple[list[Leg], list[bool]]:
    """Build the legs between poses, and find the poses at which the flight must rest.

    The flight rests where its direction changes sharply.

    Parameters
    ----------
    poses
        n matrices ``lps_from_camera``.
    ways
        n - 1: the airway between a pose and the next, or None for a curve through space.

    Notes
    -----
    A leg through space is a centripetal Catmull-Rom curve (Yuksel, Schaefer, Keyser, "Parameterization and applications
    of Catmull-Rom curves", CAD 43(7), 2011), which of its family makes no loops and stays nearest to the chords. On it
    the gaze turns along the great circle with a steady horizon; along an airway the camera turns with the airway.
    """
    at = np.array([pose[:3, 3] for pose in poses])
    legs: list[Leg | None] = [
        None if way is None else _leg_along_airway(way, poses[n], poses[n + 1]) for n, way in enumerate(ways)
    ]
    found = [leg or _through_space(n, at, poses, legs) for n, leg in enumerate(legs)]
    rests = [True] * len(poses)
    for n in range(1, len(found)):
        before, after = found[n - 1], found[n]
        if before.length_mm <= ZERO_LENGTH_MM or after.length_mm <= ZERO_LENGTH_MM:
            continue
        one, other = before.tangents[-1], after.tangents[0]
        if float(one @ other) > math.cos(BEND_RAD):
            shared = (one + other) / np.linalg.norm(one + other)
            before.tangents[-1] = after.tangents[0] = shared
            rests[n] = False
    return found, rests


def _through_space(n: int, at: Points, poses: Sequence[Points], airways: Sequence[Leg | None]) -> Leg:
    start, end = at[n], at[n + 1]
    chord = end - start
    length = float(np.linalg.norm(chord))
    if length <= ZERO_LENGTH_MM:
        still = np.zeros((2, 3))
        return Leg(poses[n], poses[n + 1], np.zeros(2), np.array([start, end]), still)
    knot = math.sqrt(length)

    def slope(beyond: int, leg_beyond: int, tangent_at: int) -> Points:
        """Return the slope of the flight curve at one end of a leg, per knot interval.

        ``beyond`` is the next key frame outside the leg, and ``leg_beyond`` the leg to it. If that leg follows an
        airway, its tangent at index ``tangent_at`` gives the slope.
        """
        if 0 <= leg_beyond < len(airways):
            airway = airways[leg_beyond]
            if airway is not None:
                return np.asarray(airway.tangents[tangent_at] * length)
            outer = at[beyond] - (start if beyond < n else end)
            outer = -outer if beyond < n else outer
            far = float(np.linalg.norm(outer))
            if far > ZERO_LENGTH_MM:
                gap = math.sqrt(far)
                return np.asarray(knot * (outer / gap - (outer + chord) / (gap + knot)) + chord)
        return np.asarray(chord, dtype=np.float64)

    a, b = slope(n - 1, n - 1, -1), slope(n + 2, n + 1, 0)
    t = np.linspace(0.0, 1.0, min(max(math.ceil(length / STEP_MM), 8), MAX_SAMPLES) + 1)[:, None]
    t2, t3 = t * t, t * t * t
    points = (2 * t3 - 3 * t2 + 1) * start + (t3 - 2 * t2 + t) * a + (3 * t2 - 2 * t3) * end + (t3 - t2) * b
    slopes = (6 * t2 - 6 * t) * start + (3 * t2 - 4 * t + 1) * a + (6 * t - 6 * t2) * end + (3 * t2 - 2 * t) * b
    return _spline_leg(poses[n], poses[n + 1], points, slopes)


def _leg_along_airway(way: AirwayWay, start: Points, end: Points) -> Leg | None:
    """Return the leg along the airways' centreline; None if the airway between the key frames is too short."""
    given_mm = _cumulative(way.points_lps)
    if given_mm[-1] <= ZERO_LENGTH_MM:
        return None
    path = FlightPath(way.points_lps, max_deviation_mm=ROUND_MM)
    points = path.points_lps
    mm = np.linspace(0.0, path.length_mm, len(points))
    off_start, off_end = start[:3, 3] - points[0], end[:3, 3] - points[-1]
    away = float(np.linalg.norm(off_start)) + float(np.linalg.norm(off_end))
    if path.length_mm <= away:
        return None
    half = path.length_mm / 2.0
    # The centreline is where an airway is widest. Therefore the path soon moves from a key frame beside it to it,
    # and leaves it late.
    leaving = _smooth(mm / min(half, max(EASE * float(np.linalg.norm(off_start)), EASE_MM)))
    coming = _smooth((mm[-1] - mm) / min(half, max(EASE * float(np.linalg.norm(off_end)), EASE_MM)))
    shifted = points + np.outer(1.0 - leaving, off_start) + np.outer(1.0 - coming, off_end)
    leg = _spline_leg(start, end, shifted, np.gradient(shifted, axis=0))
    apex_mm = float(given_mm[way.apex])
    leg.frames = _airway_frames(points, mm, apex_mm)
    leg.rest_mm = _corner(leg, float(np.interp(apex_mm, mm, leg.place_mm)))
    return leg


def _corner(leg: Leg, place_mm: float) -> float | None:
    """Return the position in mm at which the path turns sharply, if the path does so near ``place_mm``, else None."""
    before = int(np.searchsorted(leg.place_mm, place_mm - CORNER_MM))
    after = int(np.searchsorted(leg.place_mm, place_mm + CORNER_MM))
    if before == 0 or after == len(leg.place_mm):
        return None
    return place_mm if float(leg.tangents[before] @ leg.tangents[after]) < math.cos(BEND_RAD) else None


def _spline_leg(start: Points, end: Points, points: Points, slopes: Points) -> Leg:
    points[0], points[-1] = start[:3, 3], end[:3, 3]
    lengths = np.linalg.norm(slopes, axis=1)
    # A slope vanishes where the curve turns back on itself; there the chord gives the direction.
    chords = np.gradient(points, axis=0)
    vanished = lengths < 1e-9
    slopes[vanished] = chords[vanished]
    lengths = np.maximum(np.linalg.norm(slopes, axis=1), 1e-12)
    return Leg(start, end, _cumulative(points), points, slopes / lengths[:, None])


def _airway_frames(points: Points, mm: NDArray[np.float64], apex_mm: float) -> Points:
    """Return camera axes (n, 3, 3) that look distally, averaged along the airway, with a level horizon if possible."""
    tangents = np.gradient(points, axis=0)
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1), 1e-12)[:, None]
    distal = np.where((mm < apex_mm)[:, None], -tangents, tangents)
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(distal, axis=0)])
    step = mm[1] - mm[0]
    numbers = np.arange(len(mm))
    # The averaging window is narrower near the ends of the airway, so that its middle stays the averaged point.
    reach = np.minimum(np.minimum(numbers, numbers[::-1]), max(int(DIRECTION_MEAN_MM / step), 0))
    forwards = sums[numbers + reach + 1] - sums[numbers - reach]
    norms = np.linalg.norm(forwards, axis=1)
    # A mean direction of length 0 needs opposite directions at a fork, which only defective points have.
    forwards = np.where((norms > 1e-9)[:, None], forwards / np.maximum(norms, 1e-12)[:, None], distal)
    return _with_up_directions(np.asarray(forwards, dtype=np.float64))


def _with_up_directions(forwards: Points) -> Points:
    """Return camera axes for viewing directions: level if all are far from the anterior axis, else untwisted."""
    level = bool((np.abs(forwards @ ANTERIOR_LPS) < LEVEL_LIMIT).all())
    frames = np.empty((len(forwards), 3, 3))
    up = upright(forwards[0])
    for n, forward in enumerate(forwards):
        # The up direction is transported without twist; where the horizon is level, it is computed again.
        up = upright(forward) if level else up - float(up @ forward) * forward
        up = up / np.linalg.norm(up)
        frames[n] = np.column_stack([np.cross(-up, forward), -up, forward])
    return frames


def _turned_level(a: Points, b: Points, share: float) -> Points:
    """Interpolate two rotations: the gaze on the great circle, the roll against the horizon in proportion.

    If the gaze passes too near to the anterior axis for a horizon, or turns back by 180 degrees, the result is the
    shortest rotation (Shoemake, "Animating rotation with quaternion curves", SIGGRAPH 1985).
    """
    axis = np.cross(a[:, 2], b[:, 2])
    sine, cosine = float(np.linalg.norm(axis)), float(a[:, 2] @ b[:, 2])
    shortest = vector_from_rotation(orthonormal(a.T @ b))
    if sine < 1e-6:
        return orthonormal(a @ rotation_from_vector(share * shortest))
    angle = math.atan2(sine, cosine)
    forwards = np.array([rotation_from_vector(axis / sine * angle * t) @ a[:, 2] for t in np.linspace(0.0, 1.0, 9)])
    if not (np.abs(forwards @ ANTERIOR_LPS) < LEVEL_LIMIT).all():
        return orthonormal(a @ rotation_from_vector(share * shortest))
    forward = rotation_from_vector(axis / sine * angle * share) @ a[:, 2]
    roll_a, roll_b = _roll(a), _roll(b)
    roll = roll_a + share * math.remainder(roll_b - roll_a, math.tau)
    return orthonormal(_with_up_directions(forward[None])[0] @ rotation_from_vector(np.array([0.0, 0.0, roll])))


def _roll(rotation: Points) -> float:
    """Return the roll angle of a camera rotation against the horizon, in radians."""
    level = _with_up_directions(rotation[:, 2][None])[0].T @ rotation
    return math.atan2(float(level[1, 0]), float(level[0, 0]))


def _smooth(share: NDArray[np.float64]) -> NDArray[np.float64]:
    t = np.clip(share, 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t))


def _cumulative(points: Points) -> NDArray[np.float64]:
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
