"""Movement of a bronchoscope in the lumen by insertion, roll and flexion, constrained by the wall."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from carina import _core
from carina.argument_checks import (
    COORDINATE_MM,
    array_of,
    bounded,
    check_arguments,
    choice,
    instance,
    name_or,
    numbers_within,
    text_of,
)
from carina.display import one_line
from carina.errors import UsageError, refuse_pickle
from carina.scopes.library import ScopePreset, scope_preset
from carina.scopes.pose import Pose, pose_of_valid_matrix
from carina.scopes.wall_field import WallField
from carina.value import FrozenValue

ScopeLimit = Literal["none", "entry", "wall", "narrow", "length", "flexion"]
OperatorPosition = Literal["head", "facing"]
Point = tuple[float, float, float]

# Defaults for a scope without maker's data: those of the generic class (library), and the largest flexion.
_RIGID_MM = 10.0
_BENDING_MM = (30.0, 50.0)
_FLEXION_DEG = (180.0, 130.0)
_LENGTH_MM = 600.0


@one_line
@dataclass(frozen=True, slots=True)
class Contact:
    """Contact of the scope's tip with the wall."""

    point_lps: Point
    """Point of the wall that the tip touches, LPS mm."""
    normal_lps: Point
    """Unit vector that points from the wall into the lumen, LPS."""
    depth_mm: float
    """Distance in mm by which the commanded tip exceeds the position that the wall permits."""


@one_line
@dataclass(frozen=True, slots=True)
class ContactRecord:
    """Summary of all contacts since the scope was placed."""

    count: int = 0
    """Number of contacts of the tip with the wall."""
    time_s: float = 0.0
    """Total time in s in which the tip was in contact with the wall."""
    max_depth_mm: float = 0.0
    """Largest depth in mm by which a contact is inside the wall (`Contact.depth_mm`)."""


