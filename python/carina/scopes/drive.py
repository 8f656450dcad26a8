"""The bronchoscope in the lumen: insertion, roll and flexion move it, and the wall holds it."""

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
from carina.scopes.pose import Pose
from carina.scopes.wall_field import WallField
from carina.value import FrozenValue

__all__ = ["Contact", "ContactRecord", "ScopeDrive", "ScopeHold", "ScopeLimit", "ScopeState", "lever_flexion"]

ScopeLimit = Literal["none", "entry", "wall", "narrow", "length", "flexion"]
OperatorPosition = Literal["head", "facing"]
Point = tuple[float, float, float]

# What a scope has whose maker states nothing: the generic class (library), and no lever is pulled farther.
_RIGID_MM = 10.0
_BENDING_MM = (30.0, 50.0)
_FLEXION_DEG = (180.0, 130.0)
_LENGTH_MM = 600.0


@one_line
@dataclass(frozen=True, slots=True)
class Contact:
    """Where the tip touches the wall."""

    point_lps: Point
    """The place of the wall, LPS mm."""
    normal_lps: Point
    """Away from the wall, unit length."""
    depth_mm: float
    """How much farther the hand has pushed or bent the tip than the wall lets it."""


@one_line
@dataclass(frozen=True, slots=True)
class ContactRecord:
    """All that touched since the scope was placed."""

    count: int = 0
    """How often the tip began to touch."""
    time_s: float = 0.0
    """How long it touched in all."""
    max_depth_mm: float = 0.0
    """The deepest `Contact.depth_mm`."""


