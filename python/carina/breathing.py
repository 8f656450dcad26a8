"""Breathing and cough: the deformation of the chest at a time, for pictures, wall, tree and contact alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina.argument_checks import (
    COORDINATE_MM,
    array_of,
    bounded,
    check_arguments,
    check_fields,
    coordinates,
    each,
    instance,
    number_from,
)
from carina.display import one_line
from carina.errors import GeometryError, UsageError

__all__ = ["Breathing", "ChestDeformation", "ChestFrame", "ChestMotion"]

Points = NDArray[np.float64]

MOVED_TEXT = "simulated breathing"
"""Text in every saved picture of a moved patient."""
COUGH_S = 0.5
"""Duration of a cough, s."""
COUGH_SHIFT_MM = 10.0
"""Shift of the lung bases towards the head in a cough, mm: the carina moves by half of it."""
EXHALED_POWER = 4
"""Exponent of the cosine over time; with 4, the chest is near expiration for half of a period."""
MAX_BREATHING_S = 86_400.0
"""Longest time of a breathing, s; a chest that has breathed for longer rests in its last state."""
LEAST_HEIGHT_MM = 60.0
"""Minimum height of a tree of airways whose breathing can be simulated, mm."""


class _Branch(Protocol):
    @property
    def points(self) -> Points: ...


class _Tree(Protocol):
    @property
    def branches(self) -> Sequence[_Branch]: ...


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ChestDeformation:
    """Affine map from the CT at rest to the patient at one instant, LPS mm.

    Examples
    --------
    >>> import numpy as np
    >>> moved = ChestDeformation(np.diag([1.0, 1.0, 0.95, 1.0]))
    >>> moved.points([[0.0, 0.0, -100.0]]).tolist()
    [[0.0, 0.0, -95.0]]
    >>> ChestDeformation(np.eye(4)).is_rest
    True
    """

    lps_from_rest: NDArray[np.float64]
    """Matrix (4, 4) from positions in the CT at rest to patient space, mm; it neither mirrors nor folds the chest."""

    def __post_init__(self) -> None:
        """Check the matrix and store a copy as float64."""
        check_fields(self, lps_from_rest=array_of(4, 4))
        matrix = np.array(self.lps_from_rest, dtype=np.float64)
        if not np.isfinite(matrix).all() or not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
            raise UsageError(
                f"a deformation must be a 4x4 matrix of finite numbers whose last row is 0, 0, 0, 1; found "
                f"{matrix.tolist()}",
                code="breathing.deformation",
            )
        stretches = np.linalg.svd(matrix[:3, :3], compute_uv=False)
        if np.linalg.det(matrix[:3, :3]) <= 0.0 or stretches[-1] < 0.2 or stretches[0] > 5.0:
            least, most = stretches[-1], stretches[0]
            raise UsageError(
                "a deformation must not mirror the chest, and must change lengths by a factor of 0.2 to 5; found "
                f"factors {least:.3g} to {most:.3g}, determinant {np.linalg.det(matrix[:3, :3]):.3g}",
                code="breathing.deformation",
            )
        matrix.flags.writeable = False
        object.__setattr__(self, "lps_from_rest", matrix)

    @property
    def is_rest(self) -> bool:
        """Whether the map moves nothing; pictures and distances are then those without breathing, bit for bit."""
        return bool(np.array_equal(self.lps_from_rest, np.eye(4)))

    @property
    def rest_from_lps(self) -> NDArray[np.float64]:
        """Matrix (4, 4) from patient space to positions in the CT at rest, mm."""
        inverse: NDArray[np.float64] = np.linalg.inv(self.lps_from_rest).astype(np.float64, copy=False)
        return inverse

    @check_arguments(rest_lps=coordinates(COORDINATE_MM))
    def points(self, rest_lps: ArrayLike) -> Points:
        """Return the positions (n, 3) in patient space of points (n, 3) of the CT at rest, LPS mm."""
        points = np.atleast_2d(np.asarray(rest_lps, dtype=np.float64))
        return points if self.is_rest else points @ self.lps_from_rest[:3, :3].T + self.lps_from_rest[:3, 3]

    @check_arguments(points_lps=coordinates(COORDINATE_MM))
    def rest_points(self, points_lps: ArrayLike) -> Points:
        """Return the positions (n, 3) in the CT at rest of points (n, 3) in patient space, LPS mm."""
        points = np.atleast_2d(np.asarray(points_lps, dtype=np.float64))
        if self.is_rest:
            return points
        inverse = self.rest_from_lps
        return points @ inverse[:3, :3].T + inverse[:3, 3]

    @check_arguments(rest_lps=coordinates(COORDINATE_MM), radius_mm=array_of(None))
    def radii_mm(self, rest_lps: ArrayLike, radius_mm: ArrayLike) -> NDArray[np.float64]:
        """Return the radii (n,) in mm, at the instant, of the lumen along a centreline.

        A radius is that of the circle with the area of the lumen's section across the centreline.

        Parameters
        ----------
        rest_lps
            (n, 3) points of the centreline in the CT at rest, LPS mm, two or more.
        radius_mm
            (n,) radii at rest, mm.
        """
        radius = np.asarray(radius_mm, dtype=np.float64)
        points = np.atleast_2d(np.asarray(rest_lps, dtype=np.float64))
        if self.is_rest or len(points) < 2:
            return radius
        along = np.gradient(points, axis=0)
        lengths = np.linalg.norm(along, axis=1)
        moved = np.linalg.norm(along @ self.lps_from_rest[:3, :3].T, axis=1)
        # The volume of a slice of the lumen changes by the determinant, and its thickness by the stretch along it.
        stretch = np.divide(moved, lengths, out=np.ones_like(lengths), where=lengths > 0.0)
        radii: NDArray[np.float64] = radius * np.sqrt(np.linalg.det(self.lps_from_rest[:3, :3]) / stretch)
        return radii


@one_line
@dataclass(frozen=True, slots=True)
class ChestFrame:
    """Heights between which the chest moves, and the axis of its central airways, LPS mm.

    Examples
    --------
    >>> ChestFrame(top_z_mm=110.0, base_z_mm=-130.0).height_mm
    240.0
    """

    top_z_mm: float
    """Height of the thoracic inlet, which breathing does not move."""
    base_z_mm: float
    """Height of the lowest airways, which move by the full amplitude."""
    axis_x_mm: float = 0.0
    """x of the vertical axis towards which a cough narrows the airways."""
    axis_y_mm: float = 0.0
    """LPS y coordinate of the central airways' axis, mm."""

    def __post_init__(self) -> None:
        """Raise an error if the heights do not describe a chest."""
        check_fields(
            self,
            top_z_mm=bounded(COORDINATE_MM, unit="mm"),
            base_z_mm=bounded(COORDINATE_MM, unit="mm"),
            axis_x_mm=bounded(COORDINATE_MM, unit="mm"),
            axis_y_mm=bounded(COORDINATE_MM, unit="mm"),
        )
        if not self.height_mm >= LEAST_HEIGHT_MM:
            raise GeometryError(
                f"breathing: expected airways over {LEAST_HEIGHT_MM:.0f} mm or more from top to bottom; found "
                f"{self.height_mm:.0f} mm",
                code="breathing.height",
            )

    @property
    def height_mm(self) -> float:
        """Distance from the lowest airways to the thoracic inlet, mm."""
        return self.top_z_mm - self.base_z_mm

    @classmethod
    def of_tree(cls, tree: _Tree) -> ChestFrame:
        """Return the frame of a chest with this :class:`carina.track.AirwayTree` in its CT at rest.

        Raises
        ------
        GeometryError
            If the tree is lower than 60 mm (code ``breathing.height``).
        """
        z = np.concatenate([branch.points[:, 2] for branch in tree.branches])
        x, y, _ = (float(v) for v in tree.branches[0].points[-1])
        return cls(float(z.max()), float(z.min()), x, y)


