"""Functions that render one picture of a volume and mark the scope's tip in it, for scripts and the command line."""

from __future__ import annotations

import dataclasses
import inspect
from functools import cache
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import NDArray

from carina.argument_checks import (
    any_number,
    array_of,
    check_arguments,
    choice,
    flag,
    having,
    instance,
    mask_array,
    name_or,
    numbers_within,
    shown,
    text_of,
)
from carina.errors import RenderError, UsageError, check_type
from carina.render.processor_choice import Backend
from carina.render.renderer import Renderer
from carina.render.surface import Surface
from carina.render.transfer_function import TransferFunction
from carina.render.view_settings import ViewSettings
from carina.render.view_table import LEAD_VIEW, view_row
from carina.render.view_values import THIN, Carm, FlatPlace, GreyWindow, Orbit, Reformation, Sight, Slab
from carina.render.views import AirwayView, Picture, TreeView, View
from carina.render.wall_texture import DecorationTree
from carina.scopes import (
    FULL_FRAME,
    OUTLINES,
    DepthOfField,
    ImageField,
    Lens,
    Outline,
    PathFrames,
    Pose,
    ScopePreset,
    scope_preset,
)
from carina.volume import Volume

MARK_RGB = (70, 220, 235)
A_WORD = text_of(80, least=0)
"""Check of a text's maximum length; the view itself rejects invalid texts and numbers with a `RenderError`."""
A_TRANSFER = instance(TransferFunction, "get one from carina.transfer_preset", optional=True)
A_SCOPE = name_or(ScopePreset, "name one of carina.scopes.scope_presets", optional=True)
A_LENS = instance(Lens, "create a carina.scopes.Lens", optional=True)
AN_OUTLINE = choice(*OUTLINES, optional=True)


def _check_view(where: str, name: str, value: object) -> None:
    """Reject a view's name that is too long for an error message; `render_view` rejects other invalid views."""
    if isinstance(value, str):
        text_of(80, least=0)(where, name, value)


