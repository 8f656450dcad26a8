"""The single-machine renderer: one volume, one transfer function, all views."""

from __future__ import annotations

import dataclasses
import time
from pathlib import Path
from typing import NoReturn, get_args

import numpy as np
from numpy.typing import NDArray

from carina import _core
from carina._core import CancelToken
from carina.argument_checks import (
    check_arguments,
    choice,
    each,
    file_path,
    function,
    having,
    instance,
    mask_array,
    whole_from,
)
from carina.display.progress import ProgressChoice, progress_function, shows_progress
from carina.errors import RenderError, refuse_pickle
from carina.render.airway import AirwayCaster
from carina.render.backend import Backend
from carina.render.decoration import DecorationTree
from carina.render.planes import PlaneCaster
from carina.render.radiograph import cast_drr
from carina.render.reformation import cast_path_view
from carina.render.scene import Cancel, Scene, SceneKeeper
from carina.render.surface import Hit, Surface
from carina.render.transfer import TransferFunction
from carina.render.tree import cast_tree
from carina.render.views import (
    AirwayView,
    DrrView,
    PathView,
    Picture,
    TreeView,
    View,
)
from carina.volume import Volume

__all__ = ["Renderer", "can_cut"]


def can_cut(view: View) -> bool:
    """Whether rows of a view's picture can be rendered alone."""
    match view:
        case AirwayView():
            return view.depth_of_field is None
        case DrrView():
            return view.window_mm is not None
        case _:
            return True


VIEW_CLASSES = get_args(View)
AN_OPTION = instance(bool, "give True or False", optional=True)
ROWS = each(whole_from(0, 8192), least=2, most=2, optional=True)
AN_AIRWAY_VIEW = instance(AirwayView, "create a carina.render.AirwayView")
A_TRANSFER = instance(TransferFunction, "get one from carina.transfer_preset", optional=True)
A_TREE = having("branches", "get one from carina.find_airways", optional=True)


