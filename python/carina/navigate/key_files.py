"""Files of key frames (``carina-keys``): version 1 with times; version 2 with speeds, airway paths and case."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from carina.commands.fields import Through
from carina.disk import read_regular_text
from carina.display import one_line
from carina.errors import VolumeImportError
from carina.navigate.key_frames import KeyFrame, KeyFrameFlight
from carina.navigate.key_legs import AirwayWay
from carina.navigate.recording import case_key
from carina.scopes import Pose
from carina.volume import Volume

__all__ = ["KeyFrameFile", "Through", "open_key_frames"]


FORMAT, VERSION = "carina-keys", 2
MAX_BYTES = 50_000_000
MAX_NAME = 200


@one_line
@dataclass(frozen=True, slots=True)
class KeyFrameFile:
    """Content of a file of key frames: the key frames, and speed, route, case and view of the flight through them.

    Parameters
    ----------
    frames
        Key frames in the order of the flight.
    speed_mm_s
        Speed of legs without their own speed.
    through
        Chosen route: through the airways where two key frames lie in them, or a curve through space.
    case
        :func:`carina.navigate.case_key` of the scan in which they were made; None (version 1) if unknown.
    view
        Display settings of the airway view, as in a recording; empty if unknown.
    """

    frames: tuple[KeyFrame, ...]
    speed_mm_s: float = 20.0
    through: Through = "space"
    case: dict[str, Any] | None = None
    view: dict[str, Any] = field(default_factory=dict)

    def flight(self) -> KeyFrameFlight:
        """Return the flight through the key frames.

        Raises
        ------
        UsageError
            ``navigate.keys``: see :class:`KeyFrameFlight`.
        """
        return KeyFrameFlight(self.frames, speed_mm_s=self.speed_mm_s)

    def check(self, volume: Volume) -> None:
        """Raise an error if the key frames were made in another case than the volume's.

        Raises
        ------
        VolumeImportError
            ``navigate.keys``.
        """
        if self.case is not None and self.case != case_key(volume):
            raise VolumeImportError(
                "these key frames belong to another scan, with a different grid or different voxel values; open that "
                "scan",
                code="navigate.keys",
            )
        for number, frame in enumerate(self.frames, 1):
            if not volume.contains_lps(frame.pose.position_lps):
                raise VolumeImportError(
                    f"key frame {number} lies outside this scan; open the scan that the key frames belong to",
                    code="navigate.keys",
                )

    def to_json(self) -> dict[str, Any]:
        """Return the document ``carina-keys`` 2; floats keep every bit."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "case": self.case,
            "speed_mm_s": self.speed_mm_s,
            "through": self.through,
            "view": self.view,
            "keys": [
                {
                    "name": frame.name,
                    "lps_from_camera": frame.pose.lps_from_camera.tolist(),
                    "speed_mm_s": frame.speed_mm_s,
                    "way": None
                    if frame.way is None
                    else {"points_lps": frame.way.points_lps.tolist(), "apex": frame.way.apex},
                }
                for frame in self.frames
            ],
        }


def open_key_frames(path: str | Path) -> KeyFrameFile:
    """Read key frames from a file.

    Raises
    ------
    VolumeImportError
        ``navigate.keys``: if the file cannot be read or contains no key frames.
    """
    place = Path(path)
    try:
        try:
            text = read_regular_text(place, max_bytes=MAX_BYTES)
        except VolumeImportError as error:
            if error.code != "disk.too-large":
                raise
            raise VolumeImportError(f"{place.name}: too large for a key-frame file", code="navigate.keys") from None
        document = json.loads(text)
        if document["format"] != FORMAT or document["version"] not in {1, VERSION}:
            raise ValueError(f"expected the format {FORMAT}, version 1 or {VERSION}")
        return _timed_key_frames(document) if document["version"] == 1 else _key_frames_with_speeds(document)
    except VolumeImportError:
        raise
    except OSError as error:
        raise VolumeImportError(f"{place.name}: cannot be read: {error.strerror}", code="navigate.keys") from error
    except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
        raise VolumeImportError(f"{place.name}: not a key-frame file: {error}", code="navigate.keys") from error


def _timed_key_frames(document: dict[str, Any]) -> KeyFrameFile:
    keys = document["keys"]
    file = KeyFrameFile(tuple(KeyFrame(float(key["time_s"]), Pose(np.array(key["lps_from_camera"]))) for key in keys))
    # The flight is built here so that times that do not increase are reported as an error of the file.
    file.flight()
    return file


def _key_frames_with_speeds(document: dict[str, Any]) -> KeyFrameFile:
    through, case, view = document["through"], document["case"], document.get("view", {})
    if (
        through not in {"airways", "space"}
        or not (case is None or isinstance(case, dict))
        or not isinstance(view, dict)
    ):
        raise ValueError(
            "expected 'airways' or 'space' in the field 'through', and objects in the fields 'case' and 'view'"
        )
    frames = []
    for key in document["keys"]:
        way = key.get("way")
        frames.append(
            KeyFrame(
                None,
                Pose(np.array(key["lps_from_camera"])),
                str(key.get("name") or "")[:MAX_NAME],
                None if key.get("speed_mm_s") is None else float(key["speed_mm_s"]),
                None if way is None else AirwayWay(np.array(way["points_lps"]), int(way["apex"])),
            )
        )
    file = KeyFrameFile(tuple(frames), float(document["speed_mm_s"]), through, case, view)
    if not frames or not math.isfinite(file.speed_mm_s):
        raise ValueError("it contains no key frames, or no speed")
    if len(frames) > 1:
        file.flight()
    return file
