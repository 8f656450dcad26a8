"""Library of bronchoscopes: properties of each instrument, and the basis of each value.

Basis of a value: ``s`` was read in a source; ``k`` is common knowledge that was not checked against the maker's data.
Unknown values are None. Sizes are nominal: measured diameters exceed them (`FIT_MARGIN_MM`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from carina.display import one_line
from carina.errors import UsageError
from carina.scopes.fit import FOV_DEG, fit_generic_optics
from carina.scopes.lens import DepthOfField, ImageField, Lens, Outline
from carina.scopes.pose import Pose

FIT_MARGIN_MM = 0.4
"""Margin in mm that is added to the stated tip diameter, because measured diameters exceed it by 0.19 to 0.66 mm.

Mean 0.41 mm (10 scopes of 2.2 to 4.9 mm; basis s).
"""
DEFAULT_SCOPE = "generic"
ScopeClass = Literal["diagnostic", "therapeutic", "thin", "ultrathin", "paediatric", "ebus", "single-use", "robotic"]
Point = tuple[float, float, float]

_FIT = fit_generic_optics()
_LENS = Lens.fisheye(_FIT.k1)
# Share of the lens's natural fall-off of light that remains after the camera's correction (basis k).
_VIGNETTE = 0.5


@one_line
@dataclass(frozen=True, slots=True)
class ScopePreset:
    """One instrument; lengths in mm, angles in degrees, None for unknown values."""

    name: str
    title: str
    scope_class: ScopeClass
    tip_mm: float
    """Outer diameter of the distal end in mm, as stated by the maker."""
    tube_mm: float | None
    """Outer diameter of the insertion tube in mm, if it differs from the tip's."""
    channel_mm: float | None
    """Inner diameter of the working channel, mm."""
    fov_deg: float | None
    focus_mm: tuple[float, float] | None
    """Depth of field: nearest and farthest sharp distance from the tip, mm."""
    flexion_deg: tuple[float, float] | None
    """Largest flexion of the tip up and down, degrees; None if it is unknown."""
    length_mm: float | None
    """Working length of the insertion tube, mm."""
    basis: str
    """Basis of the values: ``s`` or ``k`` (see the module), or a list of the values of each basis."""
    view_up_deg: float = 0.0
    """Angle in degrees from the shaft's axis up to the direction of view; 35 for a forward-oblique EBUS scope."""
    outline: Outline = "round"
    """Outline of the picture (basis k)."""
    lens: Lens = _LENS
    """Lens; the generic lens, since no maker publishes one."""
    rigid_tip_mm: float | None = 10.0
    """Length in mm of the longest rigid part of the tip ("< 10 mm", a specification of the 1960s; basis s)."""
    bending_mm: tuple[float, float] | None = (30.0, 50.0)
    """Length of the bending section in mm, shortest and longest of the class (basis k)."""
    bend_radius_mm: tuple[float, float] | None = (10.0, 15.0)
    """Radius of the bending section at full flexion in mm, smallest and largest of the class (basis k)."""

    @property
    def fit_mm(self) -> float:
        """Diameter in mm of the lumen that the scope needs: tip plus `FIT_MARGIN_MM`, or the tube if that is larger."""
        return max(self.tip_mm + FIT_MARGIN_MM, self.tube_mm or 0.0)

    @property
    def face_mm(self) -> float:
        """Distance in mm of the tip's face in front of the camera's centre, fitted.

        Below 0 the face is behind the centre.
        """
        return _FIT.face_mm

    @property
    def guides_mm(self) -> tuple[Point, ...]:
        """Ends of the light guides in camera space, mm: two on the face, left and right of the lens (basis k).

        Both guides are a little above the lens.
        """
        across, up = 0.28 * self.tip_mm, 0.1 * self.tip_mm
        return ((-across, -up, self.face_mm), (across, -up, self.face_mm))

    @property
    def usual_fov_deg(self) -> float:
        """Field of view of the instrument in degrees; the generic scope's if it is unknown."""
        return FOV_DEG if self.fov_deg is None else self.fov_deg

    @property
    def field(self) -> ImageField:
        """Outline and vignette of the scope's picture."""
        return ImageField(self.outline, vignette=_VIGNETTE)

    @property
    def depth_of_field(self) -> DepthOfField | None:
        """Range of distances that the scope shows sharp; None if unknown."""
        return None if self.focus_mm is None else DepthOfField(*self.focus_mm)

    def camera_pose(self, tip: Pose, *, picture_turned: bool = False) -> Pose:
        """Return the pose of the camera when the shaft ends at ``tip``: rotated upwards by `view_up_deg`.

        ``picture_turned``: ``tip`` is turned by 180 degrees (`ScopeDrive.operator`), so that the instrument's up is the
        picture's down.
        """
        if self.view_up_deg == 0.0:
            return tip
        up_rad = math.radians(-self.view_up_deg if picture_turned else self.view_up_deg)
        c, s = math.cos(up_rad), math.sin(up_rad)
        turn = np.eye(4)
        # A rotation about +x (right) moves the forward axis towards -y (up).
        turn[1:3, 1:3] = [[c, -s], [s, c]]
        return Pose(tip.lps_from_camera @ turn)


def _single_use(size: str, tip: float, channel: float, down: float) -> ScopePreset:
    return ScopePreset(
        f"single-use-{size}",
        f"Single-use, {size} (Ambu aScope 4)",
        "single-use",
        tip,
        None,
        channel,
        85.0,
        (6.0, 50.0),
        (180.0, down),
        600.0,
        "k",
        outline="octagon",
    )


