"""Lens model of a bronchoscope, the outline of its picture, and the ray of each pixel for a given picture size.

Camera axes: +x right, +y down, +z forward. Points of a picture are in corner coordinates: pixel (0, 0) is the corner of
the top-left pixel, its centre is (0.5, 0.5).
"""

from __future__ import annotations

import functools
import math
import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina.argument_checks import (
    any_number,
    check_arguments,
    check_fields,
    choice,
    each,
    instance,
    number_from,
    pixels,
    text_of,
)
from carina.display import one_line
from carina.errors import RenderError

Outline = Literal["none", "round", "octagon"]
Model = Literal["pinhole", "equidistant", "brown", "fisheye"]
OUTLINES: tuple[Outline, ...] = ("none", "round", "octagon")
DEFAULT_FOV_DEG = 90.0
# Limit of cached rays, in pixels of 14 bytes: a flight needs the rays of its still size and of several smaller ones.
RAYS_IN_MEMORY_PX = 4_000_000


@one_line
@dataclass(frozen=True, slots=True)
class Calibration:
    """Focal lengths and principal point of a calibration, in pixels of pictures of ``size_px``.

    ``centre_px`` is in corner coordinates: OpenCV's value plus 1/2, since OpenCV's pixel (0, 0) is the centre of the
    first pixel.
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    size_px: tuple[int, int]


@one_line
@dataclass(frozen=True, slots=True)
class Lens:
    """Lens model, independent of the size of the picture; create one with the class methods.

    ``brown`` is OpenCV's default model with k1 k2 p1 p2 k3 k4 k5 k6. ``fisheye`` is that of ``cv2.fisheye`` with k1 to
    k4: the distance from the centre of the picture is f (a + k1 a^3 + k2 a^5 + ...) at the angle a.

    Raises
    ------
    RenderError
        If a coefficient is not finite.
    """

    model: Model
    coefficients: tuple[float, ...] = ()
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        """Raise an error if a field of this `Lens` has an invalid value."""
        check_fields(
            self,
            RenderError,
            "render.camera",
            model=choice("pinhole", "equidistant", "brown", "fisheye"),
            coefficients=each(number_from(-1e6, 1e6), most=8),
            calibration=instance(Calibration, "read one with carina.scopes.lens_from_file", optional=True),
        )
        expected = {"pinhole": 0, "equidistant": 0, "brown": 8, "fisheye": 4}.get(self.model)
        if len(self.coefficients) != expected:
            raise RenderError(
                "a lens must be pinhole, equidistant, brown with 8 coefficients or fisheye with 4; found "
                f"{self.model} with {len(self.coefficients)}",
                code="render.camera",
            )
        if not all(math.isfinite(value) for value in self.coefficients):
            raise RenderError(
                f"the coefficients of a lens must be finite numbers; found {self.coefficients}", code="render.camera"
            )

    @classmethod
    def pinhole(cls) -> Lens:
        """Return a lens without distortion: straight lines stay straight."""
        return cls("pinhole")

    @classmethod
    def equidistant(cls) -> Lens:
        """Return a lens whose distance from the centre of the picture is proportional to the angle."""
        return cls("equidistant")

    @classmethod
    @check_arguments(**dict.fromkeys(("k1", "k2", "k3", "p1", "p2"), number_from(-1e6, 1e6)))
    def brown(cls, k1: float, k2: float = 0.0, *, k3: float = 0.0, p1: float = 0.0, p2: float = 0.0) -> Lens:
        """Return a lens with Brown's radial and tangential distortion; k1 below 0 gives barrel distortion."""
        return cls("brown", (k1, k2, p1, p2, k3, 0.0, 0.0, 0.0))

    @classmethod
    @check_arguments(**dict.fromkeys(("k1", "k2", "k3", "k4"), number_from(-1e6, 1e6)))
    def fisheye(cls, k1: float, k2: float = 0.0, k3: float = 0.0, k4: float = 0.0) -> Lens:
        """Return an equidistant lens with a polynomial of the angle (Kannala and Brandt 2006)."""
        return cls("fisheye", (k1, k2, k3, k4))

    @check_arguments(width=pixels(), height=pixels(), fov_deg=number_from(1.0, 170.0, optional=True, unit="degrees"))
    def optics(self, width: int, height: int, fov_deg: float | None = None) -> Optics:
        """Return the optics of this lens in front of a picture.

        Parameters
        ----------
        width, height
            Size of the picture in pixels, 1 to 8192.
        fov_deg
            Full angle across the shorter side, 1 to 170 degrees; default 90. A calibrated lens has its own, and accepts
            no other.

        Raises
        ------
        RenderError
            If a value is out of range, the model folds back on itself inside the image circle, or the picture does not
            have the proportions of the calibration's pictures.
        """
        return _optics(self, width, height, None if fov_deg is None else float(fov_deg))


PINHOLE = Lens.pinhole()


@one_line
@dataclass(frozen=True, slots=True)
class ImageField:
    """Outline of the picture on the monitor, over the shorter side, and its darkening towards the edge.

    Pixels outside the outline have no ray and are black. ``edge_px`` is the width of the soft edge inside the outline.
    ``vignette`` is 0 for even brightness, 1 for the lens's natural fall-off of light (cos^4 for a pinhole), or a
    fraction.

    Raises
    ------
    RenderError
        If a value is out of range.
    """

    outline: Outline = "none"
    edge_px: float = 1.5
    vignette: float = 0.0

    def __post_init__(self) -> None:
        """Raise an error if a field of this `ImageField` has an invalid value."""
        check_fields(self, RenderError, "render.camera", outline=text_of(), edge_px=any_number(), vignette=any_number())
        if self.outline not in OUTLINES:
            raise RenderError(
                f"outline must be one of {', '.join(OUTLINES)}; found {self.outline!r}", code="render.camera"
            )
        if not 0.0 <= self.edge_px <= 100.0:
            raise RenderError(
                f"the width of a soft edge must be between 0 and 100 pixels; found {self.edge_px:g}",
                code="render.camera",
            )
        if not 0.0 <= self.vignette <= 1.0:
            raise RenderError(f"vignetting must be between 0 and 1; found {self.vignette:g}", code="render.camera")