@one_line
@dataclass(frozen=True, slots=True)
class Breathing:
    """Quiet breathing, with coughs at given times; the CT shows the end of an inspiration.

    At expiration a point of the airways is shifted towards the head and to the back, in proportion to its distance from
    the thoracic inlet. A cough shifts the airways further and narrows them towards the vertical axis of the trachea.

    Examples
    --------
    >>> breath, chest = Breathing(), ChestFrame(110.0, -130.0)
    >>> breath.at(0.0, chest).is_rest
    True
    >>> exhaled = breath.at(1.8, chest)
    >>> exhaled.points([[0.0, 0.0, -130.0]]).round(3).tolist()
    [[0.0, 2.0, -118.0]]
    >>> exhaled.points([[0.0, 0.0, 0.0]]).round(1).tolist()
    [[0.0, 0.9, 5.5]]

    References
    ----------
    Linear growth with the distance from the manubrium: Wang 1998, Radiat Med 16:257. Amplitudes and period:
    Seppenwoolde 2002, IJROBP 53:822. Course over time: Lujan 1999, Med Phys 26:715. Narrowing: Boiselle 2009, Radiology
    252:255. Shift of the carina in deep expiration: Respiration 2020;99:771. Details: docs/decisions/0155.
    """

    craniocaudal_mm: float = 12.0
    """Shift of the lowest airways towards the head at expiration, 0 to 40 mm."""
    anteroposterior_mm: float = 2.0
    """Shift of the lowest airways to the back at expiration, 0 to 20 mm."""
    period_s: float = 3.6
    """Duration of one breath, 1 to 20 s."""
    phase: float = 0.0
    """Share of a period, 0 to 1, that has passed at time 0 since the end of an inspiration."""
    coughs_s: tuple[float, ...] = ()
    """Times at which coughs start, s."""
    collapse: float = 0.55
    """Share of the trachea's area, 0 to 0.8, that is closed at the strongest moment of a cough."""

    def __post_init__(self) -> None:
        """Raise an error if a field of this `Breathing` has an invalid value."""
        check_fields(
            self,
            craniocaudal_mm=number_from(0.0, 40.0, unit="mm"),
            anteroposterior_mm=number_from(0.0, 20.0, unit="mm"),
            period_s=number_from(1.0, 20.0, unit="s"),
            phase=number_from(0.0, 1.0),
            coughs_s=each(number_from(0.0, 86_400.0, unit="s"), most=10_000),
            collapse=number_from(0.0, 0.8),
        )
        object.__setattr__(self, "coughs_s", tuple(sorted(float(v) for v in self.coughs_s)))

    @classmethod
    @check_arguments(movement_mm=number_from(0.0, 40.0, unit="mm"), period_s=number_from(1.0, 20.0, unit="s"))
    def of_movement(cls, movement_mm: float, period_s: float) -> Breathing:
        """Return breathing with a shift of the lung bases towards the head, in mm, and a period, in s.

        The shift to the back has its published ratio to the shift towards the head.

        Examples
        --------
        >>> Breathing.of_movement(18.0, 5.0).anteroposterior_mm
        3.0
        """
        usual = cls()
        back_mm = movement_mm * usual.anteroposterior_mm / usual.craniocaudal_mm
        return cls(craniocaudal_mm=movement_mm, anteroposterior_mm=back_mm, period_s=period_s)

    @check_arguments(time_s=bounded(86_400.0, unit="s"))
    def expiration(self, time_s: float) -> float:
        """Return the state of breath at a time: 0 at the end of an inspiration, 1 at that of an expiration."""
        share = math.fmod(time_s / self.period_s + self.phase, 1.0)
        return 1.0 - math.cos(math.pi * share) ** EXHALED_POWER

    @check_arguments(time_s=bounded(86_400.0, unit="s"))
    def cough(self, time_s: float) -> float:
        """Return the strength of the cough at a time in s: 0 without a cough, 1 at its strongest moment."""
        since = [time_s - start for start in self.coughs_s if 0.0 < time_s - start < COUGH_S]
        return math.sin(math.pi * since[-1] / COUGH_S) ** 2 if since else 0.0

    @check_arguments(time_s=bounded(86_400.0, unit="s"), chest=instance(ChestFrame, "use ChestFrame.of_tree"))
    def at(self, time_s: float, chest: ChestFrame) -> ChestDeformation:
        """Return the deformation of a chest at a time in s.

        The map is exactly the identity at the end of an inspiration, and at any time if both amplitudes are 0 and there
        is no cough.
        """
        exhaled, cough = self.expiration(time_s), self.cough(time_s)
        up_mm = self.craniocaudal_mm * exhaled + COUGH_SHIFT_MM * cough
        back_mm = self.anteroposterior_mm * exhaled
        narrowed = 1.0 - cough * (1.0 - math.sqrt(1.0 - self.collapse))
        height, top = chest.height_mm, chest.top_z_mm
        # A row of a coordinate that does not move is that of the identity, without a sum that could round.
        matrix = np.eye(4)
        if narrowed != 1.0:
            matrix[0, [0, 3]] = narrowed, (1.0 - narrowed) * chest.axis_x_mm
        if narrowed != 1.0 or back_mm != 0.0:
            matrix[1, 1:] = narrowed, -back_mm / height, (1.0 - narrowed) * chest.axis_y_mm + back_mm * top / height
        if up_mm != 0.0:
            matrix[2, 2:] = 1.0 - up_mm / height, up_mm * top / height
        return ChestDeformation(matrix)

    def to_json(self) -> dict[str, Any]:
        """Return the breathing as a JSON object, from which :meth:`from_json` restores it exactly."""
        return {
            "craniocaudal_mm": self.craniocaudal_mm,
            "anteroposterior_mm": self.anteroposterior_mm,
            "period_s": self.period_s,
            "phase": self.phase,
            "coughs_s": list(self.coughs_s),
            "collapse": self.collapse,
        }

    @classmethod
    def from_json(cls, document: Any) -> Breathing:
        """Return the breathing of a JSON object.

        Raises
        ------
        UsageError
            If a field is missing, unknown or out of range.

        Examples
        --------
        >>> Breathing.from_json(Breathing(phase=0.25).to_json()) == Breathing(phase=0.25)
        True
        """
        names = set(Breathing().to_json())
        if not isinstance(document, dict) or set(document) != names:
            raise UsageError(
                f"breathing: expected an object with the fields {', '.join(sorted(names))}; found {document!r}",
                code="breathing.document",
            )
        if not isinstance(document["coughs_s"], list):
            raise UsageError(
                f"breathing: expected coughs_s to be a list; found {document['coughs_s']!r}", code="breathing.document"
            )
        return cls(**{**document, "coughs_s": tuple(document["coughs_s"])})

    @property
    def words(self) -> str:
        """Text that a picture with breathing contains, such as *simulated breathing, 12 mm every 3.6 s*."""
        parts = [f"simulated breathing, {self.craniocaudal_mm:g} mm every {self.period_s:g} s"]
        if self.coughs_s:
            parts.append("cough")
        return " and ".join(parts)


