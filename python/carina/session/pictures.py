"""Thumbnail of a case, by which the user recognises the case in the list."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

if TYPE_CHECKING:
    from carina.session.scene import ShownCase

__all__ = ["small_picture"]

VIEW = "tree"
"""The outside view, because the trees of two patients differ visibly, while their inside views look alike."""
WIDTH, HEIGHT = 320, 240
STEP_VOX = 1.0
QUALITY = 82


def small_picture(scene: ShownCase) -> bytes:
    """Return a JPEG of the airways from outside, with the present view settings.

    Raises
    ------
    CarinaError
        If the renderer fails.
    """
    import simplejpeg

    picture = scene.renderer.render(scene.spec(VIEW, WIDTH, HEIGHT, STEP_VOX))
    pixels = np.ascontiguousarray(picture.rgb)
    return cast(bytes, simplejpeg.encode_jpeg(pixels, quality=QUALITY, colorspace="RGB", colorsubsampling="420"))
