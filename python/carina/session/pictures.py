"""The small picture by which a person knows a case again."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import numpy as np

if TYPE_CHECKING:
    from carina.session.scene import ShownCase

__all__ = ["small_picture"]

VIEW = "tree"
"""From outside no two patients' airways are alike; from within, most are."""
WIDTH, HEIGHT = 320, 240
STEP_VOX = 1.0
QUALITY = 82


def small_picture(scene: ShownCase) -> bytes:
    """A JPEG of the airways from outside, as they are looked at now.

    Raises
    ------
    CarinaError
        If the renderer has no answer.
    """
    import simplejpeg

    picture = scene.renderer.render(scene.spec(VIEW, WIDTH, HEIGHT, STEP_VOX))
    pixels = np.ascontiguousarray(picture.rgb)
    return cast(bytes, simplejpeg.encode_jpeg(pixels, quality=QUALITY, colorspace="RGB", colorsubsampling="420"))