@one_line
@dataclass(frozen=True, slots=True)
class ChestMotion:
    """Breathing of a patient with a known chest on a clock; the tissue round the tip carries the tip along.

    Examples
    --------
    >>> motion = ChestMotion(Breathing(), ChestFrame(110.0, -130.0), began_s=2.0)
    >>> motion.at(2.0).is_rest, motion.at(3.8).is_rest
    (True, False)
    >>> ChestMotion.from_json(motion.to_json()) == motion
    True
    """

    breathing: Breathing
    chest: ChestFrame
    began_s: float = 0.0
    """Time of the clock at which the time of the breathing is 0, s."""

    def __post_init__(self) -> None:
        """Raise an error if a field has an invalid value."""
        check_fields(
            self,
            breathing=instance(Breathing, "create a carina.breathing.Breathing"),
            chest=instance(ChestFrame, "use ChestFrame.of_tree"),
            began_s=bounded(1e9, unit="s"),
        )

    def at(self, clock_s: float) -> ChestDeformation:
        """Return the deformation at a time of the clock, s; before its beginning the chest is at rest."""
        return self.breathing.at(min(max(clock_s - self.began_s, 0.0), MAX_BREATHING_S), self.chest)

    def to_json(self) -> dict[str, Any]:
        """Return the motion as a JSON object, from which :meth:`from_json` restores it exactly."""
        chest = self.chest
        return {
            "breathing": self.breathing.to_json(),
            "top_z_mm": chest.top_z_mm,
            "base_z_mm": chest.base_z_mm,
            "axis_x_mm": chest.axis_x_mm,
            "axis_y_mm": chest.axis_y_mm,
            "began_s": self.began_s,
        }

    @classmethod
    def from_json(cls, document: Any) -> ChestMotion:
        """Return the motion of a JSON object.

        Raises
        ------
        UsageError
            If a field is missing, unknown or out of range.
        GeometryError
            If the heights do not describe a chest.
        """
        names = {"breathing", "top_z_mm", "base_z_mm", "axis_x_mm", "axis_y_mm", "began_s"}
        if not isinstance(document, dict) or set(document) != names:
            raise UsageError(
                f"breathing: expected an object with the fields {', '.join(sorted(names))}; found {document!r}",
                code="breathing.document",
            )
        places = {name: document[name] for name in names - {"breathing", "began_s"}}
        return cls(Breathing.from_json(document["breathing"]), ChestFrame(**places), document["began_s"])
