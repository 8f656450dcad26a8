"""Contact sheet: the pictures of all forks of a route with their captions, as one image."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

from carina.display.dot_letters import TEXT_RGB, text_height, text_width, write_on
from carina.errors import NoResultError
from carina.plan.turns.pictures import TurnPicture
from carina.plan.turns.texts import place_words
from carina.render.picture_text import DRAWN_RGB, QUIET_RGB

NOT_A_DEVICE = "Not a medical device. Not for diagnosis."
GAP_PX = 16
LETTER_PX = 2
"""Size in pixels of one dot of the captions' dot-matrix letters."""
MAX_LINES = 6
"""Number of lines of a caption; further lines are omitted."""
BACKGROUND_RGB = (14, 17, 19)
WIDTH_TO_HEIGHT = 1.4
"""Intended ratio of the sheet's sides, that of a screen or a page."""

Rgb = NDArray[np.uint8]
Line = tuple[str, tuple[int, int, int]]


def contact_sheet(pictures: Sequence[TurnPicture], *, title: str, notes: Sequence[str] = ()) -> Rgb:
    """Return the pictures of the turns of a route in one image, with numbers, directions and places.

    Parameters
    ----------
    pictures
        Pictures of the turns in order, all of one size.
    title
        Title of the sheet, without the patient's identity.
    notes
        Notes below the pictures; the statement that Carina is not a medical device follows them.

    Raises
    ------
    NoResultError
        ``plan.no-forks``: if there are no pictures.
    """
    if not pictures:
        raise NoResultError("this route passes no fork, so there is nothing to show", code="plan.no-forks")
    side = pictures[0].rgb.shape[0]
    captions = [_caption(n, picture, side) for n, picture in enumerate(pictures, start=1)]
    high = text_height(LETTER_PX) + 2 * LETTER_PX
    cell = side + max(len(lines) for lines in captions) * high + GAP_PX
    columns = min(len(pictures), max(1, ceil(sqrt(len(pictures) * WIDTH_TO_HEIGHT * cell / (side + GAP_PX)))))
    rows = ceil(len(pictures) / columns)
    width = columns * (side + GAP_PX) + GAP_PX
    head = _lines([title], width, TEXT_RGB)
    foot = _lines([*notes, NOT_A_DEVICE], width, QUIET_RGB)
    top = GAP_PX + len(head) * high + GAP_PX
    rgb = np.empty((top + rows * (cell + GAP_PX) + len(foot) * high + GAP_PX, width, 3), dtype=np.uint8)
    rgb[:] = BACKGROUND_RGB
    _write(rgb, head, GAP_PX, GAP_PX)
    for n, (picture, caption) in enumerate(zip(pictures, captions, strict=True)):
        left = GAP_PX + n % columns * (side + GAP_PX)
        upper = top + n // columns * (cell + GAP_PX)
        rgb[upper : upper + side, left : left + side] = picture.rgb
        _write(rgb, caption, left, upper + side + LETTER_PX)
    _write(rgb, foot, GAP_PX, rgb.shape[0] - GAP_PX - len(foot) * high)
    return rgb


def _caption(number: int, picture: TurnPicture, width: int) -> list[Line]:
    """Return the lines below a picture: number, branches and direction; place; doubts in another colour."""
    turn = picture.turn
    what = f"{number}. {turn.from_branch} to {turn.to_branch}, {turn.direction(picture.operator)}"
    place = place_words(turn.from_carina_mm, turn.from_fork_mm, None, number == 1)
    lines = [*_lines([what], width, TEXT_RGB), *_lines([place], width, QUIET_RGB)]
    return [*lines, *_lines(turn.cautions, width, DRAWN_RGB)][:MAX_LINES]


def _lines(texts: Sequence[str], width: int, colour: tuple[int, int, int]) -> list[Line]:
    """Return texts as lines that fit into a width in pixels."""
    letters = max((width - 2 * LETTER_PX) // (text_width("nn", LETTER_PX) - text_width("n", LETTER_PX)), 8)
    # A no-break space keeps the hour and its unit in one line.
    plain = [text.replace(" o\u2019clock", "\u00a0o'clock").replace("\u2019", "'") for text in texts]
    return [(line.replace("\u00a0", " "), colour) for text in plain for line in textwrap.wrap(text, letters)]


def _write(rgb: Rgb, lines: Sequence[Line], left: int, top: int) -> None:
    high = text_height(LETTER_PX) + 2 * LETTER_PX
    for n, (text, colour) in enumerate(lines):
        write_on(rgb, text, left, top + n * high + high // 2, size=LETTER_PX, rgb_of=colour)
