"""``carina render``."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import carina
from carina.cli.arguments import parse_point
from carina.cli.console import print_json, progress_printer, say
from carina.errors import UsageError
from carina.render import TransferFunction, mark_tip, render_view, transfer_preset
from carina.scopes import Pose

__all__ = ["report"]

MARKED_VIEWS = {"xray-axial", "xray-coronal", "xray-sagittal", "axial", "coronal", "sagittal", "tree"}


def _transfer(text: str | None) -> TransferFunction | None:
    if text is None:
        return None
    if text.endswith(".json"):
        return TransferFunction.from_json_text(Path(text).read_text(encoding="utf-8"))
    return transfer_preset(text)


def _window(text: str) -> tuple[float, float]:
    parts = text.split(",")
    try:
        width, level = (float(part) for part in parts)
    except ValueError:
        raise UsageError(f"--window: expected width,level in HU, such as 1500,-600; found {text!r}") from None
    return width, level


def report(
    path: Path,
    *,
    output: Path,
    view: str,
    at: NDArray[np.float64] | None,
    look: NDArray[np.float64] | None,
    up: NDArray[np.float64] | None,
    fov_deg: float,
    size: tuple[int, int],
    method: str,
    step_vox: float,
    transfer: str | None,
    shading: bool,
    orbit: str | None,
    window: str,
    series: str | None,
    as_json: bool,
) -> int:
    """Render one picture and write it as PNG."""
    if output.suffix.lower() != ".png":
        raise UsageError(f"-o: expected a file name that ends in .png; found {output.name!r}")
    if not output.parent.is_dir():
        raise UsageError(f"-o: there is no folder {output.parent}")
    chosen = _transfer(transfer)
    orbit_values = None if orbit is None else parse_point(orbit, "--orbit")
    window_hu = _window(window)
    progress = progress_printer()
    volume = carina.open_volume(path, series=series, progress=progress)
    airways = None
    # The lumen closes thin walls in the endoscopic picture, is the tree view's surface, and gives the default pose.
    wants_wall = view == "airway" and volume.is_hu and (chosen is None or chosen.name == "endoscopic")
    if at is None or view == "tree" or wants_wall:
        try:
            airways = carina.find_airways(volume, progress=progress)
        except carina.NoResultError as error:
            if at is None or view == "tree":
                raise
            say(f"note: {error}; thin walls are shown as the CT has them")
    if at is None:
        assert airways is not None
        at = airways.root_lps
    pose = Pose.looking(at, (0.0, 0.0, -1.0) if look is None else look, up)
    picture = render_view(
        volume,
        view=view,
        pose=pose,
        fov_deg=fov_deg,
        width=size[0],
        height=size[1],
        method=method,
        step_vox=step_vox,
        transfer=chosen,
        shading=shading,
        orbit=None if orbit_values is None else tuple(float(v) for v in orbit_values),
        window_hu=window_hu,
        lumen_zyx=None if airways is None else airways.lumen_zyx,
    )
    if view in MARKED_VIEWS:
        picture = mark_tip(picture, pose.position_lps)
    picture.save(output)
    say(f"wrote {output}")
    if as_json:
        print_json(
            {
                "file": str(output),
                "view": view,
                "size": list(size),
                "lps_from_camera": pose.lps_from_camera.tolist(),
                "stats": dataclasses.asdict(picture.stats),
            }
        )
    return 0
