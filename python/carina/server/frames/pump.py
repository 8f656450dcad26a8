"""Frame pump: a thread that renders, encodes and sends one picture after another."""

from __future__ import annotations

import itertools
import logging
import threading
from collections import deque
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from carina.breathing import ChestDeformation
from carina.errors import CancelledError, CarinaError, UsageError
from carina.render import FINDER_VIEW, LEAD_VIEW, CancelToken, Picture
from carina.render.saved_picture import FULL_STEP_VOX
from carina.scopes import Optics
from carina.server.frames.pacing import DEFAULT_RATE_HZ, MOVING, FrameScheduler, RenderOrder
from carina.server.to_wire.session import picture_lines
from carina.server.wire.codec import encode_picture
from carina.server.wire.messages import PictureHeader, PictureLayer, PictureLens, PictureOutline, Status
from carina.session import LayerLines, SessionRenderer, ShownCase, log_fault

logger = logging.getLogger(__name__)

MOVING_QUALITY = 85
STILL_QUALITY = 95
STATUS_EVERY_S = 0.5
MAX_SHOWN = 64
"""Maximum number of sent airway pictures that are stored so that a click in one of them can be resolved."""


@dataclass(frozen=True, slots=True)
class ShownPicture:
    """Renderer and view of a sent airway picture, used to find the wall under a click in the picture."""

    renderer: SessionRenderer
    view: Any
    """View in the full size that the client requested, so that a click in a coarse picture is resolved exactly."""
    width: int
    height: int
    """Height in pixels of the picture as sent; ``width`` likewise is that of the sent picture."""
    moved: ChestDeformation | None = None
    """Deformation of the chest in the picture; None without a simulated breathing."""

    @property
    def lens_lps(self) -> tuple[float, float, float]:
        """Position of the lens in the CT at rest, LPS mm."""
        lens = self.view.pose.position_lps
        x, y, z = (float(v) for v in (lens if self.moved is None else self.moved.rest_points(lens)[0]))
        return x, y, z

    def wall_at(self, column: float, row: float) -> Any:
        """Return the first wall that the ray through a position in the picture meets, or None.

        The position of the wall is that in the CT at rest; its depth is that in the picture.

        Parameters
        ----------
        column, row
            Position in pixels of the sent picture; (0, 0) is the corner of the top left pixel.

        Raises
        ------
        UsageError
            ``session.pick`` if the position is outside the picture.
        """
        if not (column <= self.width and row <= self.height):
            msg = f"the position ({column:g}, {row:g}) lies outside the image of {self.width} x {self.height} pixels"
            raise UsageError(msg, code="session.pick")
        # A position on the right or lower edge of the picture counts as its last pixel.
        n = min(int(column / self.width * self.view.width), self.view.width - 1)
        m = min(int(row / self.height * self.view.height), self.view.height - 1)
        hit = self.renderer.pick(self.view, n, m)
        if hit is None or self.moved is None:
            return hit
        return replace(hit, position_lps=self.moved.rest_points(hit.position_lps)[0])


def encode_jpeg(rgb: NDArray[np.uint8], *, full: bool) -> tuple[bytes, int]:
    """Encode a picture as JPEG: quality 95 with 4:4:4 sampling if ``full``, else quality 85 with 4:2:0.

    Returns
    -------
    tuple
        The JPEG bytes and the quality.
    """
    quality = STILL_QUALITY if full else MOVING_QUALITY
    sampling = "444" if full else "420"
    pixels = np.ascontiguousarray(rgb)
    data = simplejpeg.encode_jpeg(pixels, quality=quality, colorspace="RGB", colorsubsampling=sampling)
    return cast(bytes, data), quality


