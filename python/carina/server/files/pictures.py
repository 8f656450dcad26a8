"""Pictures of the views as PNG files, rendered by the code of ``carina render`` and not copied from the screen."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from starlette.responses import Response

from carina.commands import PictureFacts
from carina.errors import CarinaError, UsageError
from carina.render.saved_picture import PictureMarks
from carina.render.view_table import view_row
from carina.session import Session, finish_case_picture
from carina.volume import badges_of

FULL_STEP_VOX = 0.5
"""Step along the rays of a final picture, in voxels, as that of ``carina render``."""
SIDES_PX = (16, 8192)


@dataclass(frozen=True, slots=True, kw_only=True)
class PictureOrder:
    """Size and marks of a requested picture."""

    size_px: tuple[int, int]
    """Width and height of the file."""
    screen_width: int
    """Width in pixels of the picture in the window, to which the scales of the window apply."""
    window: int
    """Number of the window whose display settings the picture shows."""
    marks: PictureMarks

    @classmethod
    def of_query(cls, query: Mapping[str, str]) -> PictureOrder:
        """Return the order of the parameters of a request.

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

    Parameters
    ----------
    session
        Session with the open case.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self._one_at_a_time = asyncio.Lock()

    async def answer(self, view: str, query: Mapping[str, str]) -> Response:
        """Return a response with a view as PNG; the name of the file is the name of the view.

        Raises
        ------
        CarinaError
            If no case is open, the view has no picture, or a parameter is out of range.
        """
        order = PictureOrder.of_query(query)
        async with self._one_at_a_time:
            png = await asyncio.to_thread(self._png, view, order)
        disposition = f'attachment; filename="{view}.png"'
        headers = {"cache-control": "no-store", "content-disposition": disposition}
        return Response(png, media_type="image/png", headers=headers)

    def _png(self, view: str, order: PictureOrder) -> bytes:
        row = view_row(view)
        volume, airways, route, *_ = self._session.ask(PictureFacts())
        scene = self._session.scene(order.window)
        if scene is None or not scene.has(row.needs):
            raise CarinaError(f"this view has no image yet: {row.empty}", code="render.no-picture")
        spec = scene.spec(view, *order.size_px, FULL_STEP_VOX, full_width=order.screen_width)
        finished = finish_case_picture(
            scene.renderer.render(spec),
            order.marks,
            volume=volume,
            airways=airways,
            route=route,
            tip_lps=np.asarray(scene.pose.position_lps),
        )
        return finished.png(badges=tuple(dict.fromkeys((*badges_of(volume), *getattr(airways, "badges", ())))))
