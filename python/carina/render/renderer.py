"""Single-machine renderer: one volume, one transfer function, all views."""

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
from carina.render.planes import PlaneCaster
from carina.render.processor_choice import Backend
from carina.render.radiograph import cast_drr
from carina.render.reformation import cast_path_view
from carina.render.scene import Cancel, Scene, SceneBuilder
from carina.render.surface import Hit, Surface
from carina.render.transfer_function import TransferFunction
from carina.render.tree import cast_tree
from carina.render.views import (
    AirwayView,
    DrrView,
    PathView,
    Picture,
    TreeView,
    View,
)
from carina.render.wall_texture import DecorationTree
from carina.volume import Volume


def can_cut(view: View) -> bool:
    """Return whether a strip of rows of a view's picture can be rendered without the other rows."""
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
    """Renderer of all views of one volume.

    Several threads may use a renderer: one thread can render while another prepares maps or sets the lumen or the
    transfer function. A picture shows the state before or after such a change, never a mixture.

    Parameters
    ----------
    volume
        The volume; not copied.
    transfer
        Transfer function of the airway view. Default: the *endoscopic* preset, or a transfer function from the
        histogram if the volume is not in HU.
    cache_dir
        Folder for maps that were slow to build (docs/decisions/0104); None stores no maps.
    simd
        Instruction set of the kernels (``portable``, ``avx2``, ``avx512``, ``neon``) for tests. Default: the value of
        ``CARINA_SIMD``, or the fastest set of this machine. The pictures are the same.
    backend
        Processor of the airway views: CPU (default) or graphics device. Pictures of a graphics device equal the CPU's
        within one grey level on 99.9 % of the pixels, and their ``Picture.stats.method`` begins with ``gpu-``.

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
        self._scenes = SceneBuilder(volume, transfer, cache_dir)
        self._airway = AirwayCaster(volume, simd=simd, backend=backend)
        self._planes = PlaneCaster(volume)

    def __reduce__(self) -> NoReturn:
        """Raise an error, because a `Renderer` is bound to its process and cannot be pickled."""
        refuse_pickle(self, "pickle its volume, and create a carina.Renderer of it in the other process")

    def __repr__(self) -> str:
        """Return a one-line description of this `Renderer` for the Python interpreter."""
        ready = "prepared" if self.prepared else "not prepared"
        return f"Renderer({self._volume!r}, transfer={self.transfer.name!r}, {ready})"

    @property
    def volume(self) -> Volume:
        """Volume that is rendered."""
        return self._volume

    @property
    def transfer(self) -> TransferFunction:
        """Transfer function of the airway view."""
        return self._scenes.scene.transfer

    @property
    def prepared(self) -> bool:
        """Whether the maps that method ``leap`` needs exist.

        Without maps the same picture is rendered by brute force.
        """
        scene = self._scenes.scene
        return scene.maps is not None or scene.class_maps is not None

    @check_arguments(transfer=instance(TransferFunction, "get one from carina.transfer_preset"))
    def set_transfer(self, transfer: TransferFunction) -> None:
        """Set the transfer function; call ``prepare`` afterwards, unless its map is still in memory."""
        self._scenes.set_transfer(transfer)

    @check_arguments(lumen_zyx=mask_array(optional=True), tree=A_TREE)
    def set_lumen(self, lumen_zyx: NDArray[np.uint8] | None, tree: DecorationTree | None = None) -> None:
        """Set the airway lumen ``(nz, ny, nx)`` on the volume's grid, for the wall and the tree view.

        None removes the lumen.

        With the ``tree`` of the lumen (:class:`carina.track.AirwayTree`) the *endoscopic* preset draws decoration that
        is fixed to anatomy: rings, the membranous wall, colour by region, ridges of forks.

        Raises
        ------
        GeometryError
            If the shape of the mask differs from the volume's.
        """
        self._scenes.set_lumen(lumen_zyx, tree)

    @shows_progress
    @check_arguments(cancel=function, all_classes=AN_OPTION)
    def prepare(
        self, progress: ProgressChoice = None, cancel: Cancel | None = None, *, all_classes: bool | None = None
    ) -> None:
        """Build the IsoRegion map for the current transfer function and lumen, or read it from the cache.

        Parameters
        ----------
        progress
            False, True or ``f(what, fraction)``. True and None show a bar in a terminal or a notebook. The fraction is
            None where it is unknown.
        cancel
            Function that is called every 50 ms and returns True to stop. If the transfer function or the lumen changes
            while maps are built, the maps are built again for the latest values.
        all_classes
            Whether to build also labels and radii of opaque classes, for leaps by the segment table with shading off
            (paper 4.3), in twice the memory. Default: only for transfer functions of sampling ``nearest``, which are
            the paper's.

        Raises
        ------
        CancelledError
            If ``cancel`` returned True; maps that existed before stay in use.
        """
        self._scenes.prepare(progress_function(progress), cancel, all_classes=all_classes)

    @check_arguments(path=file_path(optional=True))
    def use_isoregion_map(self, path: str | Path | None) -> None:
        """Use an IsoRegion map from a file for transfer functions of sampling ``nearest``, which are the paper's.

        The next call of ``prepare`` then builds no map of equal values. The picture is the same.

        Parameters
        ----------
        path
            File of ``carina isoregion`` for this volume without a transfer function; None builds maps again.

        Raises
        ------
        VolumeImportError
            If the file is damaged, or is the map of another volume or of another comparison of values
            (``import.isoregion-map``).
        """
        self._scenes.use_isoregion_map(None if path is None else Path(path))

    def wait_stored(self) -> None:
        """Wait until the background thread has written the maps to the cache."""
        self._scenes.wait_stored()

    @property
    def scene(self) -> Scene:
        """Current scene: the immutable input of pictures, which another thread or machine can render later."""
        return self._scenes.scene

    @check_arguments(scene=instance(Scene, "take one from Renderer.scene"))
    def adopt_scene(self, scene: Scene) -> None:
        """Use a scene that another renderer of the same volume has built: its lumen, wall, transfer function and maps.

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
            View definition.
        rows
            First row and the row after the last. Assembled strips equal the whole picture, bit for bit. Pictures with
            depth of field, and radiographs whose window is fitted, can only be rendered whole: see :func:`can_cut`.
        stop
            Token by which another thread cancels the rendering. The airway and the tree view check the token every few
            rows; the other views take milliseconds and do not check it.
        scene
            Scene to render, from an earlier read of :attr:`scene`. Default: the current scene.

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
        # Other views do a part of their work in the calling thread, which this time does not include.
        counts = picture.stats.method in {"leap", "leap-all", "brute"}
        rays_s = _mean_processor_s(counted_s, _core.picture_clock_s(), seconds) if counts else None
        return dataclasses.replace(picture, stats=dataclasses.replace(picture.stats, seconds=seconds, rays_s=rays_s))

    @check_arguments(view=AN_AIRWAY_VIEW, scene=instance(Scene, "take one from Renderer.scene", optional=True))
    def with_chosen_method(self, view: AirwayView, *, scene: Scene | None = None) -> AirwayView:
        """Return an airway view with the ray method that this renderer chooses by measured times.

        Other renderers then cast the rows of the view by the same method. A view whose method is not measured is
        returned unchanged.

        Parameters
        ----------
        view
            Airway view.
        scene
            Scene of the picture. Default: the current scene.
        """
        leaps = self._airway.leaps_are_faster(self._scenes.scene if scene is None else scene, view)
        return view if leaps is None else dataclasses.replace(view, method="leap-always" if leaps else "brute")

    @check_arguments(view=AN_AIRWAY_VIEW, rows=ROWS)
    def surface(self, view: AirwayView, *, rows: tuple[int, int] | None = None) -> Surface:
        """Return depth, position and normal of the first wall at every pixel of an airway view.

        The rays are the same as those of the rendered picture.

        Parameters
        ----------
        view
            Airway view; its shading has no effect.
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
        """Return the first wall at one pixel of an airway view; None if the ray of the pixel meets no wall.

        One ray is cast; the values equal those of :meth:`surface`.

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


def _mean_processor_s(first_s: float | None, last_s: float | None, seconds: float) -> float | None:
    """Return the mean processor time per picture thread between two clock readings, in seconds.

    The result is None if a reading is missing, or if the difference is negative or exceeds the wall time ``seconds``.
    The readings then belong to different sets of threads, because a force device started or ended between them.
    """
    if first_s is None or last_s is None or not 0.0 <= last_s - first_s <= 1.1 * seconds:
        return None
    return last_s - first_s