class FramePump:
    """Render thread of one window, which renders the pictures that the scheduler orders.

    :meth:`run` is the body of the thread; :meth:`step` renders one picture.

    Parameters
    ----------
    scene
        Returns the current content of the views, or None without a case. The pump calls it without holding its lock.
    deliver
        Sends one binary message; called in order, from the thread of the pump.
    report
        Sends a status message, or the code and message of an error; called from the thread of the pump.
    clock
        Monotonic clock of the session, in seconds.
    threads
        Number of render threads, reported in status messages.
    simd
        Name of the SIMD instruction set, reported in status messages.
    """

    def __init__(
        self,
        scene: Callable[[], ShownCase | None],
        deliver: Callable[[bytes], None],
        report: Callable[[Status | tuple[str, str]], None],
        *,
        clock: Callable[[], float],
        threads: int = 1,
        simd: str = "",
    ) -> None:
        self._scene = scene
        self._deliver = deliver
        self._report = report
        self._clock = clock
        self._threads = threads
        self._simd = simd
        self._rate_hz = DEFAULT_RATE_HZ
        self._scheduler = FrameScheduler(rate_hz=self._rate_hz)
        self._lock = threading.Lock()
        """Lock of the scheduler.

        The pump never calls the session with this lock held, because the session calls :meth:`wake` under its own lock.
        """
        self._under_way: tuple[RenderOrder, CancelToken] | None = None
        self._shown: dict[int, ShownPicture] = {}
        self._woken = threading.Event()
        self._stopped = False
        self._frame_ids = itertools.count(1)
        self._answers: deque[tuple[float, float]] = deque()
        """Time of the first picture of each pose of the last second, and age of the pose at that time, in seconds."""
        self._status_sent = True
        self._status_s = float("-inf")
        self._status_pose_id = -1
        self._last_words: dict[str, str] = {}
        """Last error message that was sent for each view that could not be rendered."""

    def set_layout(self, views: Mapping[str, tuple[int, int]]) -> None:
        """Set the visible views and their sizes (width, height) in pixels."""
        with self._lock:
            self._scheduler.set_layout(views)
        self.wake()

    def set_rate(self, rate_hz: float) -> None:
        """Set the target rate of airway pictures while moving, in pictures per second."""
        with self._lock:
            self._rate_hz = rate_hz
            self._scheduler.set_rate(rate_hz)
        self.wake()

    @property
    def rate_hz(self) -> float:
        """Target rate of airway pictures while moving, in pictures per second."""
        return self._rate_hz

    def shown(self, frame_id: int) -> ShownPicture | None:
        """Return a recently sent airway picture, or None if it is no longer stored."""
        with self._lock:
            return self._shown.get(frame_id)

    def acknowledge(self, frame_id: int) -> None:
        """Record that the client has decoded a picture."""
        with self._lock:
            self._scheduler.acknowledge(frame_id)
        self.wake()

    def wake(self) -> None:
        """Wake the thread, because something that it renders may have changed."""
        self._woken.set()

    def content_changed(self) -> None:
        """Cancel the fine picture in progress if a change of content makes it obsolete, and wake the thread."""
        with self._lock:
            under_way = self._under_way
        if under_way is not None and under_way[0].grade > MOVING and self._is_obsolete(under_way[0]):
            under_way[1].cancel()
        self.wake()

    def _is_obsolete(self, order: RenderOrder) -> bool:
        scene = self._scene()
        if scene is None:
            return True
        now_s = self._clock()
        with self._lock:
            keys = _content_keys(scene, self._scheduler)
            return self._scheduler.should_cancel(order, keys, now_s, at_rest=scene.key_at_rest())

    def stop(self) -> None:
        """End :meth:`run` when the picture in progress is rendered."""
        self._stopped = True
        self._woken.set()

    def run(self) -> None:
        """Render pictures until :meth:`stop` is called."""
        while not self._stopped:
            # Cleared before the step, so that a change during the step is not lost.
            self._woken.clear()
            try:
                rendered = self.step()
            except BaseException as error:
                # BaseException: a panic of the compiled module is not an Exception. The thread continues with the next
                # picture, because no other thread renders.
                log_fault(logger, "sending one image failed", error)
                rendered = False
            if not rendered:
                self._woken.wait(self.wait_s())

    def wait_s(self) -> float | None:
        """Return the seconds until a picture can become due without an event; None if there is no such time."""
        now_s = self._clock()
        with self._lock:
            wake_s = self._scheduler.wake_s(now_s)
        # One millisecond more, so that rounding cannot end the wait just before the time.
        return None if wake_s is None else max(0.0, wake_s - now_s) + 0.001

    def step(self) -> bool:
        """Render and deliver one picture; return False if no picture is due now."""
        scene = self._scene()
        if scene is None:
            return False
        began_s = self._clock()
        stop = CancelToken()
        with self._lock:
            self._scheduler.observe(_content_keys(scene, self._scheduler), began_s, at_rest=scene.key_at_rest())
            order = self._scheduler.next_order(began_s)
            self._under_way = None if order is None else (order, stop)
        if order is None:
            return False
        try:
            # A change of the scene before `_under_way` was set could not cancel this picture, so the order is checked
            # once more before it is rendered.
            if order.grade > MOVING and self._is_obsolete(order):
                return True
            self._render(scene, order, stop, began_s)
        except BaseException as error:
            # BaseException: a panic of the compiled module is not an Exception. Errors after the rendering count too:
            # otherwise a picture that cannot be sent would be rendered again and again.
            log_fault(logger, f"rendering failed: {order.view}", error)
            words = f"the {order.view} view could not be rendered: internal error in Carina ({type(error).__name__})"
            self._report_failure(order, "carina.fault", words)
        finally:
            with self._lock:
                self._under_way = None
        return True

    def _render(self, scene: ShownCase, order: RenderOrder, stop: CancelToken, began_s: float) -> None:
        shows = FINDER_VIEW if order.purpose == "finder" else order.view
        try:
            view = scene.spec(shows, order.width, order.height, order.step_vox, full_width=order.full_width)
            picture = scene.renderer.render(view, stop=stop)
            outline = scene.outline_of(shows, picture)
            layers = scene.layers_of(shows, picture)
            rendered_s = self._clock() - began_s
            frame_id = next(self._frame_ids)
            payload, quality = encode_jpeg(picture.rgb, full=order.full)
            header = PictureHeader(
                frame_id=frame_id,
                view=cast(Any, shows),
                stands_for=cast(Any, order.view) if shows != order.view else None,
                pose_id=scene.pose_id,
                lps_from_camera=_matrix_message(_rest_from_camera(picture)),
                fov_deg=None if picture.fov_deg is None else float(picture.fov_deg),
                lens=_lens_message(picture.optics),
                lps_from_pixel=_matrix_message(picture.lps_from_pixel),
                lines=picture_lines(picture.lines),
                outline=None if outline is None else PictureOutline(len(outline.data), outline.complete),
                width=int(picture.rgb.shape[1]),
                height=int(picture.rgb.shape[0]),
                step_vox=order.step_vox if shows == LEAD_VIEW else None,
                codec="jpeg",
                quality=quality,
                full=order.full and scene.can_be_final(shows),
                empty=shows == LEAD_VIEW and _is_empty(picture.rgb),
                decorated=picture.decorated,
                render_ms=round(rendered_s * 1e3, 2),
                method=str(picture.stats.method),
                layers=tuple(_layer_message(one) for one in layers),
                breathes=scene.breathes(shows),
            )
            parts = (payload, *(one.data for one in layers), b"" if outline is None else outline.data)
            data = encode_picture(header, b"".join(parts))
        except CarinaError as error:
            if isinstance(error, CancelledError) and stop.cancelled:
                with self._lock:
                    self._scheduler.record_cancelled(order, self._clock() - began_s)
            else:
                self._report_failure(order, error.code, str(error))
            return
        now_s = self._clock()
        with self._lock:
            rays_s = picture.stats.rays_s
            wanted = self._scheduler.rendered(order, frame_id, now_s - began_s, now_s, rays_s=rays_s)
            if wanted and shows == LEAD_VIEW:
                fine = scene.spec(shows, order.full_width, order.full_height, FULL_STEP_VOX)
                self._shown[frame_id] = ShownPicture(
                    scene.renderer, fine, header.width, header.height, scene.deformation
                )
                while len(self._shown) > MAX_SHOWN:
                    del self._shown[next(iter(self._shown))]
        if wanted:
            self._deliver(data)
            if shows == LEAD_VIEW:
                self._send_status(now_s, scene, header)
        self._last_words.pop(order.view, None)

    def _report_failure(self, order: RenderOrder, code: str, words: str) -> None:
        with self._lock:
            self._scheduler.failed(order)
        if words != self._last_words.get(order.view):
            # Send an error once, not for every frame.
            self._last_words[order.view] = words
            self._report((code, words))

    def _send_status(self, now_s: float, scene: ShownCase, header: PictureHeader) -> None:
        """Send a status message: twice a second while the tip moves, and once after it stops."""
        first = header.pose_id != self._status_pose_id
        if first:
            # Only the first picture of a pose counts: later, finer pictures of it do not show the rate of moving
            # pictures.
            self._status_pose_id = header.pose_id
            self._answers.append((now_s, now_s - scene.pose_s))
            while self._answers[0][0] < now_s - 1.0:
                self._answers.popleft()
            self._status_sent = False
        if self._status_sent or not (header.full or now_s - self._status_s >= STATUS_EVERY_S):
            return
        self._status_s, self._status_sent = now_s, True
        ages_s = sorted(age_s for _, age_s in self._answers)
        spread_s = self._answers[-1][0] - self._answers[0][0]
        self._report(
            Status(
                fps=round((len(ages_s) - 1) / spread_s, 1) if spread_s > 0.0 else 0.0,
                render_ms=header.render_ms,
                age_ms=round(ages_s[len(ages_s) // 2] * 1e3, 1),
                method=header.method,
                threads=self._threads,
                simd=self._simd,
            )
        )


def _content_keys(scene: ShownCase, scheduler: FrameScheduler) -> dict[str, Hashable]:
    return {view: scene.key(view) for view in scheduler.visible}


def _is_empty(rgb: NDArray[np.uint8]) -> bool:
    """Return whether the picture is black in every 64th pixel (a grid of 8 x 8), that is, no ray met anything."""
    return not rgb[::8, ::8].any()


def _rest_from_camera(picture: Picture) -> NDArray[np.float64] | None:
    """Return the matrix from camera space to the CT at rest, in which the window has tree, route and marks."""
    if picture.lps_from_camera is None or picture.lps_from_rest is None:
        return picture.lps_from_camera
    return np.linalg.solve(picture.lps_from_rest, picture.lps_from_camera).astype(np.float64, copy=False)


def _lens_message(optics: Optics | None) -> PictureLens | None:
    if optics is None:
        return None
    model, coefficients = optics.formula
    return PictureLens(cast(Any, model), coefficients, optics.focal_px, optics.centre_px, optics.limit_rad)


def _layer_message(lines: LayerLines) -> PictureLayer:
    return PictureLayer(len(lines.data), lines.complete, lines.layer, lines.part, lines.pixel_from_line)


def _matrix_message(matrix: NDArray[np.float64] | None) -> tuple[float, ...] | None:
    return None if matrix is None else tuple(float(v) for v in np.asarray(matrix).ravel())
