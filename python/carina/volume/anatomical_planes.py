"""The three anatomical planes and their radiological display, for all code that draws, scrolls or paints in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

Plane = Literal["axial", "coronal", "sagittal"]


@dataclass(frozen=True, slots=True)
class PlaneDisplay:
    """Patient axes (LPS) of a plane on the screen; a minus sign marks the opposite direction.

    Patient right is on screen left in axial planes (seen from the feet, anterior up) and in coronal planes (seen from
    the front, superior up); anterior is on the left in sagittal planes.
    """

    right: str
    down: str
    into: str
    """Patient axis that points away from the viewer: the cross product of ``right`` and ``down``."""
    next_slice: Literal[1, -1]
    """Direction along ``into`` of the next slice when scrolling: 1 is deeper into the screen, -1 towards the viewer."""

    @property
    def normal_axis(self) -> int:
        """Index of the patient axis perpendicular to the plane: 0, 1 or 2 for x, y, z."""
        return "xyz".index(self.into[-1])


PLANES: Mapping[Plane, PlaneDisplay] = MappingProxyType(
    {
        "axial": PlaneDisplay(right="x", down="y", into="z", next_slice=-1),
        "coronal": PlaneDisplay(right="x", down="-z", into="y", next_slice=1),
        "sagittal": PlaneDisplay(right="y", down="-z", into="-x", next_slice=1),
    }
)
