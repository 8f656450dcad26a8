"""A renderer whose pictures come from many machines; to a session it is one like any other."""

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
from carina.render.decoration import DecorationTree
from carina.render.scene import Cancel, Scene
from carina.volume import Volume

__all__ = ["ClusterRenderer", "render_frames"]

LEAST_PIXELS = 128 * 128
"""Smaller pictures are rendered sooner than they travel."""
POLL_S = 0.02


class ClusterRenderer:
    """Renders the views of one volume on the machines of a console.

    Pictures are those of :class:`carina.render.Renderer`, bit for bit. What travels slower than it is rendered (planes,
    projections, small pictures) is rendered here, and so is everything while no machine is there.

    Parameters
    ----------
    renderer
        This machine's renderer of the volume. It holds what is shown; the others get it from here.
    console
        Where the machines are. Its content becomes this renderer's.
    spread_all
        Spread every view that can be cut, however small: for tests.
    """

    def __init__(self, renderer: Renderer, console: Console, *, spread_all: bool = False) -> None:
        self._renderer = renderer
        self._console = console
        self._spread_all = spread_all
        self._parcels = console.parcels
        self._sent: tuple[Scene, int] | None = None
        self._sending = threading.Lock()

    def __repr__(self) -> str:
        return f"ClusterRenderer({self._renderer!r})"

    @property
    def volume(self) -> Volume:
        """The volume."""
        return self._renderer.volume

    @property
    def transfer(self) -> TransferFunction:
        """The transfer function of the airway view."""
        return self._renderer.transfer

    @property
    def prepared(self) -> bool:
        """True if ``leap`` leaps."""
        return self._renderer.prepared

    @property
    def scene(self) -> Scene:
        """What pictures are made from now."""
        return self._renderer.scene

    def set_transfer(self, transfer: TransferFunction) -> None:
        """See :meth:`carina.render.Renderer.set_transfer`."""
        self._renderer.set_transfer(transfer)

    def set_lumen(self, lumen_zyx: NDArray[np.uint8] | None, tree: DecorationTree | None = None) -> None:
        """See :meth:`carina.render.Renderer.set_lumen`."""
        self._renderer.set_lumen(lumen_zyx, tree)

    @shows_progress
    def prepare(
        self, progress: ProgressChoice = None, cancel: Cancel | None = None, *, all_classes: bool | None = None
    ) -> None:
        """See :meth:`carina.render.Renderer.prepare`; maps are built here and sent."""
        self._renderer.prepare(progress, cancel, all_classes=all_classes)
        self._send()

    def wait_stored(self) -> None:
        """See :meth:`carina.render.Renderer.wait_stored`."""
        self._renderer.wait_stored()

    def surface(self, view: AirwayView, *, rows: tuple[int, int] | None = None) -> Surface:
        """See :meth:`carina.render.Renderer.surface`; made here."""
        return self._renderer.surface(view, rows=rows)

    def pick(self, view: AirwayView, column: int, row: int) -> Hit | None:
        """See :meth:`carina.render.Renderer.pick`; one ray, made here."""
        return self._renderer.pick(view, column, row)

    def spreads(self, view: View) -> bool:
        """Whether a view is rendered by other machines, if there are any."""
        if self._spread_all:
            return can_cut(view)
        large = view.width * view.height >= LEAST_PIXELS
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
        """Render one view; see :meth:`carina.render.Renderer.render`. Several threads may ask at once.

        ``stream`` names pictures of which only the newest matters: an older one that still waits is given up, with
        CancelledError.
        """
        if rows is not None or scene is not None or not self.spreads(view) or not self._console.has_renderers:
            return self._renderer.render(view, rows=rows, stop=stop, scene=scene)
        frame_id, future = self.want(view, stream=stream)
        while True:
            try:
                return future.result(timeout=POLL_S if stop is not None else None)
            except StillRendering:
                if stop is not None and stop.cancelled:
                    self._console.drop(frame_id)
                    raise CancelledError("the image was superseded by a newer one") from None

    def want(self, view: View, *, whole: bool = False, stream: str | None = None) -> tuple[int, Future[Picture]]:
        """Ask for a picture of what is shown now, and go on: its number, and the picture when it is there.

        ``whole`` gives it to one machine uncut, for jobs of many pictures.
        """
        scene, content = self._send()
        return self._console.render(view, Content(content, self._renderer, scene), whole=whole, stream=stream)

    def render_frames(
        self, views: Iterable[View], *, first: int = 0, ahead: int | None = None, cancel: Cancel | None = None
    ) -> Iterator[tuple[int, Picture]]:
        """Render many pictures, whole ones side by side, and hand them over in order: films, series, data sets.

        Parameters
        ----------
        views
            What to render; a generator is asked only as far ahead as pictures are under way.
        first
            Number of the first picture to render: a job that was interrupted goes on behind the last number it got.
            Earlier views are passed over.
        ahead
            Pictures under way at once; as many as keep all machines busy unless told.
        cancel
            Asked between pictures.

        Yields
        ------
        (number, picture)
            In order, none left out. A machine that is lost costs time, never a picture.

        Raises
        ------
        CancelledError
            If ``cancel`` said so.
        RenderError
            What the first refused view is refused for, in its turn.
        """
        under_way: list[tuple[int, int, Future[Picture]]] = []
        source = iter(enumerate(views))
        limit = ahead
        try:
            exhausted = False
            while True:
                if limit is None or ahead is None:
                    # Two for each machine, and one that is being handed over.
                    limit = 2 * self._console.num_ready + 1
                while not exhausted and len(under_way) < limit:
                    item = next(source, None)
                    if item is None:
                        exhausted = True
                    elif item[0] >= first:
                        under_way.append((item[0], *self.want(item[1], whole=True)))
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
        """How the cluster does."""
        return self._console.status()

    def _send(self) -> tuple[Scene, int]:
        """The present scene and its number; told to the console where it is new."""
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
