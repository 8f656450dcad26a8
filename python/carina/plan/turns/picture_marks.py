"""Marks drawn over the picture of a turn: the edge of the opening, and the clock."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from carina.display.dot_letters import write_on
from carina.plan.turns.fork_view import Operator
from carina.plan.turns.turn_list import Turn

Field = NDArray[np.float64]
Rgb = NDArray[np.uint8]
Colour = tuple[int, int, int]

QUIET_RGB: Colour = (200, 206, 212)
DARK_RGB: Colour = (8, 10, 12)


def draw_edge(rgb: Rgb, field: Field, width_px: float, colour: Colour) -> None:
    """Draw a line along the contour 0.5 of a field, on a dark rim.

    Parameters
    ----------
    rgb
        (height, width, 3) picture, changed in place.
    field
        (height, width) values whose contour at 0.5 is drawn.
    width_px, colour
        Width and colour of the line.
    """
    down, across = np.gradient(field)
    away = np.abs(field - 0.5) / np.maximum(np.hypot(down, across), 1e-3)
    _blend(rgb, 0.7 * np.clip(0.5 * width_px + 1.5 - away, 0.0, 1.0), DARK_RGB)
    _blend(rgb, np.clip(0.5 * width_px + 0.5 - away, 0.0, 1.0), colour)


def draw_clock(rgb: Rgb, turn: Turn, operator: Operator, colour: Colour) -> None:
    """Draw hour ticks, a wedge at the opening, and the hours of the openings.

    The name of the branch is the caption of the picture (`TurnPicture.words`), not part of its pixels.

    Parameters
    ----------
    rgb
        (height, width, 3) picture, changed in place.
    turn, operator
        The turn, and the position of the operator for the hours.
    colour
        Colour of the opening to enter.
    """
    dial = _Dial(rgb)
    size = text_size(rgb)
    for hour in range(12):
        dial.tick(float(hour), long=hour % 3 == 0)
    taken, at = turn.hour(operator), turn.clock(operator)
    if at is not None:
        # The wedge is at the opening itself, not at the whole hour.
        dial.wedge(at, colour)
        dial.write(f"{taken}", at, size, colour)
    for other in turn.others:
        hour_of_other = other.hour(operator)
        if hour_of_other is not None and hour_of_other != taken:
            dial.write(f"{hour_of_other}", float(hour_of_other), size, QUIET_RGB)


def text_size(rgb: Rgb) -> int:
    """Return the size of a glyph's dot in pixels at which text is 8 pt high if the picture fills a third of a page."""
    height, width = rgb.shape[:2]
    return max(1, round(3.0 * float(min(height, width)) / 512.0))


class _Dial:
    """Clock drawn round a picture; lengths are in pixels of a picture of 512 pixels."""

    def __init__(self, rgb: Rgb) -> None:
        self._rgb = rgb
        height, width = rgb.shape[:2]
        self.scale = min(height, width) / 512
        rows, columns = np.mgrid[0:height, 0:width] + 0.5
        right, up = columns - width / 2, height / 2 - rows
        self._radius = np.hypot(right, up)
        self._hours = (np.arctan2(right, up) / math.tau * 12.0) % 12.0
        # The outer 48 pixels are reserved for the letters of the patient's directions.
        self._outer = 0.5 * min(height, width) - 48.0 * self.scale

    def tick(self, hour: float, *, long: bool) -> None:
        """Draw an hour tick: a line at an hour towards the middle of the picture."""
        length = (9.0 if long else 6.0) * self.scale
        along = np.minimum(self._radius - (self._outer - length), self._outer - self._radius)
        off = self._off_px(hour)
        for width, colour in ((3.6, DARK_RGB), (1.6, QUIET_RGB)):
            share = np.clip(0.5 * width * self.scale - off + 0.5, 0.0, 1.0) * np.clip(along + 0.5, 0.0, 1.0)
            _blend(self._rgb, share, colour)

    def wedge(self, hours: float, colour: Colour) -> None:
        """Draw a triangle at an hour that points towards the middle of the picture."""
        length = 16.0 * self.scale
        inwards = np.clip((self._radius - (self._outer - length)) / length, 0.0, 1.0)
        within = (self._radius >= self._outer - length) & (self._radius <= self._outer)
        _blend(self._rgb, np.clip(7.0 * self.scale * inwards - self._off_px(hours) + 0.5, 0.0, 1.0) * within, colour)

    def write(self, text: str, hours: float, size: int, colour: Colour) -> None:
        """Draw a text inside the clock's ring at an hour."""
        height, width = self._rgb.shape[:2]
        angle, radius = hours / 12.0 * math.tau, self._outer - (16.0 + 6.0 * size) * self.scale
        column, row = width / 2 + radius * math.sin(angle), height / 2 - radius * math.cos(angle)
        write_on(self._rgb, text, round(column), round(row), align=0.5, size=size, rgb_of=colour)

    def _off_px(self, hours: float) -> Field:
        """Return the distance in pixels of each pixel from the line to an hour, along a circle round the middle."""
        off: Field = np.abs((self._hours - hours + 6.0) % 12.0 - 6.0) / 12.0 * math.tau * self._radius
        return off


def _blend(rgb: Rgb, share: Field, colour: Colour) -> None:
    touched = share > 0.0
    under = rgb[touched].astype(np.float64)
    rgb[touched] = np.rint(under + share[touched][:, None] * (np.array(colour) - under)).astype(np.uint8)