FULL_FRAME = ImageField()


@one_line
@dataclass(frozen=True, slots=True)
class DepthOfField:
    """Range of distances from the tip that a scope of fixed focus shows sharp, mm.

    Raises
    ------
    RenderError
        Unless 0 < ``near_mm`` < ``far_mm``.
    """

    near_mm: float
    far_mm: float

    def __post_init__(self) -> None:
        """Raise an error if a field of this `DepthOfField` has an invalid value."""
        check_fields(
            self,
            RenderError,
            "render.camera",
            near_mm=any_number(),
            far_mm=any_number(),
        )
        if not (0.0 < self.near_mm < self.far_mm <= 1e5):
            raise RenderError(
                "the near limit of a depth of field must be above 0 mm and below its far limit; found "
                f"{self.near_mm:g} to {self.far_mm:g} mm",
                code="render.camera",
            )


class Optics:
    """Lens in front of a picture of a given size: maps directions to pixels and back. See `Lens.optics`."""

    __slots__ = ("_core", "fov_deg", "lens", "size_px")

    def __init__(self, lens: Lens, size_px: tuple[int, int], fov_deg: float | None, core: _core.Optics) -> None:
        self.lens = lens
        self.size_px = size_px
        self.fov_deg = math.degrees(core.fov_rad) if fov_deg is None else fov_deg
        """Full angle across the shorter side in degrees: the given one, or that of the calibration."""
        self._core = core

    @property
    def limit_deg(self) -> float:
        """Largest angle in degrees between a ray of the picture and the lens axis."""
        return math.degrees(self._core.limit_rad)

    @property
    def limit_rad(self) -> float:
        """Largest angle in radians between a ray of the picture and the lens axis."""
        return self._core.limit_rad

    @property
    def formula(self) -> tuple[Literal["brown", "fisheye"], tuple[float, ...]]:
        """Lens as one of OpenCV's two models: name of the model, and its 8 or 4 coefficients."""
        return _formula(self.lens)

    @property
    def focal_px(self) -> tuple[float, float]:
        """Focal lengths of the picture across and down, pixels."""
        return self._core.focal_px

    @property
    def centre_px(self) -> tuple[float, float]:
        """Point where the optical axis meets the picture, in corner coordinates."""
        return self._core.centre_px

    def directions_of(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return unit directions (n, 3) in camera space of picture points (n, 2).

        The directions of points outside the lens model are NaN.
        """
        return self._core.directions(np.ascontiguousarray(pixels, dtype=np.float64))

    def pixels_of(self, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the picture points (n, 2) of directions (n, 3) of any length in camera space.

        The points of invisible directions are NaN.
        """
        return self._core.pixels(np.ascontiguousarray(directions, dtype=np.float64))

    def rays(self, field: ImageField) -> _core.LensRays:
        """Return the rays of all pixels, for the ray casters; the most recently used rays are cached."""
        return _RAYS.of(self, field)

    def _build_rays(self, field: ImageField) -> _core.LensRays:
        return self._core.rays(shape=field.outline, edge_px=field.edge_px, vignette=field.vignette)

    def __repr__(self) -> str:
        """Return a one-line description of this `Optics` for the Python interpreter."""
        return f"Optics({self.lens.model}, fov_deg={self.fov_deg:.1f})"


def _formula(lens: Lens) -> tuple[Literal["brown", "fisheye"], tuple[float, ...]]:
    if lens.model in {"pinhole", "brown"}:
        return "brown", lens.coefficients or (0.0,) * 8
    return "fisheye", lens.coefficients or (0.0,) * 4


@functools.lru_cache(maxsize=64)
def _optics(lens: Lens, width: int, height: int, fov_deg: float | None) -> Optics:
    model, coefficients = _formula(lens)
    known = lens.calibration
    if known is None and fov_deg is None:
        fov_deg = DEFAULT_FOV_DEG
    core = _core.Optics(
        model,
        coefficients,
        width=width,
        height=height,
        fov_rad=None if fov_deg is None else math.radians(fov_deg),
        focal_px=None if known is None else known.focal_px,
        centre_px=None if known is None else known.centre_px,
        calibrated_size_px=None if known is None else known.size_px,
    )
    return Optics(lens, (width, height), fov_deg, core)


class _RayCache:
    """Cache of the rays of recent pictures; any thread may use it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._cache: OrderedDict[tuple[Any, ...], _core.LensRays] = OrderedDict()

    def of(self, optics: Optics, field: ImageField) -> _core.LensRays:
        key = (optics.lens, *optics.size_px, optics.fov_deg, field)
        with self._lock:
            if key in self._cache:
                self._cache.move_to_end(key)
                return self._cache[key]
        rays = optics._build_rays(field)
        with self._lock:
            self._cache[key] = rays
            while len(self._cache) > 1 and sum(k[1] * k[2] for k in self._cache) > RAYS_IN_MEMORY_PX:
                self._cache.popitem(last=False)
        return rays


_RAYS = _RayCache()
