"""View definitions that the renderer accepts, and the picture that it returns."""

from __future__ import annotations

import json
import numbers
import os
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import DTypeLike, NDArray

from carina.argument_checks import (
    any_number,
    array_of,
    check_fields,
    each,
    flag,
    instance,
    is_number,
    lps_point,
    number_from,
    shown,
    text_of,
)
from carina.breathing import MOVED_TEXT, ChestDeformation
from carina.disk import write_whole
from carina.display import one_line
from carina.display.dot_letters import with_text_lines
from carina.display.png import png_bytes
from carina.errors import RenderError, UsageError
from carina.render.appearance import DecorationName, check_guides
from carina.render.png_text import BADGES_KEYWORD, KEYWORD
from carina.render.view_values import Slab
from carina.scopes import FULL_FRAME, PINHOLE, DepthOfField, ImageField, Lens, Optics, PathFrames, Pose, ScopePreset
from carina.volume import Note
from carina.volume.anatomical_planes import PLANES, Plane
from carina.volume.inserted_structures import INSERTED, PICTURE_TEXT

__all__ = [
    "AirwayView",
    "CutPlaneView",
    "DrrView",
    "PathView",
    "Picture",
    "PictureLines",
    "RenderStats",
    "Slab",
    "SliceView",
    "TreeView",
    "TriPlaneView",
    "View",
    "XrayView",
]

WINDOW_HU = (1500.0, -600.0)
STOP_TRANSPARENCY = 1 / 512


A_POSE = instance(Pose, "get one from a carina.FlightPath or from carina.Pose.looking")
A_WINDOW = array_of(2)
A_POINT = array_of(3, largest=1e40)


def _check(
    width: int, height: int, *, fov_deg: float | None = None, window_hu: tuple[float, float] | None = None
) -> None:
    whole_sizes = all(isinstance(side, numbers.Integral) and not isinstance(side, bool) for side in (width, height))
    if not (whole_sizes and 1 <= width <= 8192 and 1 <= height <= 8192):
        raise RenderError(
            f"an image must have 1 to 8192 pixels on each side; found {shown(width)} x {shown(height)}",
            code="render.camera",
        )
    if fov_deg is not None and not (is_number(fov_deg) and 1.0 <= fov_deg <= 170.0):
        raise RenderError(
            f"the field of view must be between 1 and 170 degrees; found {shown(fov_deg)}", code="render.camera"
        )
    given = window_hu
    if window_hu is not None:
        try:
            A_WINDOW("window", "window", window_hu)
        except UsageError:
            window_hu = (0.0, 0.0)
    if window_hu is not None and not window_hu[0] > 0:
        raise RenderError(
            f"a window needs a width above 0 and a level, both at most 1e5; found {shown(given)}", code="render.setting"
        )


def _check_mm(what: str, value: float | None) -> None:
    if value is not None and not (is_number(value) and 0 < value <= 1e5):
        raise RenderError(f"{what} must be above 0 mm and at most 1e5 mm; found {shown(value)}", code="render.setting")


def _check_point(what: str, at: tuple[float, float, float] | NDArray[np.float64]) -> None:
    try:
        A_POINT(what, "point", at)
    except UsageError:
        raise RenderError(
            f"{what} must be three finite numbers in mm (LPS); found {shown(at)}", code="render.setting"
        ) from None