@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    view=_check_view,
    pose=instance(Pose, "get one from a carina.FlightPath or from carina.Pose.looking", optional=True),
    fov_deg=any_number(optional=True),
    width=any_number(),
    height=any_number(),
    method=A_WORD,
    step_vox=any_number(),
    transfer=A_TRANSFER,
    shading=flag,
    texture=flag,
    orbit=array_of(None, largest=5000.0, optional=True),
    window_hu=numbers_within(optional=True),
    extent_mm=any_number(),
    mm_per_px=any_number(optional=True),
    carm_deg=array_of(2, largest=1e6),
    tone=A_WORD,
    path=instance(PathFrames, "get one from FlightPath.frames", optional=True),
    turn_deg=any_number(),
    slab=instance(Slab, "create a carina.render.Slab", optional=True),
    scope=A_SCOPE,
    lens=A_LENS,
    outline=AN_OUTLINE,
    vignette=any_number(optional=True),
    depth_of_field=instance(DepthOfField, "create a carina.scopes.DepthOfField", optional=True),
    lumen_zyx=mask_array(optional=True),
    tree=having("branches", "get one from carina.find_airways", optional=True),
    backend=instance(Backend, "create a carina.render.Backend", optional=True),
)
def render_view(
    volume: Volume,
    *,
    view: str | View,
    pose: Pose | None = None,
    fov_deg: float | None = None,
    width: int = 512,
    height: int = 512,
    method: Literal["leap", "brute"] | str = "leap",
    step_vox: float = 0.5,
    transfer: TransferFunction | None = None,
    shading: bool = True,
    texture: bool = True,
    orbit: tuple[float, ...] | None = None,
    window_hu: tuple[float, float] | None = None,
    extent_mm: float = 60.0,
    mm_per_px: float | None = None,
    carm_deg: tuple[float, float] = (0.0, 0.0),
    tone: Literal["radiograph", "fluoroscopy"] | str = "radiograph",
    path: PathFrames | None = None,
    turn_deg: float = 0.0,
    slab: Slab | None = None,
    scope: ScopePreset | str | None = None,
    lens: Lens | None = None,
    outline: Outline | None = None,
    vignette: float | None = None,
    depth_of_field: DepthOfField | None = None,
    lumen_zyx: NDArray[np.uint8] | None = None,
    tree: DecorationTree | None = None,
    backend: Backend | None = None,
) -> Picture:
    """Render one picture of a volume.

    Parameters
    ----------
    volume
        The volume.
    view
        A view definition such as :class:`carina.render.AirwayView`, which contains all settings; or a name from
        :data:`carina.render.VIEW_NAMES` (``airway``, ``axial``, ``tree``, ...), with the parameters below.
    pose
        Pose of the tip: the camera of the airway view, the centre of the planes. Required with the name of a view.
    fov_deg
        Full angle across the shorter side of the airway view, in degrees. Default: the angle of the scope, of the lens
        calibration, or 90.
    scope
        Instrument (see :func:`carina.scopes.scope_presets`) whose lens, field of view, outline and direction of view
        are used; ``pose`` is then the end of its shaft.
    shading, texture
        Light and gloss, and decoration, of the airway view. Decoration does not come from the CT: mottling, micro
        relief, vessels and, with ``tree``, decoration fixed to anatomy.
    lens, outline, vignette, depth_of_field
        Settings of the airway view that replace the scope's. Default without a scope: a pinhole over the full frame.
        Depth of field is off by default.
    orbit
        Azimuth and elevation in degrees and, optionally, distance in mm, of the camera of ``tri-plane`` and ``tree``.
    window_hu
        Width and level. Default: (1500, -600) for planes; fitted to the values of an X-ray. In mm of water for ``drr``.
    carm_deg, tone
        Primary (LAO above 0) and secondary (cranial above 0) angle of ``drr`` in degrees, and its tone.
    path, turn_deg
        Path of ``straightened`` and ``curved``, and the rotation of their cutting plane in degrees.
    slab
        Slab thickness and kind of planes and path views.
    lumen_zyx
        The airway lumen (nz, ny, nx), required for ``tree``, and for the closed wall of the endoscopic airway view.
    tree
        The airway tree of that lumen (:class:`carina.track.AirwayTree`); the *endoscopic* preset uses it to draw rings,
        membranous wall, colour by region and ridges of forks.
    backend
        Processor of the airway view: CPU or graphics device. Default: CPU.

    Returns
    -------
    Picture
        RGB and the geometry of its pixels.

    Raises
    ------
    UsageError
        If there is no view or scope of this name, or ``orbit`` has not two or three values.
    RenderError
        If a setting is out of range, or ``tree`` is rendered without a lumen.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> pose = carina.FlightPath(airways.tree.route_to(airways.tree.root.id)).pose_at(20.0)
    >>> picture = carina.render_view(
    ...     phantom.volume, view="airway", pose=pose, width=64, height=48, lumen_zyx=airways.lumen_zyx
    ... )
    >>> picture.rgb.shape
    (48, 64, 3)
    """
    check_type("render_view", "volume", volume, Volume, "open a volume with carina.open_volume")
    options: dict[str, Any] = {
        "fov_deg": fov_deg,
        "width": width,
        "height": height,
        "method": method,
        "step_vox": step_vox,
        "shading": shading,
        "texture": texture,
        "orbit": orbit,
        "window_hu": window_hu,
        "extent_mm": extent_mm,
        "mm_per_px": mm_per_px,
        "carm_deg": carm_deg,
        "tone": tone,
        "path": path,
        "turn_deg": turn_deg,
        "slab": slab,
        "scope": scope,
        "lens": lens,
        "outline": outline,
        "vignette": vignette,
        "depth_of_field": depth_of_field,
    }
    if isinstance(view, str):
        given = {name for name, value in options.items() if _differs(value, _DEFAULTS[name])}
        ignored = sorted(given & ignored_settings(view))
        if ignored:
            raise UsageError(f"render_view: {', '.join(ignored)}: not used by the {view} view; omit it")
        spec = view_spec(view=view, pose=_needed_pose("render_view", pose), **options)
    else:
        check_type("render_view", "view", view, get_args(View), "or pass one of carina.render.VIEW_NAMES")
        doubled = [name for name, value in {"pose": pose, **options}.items() if _differs(value, _DEFAULTS[name])]
        if doubled:
            names, kind = ", ".join(doubled), type(view).__name__
            raise UsageError(
                f"render_view: {names}: expected as fields of the {kind}, found as separate arguments; set them in "
                f"the {kind}"
            )
        spec = view
    renderer = Renderer(volume, transfer=transfer, backend=backend)
    if lumen_zyx is not None and isinstance(spec, AirwayView | TreeView):
        renderer.set_lumen(lumen_zyx, tree)
    if isinstance(spec, AirwayView) and spec.method == "leap":
        renderer.prepare(progress=False)
    return renderer.render(spec)