class Renderer:
    """Renders all views of one volume.

    Pictures can be rendered in one thread while another prepares maps or sets the lumen or the transfer function: a
    picture sees the state before or after a change, never between.

    Parameters
    ----------
    volume
        The volume; not copied.
    transfer
        Transfer function of the airway view; the *endoscopic* preset, or one from the histogram where the volume is not
        in HU.
    cache_dir
        Folder for maps that were slow to build (docs/decisions/0104); None keeps none.
    simd
        Instruction set of the kernels (``portable``, ``avx2``, ``avx512``, ``neon``) for tests; unless told, what
        ``CARINA_SIMD`` names, or the fastest of this machine. The pictures are the same.
    backend
        Whether airway views may come from a graphics device; from the CPU unless told. Its pictures are the CPU's
        within one grey level on 99.9 % of the pixels, and ``Picture.stats.method`` begins with ``gpu-``.

    Examples
    --------
    >>> import carina
    >>> phantom = carina.generate_phantom(spacing_mm=3.0, generations=3)
    >>> airways = carina.find_airways(phantom.volume)
    >>> renderer = carina.Renderer(phantom.volume)
    >>> renderer.set_lumen(airways.lumen_zyx)
    >>> renderer.render(carina.render.TreeView(width=64, height=48)).view
    'tree'
    """

    @check_arguments(
        volume=instance(Volume, "open a volume with carina.open_volume"),
        transfer=A_TRANSFER,
        cache_dir=file_path(optional=True),
        simd=choice("portable", "avx2", "avx512", "neon", optional=True),
        backend=instance(Backend, "create a carina.render.Backend", optional=True),
    )
    def __init__(
        self,
        volume: Volume,
        *,
        transfer: TransferFunction | None = None,
        cache_dir: Path | None = None,
        simd: str | None = None,
        backend: Backend | None = None,
    ) -> None:
        self._volume = volume
        self._simd = simd
        self._scenes = SceneKeeper(volume, transfer, cache_dir)
        self._airway = AirwayCaster(volume, simd=simd, backend=backend)
        self._planes = PlaneCaster(volume)

    def __reduce__(self) -> NoReturn:
        refuse_pickle(self, "pickle its volume, and create a carina.Renderer of it in the other process")

    def __repr__(self) -> str:
        ready = "prepared" if self.prepared else "not prepared"
        return f"Renderer({self._volume!r}, transfer={self.transfer.name!r}, {ready})"

    @property
    def volume(self) -> Volume:
        """The volume."""
        return self._volume

    @property
    def transfer(self) -> TransferFunction:
        """The transfer function of the airway view."""
        return self._scenes.scene.transfer

    @property
    def prepared(self) -> bool:
        """True if ``leap`` leaps; else it renders the same picture by brute force."""
        scene = self._scenes.scene
        return scene.maps is not None or scene.class_maps is not None

    @check_arguments(transfer=instance(TransferFunction, "get one from carina.transfer_preset"))
    def set_transfer(self, transfer: TransferFunction) -> None:
        """Show the volume with another transfer function; call ``prepare`` again, unless its map is still in memory."""
        self._scenes.set_transfer(transfer)

    @check_arguments(lumen_zyx=mask_array(optional=True), tree=A_TREE)
    def set_lumen(self, lumen_zyx: NDArray[np.uint8] | None, tree: DecorationTree | None = None) -> None:
        """Set the airway lumen ``(nz, ny, nx)`` on the volume's grid, for the wall and the tree view; None clears it.

        With the lumen's ``tree`` (:class:`carina.track.AirwayTree`) the *endoscopic* look draws what is fixed to
        anatomy: rings, the membranous wall, colour by region, ridges of forks.

        Raises
        ------
        GeometryError
            If the mask has another shape than the volume.
        """
        self._scenes.set_lumen(lumen_zyx, tree)

    @shows_progress
    @check_arguments(cancel=function, all_classes=AN_OPTION)
    def prepare(
        self, progress: ProgressChoice = None, cancel: Cancel | None = None, *, all_classes: bool | None = None
    ) -> None:
        """Build the IsoRegion map for the present transfer function and lumen, or take it from the cache.

        Parameters
        ----------
        progress
            False, True or ``f(what, fraction)``. True, as None, shows a bar in a terminal or a notebook. The fraction
            is None where it is unknown.
        cancel
            Asked every 50 ms. A change of transfer function or lumen while maps are built makes them stale: they are
            built again for the newest.
        all_classes
            Also build labels and radii of opaque classes, for leaps by the step table with shading off (paper 4.3).
            Unless told, only for transfer functions of sampling ``nearest``, which are the paper's. Twice the memory.

        Raises
        ------
        CancelledError
            If ``cancel`` said so; what was ready before stays in use.
        """
        self._scenes.prepare(progress_function(progress), cancel, all_classes=all_classes)

    def wait_stored(self) -> None:
        """Wait until the maps that the cache keeps are on disk; storing goes on in the background otherwise."""
        self._scenes.wait_stored()

    @property
    def scene(self) -> Scene:
        """What pictures are made from now; it never changes, so a picture can be made from it later or elsewhere."""
        return self._scenes.scene

    @check_arguments(scene=instance(Scene, "take one from Renderer.scene"))
    def adopt_scene(self, scene: Scene) -> None:
        """Show a scene that another renderer of the same volume has made: its lumen, wall, transfer function and maps.

        Raises
        ------
        GeometryError
            If the scene belongs to a volume of another shape.
        """
        self._scenes.adopt(scene)

    @check_arguments(
        view=instance(VIEW_CLASSES, "create one of the views of carina.render"),
        rows=ROWS,
        stop=instance(CancelToken, "create a carina.render.CancelToken", optional=True),
        scene=instance(Scene, "take one from Renderer.scene", optional=True),
    )
    def render(
        self,
        view: View,
        *,
        rows: tuple[int, int] | None = None,
        stop: CancelToken | None = None,
        scene: Scene | None = None,
    ) -> Picture:
        """Render one view.

        Parameters
        ----------
        view
            What to render.
        rows
            First row and the row after the last. Strips put together are the whole picture, bit for bit. Pictures with
            depth of field, and radiographs whose window is fitted, exist only whole: see :func:`can_cut`.
        stop
            Gives the picture up when another thread cancels it. The airway and the tree view look at it every few rows;
            the others take milliseconds and do not.
        scene
            In place of the present scene: one that :attr:`scene` gave earlier.

        Raises
        ------
        RenderError
            If the view cannot be rendered: a tree without a lumen, a setting out of range.
        CancelledError
            If ``stop`` was cancelled.
        """
        started, counted_s = time.perf_counter(), _core.picture_clock_s()
        scene = self._scenes.scene if scene is None else scene
        if rows is not None and not 0 <= rows[0] < rows[1] <= view.height:
            msg = (
                f"expected rows between 0 and {view.height}, with the first before the last; found {rows[0]} to "
                f"{rows[1]}"
            )
            raise RenderError(msg, code="render.setting")
        match view:
            case AirwayView():
                picture = self._airway.cast(scene, view, rows=rows, stop=stop)
            case TreeView():
                picture = self._tree(scene, view, rows, stop)
            case DrrView():
                picture = cast_drr(self._volume, view, rows=rows, simd=self._simd)
            case PathView():
                picture = cast_path_view(self._volume, view, rows=rows)
            case _:
                picture = self._planes.render(view, rows=rows)
        seconds = time.perf_counter() - started
        # Of the other views, a part is made in the calling thread.
        counts = picture.stats.method in {"leap", "leap-all", "brute"}
        rays_s = _between(counted_s, _core.picture_clock_s(), seconds) if counts else None
        return dataclasses.replace(picture, stats=dataclasses.replace(picture.stats, seconds=seconds, rays_s=rays_s))

    @check_arguments(view=AN_AIRWAY_VIEW, rows=ROWS)
    def surface(self, view: AirwayView, *, rows: tuple[int, int] | None = None) -> Surface:
        """Depth, position and normal of the first wall at every pixel of an airway view, from the rays of its picture.

        Parameters
        ----------
        view
            What to look at; shading has no part in it.
        rows
            First row and the row after the last.

        Returns
        -------
        Surface
            Arrays of the picture's shape; NaN where a ray meets no wall.
        """
        return self._airway.surface(self._scenes.scene, view, rows=rows)

    @check_arguments(view=AN_AIRWAY_VIEW, column=whole_from(0, 8191), row=whole_from(0, 8191))
    def pick(self, view: AirwayView, column: int, row: int) -> Hit | None:
        """Return the first wall at one pixel of an airway view; None where the ray meets none.

        One ray is cast; the numbers are those of :meth:`surface`.

        Raises
        ------
        RenderError
            If the pixel lies outside the picture.
        """
        return self._airway.pick(self._scenes.scene, view, column, row)

    def _tree(self, scene: Scene, view: TreeView, rows: tuple[int, int] | None, stop: CancelToken | None) -> Picture:
        tree = scene.tree
        if tree is None:
            raise RenderError(
                "there is no tree to show, because the airways have not been segmented yet", code="render.no-lumen"
            )
        return cast_tree(tree, view, rows=rows, simd=self._simd, stop=stop)


def _between(first_s: float | None, last_s: float | None, seconds: float) -> float | None:
    """Return the processor time between two readings.

    The result is None where a reading is missing, and where the readings cannot be of the same threads, because a force
    device started or ended one in between.
    """
    if first_s is None or last_s is None or not 0.0 <= last_s - first_s <= 1.1 * seconds:
        return None
    return last_s - first_s