def _check_plane(name: str) -> None:
    if not isinstance(name, str) or name not in PLANES:
        raise RenderError(f"expected one of the planes {', '.join(PLANES)}; found {shown(name)}", code="render.setting")


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class AirwayView:
    """View from the scope's tip by direct volume rendering (paper 3.1).

    Parameters
    ----------
    pose
        Pose of the camera.
    fov_deg
        Full angle across the shorter side, in degrees; None uses the angle of the lens calibration, else 90.
    width, height
        Size of the picture in pixels, 1 to 8192.
    step_vox
        Ray step in units of the smallest spacing. With a transfer function of sampling ``nearest`` (paper) the step is
        one voxel and shading is off.
    shading
        Whether light and gloss are computed.
    method
        ``leap`` leaps if that is faster: a few trial rays decide, or for transfer functions of sampling ``nearest``
        (paper) the measured times of a few rows. ``leap-always`` leaps in every picture, for measurements; ``brute``
        reads every sample. The pictures are the same; leaps over opaque values may move one channel by one level.
    lens
        Lens model.
    field
        Outline of the picture and its vignette.
    depth_of_field
        Sharp range; nearer and farther walls are blurred. It needs the whole picture and about twice the time.
    stop_transparency
        Transparency below which a ray ends. Change it only for comparisons with renderers that end rays elsewhere.
    guides_mm
        Ends of the scope's light guides in camera space, mm; they replace those of the transfer function's appearance.
    texture
        Whether decoration is drawn, which does not come from the CT: mottling, micro relief and vessels, rings,
        membranous wall, colour by region, pale ridges.
    deformation
        Deformation of the chest at the instant of the picture (:class:`carina.breathing.Breathing`); the pose is then
        one in the moved patient. None, and a deformation that moves nothing, show the CT as it is, bit for bit.
    """

    pose: Pose
    fov_deg: float | None = None
    width: int = 512
    height: int = 512
    step_vox: float = 0.5
    shading: bool = True
    method: Literal["leap", "brute", "leap-always"] = "leap"
    lens: Lens = PINHOLE
    field: ImageField = FULL_FRAME
    depth_of_field: DepthOfField | None = None
    stop_transparency: float = STOP_TRANSPARENCY
    guides_mm: tuple[tuple[float, float, float], ...] | None = None
    texture: bool = True
    deformation: ChestDeformation | None = None

    def __post_init__(self) -> None:
        """Raise an error if a field of this `AirwayView` has an invalid value."""
        _check(self.width, self.height, fov_deg=self.fov_deg)
        check_fields(
            self,
            RenderError,
            "render.setting",
            pose=A_POSE,
            step_vox=any_number(),
            shading=flag,
            method=text_of(),
            lens=instance(Lens, "create a carina.scopes.Lens"),
            field=instance(ImageField, "create a carina.scopes.ImageField"),
            depth_of_field=instance(DepthOfField, "create a carina.scopes.DepthOfField", optional=True),
            stop_transparency=any_number(),
            guides_mm=each(lps_point(), least=1, most=16, optional=True),
            texture=flag,
            deformation=instance(ChestDeformation, "get one from carina.breathing.Breathing.at", optional=True),
        )
        # A lens that does not fit the picture is rejected before any ray is cast; the picture uses the same optics.
        _ = self.optics
        if not 0.01 <= self.step_vox <= 100:
            raise RenderError(
                f"the ray step must be between 0.01 and 100 voxels; found {self.step_vox}", code="render.setting"
            )
        if self.method not in {"leap", "brute", "leap-always"}:
            msg = f"the ray method must be leap, brute or leap-always; found {self.method!r}"
            raise RenderError(msg, code="render.setting")
        if not 1 / 65536 <= self.stop_transparency <= 0.25:
            msg = f"the transparency at which rays stop must be between 1/65536 and 1/4; found {self.stop_transparency}"
            raise RenderError(msg, code="render.setting")
        if self.guides_mm is not None:
            check_guides(self.guides_mm)

    @property
    def lps_from_rest(self) -> NDArray[np.float64] | None:
        """Matrix (4, 4) from the CT at rest to the breathing patient, mm; None if the patient is at rest."""
        return None if self.deformation is None or self.deformation.is_rest else self.deformation.lps_from_rest

    @property
    def optics(self) -> Optics:
        """Optics of the view: its lens, fitted to the size of its picture."""
        return self.lens.optics(self.width, self.height, self.fov_deg)

    @classmethod
    def of_scope(
        cls,
        scope: ScopePreset,
        tip: Pose,
        *,
        fov_deg: float | None = None,
        picture_turned: bool = False,
        **settings: Any,
    ) -> AirwayView:
        """Return the view of an instrument whose shaft ends at ``tip``: its lens, field of view, outline and direction.

        Every other setting can be given by name and replaces the instrument's. Depth of field is off by default. For
        ``picture_turned`` see `ScopePreset.camera_pose`.
        """
        seen = {"lens": scope.lens, "field": scope.field, "guides_mm": scope.guides_mm, **settings}
        if fov_deg is None and seen["lens"].calibration is None:
            fov_deg = scope.usual_fov_deg
        return cls(scope.camera_pose(tip, picture_turned=picture_turned), fov_deg=fov_deg, **seen)


