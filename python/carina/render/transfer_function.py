"""Transfer functions: colour and opacity by HU, the presets, and a transfer function from a volume's histogram."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import (
    check_arguments,
    check_fields,
    choice,
    flag,
    instance,
    number_from,
    text_of,
    whole_from,
)
from carina.display import one_line
from carina.errors import RenderError, UsageError
from carina.render.appearance import Appearance
from carina.volume import Volume

FORMAT = "carina-transfer"
VERSION = 1
PAPER_BIN_HU = 16


@one_line
@dataclass(frozen=True, slots=True)
class Light:
    """Light at the scope's tip, as fractions of full brightness."""

    ambient: float = 0.15
    diffuse: float = 0.85
    specular: float = 0.0
    shininess_log2: int = 4
    """Base-2 logarithm of the highlight's exponent: the exponent is ``2 ** shininess_log2``."""
    reach_mm: float | None = None
    """Distance in mm at which half the light remains; None for light that does not decrease with distance."""

    def __post_init__(self) -> None:
        """Raise an error if a field of this `Light` has an invalid value."""
        check_fields(
            self,
            RenderError,
            ambient=number_from(0.0, 10.0),
            diffuse=number_from(0.0, 10.0),
            specular=number_from(0.0, 10.0),
            shininess_log2=whole_from(0, 10),
            reach_mm=number_from(0.0, 1e5, optional=True),
        )
        shares = (self.ambient, self.diffuse, self.specular)
        whole = isinstance(self.shininess_log2, int) and 0 <= self.shininess_log2 <= 10
        if not whole or not all(np.isfinite(v) and 0 <= v <= 10 for v in shares):
            raise RenderError(
                "the ambient, diffuse and specular shares of a light, and its shininess (log2, a whole number), must "
                f"be between 0 and 10; found {self}"
            )
        if self.reach_mm is not None and not self.reach_mm > 0:
            raise RenderError(f"the reach of a light must be above 0 mm; found {self.reach_mm}")

    def as_core(self) -> tuple[float, float, float, int, float]:
        """Return the settings as the tuple that the compiled module expects."""
        reach = float("inf") if self.reach_mm is None else float(self.reach_mm)
        return self.ambient, self.diffuse, self.specular, self.shininess_log2, reach


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TransferFunction:
    """Colour and opacity by voxel value, linear between points, with the settings of the airway view.

    Parameters
    ----------
    points
        ``(n, 5)``: value, red, green, blue, opacity; values in increasing order, the rest 0..1. Two points at one value
        make a step.
    reference_mm
        Ray length for which the opacities are given, mm.
    unit
        ``HU``, or ``raw`` for volumes that are not calibrated.
    name
        Name that users see; each preset has one.
    sampling
        ``trilinear``, or ``nearest`` as in the paper: nearest voxel, step of one voxel, 16-HU bins, no shading.
    wall
        True if the airway view closes the lumen's wall (docs/decisions/0105).
    light
        Light of the shaded airway view, applied to every sample.
    appearance
        Light, gloss and texture that are applied to the first wall of each pixel instead of ``light``; None for none.

    Raises
    ------
    RenderError
        If a value is out of range.

    Examples
    --------
    >>> import carina
    >>> preset = carina.transfer_preset("endoscopic")
    >>> carina.TransferFunction.from_json(preset.to_json()).name
    'endoscopic'
    """

    points: NDArray[np.float64]
    reference_mm: float = 1.0
    unit: Literal["HU", "raw"] = "HU"
    name: str = "custom"
    sampling: Literal["trilinear", "nearest"] = "trilinear"
    wall: bool = False
    light: Light = field(default_factory=Light)
    appearance: Appearance | None = None

    def __post_init__(self) -> None:
        """Raise an error if a field of this `TransferFunction` has an invalid value."""
        check_fields(
            self,
            RenderError,
            "render.transfer",
            reference_mm=number_from(0.0, 1e5, unit="mm"),
            unit=choice("HU", "raw"),
            name=text_of(200),
            sampling=choice("trilinear", "nearest"),
            wall=flag,
            light=instance(Light, "create a carina.render.Light"),
            appearance=instance(Appearance, "create a carina.render.Appearance", optional=True),
        )
        try:
            points = np.array(self.points, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            points = np.zeros(0)
        if points.ndim != 2 or points.shape[1:] != (5,) or len(points) == 0:
            msg = (
                "a transfer function needs at least one point, each [hu, r, g, b, alpha]; "
                f"found an array of shape {points.shape}"
            )
            raise RenderError(msg, code="render.transfer")
        outside = ~np.isfinite(points).all(axis=1) | ~((points[:, 1:] >= 0) & (points[:, 1:] <= 1)).all(axis=1)
        if outside.any():
            at = int(np.flatnonzero(outside)[0])
            msg = (
                "a transfer function must have finite values, and colours and opacities from 0 to 1; found at "
                f"point {at}: {points[at].tolist()}"
            )
            raise RenderError(msg, code="render.transfer")
        falling = np.flatnonzero(np.diff(points[:, 0]) < 0)
        if len(falling):
            before, after = points[falling[0] : falling[0] + 2, 0]
            msg = (
                "the points of a transfer function must be in increasing order of value; "
                f"found {after:g} at point {falling[0] + 1} after {before:g}"
            )
            raise RenderError(msg, code="render.transfer")
        if not (np.isfinite(self.reference_mm) and self.reference_mm > 0):
            raise RenderError("the reference length of a transfer function must be above 0 mm", code="render.transfer")
        if self.appearance is not None and self.sampling == "nearest":
            raise RenderError(
                "nearest sampling provides no gradient, which an appearance needs; use trilinear sampling",
                code="render.transfer",
            )
        if self.unit not in {"HU", "raw"} or self.sampling not in {"trilinear", "nearest"}:
            msg = (
                "the unit must be HU or raw, and the sampling must be trilinear or nearest; "
                f"found {self.unit!r}, {self.sampling!r}"
            )
            raise RenderError(msg, code="render.transfer")
        points.flags.writeable = False
        object.__setattr__(self, "points", points)

    @property
    def bin_hu(self) -> int:
        """Width in HU of the bins of equal colour in a volume of more than 256 values; 1 if values are not binned."""
        return PAPER_BIN_HU if self.sampling == "nearest" else 1

    def to_json(self) -> dict[str, Any]:
        """Return the transfer function as a JSON object (format ``carina-transfer``, version 1)."""
        light = {k: getattr(self.light, k) for k in ("ambient", "diffuse", "specular", "shininess_log2", "reach_mm")}
        return {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "unit": self.unit,
            "reference_mm": self.reference_mm,
            "points": self.points.tolist(),
            "sampling": self.sampling,
            "wall": self.wall,
            "light": light,
            "appearance": None if self.appearance is None else self.appearance.to_json(),
        }

    @classmethod
    @check_arguments(document=instance(Mapping, "take one from TransferFunction.to_json"))
    def from_json(cls, document: Mapping[str, Any]) -> TransferFunction:
        """Create a transfer function from a JSON object; ignore unknown keys, use defaults for missing optional keys.

        Raises
        ------
        RenderError
            If the object has another format or version, or contains invalid values.
        """
        if document.get("format") != FORMAT or document.get("version") != VERSION:
            msg = (
                f"expected a transfer function (format {FORMAT!r}, version {VERSION}); "
                f"found format {document.get('format')!r}, version {document.get('version')!r}"
            )
            raise RenderError(msg, code="render.transfer")
        try:
            light_document = dict(document.get("light") or {})
            appearance = document.get("appearance")
            known = ("ambient", "diffuse", "specular", "shininess_log2", "reach_mm")
            return cls(
                points=np.array(document["points"], dtype=np.float64),
                reference_mm=float(document.get("reference_mm", 1.0)),
                unit=document.get("unit", "HU"),
                name=str(document.get("name", "custom")),
                sampling=document.get("sampling", "trilinear"),
                wall=bool(document.get("wall", False)),
                light=Light(**{k: light_document[k] for k in known if k in light_document}),
                appearance=None if appearance is None else Appearance.from_json(appearance),
            )
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            # OverflowError: an integer of hundreds of digits cannot be converted to float.
            if isinstance(error, RenderError):
                raise
            raise RenderError(f"the transfer function cannot be read: {error}", code="render.transfer") from None

    @classmethod
    @check_arguments(text=instance(str, "read the text of a JSON file"))
    def from_json_text(cls, text: str) -> TransferFunction:
        """Create a transfer function from the text of a JSON file."""
        try:
            document = json.loads(text)
        except (ValueError, RecursionError) as error:
            # json raises ValueError for bad JSON and for integers with more digits than Python converts.
            raise RenderError(f"the transfer function is not JSON: {error}", code="render.transfer") from None
        if not isinstance(document, dict):
            raise RenderError("expected a transfer function as a JSON object", code="render.transfer")
        return cls.from_json(document)


# The wall becomes opaque around the half-maximum between air and tissue, where a lumen ends. The colours deepen from
# thin mucosa over cartilage to the tissue behind. The exposure of a scope keeps about 3 cm of airway bright.
ENDOSCOPIC = TransferFunction(
    points=np.array(
        [
            [-700.0, 0.88, 0.46, 0.41, 0.0],
            [-400.0, 0.93, 0.56, 0.50, 0.97],
            [-100.0, 0.95, 0.62, 0.56, 0.99],
            [200.0, 0.98, 0.76, 0.70, 0.995],
        ]
    ),
    name="endoscopic",
    wall=True,
    light=Light(ambient=0.26, diffuse=0.98, specular=0.35, shininess_log2=5, reach_mm=26.0),
    appearance=Appearance(vessels=0.5, rings=1.0, membrane=1.0, hue=1.0, spurs=1.0, specks=1.0),
)

CT_GREY = TransferFunction(
    points=np.array(
        [
            [-700.0, 0.35, 0.35, 0.35, 0.0],
            [-400.0, 0.55, 0.55, 0.55, 0.8],
            [50.0, 0.78, 0.78, 0.78, 0.95],
            [400.0, 1.0, 1.0, 1.0, 0.99],
        ]
    ),
    name="ct-grey",
    light=Light(ambient=0.15, diffuse=0.85),
)

# Paper 4.3 gives no transfer function; this one shows tissue as opaque, in 16-HU bins.
PAPER = TransferFunction(
    points=np.array(
        [
            [-600.0, 0.30, 0.24, 0.22, 0.0],
            [-300.0, 0.62, 0.45, 0.40, 0.6],
            [0.0, 0.85, 0.70, 0.62, 0.9],
            [400.0, 1.0, 0.97, 0.92, 0.99],
        ]
    ),
    name="paper",
    sampling="nearest",
)

SEE_THROUGH = TransferFunction(
    points=np.array(
        [
            [-700.0, 0.80, 0.45, 0.40, 0.0],
            [-550.0, 0.85, 0.50, 0.45, 0.10],
            [-300.0, 0.85, 0.50, 0.45, 0.04],
            [-20.0, 0.75, 0.35, 0.30, 0.03],
            [60.0, 0.80, 0.30, 0.25, 0.10],
            [200.0, 0.95, 0.85, 0.70, 0.35],
            [400.0, 1.0, 0.98, 0.92, 0.8],
        ]
    ),
    name="see-through",
    light=Light(ambient=0.3, diffuse=0.7),
)

PRESETS = {t.name: t for t in (ENDOSCOPIC, CT_GREY, SEE_THROUGH, PAPER)}


@check_arguments(name=text_of(200, least=0))
def transfer_preset(name: str) -> TransferFunction:
    """Return a preset: ``endoscopic``, ``ct-grey``, ``see-through`` or ``paper``.

    Raises
    ------
    UsageError
        If there is no preset of this name.

    Examples
    --------
    >>> import carina
    >>> carina.transfer_preset("ct-grey").unit
    'HU'
    """
    try:
        return PRESETS[name]
    except KeyError:
        raise UsageError(f"expected one of the transfer functions {', '.join(PRESETS)}; found {name!r}") from None


def transfer_from_histogram(volume: Volume) -> tuple[TransferFunction, float]:
    """Return a transfer function for a volume that is not in HU, from the volume's histogram.

    Otsu's threshold separates dark voxels (air) from bright voxels (tissue). The opacity ramp of the endoscopic preset
    is placed around the threshold, as it is placed around the half-maximum in HU, and scaled by the difference between
    the means of the two classes.

    Parameters
    ----------
    volume
        Any volume; its values are used without calibration.

    Returns
    -------
    tuple
        The transfer function (unit ``raw``) and the threshold below which a voxel counts as air.

    References
    ----------
    N. Otsu, A threshold selection method from gray-level histograms, IEEE Trans. SMC 9 (1979).
    """
    lo, hi = volume.value_range
    counts = np.bincount(volume.hu_zyx.ravel().astype(np.int32) - lo, minlength=hi - lo + 1).astype(np.float64)
    values = np.arange(lo, hi + 1, dtype=np.float64)
    if hi == lo:
        msg = f"every voxel of this volume has the value {lo}, so there is nothing to distinguish"
        raise RenderError(msg, code="render.transfer")
    below = np.cumsum(counts)[:-1]
    above = counts.sum() - below
    sums = np.cumsum(counts * values)[:-1]
    mean_below = sums / np.maximum(below, 1)
    mean_above = ((counts * values).sum() - sums) / np.maximum(above, 1)
    between = below * above * (mean_above - mean_below) ** 2
    # A gap between two peaks gives a plateau of equal maxima; the threshold is the middle of the plateau.
    best = np.flatnonzero(between >= between.max() * (1 - 1e-12))
    at = int(best[len(best) // 2])
    dark, bright = float(mean_below[at]), float(mean_above[at])
    threshold = float(values[at]) + 0.5
    # In HU: dark -950, bright 50, half-maximum -450; the ramp runs from 1/4 of the contrast below it to 1/20 above.
    contrast = bright - dark
    start, full = threshold - 0.25 * contrast, threshold + 0.05 * contrast
    colours = ENDOSCOPIC.points[:, 1:]
    stops = [start, full, full + 0.3 * contrast, full + 0.6 * contrast]
    points = np.column_stack([stops, colours])
    return replace(ENDOSCOPIC, points=points, unit="raw", name="from histogram"), threshold