class ScopeHold(FrozenValue, frozen=True):
    """Insertion, roll and lever flexion of a scope, as the operator sets them."""

    insertion_mm: float
    """Insertion in mm from the start of the path along which the scope enters (the trachea's start)."""
    roll_rad: float
    """Roll of the shaft in radians, clockwise as the operator sees it."""
    flexion_rad: float
    """Flexion of the tip in radians; above 0 towards the instrument's up, below 0 down."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ScopeState:
    """State of the simulated scope after a move."""

    pose: Pose
    """Pose of the tip's face, turned by 180 degrees about its axis for an operator who faces the patient.

    For the operator see `ScopeDrive.operator`; `ScopePreset.camera_pose` returns the camera of a forward-oblique scope
    for this pose.
    """
    hold: ScopeHold
    """Insertion, roll and flexion that the scope has reached."""
    contact: Contact | None
    """Contact of the tip with the wall, or None if the tip touches no wall."""
    red_out: float
    """Loss of the view by contact: 0 for a clear view to 1 where the lens lies on the wall and the picture is red."""
    limit: ScopeLimit
    """Reason why the scope did not reach the commanded position.

    ``none``; ``entry`` (drawn back to the entry); ``wall`` (the tip is pressed against the wall); ``narrow`` (the lumen
    is too narrow: see `passable_mm`); ``length`` (end of the scope's length); ``flexion`` (the lever's stop).
    """
    passable_mm: float | None
    """Largest diameter in mm of a scope that would pass the narrow place, if the limit is ``narrow``, else None."""
    record: ContactRecord
    """Summary of all contacts since the scope was placed."""

    @property
    def insertion_mm(self) -> float:
        """Insertion of the scope, mm; see `ScopeHold`."""
        return self.hold.insertion_mm

    @property
    def roll_rad(self) -> float:
        """Roll of the scope, radians; see `ScopeHold`."""
        return self.hold.roll_rad

    @property
    def flexion_rad(self) -> float:
        """Flexion of the scope, radians; see `ScopeHold`."""
        return self.hold.flexion_rad


class ScopeDrive:
    """Simulated bronchoscope in a lumen.

    The scope is modelled as an elastic axis, stiff against twist: a rigid tip, a bending section whose rest shape has
    the lever's curvature, and a shaft whose rest shape is straight and which follows the airway behind the tip. Tip and
    shaft cannot leave the lumen. On one build, the same samples give the same states, bit for bit.

    Parameters
    ----------
    field
        Signed distance to the wall.
    scope
        The instrument or its name in the library. The generic scope's values replace unknown values. Diameters are the
        stated ones (`FIT_MARGIN_MM` is for plans).
    start_path
        (n, 3) LPS mm, path of the scope's entry: the trachea's centreline, or a route from the tree's root. The scope
        enters at the first position that is wide enough.
    up_lps
        Direction of upward flexion at roll 0, which is up in the picture of an operator at the head; default anterior.
    operator
        ``head`` (at the patient's head) or ``facing``, whose picture is turned by 180 degrees. Only the picture is
        turned: the position of the scope, and insertion, roll and flexion of the instrument, are the same.
    cords_mm
        Position of the vocal cords in mm of the start path, below 0 if they lie above it; None if unknown.

    Raises
    ------
    UsageError
        If the path is too narrow for the scope, or has no direction (code ``scope.drive``). If the wall is that of a
        moved patient (code ``scope.wall``).

    Examples
    --------
    A tube of 6 mm radius along z.

    >>> z, y, x = np.mgrid[0:60, -10:11, -10:11].astype(np.float32)
    >>> field = WallField.from_distances(6.0 - np.hypot(x, y), np.array(
    ...     [[1.0, 0, 0, -10], [0, 1.0, 0, -10], [0, 0, 1.0, -60], [0, 0, 0, 1.0]]))
    >>> drive = ScopeDrive(field, "standard", [[0, 0, -5.0], [0, 0, -55.0]])
    >>> state = drive.drive(30.0, 0.0, 0.0, 0.1)
    >>> [round(v, 1) for v in state.pose.position_lps.tolist()]
    [0.0, 0.0, -35.0]
    """

    @check_arguments(
        field=instance(WallField, "make one with carina.wall_field"),
        scope=name_or(ScopePreset, "name one of carina.scopes.scope_presets"),
        start_path=numbers_within(),
        up_lps=array_of(3, optional=True),
        operator=text_of(80),
        cords_mm=bounded(COORDINATE_MM, optional=True, unit="mm"),
    )
    def __init__(
        self,
        field: WallField,
        scope: ScopePreset | str,
        start_path: ArrayLike,
        *,
        up_lps: ArrayLike | None = None,
        operator: OperatorPosition = "head",
        cords_mm: float | None = None,
    ) -> None:
        _check_operator(operator)
        if field.core.is_deformed:
            # The search for a contact steps by the distance, which after a deformation may exceed the true distance, so
            # that the scope could pass through a thin wall without a contact.
            raise UsageError(
                "ScopeDrive: expected the wall of the CT at rest; found a deformed wall, by whose distances contacts "
                "can be missed. Drive in the wall at rest, and move the poses with Pose.carried_by",
                code="scope.wall",
            )
        if cords_mm is not None and not math.isfinite(cords_mm):
            raise UsageError(
                f"expected the position of the vocal cords as a number in mm; found {cords_mm}", code="scope.drive"
            )
        preset = scope_preset(scope) if isinstance(scope, str) else scope
        up_deg, down_deg = preset.flexion_deg or _FLEXION_DEG
        sizes = (
            preset.tip_mm / 2.0,
            (preset.tube_mm or preset.tip_mm) / 2.0,
            preset.rigid_tip_mm or _RIGID_MM,
            float(np.mean(preset.bending_mm or _BENDING_MM)),
            math.radians(up_deg),
            math.radians(down_deg),
            preset.length_mm or _LENGTH_MM,
        )
        path = _point_array(start_path)
        up = None if up_lps is None else [float(v) for v in np.asarray(up_lps, dtype=np.float64)]
        self._core = _core.ScopeDrive(field.core, sizes, path, up)
        self._cords_mm = cords_mm
        self._scope = preset
        self._field = field
        self._flexion_rad = (sizes[5], sizes[4])
        self._operator: OperatorPosition = operator
        self._state_from_core = self._state_for_operator(self._core.state)

    def __copy__(self) -> ScopeDrive:
        """Return an independent copy of this `ScopeDrive`."""
        return self.copy()

    def __deepcopy__(self, _memo: object) -> ScopeDrive:
        # Both copies share the wall, which never changes.
        """Return an independent copy of this `ScopeDrive`."""
        return self.copy()

    def __reduce__(self) -> NoReturn:
        """Raise an error, because a `ScopeDrive` is bound to its process and cannot be pickled."""
        refuse_pickle(self, "create a carina.ScopeDrive in the other process, and drive it to the same place")

    def __repr__(self) -> str:
        """Return a one-line description of this `ScopeDrive` for the Python interpreter."""
        return f"ScopeDrive({self._scope.name!r}, insertion_mm={self._state_from_core.insertion_mm:.1f})"

    @property
    def scope(self) -> ScopePreset:
        """Instrument that is driven."""
        return self._scope

    @property
    def field(self) -> WallField:
        """Signed distances to the wall that constrain the scope."""
        return self._field

    @property
    def state(self) -> ScopeState:
        """State of the scope after the last move."""
        return self._state_from_core

    @property
    def operator(self) -> OperatorPosition:
        """Position of the operator: at the patient's head, or facing the patient."""
        return self._operator

    @check_arguments(operator=choice("head", "facing"))
    def set_operator(self, operator: OperatorPosition) -> ScopeState:
        """Turn the picture for another position of the operator; the scope does not move.

        Raises
        ------
        UsageError
            If the position is unknown; nothing is changed.
        """
        _check_operator(operator)
        if operator != self._operator:
            self._operator = operator
            self._state_from_core = replace(self._state_from_core, pose=_turned_by_180_deg(self._state_from_core.pose))
        return self._state_from_core

    def _state_for_operator(self, found: dict[str, Any]) -> ScopeState:
        state = _state_from_core(found)
        return state if self._operator == "head" else replace(state, pose=_turned_by_180_deg(state.pose))

    @property
    def entry_mm(self) -> float:
        """Position of the scope's entry in mm of the start path: the least insertion."""
        return self._core.entry_mm

    @property
    def depth_from_cords_mm(self) -> float | None:
        """Insertion from the vocal cords in mm; None if their position is unknown."""
        return None if self._cords_mm is None else self._state_from_core.insertion_mm - self._cords_mm

    @property
    def flexion_range_rad(self) -> tuple[float, float]:
        """Flexion limits of the lever in radians, down (below 0) and up."""
        return -self._flexion_rad[0], self._flexion_rad[1]

    @check_arguments(
        insertion_mm=bounded(COORDINATE_MM, unit="mm"),
        roll_rad=bounded(1e6, unit="rad"),
        flexion_rad=bounded(1e6, unit="rad"),
        dt_s=bounded(86_400.0, unit="s"),
    )
    def drive(self, insertion_mm: float, roll_rad: float, flexion_rad: float, dt_s: float) -> ScopeState:
        """Set the three controls; the scope moves towards them from its present position until the wall stops it.

        Roll and flexion always reach their values, since a lever can be pressed against a wall; insertion may not. Add
        increments to ``state.insertion_mm`` instead of the last commanded value: otherwise a hand that pushed against a
        wall first has to draw back.

        Parameters
        ----------
        insertion_mm
            Insertion from the start of the path.
        roll_rad, flexion_rad
            Roll, clockwise as the operator sees it; flexion, positive towards the instrument's up (which is down in a
            turned picture).
        dt_s
            Time since the last sample, which counts as time of contact.

        Returns
        -------
        ScopeState
            State that the scope has reached.

        Raises
        ------
        UsageError
            If a number is not finite or ``dt_s`` is negative; nothing is changed.
        """
        found = self._core.drive(float(insertion_mm), float(roll_rad), float(flexion_rad), float(dt_s))
        self._state_from_core = self._state_for_operator(found)
        return self._state_from_core

    @check_arguments(path=numbers_within(), insertion_mm=bounded(COORDINATE_MM, unit="mm"))
    def place(self, path: ArrayLike, insertion_mm: float) -> ScopeState:
        """Place the scope along a path, with roll and flexion 0 and an empty record of contacts.

        Parameters
        ----------
        path
            (n, 3) LPS mm; it starts where the scope's own path starts and may lead into any branch.
        insertion_mm
            Requested position of the tip, in mm of the start path. If the airway is too narrow, the tip is placed
            before that position, and the state's limit is set.

        Raises
        ------
        UsageError
            If the path passes far from the scope's entry (code ``scope.drive``).
        """
        self._state_from_core = self._state_for_operator(self._core.place(_point_array(path), float(insertion_mm)))
        return self._state_from_core

    def copy(self) -> ScopeDrive:
        """Return an independent copy of the scope in the same position.

        The copy and the original respond to the same samples with the same states, bit for bit.
        """
        other = ScopeDrive.__new__(ScopeDrive)
        vars(other).update(vars(self))
        other._core = self._core.copy()
        return other

    def shaft_lps(self) -> NDArray[np.float64]:
        """Return the scope's axis from the entry to the tip's face, (n, 3) LPS mm, one point every 2 mm."""
        return self._core.shaft_lps()

    def wall_depths_mm(self) -> tuple[float, float]:
        """Return the depth of tip and shaft in the wall, mm, by the wall field of the scope; 0 outside the wall."""
        return self._core.wall_depths_mm()


def lever_flexion(lever: float, flexion_range_rad: tuple[float, float], *, invert: bool = False) -> float:
    """Return the flexion for a position of the lever.

    Parameters
    ----------
    lever
        -1 (lever up) to 1 (lever down), 0 at rest. As on a real scope, lever down moves the tip up.
    flexion_range_rad
        The limits of `ScopeDrive.flexion_range_rad`.
    invert
        Whether lever down moves the tip down.

    Returns
    -------
    float
        Radians, above 0 up.

    Examples
    --------
    >>> lever_flexion(0.5, (-2.0, 3.0)), lever_flexion(0.5, (-2.0, 3.0), invert=True)
    (1.5, -1.0)
    """
    if not math.isfinite(lever):
        raise UsageError(f"expected a lever position from -1 to 1; found {lever}", code="scope.drive")
    place = min(max(-lever if invert else lever, -1.0), 1.0)
    down, up = flexion_range_rad
    return place * up if place >= 0.0 else -place * down


def _check_operator(operator: OperatorPosition) -> None:
    if operator not in {"head", "facing"}:
        raise UsageError(f"expected operator position 'head' or 'facing'; found {operator!r}", code="scope.drive")


def _turned_by_180_deg(pose: Pose) -> Pose:
    """Return a pose turned by 180 degrees about its forward axis; only signs change, so nothing is rounded."""
    matrix = pose.lps_from_camera.copy()
    matrix[:3, :2] *= -1.0
    return pose_of_valid_matrix(matrix)


def _point_array(points: ArrayLike) -> NDArray[np.float64]:
    found = np.ascontiguousarray(points, dtype=np.float64)
    if found.ndim != 2 or found.shape[1] != 3:
        raise UsageError(f"a path needs points of shape (n, 3); found {found.shape}", code="scope.drive")
    return found


def _state_from_core(found: dict[str, Any]) -> ScopeState:
    contact = found["contact"]
    return ScopeState(
        pose=pose_of_valid_matrix(found["lps_from_tip"]),
        hold=ScopeHold(found["insertion_mm"], found["roll_rad"], found["flexion_rad"]),
        contact=None if contact is None else Contact(tuple(contact[0]), tuple(contact[1]), contact[2]),
        red_out=found["red_out"],
        limit=found["limit"],
        passable_mm=found["passable_mm"],
        record=ContactRecord(*found["record"]),
    )