_DEFAULTS = {name: parameter.default for name, parameter in inspect.signature(render_view).parameters.items()}


def _differs(value: object, default: object) -> bool:
    """Return whether an argument differs from its default; an array differs from every default."""
    return value is not default and (isinstance(value, np.ndarray) or value != default)


def _needed_pose(where: str, pose: object) -> Pose:
    check_type(where, "pose", pose, Pose, "get one from a carina.FlightPath or from carina.Pose.looking")
    assert isinstance(pose, Pose)
    return pose


@check_arguments(
    volume=instance(Volume, "open a volume with carina.open_volume"),
    fov_deg=any_number(optional=True),
    width=any_number(),
    height=any_number(),
    step_vox=any_number(),
    transfer=A_TRANSFER,
    scope=A_SCOPE,
    lens=A_LENS,
    outline=AN_OUTLINE,
    lumen_zyx=mask_array(optional=True),
)
def render_surface(
    volume: Volume,
    *,
    pose: Pose,
    fov_deg: float | None = None,
    width: int = 512,
    height: int = 512,
    step_vox: float = 0.5,
    transfer: TransferFunction | None = None,
    scope: ScopePreset | str | None = None,
    lens: Lens | None = None,
    outline: Outline | None = None,
    lumen_zyx: NDArray[np.uint8] | None = None,
) -> Surface:
    """Return depth, position and normal of the first wall at every pixel of an airway view.

    Parameters
    ----------
    volume
        The volume.
    pose
        Camera of the airway view.
    fov_deg
        Full angle across the shorter side, in degrees; default as in :func:`render_view`.
    scope, lens, outline
        As in :func:`render_view`.
    step_vox
        Ray step in units of the smallest spacing.
    transfer
        Transfer function that defines the wall; default: the *endoscopic* preset.
    lumen_zyx
        The airway lumen (nz, ny, nx), for the closed wall of the endoscopic airway view.

    Returns
    -------
    Surface
        ``depth_mm`` (height, width) float32 along the ray, ``position_lps`` (height, width, 3) float64 and
        ``normal_lps`` (height, width, 3) float32, a unit vector on the camera's side; NaN where a ray meets no wall.

    Raises
    ------
    RenderError
        If a setting is out of range.

    Examples
    --------
    >>> import carina
    >>> import numpy as np
    >>> ball = np.full((40, 40, 40), 40, dtype=np.int16)
    >>> z, y, x = np.indices(ball.shape) - 19.5
    >>> ball[x * x + y * y + z * z < 12 * 12] = -1000
    >>> volume = carina.Volume(ball, np.diag([1.0, 1.0, 1.0, 1.0]))
    >>> pose = carina.Pose.looking((19.5, 19.5, 19.5), (0, 0, 1))
    >>> surface = carina.render_surface(volume, pose=pose, width=9, height=9)
    >>> abs(float(surface.depth_mm[4, 4]) - 12) < 0.5
    True
    """
    view = view_spec(
        view=LEAD_VIEW,
        pose=pose,
        scope=scope,
        fov_deg=fov_deg,
        lens=lens,
        outline=outline,
        width=width,
        height=height,
        step_vox=step_vox,
    )
    assert isinstance(view, AirwayView)
    renderer = Renderer(volume, transfer=transfer)
    if lumen_zyx is not None:
        renderer.set_lumen(lumen_zyx)
    # Brute force: for a single picture the radius map takes more time than it saves.
    return renderer.surface(view)


