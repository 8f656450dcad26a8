"""Pictures of the views as PNG files, rendered by the code of ``carina render`` and not copied from the screen."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from starlette.responses import Response

from carina.commands import PictureFacts
from carina.errors import CancelledError, CarinaError, UsageError
from carina.render import CancelToken
from carina.render.saved_picture import FULL_STEP_VOX, PictureMarks
from carina.render.view_table import view_row
from carina.session import Session, finish_case_picture
from carina.session.scene.picture_state import PictureState
from carina.volume import badges_of

SIDES_PX = (16, 8192)
UPDATE_S = 20.0
"""Maximum time in s to wait until the renderer shows the newest airways and transfer function."""
POLL_INTERVAL_S = 0.05
"""Time in s between two checks whether the renderer shows the requested state of the case."""
DISCONNECT_CHECK_S = 0.2
"""Time in s between two checks whether the client has disconnected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOrder:
    """Size and marks of a picture that the user saves."""

    size_px: tuple[int, int]
    """Width and height of the saved picture in pixels."""
    screen_width: int
    """Width in pixels of the picture in the window, to which the scales of the window apply."""
    window: int
    """Number of the window whose display settings the picture shows."""
    marks: PictureMarks

    @classmethod
    def of_query(cls, query: Mapping[str, str]) -> PictureOrder:
        """Return the size and the marks of the picture from the parameters of a request.

        Raises
        ------
        UsageError
            ``render.setting``: if a number is missing or out of range.
        """
        scale = _whole(query, "scale", 1, 2)
        width, height = (_whole(query, side, *SIDES_PX) for side in ("width", "height"))
        if max(width, height) * scale > SIDES_PX[1]:
            raise UsageError(
                f"an image can have at most {SIDES_PX[1]} pixels on each side; found {width * scale} x "
                f"{height * scale}; save it at screen size",
                code="render.setting",
            )
        marks = {name: query.get(name, "on") == "on" for name in ("letters", "scale_bar", "names")}
        return cls(
            size_px=(width * scale, height * scale),
            screen_width=_whole(query, "full_width", *SIDES_PX),
            window=_whole(query, "window", 0, 2**31),
            marks=PictureMarks(letters=marks["letters"], scale=marks["scale_bar"], names=marks["names"]),
        )


def _whole(query: Mapping[str, str], name: str, least: int, most: int) -> int:
    text = query.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) < 12 and least <= int(text) <= most):
        raise UsageError(f"{name}: expected a whole number from {least} to {most}", code="render.setting")
    return int(text)


class Pictures:
    """Renderer of saved pictures, one at a time, because a large picture takes all cores.

    One further picture of each window can wait. A picture is stopped when its client disconnects.

    Parameters
    ----------
    session
        Session with the open case.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._one_at_a_time = asyncio.Lock()
        self._waiting: set[int] = set()
        """Numbers of the windows whose requested picture waits until other pictures are rendered."""

    async def answer(
        self, view: str, query: Mapping[str, str], *, is_disconnected: Callable[[], Awaitable[bool]] | None = None
    ) -> Response:
        """Return a response with a view as PNG; the name of the file is the name of the view.

        Parameters
        ----------
        view
            Name of the view.
        query
            Parameters of the request.
        is_disconnected
            Returns whether the client has disconnected; None never stops the picture.

        Raises
        ------
        CarinaError
            If no case is open, the view has no picture, a parameter is out of range, the case changes meanwhile, or
            another picture of this window already waits.
        CancelledError
            If the client has disconnected.
        """
        order = PictureOrder.of_query(query)
        if order.window in self._waiting:
            raise CarinaError(
                "another image of this window waits to be saved: wait until it is complete", code="render.busy"
            )
        stop = CancelToken()
        work = asyncio.ensure_future(self._png_in_turn(view, order, stop))
        try:
            while not (await asyncio.wait({work}, timeout=DISCONNECT_CHECK_S))[0]:
                if is_disconnected is not None and await is_disconnected():
                    raise CancelledError("the image was cancelled")
            png = work.result()
        finally:
            stop.cancel()
            work.cancel()
        disposition = f'attachment; filename="{view}.png"'
        headers = {"cache-control": "no-store", "content-disposition": disposition}
        return Response(png, media_type="image/png", headers=headers)

    async def _png_in_turn(self, view: str, order: PictureOrder, stop: CancelToken) -> bytes:
        self._waiting.add(order.window)
        try:
            requested: PictureState = await asyncio.to_thread(self._session.ask, PictureFacts(order.window))
            await self._one_at_a_time.acquire()
        finally:
            self._waiting.discard(order.window)
        try:
            return await _to_its_end(asyncio.to_thread(self._png, view, order, requested, stop))
        finally:
            self._one_at_a_time.release()

    def _png(self, view: str, order: PictureOrder, requested: PictureState, stop: CancelToken) -> bytes:
        row = view_row(view)
        state = self._newest_state(view, order, requested, stop)
        scene = state.scene
        if scene is None or not scene.has(row.needs):
            raise CarinaError(f"this view has no image yet: {row.empty}", code="render.no-picture")
        spec = scene.spec(view, *order.size_px, FULL_STEP_VOX, full_width=order.screen_width)
        picture = scene.renderer.render(spec, stop=stop)
        _check(stop)
        # A job can give the renderer other content at any time; the names would then not fit the picture.
        if not state.is_valid_for(view, self._session.ask(PictureFacts(order.window))):
            raise CarinaError("the case changed while the image was rendered: save it again", code="render.changed")
        finished = finish_case_picture(
            picture,
            order.marks,
            volume=state.volume,
            airways=state.airways,
            route=state.route,
            tip_lps=np.asarray(scene.pose.position_lps),
        )
        badges = (*badges_of(state.volume), *getattr(state.airways, "badges", ()))
        return finished.png(badges=tuple(dict.fromkeys(badges)))

    def _newest_state(self, view: str, order: PictureOrder, requested: PictureState, stop: CancelToken) -> PictureState:
        """Return the state of the case after the renderer shows the newest airways and transfer function.

        Raises
        ------
        CarinaError
            ``render.changed``: if another case was opened after the request, or the update takes too long.
        """
        end_s = time.monotonic() + UPDATE_S
        while True:
            _check(stop)
            state: PictureState = self._session.ask(PictureFacts(order.window))
            scene = state.scene
            if scene is None:
                return state
            if requested.scene is None or scene.case_number != requested.scene.case_number:
                raise CarinaError("another case was opened: save the image again", code="render.changed")
            if scene.can_be_final(view):
                return state
            if time.monotonic() > end_s:
                raise CarinaError("this view is being updated: wait, and save the image again", code="render.changed")
            time.sleep(POLL_INTERVAL_S)


def _check(stop: CancelToken) -> None:
    if stop.cancelled:
        raise CancelledError("the image was cancelled")


async def _to_its_end(work: Coroutine[Any, Any, bytes]) -> bytes:
    """Return the result of work that a cancellation of this coroutine does not abandon but waits for."""
    task = asyncio.ensure_future(work)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        await asyncio.wait({task})
        # The exception is read because asyncio logs an exception that is never read.
        task.exception()
        raise