class ScopeHold(FrozenValue, frozen=True):
    """How an operator holds a scope."""

    insertion_mm: float
    """From the start of the path that the scope enters along (the trachea's start)."""
    roll_rad: float
    """Clockwise as the operator sees it."""
    flexion_rad: float
    """Above 0 the instrument's up, below 0 down."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class ScopeState:
    """The scope after a sample."""

    pose: Pose
    """The tip's face, turned by 180 degrees about its axis for an operator who faces the patient
    (`ScopeDrive.operator`); `ScopePreset.camera_pose` gives the camera of a forward-oblique scope from it."""
    hold: ScopeHold
    """Insertion, roll and flexion that it has reached."""
    contact: Contact | None
    """Where the tip touches, or None."""
    red_out: float
    """0 for a clear view to 1 where the lens lies on the wall and all is red."""
    limit: ScopeLimit
    """Why the scope did not go as far as asked: ``none``; ``entry`` (drawn back to where it enters); ``wall`` (the tip
    is pressed against it); ``narrow`` (it does not fit: see `passable_mm`); ``length`` (of the scope); ``flexion``
    (the lever's stop)."""
    passable_mm: float | None
    """The largest diameter that would pass on, where the limit is ``narrow``."""
    record: ContactRecord
    """All that touched since the scope was placed."""

    @property
    def insertion_mm(self) -> float:
        """See `ScopeHold`."""
        return self.hold.insertion_mm

    @property
    def roll_rad(self) -> float:
        """See `ScopeHold`."""
        return self.hold.roll_rad

    @property
    def flexion_rad(self) -> float:
        """See `ScopeHold`."""
        return self.hold.flexion_rad


class ScopeDrive:
    """A bronchoscope in a lumen.

    The scope is an elastic axis, stiff against twist: a rigid tip, a bending section that wants the lever's curvature,
    and a shaft that wants to be straight and follows the airway behind the tip. Tip and shaft cannot leave the lumen.
    The same samples give the same states, bit for bit, on one build.

    Parameters
    ----------
    field
        Signed distance to the wall.
    scope
        The instrument or its name in the library. Where nothing is known of it, the generic scope's figure is taken.
        Diameters are as stated (`FIT_MARGIN_MM` is for plans).
    start_path
        (n, 3) LPS mm, from where the scope enters: the trachea's centreline, or a route from the tree's root. It enters
        at the first place with room for it.
    up_lps
        Where flexion up leads to at roll 0, which the picture of an operator at the head has up; anterior unless told.
    operator
        ``head`` (stands at the patient's head) or ``facing``, whose picture is turned by 180 degrees. Only the picture
        is: the scope lies the same, and insertion, roll and flexion stay the instrument's own.
    cords_mm
        Where the vocal cords are, in mm of the start path; below 0 where they lie above it. None: not known.

    Raises
    ------
    UsageError
        If the path has no room for the scope, or no direction (code ``scope.drive``).

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
        path = _points(start_path)
        up = None if up_lps is None else [float(v) for v in np.asarray(up_lps, dtype=np.float64)]
        self._core = _core.ScopeDrive(field.core, sizes, path, up)
        self._cords_mm = cords_mm
        self._scope = preset
        self._field = field
        self._flexion_rad = (sizes[5], sizes[4])
        self._operator: OperatorPosition = operator
        self._state = self._seen(self._core.state)

    def __copy__(self) -> ScopeDrive:
        return self.copy()

    def __deepcopy__(self, _memo: object) -> ScopeDrive:
        # The wall, which both have, never changes.
        return self.copy()

    def __reduce__(self) -> NoReturn:
        refuse_pickle(self, "create a carina.ScopeDrive in the other process, and drive it to the same place")

    def __repr__(self) -> str:
        return f"ScopeDrive({self._scope.name!r}, insertion_mm={self._state.insertion_mm:.1f})"

    @property
    def scope(self) -> ScopePreset:
        """The instrument."""
        return self._scope

    @property
    def field(self) -> WallField:
        """The wall that holds it."""
        return self._field

    @property
    def state(self) -> ScopeState:
        """The scope now."""
        return self._state

    @property
    def operator(self) -> OperatorPosition:
        """Where the operator stands."""
        return self._operator

    @check_arguments(operator=choice("head", "facing"))
    def set_operator(self, operator: OperatorPosition) -> ScopeState:
        """Turn the picture for an operator who stands elsewhere; the scope stays as it lies, to the last bit.

        Raises
        ------
        UsageError
            If the position is unknown; nothing is changed.
        """
        _check_operator(operator)
        if operator != self._operator:
            self._operator = operator
            self._state = replace(self._state, pose=_turned(self._state.pose))
        return self._state

    def _seen(self, found: dict[str, Any]) -> ScopeState:
        state = _state(found)
        return state if self._operator == "head" else replace(state, pose=_turned(state.pose))

    @property
    def entry_mm(self) -> float:
        """Where the scope enters, in mm of the start path: the least insertion."""
        return self._core.entry_mm

    @property
    def depth_from_cords_mm(self) -> float | None:
        """Insertion from the vocal cords; None where it is not known where they are."""
        return None if self._cords_mm is None else self._state.insertion_mm - self._cords_mm

    @property
    def flexion_range_rad(self) -> tuple[float, float]:
        """The lever's stops: the greatest flexion down (below 0) and up."""
        return -self._flexion_rad[0], self._flexion_rad[1]

    @check_arguments(
        insertion_mm=bounded(COORDINATE_MM, unit="mm"),
        roll_rad=bounded(1e6, unit="rad"),
        flexion_rad=bounded(1e6, unit="rad"),
        dt_s=bounded(86_400.0, unit="s"),
    )
    def drive(self, insertion_mm: float, roll_rad: float, flexion_rad: float, dt_s: float) -> ScopeState:
        """Set the three controls; the scope moves towards them from where it is and stops where it cannot go on.

        Roll and flexion always arrive, for a lever can be pressed against a wall; insertion may not. Add to
        ``state.insertion_mm``, not to what was asked for, or a hand that pushes at a wall will have to draw back first.

        Parameters
        ----------
        insertion_mm
            From the start of the path.
        roll_rad, flexion_rad
            Clockwise as the operator sees it; up, as the instrument is held (the picture's down where it is turned).
        dt_s
            Time since the sample before, for the time of contact.

        Returns
        -------
        ScopeState
            What became of it.

        Raises
        ------
        UsageError
            If a number is not finite or time runs backwards; nothing is changed.
        """
        found = self._core.drive(float(insertion_mm), float(roll_rad), float(flexion_rad), float(dt_s))
        self._state = self._seen(found)
        return self._state

    @check_arguments(path=numbers_within(), insertion_mm=bounded(COORDINATE_MM, unit="mm"))
    def place(self, path: ArrayLike, insertion_mm: float) -> ScopeState:
        """Lay the scope along a path, roll and flexion 0, with a new record of contact.

        Parameters
        ----------
        path
            (n, 3) LPS mm; it starts where the scope's own path does and may lead into any branch.
        insertion_mm
            Where the tip should be, in mm of the start path. Where the airway is too narrow it lies before that place,
            and the state's limit says so.

        Raises
        ------
        UsageError
            If the path passes far from where the scope enters (code ``scope.drive``).
        """
        self._state = self._seen(self._core.place(_points(path), float(insertion_mm)))
        return self._state

    def copy(self) -> ScopeDrive:
        """Another scope that lies as this one does; what is done with one does not move the other.

        Both answer the same samples with the same states, bit for bit.
        """
        other = ScopeDrive.__new__(ScopeDrive)
        vars(other).update(vars(self))
        other._core = self._core.copy()
        return other

    def shaft_lps(self) -> NDArray[np.float64]:
        """Return the scope's axis from the entry to the tip's face, (n, 3) LPS mm, a point every 2 mm."""
        return self._core.shaft_lps()

    def wall_depths_mm(self) -> tuple[float, float]:
        """How far tip and shaft are in the wall, by the field that they are held in; 0 where they are not."""
        return self._core.wall_depths_mm()


def lever_flexion(lever: float, flexion_range_rad: tuple[float, float], *, invert: bool = False) -> float:
    """Return the flexion for a position of the lever.

    Parameters
    ----------
    lever
        -1 (lever up) to 1 (lever down), 0 at rest. As on a real scope, lever down moves the tip up.
    flexion_range_rad
        The stops of `ScopeDrive.flexion_range_rad`.
    invert
        Lever down moves the tip down.

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


def _turned(pose: Pose) -> Pose:
    """Seen upside down: signs alone change, so that nothing is rounded."""
    matrix = pose.lps_from_camera.copy()
    matrix[:3, :2] *= -1.0
    return Pose(matrix)


def _points(points: ArrayLike) -> NDArray[np.float64]:
    found = np.ascontiguousarray(points, dtype=np.float64)
    if found.ndim != 2 or found.shape[1] != 3:
        raise UsageError(f"a path needs points of shape (n, 3); found {found.shape}", code="scope.drive")
    return found


def _state(found: dict[str, Any]) -> ScopeState:
    contact = found["contact"]
    return ScopeState(
        pose=Pose(found["lps_from_tip"]),
        hold=ScopeHold(found["insertion_mm"], found["roll_rad"], found["flexion_rad"]),
        contact=None if contact is None else Contact(tuple(contact[0]), tuple(contact[1]), contact[2]),
        red_out=found["red_out"],
        limit=found["limit"],
        passable_mm=found["passable_mm"],
        record=ContactRecord(*found["record"]),
    )