_STRAIGHT = PathFrames(np.array([0.0, 1.0]), np.stack([np.eye(4)] * 2))
_PROBES: dict[str, tuple[Any, Any]] = {
    "pose": (Pose.looking((0, 0, 0), (0, 0, -1)), Pose.looking((0, 0, 0), (0, 1, 0))),
    "fov_deg": (30.0, 60.0),
    "method": ("leap", "brute"),
    "step_vox": (0.5, 1.0),
    "shading": (True, False),
    "texture": (True, False),
    "orbit": ((0.0, 0.0), (10.0, 10.0)),
    "window_hu": ((100.0, 0.0), (200.0, 0.0)),
    "extent_mm": (60.0, 70.0),
    "mm_per_px": (0.5, 1.0),
    "carm_deg": ((0.0, 0.0), (10.0, 10.0)),
    "tone": ("radiograph", "fluoroscopy"),
    "path": (_STRAIGHT, PathFrames(np.array([0.0, 2.0]), np.stack([np.eye(4)] * 2))),
    "turn_deg": (0.0, 10.0),
    "slab": (Slab(5.0, "min"), Slab(10.0, "min")),
    "scope": ("thin", "ultrathin"),
    "lens": (Lens("pinhole"), Lens("equidistant")),
    "outline": ("round", "octagon"),
    "vignette": (0.0, 1.0),
    "depth_of_field": (DepthOfField(3.0, 50.0), DepthOfField(5.0, 50.0)),
}
"""Two values of each setting of a view; `ignored_settings` compares the two views to find the settings in use."""


@cache
def ignored_settings(view: str) -> frozenset[str]:
    """Return the settings of `render_view` that do not change a view; ``pose`` means the direction of the pose.

    Examples
    --------
    >>> sorted(ignored_settings("axial") & {"fov_deg", "window_hu", "tone"})
    ['fov_deg', 'tone']
    """
    row = view_row(view)
    base: dict[str, Any] = {"view": row.name, "pose": _PROBES["pose"][0], "path": _STRAIGHT}
    found = set()
    for name, values in _PROBES.items():
        first, second = (view_spec(**{**base, name: value}) for value in values)
        if all(getattr(first, one.name) == getattr(second, one.name) for one in dataclasses.fields(first)):
            found.add(name)
    return frozenset(found)


