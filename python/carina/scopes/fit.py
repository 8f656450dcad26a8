"""Optics of the generic scope, fitted to published measurements of one bronchoscope (docs/decisions/0106).

The measurements (Masters 2005, a bronchoscope in front of test charts): linear magnification, relative to 100 mm from
the tip, of 9.55 at 10 mm and of 40 at 3 mm; at 15 mm the middle is enlarged 39 % more than the edge; at 3 mm the
distortion reaches 30 %. The figures of one scope are not fully consistent; the residuals quantify the contradictions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from carina.display import one_line

FOV_DEG = 120.0
"""Usual field of view of adult scopes today, degrees (common knowledge), because that of the scope is unpublished."""
REFERENCE_MM = 100.0
MAGNIFICATION_AT = ((10.0, 9.55), (3.0, 40.0))
CENTRE_TO_EDGE = 1.39
DISTORTION = -0.30


@one_line
@dataclass(frozen=True, slots=True)
class Residual:
    """Published value, value of the fitted optics, and their relative difference."""

    what: str
    published: float
    fitted: float

    @property
    def relative(self) -> float:
        """Relative difference between the fitted and the published value: (fitted - published) / published."""
        return self.fitted / self.published - 1.0


@one_line
@dataclass(frozen=True, slots=True)
class FittedOptics:
    """The two parameters of the optical model, and their residuals.

    ``k1`` is that of :meth:`carina.scopes.Lens.fisheye`. ``face_mm`` is the distance of the tip's front face in front
    of the camera's centre (the entrance pupil); below 0 the face is behind it.
    """

    k1: float
    face_mm: float
    residuals: tuple[Residual, ...]


def fit_generic_optics(fov_deg: float = FOV_DEG) -> FittedOptics:
    """Fit the model to the published figures by least squares of the logarithms.

    The model is a central projection: an entrance pupil ``face_mm`` behind the tip's front face, and a radial image
    r(a) = f (a + k1 a^3) of the angle a. A chart at d mm before the face is d + face_mm from the pupil, so

    - magnification in the middle, relative to 100 mm: (100 + face_mm) / (d + face_mm);
    - magnification at the edge relative to the middle, for a chart at any distance: r(a) / (f tan a) at half the field
      of view. Distortion is the same number less 1. One pupil has one distortion at all distances, so the two figures
      (0.719 at 15 mm, 0.70 at 3 mm) cannot both be met.

    Parameters
    ----------
    fov_deg
        Field of view that the distortion is reached at, 10 to 175 degrees.

    Returns
    -------
    FittedOptics
        Parameters and residuals.

    References
    ----------
    Masters 2005, after features.md 5.1 "Optics". Kannala and Brandt 2006 for the polynomial.
    """
    half = math.radians(fov_deg) / 2
    # One unknown is fitted to two figures: the least-squares solution of their logarithms is the geometric mean.
    edge = math.sqrt((1.0 / CENTRE_TO_EDGE) * (1.0 + DISTORTION))
    k1 = (edge * math.tan(half) / half - 1.0) / half**2
    face_mm = _fit_face()
    fitted_edge = half * (1.0 + k1 * half**2) / math.tan(half)
    residuals = [
        Residual(f"magnification at {d:g} mm, relative to 100 mm", published, _magnification(d, face_mm))
        for d, published in MAGNIFICATION_AT
    ]
    residuals.append(Residual("magnification at 15 mm, centre relative to edge", CENTRE_TO_EDGE, 1.0 / fitted_edge))
    residuals.append(
        Residual(
            "edge magnification at 3 mm, as a fraction of the distortion-free value", 1.0 + DISTORTION, fitted_edge
        )
    )
    return FittedOptics(k1, face_mm, tuple(residuals))


def _magnification(distance_mm: float, face_mm: float) -> float:
    return (REFERENCE_MM + face_mm) / (distance_mm + face_mm)


def _fit_face() -> float:
    """Return ``face_mm`` in mm, fitted by Gauss-Newton on the logarithms; the initial pupil lies in the tip's face."""
    face = 0.0
    for _ in range(50):
        top = bottom = 0.0
        for d, published in MAGNIFICATION_AT:
            off = math.log(_magnification(d, face) / published)
            slope = 1.0 / (REFERENCE_MM + face) - 1.0 / (d + face)
            top, bottom = top + off * slope, bottom + slope * slope
        step = top / bottom
        face -= step
        if abs(step) < 1e-14:
            break
    return face