@one_line
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GreyView:
    """Common settings of the pictures that show the CT's values in a plane or surface: size, window and slab."""

    width: int = 512
    height: int = 512
    window_hu: tuple[float, float] = WINDOW_HU
    slab: Slab | None = None

    def __post_init__(self) -> None:
        check_fields(self, RenderError, "render.setting", window_hu=A_WINDOW)
        _check(self.width, self.height, window_hu=self.window_hu)
        check_fields(self, RenderError, "render.setting", slab=instance(Slab, "create a Slab", optional=True))


@one_line
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class OrbitView:
    """Common settings of the pictures from a camera that orbits its target.

    Azimuth 0 looks from anterior, 90 from the patient's left; a positive elevation looks from above. ``distance_mm`` is
    the distance between camera and target; with None the whole target fits the picture.
    """

    azimuth_deg: float = 0.0
    elevation_deg: float = 0.0
    distance_mm: float | None = None
    width: int = 512
    height: int = 512
    fov_deg: float = 30.0

    def __post_init__(self) -> None:
        _check(self.width, self.height, fov_deg=self.fov_deg)
        angle = number_from(-3600.0, 3600.0, unit="degrees")
        check_fields(self, RenderError, "render.setting", azimuth_deg=angle, elevation_deg=angle, fov_deg=any_number())
        _check_mm("the camera's distance", self.distance_mm)


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class CutPlaneView(GreyView):
    """Cut-plane through the tip, spanned by the camera's right and down axes (paper 3.1).

    The plane is ``extent_mm`` wide. The centre of the picture is the tip or, with ``centre_lps``, the point of the
    plane nearest to that point (LPS mm).
    """

    pose: Pose
    _: KW_ONLY
    extent_mm: float = 60.0
    centre_lps: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        """Raise an error if a field of this `CutPlaneView` has an invalid value."""
        GreyView.__post_init__(self)
        check_fields(self, RenderError, "render.setting", pose=A_POSE, extent_mm=any_number())
        _check_mm("the extent of a cut-plane", self.extent_mm)
        if self.centre_lps is not None:
            _check_point("the centre of a cut-plane", self.centre_lps)


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TriPlaneView(OrbitView):
    """Sagittal, coronal and axial plane through a point, drawn in occlusion order from an orbit camera (paper 3.1).

    Without a distance the whole volume fits the picture. Values below ``clear_below`` are transparent.

    The camera looks at the point where the planes meet. With ``look_at="volume"`` it looks at the centre of the volume,
    so it does not move while the user moves a plane.
    """

    centre_lps: tuple[float, float, float]
    _: KW_ONLY
    azimuth_deg: float = 35.0
    elevation_deg: float = 25.0
    window_hu: tuple[float, float] = WINDOW_HU
    clear_below: float | None = None
    look_at: Literal["point", "volume"] = "point"

    def __post_init__(self) -> None:
        """Raise an error if a field of this `TriPlaneView` has an invalid value."""
        OrbitView.__post_init__(self)
        _check(self.width, self.height, window_hu=self.window_hu)
        clear = number_from(-40_000.0, 40_000.0, optional=True)
        check_fields(self, RenderError, "render.setting", clear_below=clear, look_at=text_of(), window_hu=A_WINDOW)
        _check_point("the point where the planes meet", self.centre_lps)
        if self.look_at not in {"point", "volume"}:
            raise RenderError(f"look_at must be point or volume; found {self.look_at!r}", code="render.setting")


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class XrayView:
    """Maximum intensity projection along the grid axis nearest to a patient axis (paper 3.1).

    The orientation is that of the slices: ``coronal`` is the view from the front, ``sagittal`` from the patient's left,
    ``axial`` from the feet. The picture shows the whole volume in true proportions. With ``window_hu`` None the window
    is fitted to the projected values: the largest values are mostly bone, far above the window of the slices.
    """

    axis: Plane
    width: int = 512
    height: int = 512
    window_hu: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Raise an error if a field of this `XrayView` has an invalid value."""
        _check(self.width, self.height, window_hu=self.window_hu)
        _check_plane(self.axis)


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class DrrView:
    """Digitally reconstructed radiograph: X-rays from a C-arm, attenuated by the volume.

    Angles are those of DICOM PS3.3 C.8.7.5 (Positioner Primary and Secondary Angle), for a supine patient. The picture
    is seen from the detector, as fluoroscopy shows it: at angles 0, 0 patient right is on screen left. The C-arm turns
    about the centre of the volume.

    Parameters
    ----------
    primary_deg
        Rotation of the detector from anterior (0) towards the patient's left (LAO, above 0) or right (RAO, below 0).
    secondary_deg
        Rotation of the detector towards the head (cranial, above 0) or the feet (caudal, below 0).
    width, height
        Size of the picture in pixels, 1 to 8192.
    parallel
        Whether the rays are parallel.
    sid_mm, sod_mm
        Distances from the source to the detector and from the source to the centre.
    mm_per_px
        Size of a pixel at the centre; None fits the bounding box of the volume at primary angles 0 and 90.
    tone
        ``radiograph`` shows the logarithm of the intensity (bone white), ``fluoroscopy`` the intensity (bone dark).
    window_mm
        Width and level in mm of water; None fits the window to the picture.
    """

    primary_deg: float = 0.0
    secondary_deg: float = 0.0
    width: int = 512
    height: int = 512
    parallel: bool = False
    sid_mm: float = 1200.0
    sod_mm: float = 800.0
    mm_per_px: float | None = None
    tone: Literal["radiograph", "fluoroscopy"] = "radiograph"
    window_mm: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Raise an error if a field of this `DrrView` has an invalid value."""
        _check(self.width, self.height, window_hu=self.window_mm)
        check_fields(
            self,
            RenderError,
            "render.setting",
            primary_deg=any_number(),
            secondary_deg=any_number(),
            parallel=flag,
            sid_mm=any_number(),
            sod_mm=any_number(),
            tone=text_of(),
        )
        _check_mm("the size of a pixel", self.mm_per_px)
        if not -360.0 <= self.primary_deg <= 360.0:
            raise RenderError(
                f"the C-arm's primary angle (LAO/RAO) must be between -360 and 360 degrees; found {self.primary_deg}",
                code="render.setting",
            )
        if not -90.0 <= self.secondary_deg <= 90.0:
            raise RenderError(
                "the C-arm's secondary angle (cranial/caudal) must be between -90 and 90 "
                f"degrees; found {self.secondary_deg}",
                code="render.setting",
            )
        if not 100.0 <= self.sod_mm <= self.sid_mm <= 5000.0:
            found = f"{self.sod_mm} and {self.sid_mm}"
            raise RenderError(
                "the distances from the source to the centre and to the detector must be between 100 and 5000 mm, in "
                f"increasing order; found {found}",
                code="render.setting",
            )
        if self.tone not in {"radiograph", "fluoroscopy"}:
            raise RenderError(f"the tone must be radiograph or fluoroscopy; found {self.tone!r}", code="render.setting")


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PathView(GreyView):
    """Airway along a path, with the root at the top; the scale in mm is equal across and down.

    ``straightened`` stacks the planes perpendicular to the path: the path becomes a straight line, and a row's height
    in the picture is its distance along the route in mm. The picture covers 40 mm on each side; ``turn_deg`` rotates
    the cutting plane about the path. ``curved`` is the stretched curved planar reformation: a straight line sweeps
    along the path, and its surface is unrolled, so lengths on it are true. The line runs from patient right to left at
    ``turn_deg`` 0, as in a coronal slice, and from anterior to posterior at 90, as in a sagittal slice.

    With ``mm_per_px`` the picture is centred on the position ``centre_mm`` along the path; without it, the whole path
    fits.

    References
    ----------
    Kanitsar, Fleischmann, Wegenkittl, Felkel, Groeller, "CPR - curved planar reformation", IEEE Visualization 2002.
    """

    kind: Literal["straightened", "curved"]
    path: PathFrames
    _: KW_ONLY
    turn_deg: float = 0.0
    mm_per_px: float | None = None
    centre_mm: float = 0.0

    def __post_init__(self) -> None:
        """Raise an error if a field of this `PathView` has an invalid value."""
        GreyView.__post_init__(self)
        check_fields(
            self,
            RenderError,
            "render.setting",
            kind=text_of(),
            path=instance(PathFrames, "get one from FlightPath.frames"),
            turn_deg=number_from(-3600.0, 3600.0, unit="degrees"),
            centre_mm=number_from(-1e5, 1e5, unit="mm"),
        )
        _check_mm("the size of a pixel", self.mm_per_px)
        if self.kind not in {"straightened", "curved"}:
            raise RenderError(f"a path view must be straightened or curved; found {self.kind!r}", code="render.setting")
        if not (np.isfinite(self.turn_deg) and np.isfinite(self.centre_mm)):
            raise RenderError(
                "the rotation and the position of a path view must be finite numbers", code="render.setting"
            )


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class SliceView(GreyView):
    """Slice along patient axes, in radiological display.

    The patient's right is on the left of the screen; a sagittal slice has anterior on the left.

    The plane passes through ``centre_lps`` (LPS mm). With ``mm_per_px`` the picture is centred on that point; without
    it, the whole volume fits.
    """

    plane: Plane
    centre_lps: tuple[float, float, float]
    _: KW_ONLY
    mm_per_px: float | None = None

    def __post_init__(self) -> None:
        """Raise an error if a field of this `SliceView` has an invalid value."""
        GreyView.__post_init__(self)
        _check_plane(self.plane)
        _check_mm("the size of a pixel", self.mm_per_px)
        _check_point("the slice's centre", self.centre_lps)


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class TreeView(OrbitView):
    """View of the lumen's surface from outside, from a camera that orbits the centre of the lumen."""


