"""``carina render``: render one view of a scan or a case as an image."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.along import check_destination, print_drawn_parts, route_to
from carina.cli.arguments import check_needs, check_output_file, parse_point
from carina.cli.console import interruptible, print_json, print_note, progress_printer
from carina.cli.fork_sheet import FORK_SHEET, write_fork_sheet
from carina.cli.opened import OpenedInput, check_case_options, open_input
from carina.cli.optics import OpticsOptions
from carina.cli.xray_set import XRAY_SET, write_xray_set
from carina.config import load_settings
from carina.disk import open_regular_text
from carina.errors import CarinaError, UsageError, VolumeImportError
from carina.render import (
    LEAD_VIEW,
    VIEWS,
    Backend,
    Slab,
    TransferFunction,
    ignored_settings,
    render_surface,
    render_view,
    transfer_preset,
    view_row,
    view_spec,
)
from carina.render.saved_picture import PictureMarks, default_marks
from carina.scopes import PathFrames, Pose
from carina.session import finish_case_picture
from carina.volume.point_check import check_in_volume

MAX_TRANSFER_BYTES = 1_000_000
STEP_VOX = 0.5
# Placeholder for the route while the arguments are checked, before the route is known.
_ANY_PATH = PathFrames(np.array([0.0, 1.0]), np.stack([np.eye(4)] * 2))


def chosen_transfer(text: str | None) -> TransferFunction | None:
    """Return the preset or the JSON file that ``--transfer`` names; None without that option."""
    if text is None:
        return None
    if not text.endswith(".json"):
        return transfer_preset(text)
    try:
        with open_regular_text(text) as file:
            document = file.read(MAX_TRANSFER_BYTES + 1)
        if len(document) > MAX_TRANSFER_BYTES:
            raise VolumeImportError(f"{text}: too large for a transfer function", code="render.transfer")
        return TransferFunction.from_json_text(document)
    except VolumeImportError:
        raise
    except OSError as error:
        raise VolumeImportError(f"{text}: cannot be read: {error.strerror}", code="render.transfer") from error
    except UnicodeDecodeError as error:
        raise VolumeImportError(
            f"{text}: not a text file; expected a transfer function", code="render.transfer"
        ) from error
    except CarinaError as error:
        # The error is in the file, not in an argument.
        raise VolumeImportError(f"{text}: {error}", code=error.code) from error


def _window(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    parts = text.split(",")
    try:
        width, level = (float(part) for part in parts)
    except ValueError:
        raise UsageError(f"--window: expected width,level in HU, such as 1500,-600; found {text!r}") from None
    return width, level


def _slab(text: str | None) -> Slab | None:
    if text is None:
        return None
    thickness, _, kind = text.partition(",")
    try:
        return Slab(float(thickness), cast(Any, kind or "mean"))
    except ValueError:
        raise UsageError(
            f"--slab: expected a thickness in mm and min, max or mean, such as 10,min; found {text!r}"
        ) from None


def _chosen_marks(view: str, letters: bool | None, scale: bool | None, names: bool | None) -> PictureMarks:
    """Return the marks of a picture: those of the options, else those that the view has by default."""
    row = view_row(view)
    if scale and not row.scaled:
        raise UsageError(f"--scale-bar: the {view} view has no single scale in mm; omit the option")
    if names and not row.named:
        raise UsageError(f"--names: the {view} view shows no names of branches; omit the option")
    usual = default_marks(view)
    given = {"letters": letters, "scale": scale, "names": names}
    return dataclasses.replace(usual, **{name: value for name, value in given.items() if value is not None})


def _path_views() -> str:
    return " and ".join(sorted(row.name for row in VIEWS.values() if "route" in row.needs))


def _case_view_options(
    source: OpenedInput,
    view: str,
    seen: OpticsOptions,
    fov_deg: float | None,
    window: str | None,
    shading: bool | None,
    texture: bool | None,
) -> dict[str, Any]:
    """Return the view settings of the case for options that the command does not set."""
    document, moment = source.document, source.moment
    assert document is not None
    assert moment is not None
    look, sight = document.look, moment.sight
    found: dict[str, Any] = {}
    if view == LEAD_VIEW:
        found |= {
            "shading": sight.shading if shading is None else shading,
            "texture": sight.texture if texture is None else texture,
        }
        if seen.scope is None and seen.lens is None:
            own = dataclasses.replace(seen, scope=look.scope or "none", outline=seen.outline or look.outline)
            found |= own.options(view)
            found["fov_deg"] = look.fov_deg if fov_deg is None else fov_deg
    elif window is None and view_row(view).windowed and sight.window is not None:
        found["window_hu"] = (sight.window.width_hu, sight.window.level_hu)
    return found


def report(
    path: Path,
    *,
    output: Path,
    view: str,
    at: NDArray[np.float64] | None,
    look: NDArray[np.float64] | None,
    up: NDArray[np.float64] | None,
    fov_deg: float | None,
    seen: OpticsOptions,
    size: tuple[int, int],
    method: str,
    step_vox: float,
    transfer: str | None,
    shading: bool | None,
    texture: bool | None,
    orbit: str | None,
    window: str | None,
    surface: Path | None,
    tree: Path | None,
    to: str | None,
    turn_deg: float,
    carm_deg: tuple[float, float],
    tone: str,
    slab: str | None,
    letters: bool | None,
    scale_bar: bool | None,
    names: bool | None,
    series: str | None,
    strict: bool,
    as_json: bool,
    ct: Path | None = None,
) -> int:
    """Render one image and write it as PNG; with ``surface``, also write the wall points of its pixels."""
    if view in {XRAY_SET, FORK_SHEET}:
        sheet = view == XRAY_SET
        check_needs(
            f"other views; the view is {view!r}",
            look=look,
            up=up,
            fov=fov_deg,
            method=method != "leap",
            step_vox=step_vox != STEP_VOX,
            transfer=transfer,
            shading=shading is not None,
            texture=texture is not None,
            orbit=orbit,
            surface=surface,
            tree=tree,
            to=to if sheet else None,
            at=None if sheet else at,
            window=None if sheet else window,
            turn=turn_deg != 0.0,
            carm_primary=carm_deg[0] != 0.0,
            carm_secondary=carm_deg[1] != 0.0,
            tone=tone != "radiograph",
            slab=slab,
            letters=letters is not None,
            scale_bar=scale_bar is not None,
            names=names is not None,
            scope=seen.scope,
            lens=seen.lens,
            outline=seen.outline,
            vignette=seen.vignette,
            focus=seen.focus,
        )
        if not sheet:
            return write_fork_sheet(path, output=output, to=to, series=series, strict=strict, ct=ct, as_json=as_json)
        return write_xray_set(
            path,
            output=output,
            at=at,
            size=size,
            window=_window(window),
            series=series,
            strict=strict,
            ct=ct,
            as_json=as_json,
        )
    check_output_file(output, ".png")
    if surface is not None:
        check_output_file(surface, ".npz", what="--surface")
        if view != LEAD_VIEW:
            raise UsageError(f"--surface only applies to the airway view; the view is {view!r}")
    check_case_options(path, ct, tree=tree)
    chosen = chosen_transfer(transfer)
    options: dict[str, Any] = {
        "view": view,
        "fov_deg": fov_deg,
        "width": size[0],
        "height": size[1],
        "method": method,
        "step_vox": step_vox,
        "shading": shading is not False,
        "texture": texture is not False,
        "orbit": None if orbit is None else tuple(float(v) for v in parse_point(orbit, "--orbit")),
        "window_hu": _window(window),
        "carm_deg": carm_deg,
        "tone": tone,
        "turn_deg": turn_deg,
        "slab": _slab(slab),
        **seen.options(view),
    }
    row = view_row(view)
    ignored = ignored_settings(view)
    given = {
        "look": ("pose", look is not None),
        "up": ("pose", up is not None),
        "fov": ("fov_deg", fov_deg is not None),
        "method": ("method", method != "leap"),
        "step_vox": ("step_vox", step_vox != STEP_VOX),
        "shading": ("shading", shading is not None),
        "texture": ("texture", texture is not None),
        "orbit": ("orbit", orbit is not None),
        "window": ("window_hu", window is not None),
        "turn": ("turn_deg", turn_deg != 0.0),
        "carm_primary": ("carm_deg", carm_deg[0] != 0.0),
        "carm_secondary": ("carm_deg", carm_deg[1] != 0.0),
        "tone": ("tone", tone != "radiograph"),
    }
    unused = {option: is_given for option, (setting, is_given) in given.items() if setting in ignored}
    check_needs(f"other views; the view is {view!r}", **unused)
    if view != LEAD_VIEW:
        check_needs(f"the airway view; the view is {view!r}", transfer=transfer)
    along_path = "route" in row.needs
    if along_path:
        to = check_destination(to, view)
        options["path"] = _ANY_PATH
    elif to is not None or tree is not None:
        raise UsageError(f"--to and --tree only apply to the {_path_views()} views; the view is {view!r}")
    if slab is not None and row.slab is None:
        raise UsageError(f"--slab only applies to slices and views along a path; the view is {view!r}")
    marks = _chosen_marks(view, letters, scale_bar, names)
    direction = (0.0, 0.0, -1.0) if look is None else look
    # Check the arguments now, before minutes of reading and tracking.
    view_spec(pose=Pose.looking((0.0, 0.0, 0.0) if at is None else at, direction, up), **options)
    turned = False
    progress = progress_printer()
    source = open_input(path, series=series, strict=strict, progress=progress, ct=ct)
    volume, badges = source.volume, source.badges
    if source.moment is not None:
        options |= _case_view_options(source, view, seen, fov_deg, window, shading, texture)
        chosen = chosen or source.moment.history().current.transfer
        turned = view == LEAD_VIEW and source.moment.history().current.look.operator == "facing"
    if at is not None:
        try:
            check_in_volume(volume, at, "--at")
        except UsageError as error:
            if row.inside:
                raise
            print_note(f"note: {error}")
    airways = None
    # The lumen is needed for the wall in the airway view, for the surface in the tree view, and for the default pose.
    wants_wall = view == LEAD_VIEW and volume.is_hu and (chosen is None or chosen.wall)
    # X-ray views show the whole volume from any position.
    wants_pose = at is None and row.wants_tip
    way = None
    if to is not None:
        way = route_to(source, to, tree_file=tree, progress=progress)
        options["path"] = way.path.frames()
        print_drawn_parts(way)
    wants_lumen = wants_pose or "airways" in row.needs or (marks.names and row.named and way is None)
    if wants_lumen or wants_wall:
        try:
            airways = source.airways(progress)
            badges.add(getattr(airways, "badges", ()))
        except carina.NoResultError as error:
            if wants_lumen:
                raise
            print_note(f"note: {error}; thin walls are shown as they appear in the CT")
    left = source.tip if at is None and look is None and up is None else None
    if left is not None:
        at = left.position_lps
    if at is None and airways is not None:
        at = airways.root_lps
    pose = left or Pose.looking(volume.centre_lps if at is None else at, direction, up)
    lumen_zyx, known = (None, None) if airways is None else (airways.lumen_zyx, airways.tree)
    backend = Backend(load_settings().backend)
    spec = view_spec(pose=pose, picture_turned=turned, **options)
    picture = interruptible(
        lambda: render_view(volume, view=spec, transfer=chosen, lumen_zyx=lumen_zyx, tree=known, backend=backend)
    )
    picture = finish_case_picture(
        picture,
        marks,
        volume=volume,
        airways=airways,
        route=way,
        tip_lps=None if at is None else pose.position_lps,
    )
    picture.save(output, badges=badges.notes)
    print_note(f"wrote {output}")
    if surface is not None:
        walls = render_surface(
            volume,
            pose=pose,
            fov_deg=fov_deg,
            width=size[0],
            height=size[1],
            step_vox=step_vox,
            transfer=chosen,
            scope=options["scope"],
            lens=options["lens"],
            outline=options["outline"],
            lumen_zyx=lumen_zyx,
        )
        walls.save(surface, badges=badges.notes)
        print_note(f"wrote {surface}")
    camera = picture.lps_from_camera if view == LEAD_VIEW else None
    if as_json:
        print_json(
            {
                "file": str(output),
                **({} if surface is None else {"surface": str(surface)}),
                "view": view,
                "size": list(size),
                **({} if way is None else {"path_mm": way.length_mm, "to": way.title, **way.drawn.to_json()}),
                "lps_from_camera": (pose.lps_from_camera if camera is None else camera).tolist(),
                **({} if picture.fov_deg is None else {"fov_deg": picture.fov_deg}),
                "stats": dataclasses.asdict(picture.stats),
                "badges": badges.to_json(),
            }
        )
    return 0
