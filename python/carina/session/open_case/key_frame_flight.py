"""Computation of the flight through key frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from carina.case.document import ChosenKeyFrame, KeyFrames
from carina.errors import UsageError
from carina.navigate import AirwayWay, KeyFrame, KeyFrameFlight
from carina.session.open_case.point_in_airways import in_airways
from carina.track import way_between

if TYPE_CHECKING:
    from carina.track import Airways
    from carina.volume import Volume


@dataclass(frozen=True, slots=True, eq=False)
class KeyFlight:
    """The flight through key frames, or the reason why there is none; both are None with fewer than two key frames."""

    flight: KeyFrameFlight | None = None
    problem: str | None = None


def key_flight(volume: Volume, keys: KeyFrames, airways: Airways | None) -> KeyFlight:
    """Compute the camera flight through all key frames of a case."""
    if len(keys.frames) < 2:
        return KeyFlight()
    try:
        return KeyFlight(KeyFrameFlight(key_frames(keys, volume, airways), speed_mm_s=keys.flying.speed_mm_s))
    except UsageError as error:
        return KeyFlight(problem=str(error))


def key_frames(keys: KeyFrames, volume: Volume, airways: Airways | None) -> tuple[KeyFrame, ...]:
    """Return the key frames, each with the path from the preceding key frame.

    If requested, the path between two key frames in the airways follows the airways.
    """
    found: list[KeyFrame] = []
    before: ChosenKeyFrame | None = None
    for key in keys.frames:
        way = None
        if before is not None and keys.flying.through == "airways" and airways is not None:
            way = _way(volume, airways, before, key)
        found.append(KeyFrame(None, key.pose, key.name or "", key.speed_mm_s, way))
        before = key
    return tuple(found)


def _way(volume: Volume, airways: Airways, start: ChosenKeyFrame, end: ChosenKeyFrame) -> AirwayWay | None:
    if not all(in_airways(volume, airways, key.pose.position_lps) for key in (start, end)):
        return None
    between = way_between(airways.tree, start.pose.position_lps, end.pose.position_lps)
    return None if between is None else AirwayWay(*between)