View = AirwayView | CutPlaneView | TriPlaneView | XrayView | SliceView | TreeView | DrrView | PathView


@one_line
@dataclass(frozen=True, slots=True)
class RenderStats:
    """Render method, ray counts and time of a picture.

    ``method`` is the caster that ran: ``leap``, ``leap-all``, ``brute``, ``plane``, ``projection``, ``radiograph`` or
    ``lines``; ``gpu-leap`` and ``gpu-brute`` if a graphics device rendered the picture.

    ``num_loads`` counts the reads of volume and maps: four rows of two voxels for each sample (one voxel where sampling
    is ``nearest``), eight more rows for the gradient of each shaded sample, one radius for each look-up, and one label
    for each leap over all classes. With leaps over values one look-up reads value and radius. It is 0 for planes.

    ``rays_s`` is the processor time of the picture threads divided by their number: the time of the rays if no other
    program uses a core. It is None for planes, on a graphics device, in a cluster, and on systems other than Linux.
    """

    method: str
    width: int
    height: int
    num_rays: int
    num_samples: int
    num_lookups: int
    num_leaps: int
    num_skipped: int
    num_shaded: int
    num_loads: int
    seconds: float
    rays_s: float | None = None


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class PictureLines:
    """Positions in the patient of the rows of a picture whose surface is curved.

    Column ``column`` of a row is at ``start_lps + column * step_lps``, measured at the row's middle; both arrays are
    (height, 3), LPS mm. ``path_mm`` (height,) is the position of each row along the path, NaN beyond the ends of the
    path. ``path_column`` (height,) is the column at which the path crosses the row.
    """

    start_lps: NDArray[np.float64]
    step_lps: NDArray[np.float64]
    path_mm: NDArray[np.float64]
    path_column: NDArray[np.float64]
    mm_per_px: float

    def lps_of(self, column: float, row: float) -> NDArray[np.float64]:
        """Return the point (3,), LPS mm, at a position of the picture; rows outside the picture are clamped to it."""
        middles = np.arange(len(self.start_lps)) + 0.5
        start, step = (
            np.array([np.interp(row, middles, values[:, axis]) for axis in range(3)])
            for values in (self.start_lps, self.step_lps)
        )
        return np.asarray(start + column * step)

    def pixel_of(self, point_lps: NDArray[np.float64]) -> tuple[float, float]:
        """Return the position (column, row) in the picture whose point is nearest to ``point_lps``."""
        offset = point_lps - self.start_lps
        columns = np.einsum("ij,ij->i", offset, self.step_lps) / np.einsum("ij,ij->i", self.step_lps, self.step_lps)
        columns = np.clip(columns, 0.0, None)
        away = np.linalg.norm(offset - columns[:, None] * self.step_lps, axis=1)
        row = int(np.argmin(away))
        # The position between two rows divides their distances to the point in proportion.
        sides = [n for n in (row - 1, row + 1) if 0 <= n < len(away)]
        beside = min(sides, key=lambda n: float(away[n]), default=row)
        total = float(away[row] + away[beside])
        t = float(away[row]) / total if beside != row and total > 0.0 and total < 1.5 * self.mm_per_px else 0.0
        return (
            float((1.0 - t) * columns[row] + t * columns[beside]),
            row + 0.5 + t * (beside - row),
        )


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """Rendered view with its geometry.

    ``numpy.asarray`` returns ``rgb``.

    Parameters
    ----------
    rgb
        Pixels, (height, width, 3) uint8.
    view
        Name of the view.
    stats
        Render method, counts and time.
    lps_from_pixel
        Matrix (4, 4) of planar views, which maps (column, row, depth in mm, 1) to LPS mm; pixel (0, 0) is the top-left
        *corner* of the top-left pixel. The third column is the direction of projection or the plane's normal.
    lps_from_camera, fov_deg
        Camera (4, 4) and field of view of perspective views. The camera of a radiograph is the X-ray source, with +x
        mirrored, since the picture is seen from the detector.
    lines
        Positions of the rows, for views along a path.
    optics
        Lens of an airway view that is not a pinhole.
    decorated
        Decoration in the picture that does not come from the CT, as names of fields of
        :class:`carina.render.Appearance`.
    lps_from_rest
        Matrix (4, 4) from the CT at rest to the patient in the picture, mm, if breathing has moved the patient. Saved
        pictures then contain the text *simulated breathing*.

    Examples
    --------
    >>> import numpy as np
    >>> import carina
    >>> volume = carina.Volume(np.zeros((4, 5, 6), dtype=np.int16), np.eye(4))
    >>> pose = carina.Pose.looking((2, 2, 2), (0, 0, -1))
    >>> picture = carina.render_view(volume, view="axial", pose=pose, width=32, height=24)
    >>> np.asarray(picture).shape
    (24, 32, 3)
    """

    rgb: NDArray[np.uint8]
    view: str
    stats: RenderStats
    lps_from_pixel: NDArray[np.float64] | None = None
    lps_from_camera: NDArray[np.float64] | None = None
    fov_deg: float | None = None
    lines: PictureLines | None = None
    optics: Optics | None = None
    decorated: tuple[DecorationName, ...] = ()
    lps_from_rest: NDArray[np.float64] | None = None

    def __repr__(self) -> str:
        """Return a one-line description of this `Picture` for the Python interpreter."""
        height, width = self.rgb.shape[:2]
        return f"Picture({self.view!r}, {width}x{height}, {self.stats.method}, {self.stats.seconds:.3g} s)"

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return ``rgb`` for ``numpy.asarray``; the array is copied only for another type or on request."""
        return np.array(self.rgb, dtype=dtype, copy=copy)

    def _repr_png_(self) -> bytes:
        """Return the pixel data as PNG, for a notebook."""
        return png_bytes(np.ascontiguousarray(self.rgb))

    def pixel_of(self, point_lps: NDArray[np.float64] | tuple[float, float, float]) -> tuple[float, float] | None:
        """Return where a point appears, as (column, row) in corner coordinates; None if the camera cannot see it.

        The position can be outside the picture or its outline.
        """
        point = np.asarray(point_lps, dtype=np.float64)
        if self.lines is not None:
            return self.lines.pixel_of(point)
        if self.lps_from_pixel is not None:
            column, row, _ = np.linalg.solve(self.lps_from_pixel[:3, :3], point - self.lps_from_pixel[:3, 3])
            return float(column), float(row)
        if self.lps_from_camera is None or self.fov_deg is None:
            return None
        in_camera = self.lps_from_camera[:3, :3].T @ (point - self.lps_from_camera[:3, 3])
        if self.optics is not None:
            column, row = self.optics.pixels_of(in_camera[None])[0]
            return None if np.isnan(column) else (float(column), float(row))
        x, y, z = in_camera
        if z <= 0:
            return None
        height, width = self.rgb.shape[:2]
        focal_px = min(width, height) / 2 / np.tan(np.deg2rad(self.fov_deg) / 2)
        return float(width / 2 + focal_px * x / z), float(height / 2 + focal_px * y / z)

    def place(self) -> dict[str, Any]:
        """Return view, pose and field of view as a ``carina-pose`` document, LPS mm.

        Fields that do not apply to the view are None.
        """

        def rows(matrix: NDArray[np.float64] | None) -> list[list[float]] | None:
            return None if matrix is None else matrix.tolist()

        return {
            "format": "carina-pose",
            "version": 1,
            "space": "LPS",
            "unit": "mm",
            "view": self.view,
            "lps_from_camera": rows(self.lps_from_camera),
            "lps_from_pixel": rows(self.lps_from_pixel),
            "fov_deg": None if self.fov_deg is None else float(self.fov_deg),
            "decorated": list(self.decorated),
            **({} if self.lps_from_rest is None else {"lps_from_rest": rows(self.lps_from_rest)}),
        }

    def save(self, path: str | os.PathLike[str], *, badges: Sequence[Note] = ()) -> Path:
        """Write the picture as PNG and return the path; an existing file is replaced completely or not at all.

        The text chunk ``carina-pose`` contains :meth:`place`; :func:`carina.render.read_png_pose` reads it. The chunk
        ``carina-badges`` contains the permanent notes of the case; :func:`carina.render.read_png_badges` reads it.

        Raises
        ------
        RenderError
            If the name does not end in ``.png``.
        DiskError
            If the folder does not exist or is not writable, or the disk is full.
        """
        target = Path(path)
        if target.suffix.lower() != ".png":
            raise RenderError(f"saving an image: expected a file name that ends in .png; found {target.name!r}")
        return write_whole(target, self.png(badges=badges), what="the image")

    def png(self, *, badges: Sequence[Note] = ()) -> bytes:
        """Return the picture as the bytes of the PNG file that :meth:`save` writes."""
        words = {KEYWORD: json.dumps(self.place(), allow_nan=False)}
        if badges:
            rows = [{"code": badge.code, "words": badge.words} for badge in badges]
            words[BADGES_KEYWORD] = json.dumps(rows)
        # The lines are visible, because other programs show no text chunk.
        lines = [PICTURE_TEXT] if any(badge.code == INSERTED for badge in badges) else []
        if self.lps_from_rest is not None:
            lines.append(MOVED_TEXT)
        rgb = with_text_lines(self.rgb, lines) if lines else self.rgb
        return png_bytes(np.ascontiguousarray(rgb), words)
