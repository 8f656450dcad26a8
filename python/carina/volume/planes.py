"""The three anatomical planes and how radiology displays them, once for all who draw, scroll or paint in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

__all__ = ["PLANES", "Plane", "PlaneDisplay"]

Plane = Literal["axial", "coronal", "sagittal"]


@dataclass(frozen=True, slots=True)
class PlaneDisplay:
    """Patient axes (LPS, with a minus sign where they run the other way) of a plane on the screen.

    Patient right is on screen left in axial planes (seen from the feet, anterior up) and in coronal ones (from the
    front, superior up); anterior is on the left in sagittal ones.
    """

    right: str
    down: str
    into: str
    """Away from the viewer: right x down."""
    next_slice: Literal[1, -1]
    """Which way along ``into`` the next picture of the stack lies: towards the feet, or deeper into the screen."""

    @property
    def normal_axis(self) -> int:
        """0, 1 or 2 for x, y, z."""
        return "xyz".index(self.into[-1])


PLANES: Mapping[Plane, PlaneDisplay] = MappingProxyType(
    {
        "axial": PlaneDisplay(right="x", down="y", into="z", next_slice=-1),
        "coronal": PlaneDisplay(right="x", down="-z", into="y", next_slice=1),
        "sagittal": PlaneDisplay(right="y", down="-z", into="-x", next_slice=1),
    }
)