def view_spec(
    *,
    view: str,
    pose: Pose,
    fov_deg: float | None = None,
    width: int = 512,
    height: int = 512,
    method: Literal["leap", "brute"] | str = "leap",
    step_vox: float = 0.5,
    shading: bool = True,
    texture: bool = True,
    orbit: tuple[float, ...] | None = None,
    window_hu: tuple[float, float] | None = None,
    extent_mm: float = 60.0,
    mm_per_px: float | None = None,
    carm_deg: tuple[float, float] = (0.0, 0.0),
    tone: Literal["radiograph", "fluoroscopy"] | str = "radiograph",
    path: PathFrames | None = None,
    turn_deg: float = 0.0,
    slab: Slab | None = None,
    scope: ScopePreset | str | None = None,
    lens: Lens | None = None,
    outline: Outline | None = None,
    vignette: float | None = None,
    depth_of_field: DepthOfField | None = None,
    picture_turned: bool = False,
) -> View:
    """Return the view that :func:`render_view` renders, checked without a volume, with the same parameters.

    With ``picture_turned`` an airway view through a scope is turned by 180 degrees, as the operator who faces the
    patient sees it.
    """
    _needed_pose("view_spec", pose)
    x, y, z = (float(v) for v in pose.position_lps)
    if orbit is not None and len(orbit) not in {2, 3}:
        raise UsageError(f"expected an orbit of azimuth, elevation and optionally distance; found {orbit}")
    if window_hu is not None and np.shape(window_hu) != (2,):
        raise RenderError(
            f"a window needs a width above 0 and a level; found {shown(window_hu)}", code="render.setting"
        )
    row = view_row(view)
    sight = Sight(
        window=None if window_hu is None else GreyWindow(*window_hu),
        slab=THIN if slab is None else slab,
        zoom={view: FlatPlace(mm_per_px, extent_mm)},
        orbits={} if orbit is None else {view: Orbit(*orbit)},
        carm=Carm(*carm_deg, mm_per_px, cast(Any, tone)),
        reformation=Reformation(turn_deg, mm_per_px),
        shading=shading,
        texture=texture,
        method=cast(Any, method),
    )
    return row.spec(
        ViewSettings(
            pose=pose,
            point_lps=(x, y, z),
            width=width,
            height=height,
            scope=_scope_preset(scope),
            fov_deg=fov_deg,
            lens=lens,
            field=_picture_field(scope, outline, vignette),
            depth_of_field=depth_of_field,
            picture_turned=picture_turned,
            step_vox=step_vox,
            sight=sight,
            path=path,
        )
    )


def _scope_preset(scope: ScopePreset | str | None) -> ScopePreset | None:
    return scope_preset(scope) if isinstance(scope, str) else scope


def _picture_field(scope: ScopePreset | str | None, outline: Outline | None, vignette: float | None) -> ImageField:
    """Return outline and vignette of an airway view; a value that the caller does not give is taken from the scope."""
    preset = _scope_preset(scope)
    own = FULL_FRAME if preset is None else preset.field
    return ImageField(
        own.outline if outline is None else outline, vignette=own.vignette if vignette is None else vignette
    )


def mark_tip(picture: Picture, point_lps: NDArray[np.float64] | tuple[float, float, float]) -> Picture:
    """Return a copy of a picture with a cross-hair at a point (LPS mm); unmarked if the point is outside the picture.

    Raises
    ------
    UsageError
        If the picture has no geometry of its pixels.
    """
    if picture.lps_from_pixel is None and picture.lps_from_camera is None and picture.lines is None:
        raise UsageError("this image has no pixel geometry, so no point can be marked in it")
    at = picture.pixel_of(point_lps)
    rgb = picture.rgb.copy()
    height, width = rgb.shape[:2]
    if at is None or not (0 <= at[0] < width and 0 <= at[1] < height):
        return dataclasses.replace(picture, rgb=rgb)
    column, row = int(at[0]), int(at[1])
    gap, arm = max(2, min(width, height) // 128), max(6, min(width, height) // 32)

    def draw_cross(reach: int, half: int, colour: tuple[int, int, int]) -> None:
        for low, high in ((-reach, -gap), (gap, reach)):
            for rows, columns in (((-half, half), (low, high)), ((low, high), (-half, half))):
                top, left = max(row + rows[0], 0), max(column + columns[0], 0)
                rgb[top : max(row + rows[1] + 1, 0), left : max(column + columns[1] + 1, 0)] = colour

    # A dark rim is drawn first, so that the cross is visible on white bone.
    draw_cross(arm + 1, 1, (0, 0, 0))
    draw_cross(arm, 0, MARK_RGB)
    return dataclasses.replace(picture, rgb=rgb)
