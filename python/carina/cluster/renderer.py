"""A renderer that uses many machines, with the interface of :class:`carina.render.Renderer`."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from concurrent.futures import TimeoutError as StillRendering

import numpy as np
from numpy.typing import NDArray

from carina.cluster.console import Console, Content
from carina.display.progress import ProgressChoice, shows_progress
from carina.errors import CancelledError
from carina.render import (
    AirwayView,
    CancelToken,
    ClusterStatus,
    DrrView,
    Hit,
    Picture,
    Renderer,
    Surface,
    TransferFunction,
    TreeView,
    View,
    can_cut,
)
from carina.render.scene import Cancel, Scene
from carina.render.wall_texture import DecorationTree
from carina.volume import Volume

MIN_PIXELS = 128 * 128
"""Minimum number of pixels of a picture that other machines render; sending a smaller picture takes longer than
rendering it."""
POLL_S = 0.02


class ClusterRenderer:
    """Renderer of the views of one volume on the machines of a console.

    Pictures are equal to those of :class:`carina.render.Renderer`, bit for bit. Views that take longer to send than to
    render (planes, projections, small pictures) are rendered on this machine, and so are all views if no other machine
    is available.

    Parameters
    ----------
    renderer
        Renderer of the volume on this machine. The other machines get its content.
    console
        Connection to the machines, which sends this renderer's content to them.
    spread_all
        Distribute every view that can be divided, also small ones, for tests.
    """

    def __init__(self, renderer: Renderer, console: Console, *, spread_all: bool = False) -> None:
        self._renderer = renderer
        self._console = console
        self._spread_all = spread_all
        self._parcels = console.parcels
        self._sent: tuple[Scene, int] | None = None
        self._sending = threading.Lock()

    def __repr__(self) -> str:
        """Return the representation of the local renderer."""
        return f"ClusterRenderer({self._renderer!r})"

    @property
    def volume(self) -> Volume:
        """The volume whose views are rendered."""
        return self._renderer.volume

    @property
    def transfer(self) -> TransferFunction:
        """The transfer function of the airway view."""
        return self._renderer.transfer

    @property
    def prepared(self) -> bool:
        """Whether the radius maps for empty-space skipping (``leap``) are built; without them every sample is read."""
        return self._renderer.prepared

    @property
    def scene(self) -> Scene:
        """The current scene, which pictures show."""
        return self._renderer.scene

    def set_transfer(self, transfer: TransferFunction) -> None:
        """Set the transfer function; see :meth:`carina.render.Renderer.set_transfer`."""
        self._renderer.set_transfer(transfer)

    def set_lumen(self, lumen_zyx: NDArray[np.uint8] | None, tree: DecorationTree | None = None) -> None:
        """Set the lumen and its tree; see :meth:`carina.render.Renderer.set_lumen`."""
        self._renderer.set_lumen(lumen_zyx, tree)

    @shows_progress
    def prepare(
        self, progress: ProgressChoice = None, cancel: Cancel | None = None, *, all_classes: bool | None = None
    ) -> None:
        """Build the maps on this machine and send them to the others; see :meth:`carina.render.Renderer.prepare`."""
        self._renderer.prepare(progress, cancel, all_classes=all_classes)
        self._send_scene()

    def wait_stored(self) -> None:
        """Wait until maps are stored; see :meth:`carina.render.Renderer.wait_stored`."""
        self._renderer.wait_stored()

    def surface(self, view: AirwayView, *, rows: tuple[int, int] | None = None) -> Surface:
        """Return the visible surface, computed on this machine; see :meth:`carina.render.Renderer.surface`."""
        return self._renderer.surface(view, rows=rows)

    def pick(self, view: AirwayView, column: int, row: int) -> Hit | None:
        """Return the hit of one ray, computed on this machine; see :meth:`carina.render.Renderer.pick`."""
        return self._renderer.pick(view, column, row)

    def renders_remotely(self, view: View) -> bool:
        """Return whether a view is rendered on other machines, if any are available."""
        if self._spread_all:
            return can_cut(view)
        large = view.width * view.height >= MIN_PIXELS
        return large and isinstance(view, AirwayView | TreeView | DrrView) and can_cut(view)

    def render(
        self,
        view: View,
        *,
        rows: tuple[int, int] | None = None,
        stop: CancelToken | None = None,
        scene: Scene | None = None,
        stream: str | None = None,
    ) -> Picture:
        """Render one view; see :meth:`carina.render.Renderer.render`. Several threads may call this at once.

        Parameters
        ----------
        view
            The view to render.
        rows
            First row and row after the last; None for the whole picture. Single rows are rendered on this machine.
        stop
            Cancels the rendering.
        scene
            Another scene than the present one, rendered on this machine.
        stream
            Name of a series of pictures of which only the newest matters: an older one that still waits is cancelled.

        Returns
        -------
        Picture
            The picture.

        Raises
        ------
        CancelledError
            If ``stop`` was cancelled, or a newer picture of the stream replaced this one.
        """
        if rows is not None or scene is not None or not self.renders_remotely(view) or not self._console.has_renderers:
            return self._renderer.render(view, rows=rows, stop=stop, scene=scene)
        frame_id, future = self.request(view, stream=stream)
        while True:
            try:
                return future.result(timeout=POLL_S if stop is not None else None)
            except StillRendering:
                if stop is not None and stop.cancelled:
                    self._console.drop(frame_id)
                    raise CancelledError("the image was superseded by a newer one") from None

    def request(self, view: View, *, whole: bool = False, stream: str | None = None) -> tuple[int, Future[Picture]]:
        """Request a picture of the current content without waiting; return its number and its future.

        Parameters
        ----------
        view
            The view to render.
        whole
            Render the undivided picture on one machine, for jobs of many pictures.
        stream
            As in :meth:`render`.
        """
        scene, content = self._send_scene()
        # All machines cast the strips of a picture by one method, so that the strips fit together bit for bit.
        if isinstance(view, AirwayView):
            view = self._renderer.with_chosen_method(view, scene=scene)
        return self._console.render(view, Content(content, self._renderer, scene), whole=whole, stream=stream)

    def render_frames(
        self, views: Iterable[View], *, first: int = 0, ahead: int | None = None, cancel: Cancel | None = None
    ) -> Iterator[tuple[int, Picture]]:
        """Render many pictures, each on one machine, and yield them in order, for films, series and data sets.

        Parameters
        ----------
        views
            The views to render; a generator is read only as far as pictures are being rendered.
        first
            Number of the first picture to render, to continue an interrupted job. Earlier views are skipped.
        ahead
            Number of pictures rendered at the same time; None selects the number that keeps all machines busy.
        cancel
            Called between pictures; a true result cancels the job.

        Yields
        ------
        (number, picture)
            In order, without gaps. The loss of a machine costs time, but no picture.

        Raises
        ------
        CancelledError
            If ``cancel`` returned true.
        RenderError
            The error of the first invalid view, in its turn.
        """
        under_way: list[tuple[int, int, Future[Picture]]] = []
        source = iter(enumerate(views))
        limit = ahead
        try:
            exhausted = False
            while True:
                if limit is None or ahead is None:
                    # Two pictures for each machine, and one that is being yielded.
                    limit = 2 * self._console.num_ready + 1
                while not exhausted and len(under_way) < limit:
                    item = next(source, None)
                    if item is None:
                        exhausted = True
                    elif item[0] >= first:
                        under_way.append((item[0], *self.request(item[1], whole=True)))
                if not under_way:
                    return
                number, _, future = under_way[0]
                while True:
                    if cancel is not None and cancel():
                        raise CancelledError(f"stopped before image {number}")
                    try:
                        picture = future.result(timeout=0.25)
                        break
                    except StillRendering:
                        continue
                del under_way[0]
                yield number, picture
        finally:
            for _, frame_id, _ in under_way:
                self._console.drop(frame_id)

    def status(self) -> ClusterStatus:
        """Return the state of the cluster and its machines."""
        return self._console.status()

    def _send_scene(self) -> tuple[Scene, int]:
        """Return the current scene and its content number; pass a new scene to the console."""
        with self._sending:
            scene = self._renderer.scene
            if self._sent is None or self._sent[0] is not scene:
                parcel = self._parcels.pack(self._renderer.volume, scene)
                self._console.set_content(parcel)
                self._sent = (scene, parcel.content)
            return self._sent


def render_frames(
    renderer: Renderer | ClusterRenderer, views: Iterable[View], *, first: int = 0
) -> Iterator[tuple[int, Picture]]:
    """Render many pictures in order, on one machine or on a cluster; see :meth:`ClusterRenderer.render_frames`."""
    if isinstance(renderer, ClusterRenderer):
        yield from renderer.render_frames(views, first=first)
        return
    for number, view in enumerate(views):
        if number >= first:
            yield number, renderer.render(view)