_PRESETS = (
    ScopePreset(
        DEFAULT_SCOPE,
        "Generic adult scope",
        "diagnostic",
        4.9,
        None,
        2.0,
        FOV_DEG,
        (3.0, 100.0),
        (180.0, 130.0),
        600.0,
        "size, channel, flexion and length of the standard scope (s); optics fitted to published measurements (s), "
        "field of view and focus k",
    ),
    ScopePreset(
        "therapeutic",
        "Therapeutic (BF-1TH190 type)",
        "therapeutic",
        6.0,
        6.2,
        2.8,
        120.0,
        (3.0, 100.0),
        (180.0, 130.0),
        600.0,
        "k",
        outline="octagon",
    ),
    ScopePreset(
        "diagnostic",
        "Diagnostic HD (BF-H190)",
        "diagnostic",
        5.5,
        5.1,
        2.0,
        120.0,
        (3.0, 100.0),
        (210.0, 130.0),
        600.0,
        "k",
        outline="octagon",
    ),
    ScopePreset(
        "standard",
        "Standard (BF-P160)",
        "diagnostic",
        4.9,
        None,
        2.0,
        120.0,
        (3.0, 50.0),
        (180.0, 130.0),
        600.0,
        "s; field of view and focus k",
        outline="octagon",
    ),
    ScopePreset(
        "standard-fibre",
        "Standard fibrescope (FB-15V)",
        "diagnostic",
        4.9,
        None,
        2.2,
        120.0,
        (3.0, 50.0),
        (180.0, 130.0),
        600.0,
        "s; field of view and focus k (old fibrescopes: 80 degrees, 5 to 30 mm; s)",
    ),
    ScopePreset(
        "eb-1570k",
        "Diagnostic (PENTAX EB-1570K)",
        "diagnostic",
        5.5,
        None,
        2.0,
        None,
        None,
        (210.0, 130.0),
        600.0,
        "s",
    ),
    ScopePreset(
        "lf-v",
        "Intubation scope (Olympus LF-V)",
        "thin",
        4.1,
        None,
        1.2,
        None,
        None,
        None,
        600.0,
        "s",
    ),
    ScopePreset(
        "thin",
        "Thin (BF-P190, P290)",
        "thin",
        4.2,
        4.1,
        2.0,
        110.0,
        (2.0, 50.0),
        (210.0, 130.0),
        600.0,
        'k; "4.0 mm thin, 2.0 channel" s',
        outline="octagon",
    ),
    ScopePreset(
        "ultrathin",
        "Ultrathin (BF-MP190F, MP290F)",
        "ultrathin",
        3.0,
        None,
        1.7,
        90.0,
        (2.0, 50.0),
        (210.0, 130.0),
        600.0,
        "size and channel s, rest k",
    ),
    ScopePreset(
        "ultrathin-xp160f",
        "Ultrathin, older (BF-XP160F)",
        "ultrathin",
        2.8,
        None,
        1.2,
        90.0,
        (2.0, 50.0),
        (180.0, 130.0),
        600.0,
        "channel s, rest k",
    ),
    ScopePreset(
        "ultrathin-xp190",
        "Ultrathin, older (BF-XP190)",
        "ultrathin",
        3.1,
        None,
        1.2,
        110.0,
        (2.0, 50.0),
        (210.0, 130.0),
        600.0,
        "channel s, rest k",
    ),
    ScopePreset(
        "paediatric",
        "Paediatric 3.6 (BF-3C160)",
        "paediatric",
        3.8,
        None,
        1.2,
        120.0,
        (3.0, 50.0),
        (180.0, 130.0),
        600.0,
        "k",
        outline="octagon",
    ),
    ScopePreset(
        "ebus",
        "EBUS (BF-UC180F), 35-degree oblique view",
        "ebus",
        6.9,
        6.3,
        2.2,
        80.0,
        (2.0, 50.0),
        (120.0, 90.0),
        600.0,
        "k",
        view_up_deg=35.0,
    ),
    _single_use("slim", 3.8, 1.2, 180.0),
    _single_use("regular", 5.0, 2.2, 180.0),
    _single_use("large", 5.8, 2.8, 160.0),
    ScopePreset(
        "ion",
        "Ion catheter with vision probe",
        "robotic",
        3.5,
        None,
        2.0,
        None,
        None,
        (180.0, 180.0),
        None,
        "OD and 180 degrees in any direction s, rest k",
        rigid_tip_mm=None,
        bending_mm=None,
        bend_radius_mm=None,
    ),
    ScopePreset(
        "monarch",
        "Monarch scope (sheath 5.7 mm)",
        "robotic",
        4.4,
        None,
        2.1,
        None,
        None,
        (180.0, 180.0),
        None,
        "k",
        rigid_tip_mm=None,
        bending_mm=None,
        bend_radius_mm=None,
    ),
)
_BY_NAME = {preset.name: preset for preset in _PRESETS}


def scope_presets() -> tuple[ScopePreset, ...]:
    """Return all instruments of the library, the generic one first."""
    return _PRESETS


def scope_preset(name: str) -> ScopePreset:
    """Return the instrument of the library with this name.

    Raises
    ------
    UsageError
        If there is no such instrument; the message lists the names.
    """
    found = _BY_NAME.get(name)
    if found is None:
        raise UsageError(f"expected one of the scopes {', '.join(_BY_NAME)}; found {name!r}", code="scope.name")
    return found
