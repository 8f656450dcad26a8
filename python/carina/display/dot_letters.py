"""Letters of dots, 5 x 8, drawn into images without a font file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

# Dots of the letters, 5 x 8: one byte for each column, the lowest bit is the top row.
_DOTS = {
    " '()+,-.": "0000000000 0008070300 001c224100 0041221c00 08083e0808 0080703000 0808080808 0000606000",
    "/": "2010080402",
    "%:;?": "2313086462 0000660000 0056360000 0201510906",
    "01234567": "3e5149453e 00427f4000 7249494946 2141494d33 1814127f10 2745454539 3c4a494931 4121110907",
    "89": "3649494936 464949291e",
    "ABCDEFGH": "7c1211127c 7f49494936 3e41414122 7f4141413e 7f49494941 7f09090901 3e41415173 7f0808087f",
    "IJKLM": "00417f4100 2040413f01 7f08142241 7f40404040 7f021c027f",
    "NOPQRSTU": "7f0408107f 3e4141413e 7f09090906 3e4151215e 7f09192946 2649494932 03017f0103 3f4040403f",
    "VWXYZ": "1f2040201f 3f4038403f 6314081463 0304780403 6159494d43",
    "abcdefgh": "2054547840 7f28444438 3844444428 384444287f 3854545418 00087e0902 18a4a49c78 7f08040478",
    "ijklm": "00447d4000 2040403d00 7f10284400 00417f4000 7c04780478",
    "nopqrstu": "7c08040478 3844444438 fc18242418 18242418fc 7c08040408 4854545424 04043f4424 3c4040207c",
    "vwxyz": "1c2040201c 3c4030403c 4428102844 4c9090907c 4464544c44",
}
GLYPHS = {
    letter: bytes.fromhex(columns)
    for letters, dots in _DOTS.items()
    for letter, columns in zip(letters, dots.split(), strict=True)
}
ADVANCE, DOTS_HIGH = 6, 8
"""Distance of two letters, and height of a letter, in dots of the dot matrix."""
TEXT_RGB = (230, 232, 234)


def glyph_size(rgb: NDArray[np.uint8]) -> int:
    """Return the size of a dot of a letter in a picture, in pixels, so that text is readable in large pictures."""
    return 1 if min(rgb.shape[:2]) < 400 else max(2, min(rgb.shape[:2]) // 500)


def text_width(text: str, size: int) -> int:
    """Return the width of a text in pixels, for dots of ``size`` pixels."""
    return max(ADVANCE * len(text) - 1, 1) * size


def text_height(size: int) -> int:
    """Return the height of a line of text in pixels, for dots of ``size`` pixels."""
    return DOTS_HIGH * size


def text_dots(text: str) -> NDArray[np.bool_]:
    """Return the dots (8, n) of a line of text; an unknown letter is a hyphen."""
    dots = np.zeros((DOTS_HIGH, max(ADVANCE * len(text) - 1, 1)), dtype=bool)
    for n, letter in enumerate(text):
        for m, bits in enumerate(GLYPHS.get(letter, GLYPHS["-"])):
            dots[:, ADVANCE * n + m] = [bits >> bit & 1 for bit in range(DOTS_HIGH)]
    return dots


def write_on(
    rgb: NDArray[np.uint8],
    text: str,
    column: int,
    row: int,
    *,
    align: float = 0.0,
    size: int = 1,
    rgb_of: tuple[int, int, int] = TEXT_RGB,
) -> None:
    """Draw text, light on a dark edge and vertically centred on ``row``; parts outside the picture are cut off."""
    dots = text_dots(text)
    dots = np.pad(np.repeat(np.repeat(dots, size, axis=0), size, axis=1), 1)
    edge = np.zeros_like(dots)
    for across in (-1, 0, 1):
        for along in (-1, 0, 1):
            edge |= np.roll(np.roll(dots, across, axis=0), along, axis=1)
    top, left = row - dots.shape[0] // 2, column - int(align * dots.shape[1])
    height, width = rgb.shape[:2]
    inside = (
        slice(max(top, 0), min(top + dots.shape[0], height)),
        slice(max(left, 0), min(left + dots.shape[1], width)),
    )
    part = (
        slice(inside[0].start - top, inside[0].stop - top),
        slice(inside[1].start - left, inside[1].stop - left),
    )
    if inside[0].start >= inside[0].stop or inside[1].start >= inside[1].stop:
        return
    rgb[inside][edge[part]] = (8, 10, 12)
    rgb[inside][dots[part]] = rgb_of


def with_text_lines(rgb: NDArray[np.uint8], lines: Sequence[str]) -> NDArray[np.uint8]:
    """Return a copy of an image with lines of text at the lower left."""
    rgb = rgb.copy()
    size = glyph_size(rgb)
    high = text_height(size) + 2 * size
    for n, line in enumerate(reversed(lines)):
        write_on(rgb, line, 3 * size, rgb.shape[0] - 3 * size - high // 2 - n * high, size=size)
    return rgb
