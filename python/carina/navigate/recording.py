"""Recordings of a session's flight: every move that the pilot applied, its time, and the resulting pose.

A recording is a text file with one JSON value per line: a header, then one line for each move, each changed pose, each
change of the views and of the simulated breathing, then an end. A recording with breathing has version 2, stated by the
header or by a line before the first breathing. Poses serve for comparison: a replay applies the moves
to a new pilot with its gate, filter and mapping. All poses are those in the CT at rest; a simulated breathing carries
them along (`carina.scopes.Pose.carried_by`).
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TextIO

import numpy as np
from numpy.typing import NDArray

from carina.breathing import ChestMotion
from carina.disk import open_regular_text
from carina.display import one_line
from carina.errors import CarinaError, VolumeImportError
from carina.navigate import moves as m
from carina.navigate.navigator import Navigator
from carina.navigate.pilot import Pilot
from carina.scopes import Pose, WallField
from carina.volume import Volume

FORMAT, VERSION, BREATHING_VERSION = "carina-recording", 1, 2
"""Name of the format, its version without breathing, and its version with breathing, which older programs ignored."""
MAX_BYTES = 1 << 30
MAX_LINE = 64 << 20
"""Maximum accepted length of a line in characters: a path of a million points."""
TaskOutcome = Literal["completed", "stopped", "time-limit", "interrupted"]
"""End of an attempt at a task: completed, stopped by the user, at the time limit, or for another reason."""
MAX_LENGTH_S = 1e7
"""Maximum duration of an accepted recording in seconds: four months."""


def case_key(volume: Volume) -> dict[str, Any]:
    """Return the identification of a volume: its grid and a digest of its values; nothing about the patient."""
    digest = hashlib.blake2b(digest_size=16)
    digest.update(np.ascontiguousarray(volume.lps_from_ijk, dtype="<f8").tobytes())
    for slab in volume.hu_zyx:
        digest.update(np.ascontiguousarray(slab, dtype="<i2").tobytes())
    return {"shape_zyx": list(volume.shape_zyx), "digest": digest.hexdigest()}


class Recorder:
    """Writer of a recording of a pilot's moves, until it is closed.

    The pilot removes its devices when the recording starts (as if they were connected again, without a jump), since a
    replay starts without devices.

    Parameters
    ----------
    pilot
        Pilot to record; the recorder sets its ``on_move``.
    file
        Text file, open for writing; closed by :meth:`close`.
    case
        :func:`case_key` of the volume.
    carina
        Version of Carina that records.
    now_s
        Time at the start, of the clock of the moves.
    view
        Display settings of the airway view, as JSON values.
    motion
        Simulated breathing on the clock of the moves; None without breathing.
    on_end
        Function that is called once if the file cannot be written any more; the recording then ends, the flight
        continues.

    Raises
    ------
    OSError
        If the start cannot be written; the file is then closed.
    """

    def __init__(
        self,
        pilot: Pilot,
        file: TextIO,
        *,
        case: dict[str, Any],
        carina: str,
        now_s: float,
        view: dict[str, Any],
        motion: ChestMotion | None = None,
        on_end: Callable[[OSError], None] | None = None,
    ) -> None:
        self._pilot, self._file, self._began_s = pilot, file, now_s
        self._on_end: Callable[[OSError], None] | None = None
        self.trouble: OSError | None = None
        """Error that ended the recording before it was closed, or None."""
        self._pose: Pose | None = None
        self._view: dict[str, Any] = {}
        self._breathing: dict[str, Any] | None = None
        self._version = VERSION if motion is None else BREATHING_VERSION
        self._at_s = now_s
        self._paused_s: float | None = None
        self._in_task = False
        self.num_moves = self.num_poses = 0
        pilot.forget_devices()
        self._write(
            {
                "format": FORMAT,
                "version": self._version,
                "carina": carina,
                "case": case,
                "tip": pilot.navigator.state(),
                "begin": [m.move_to_json(move) for move in pilot.setting_up()],
            }
        )
        self.note_view(view, now_s)
        self.note_breathing(motion, now_s)
        if self.trouble is None:
            try:
                # Flush now, so that a full disk is reported at the start.
                file.flush()
            except OSError as error:
                self._end(error)
        if self.trouble is not None:
            raise self.trouble
        self._on_end = on_end
        pilot.on_move = self._record_move

    def __repr__(self) -> str:
        """Return a one-line description of this `Recorder` for the Python interpreter."""
        ended = "" if self.trouble is None else ", ended early"
        return f"Recorder({self.length_s:.1f} s, {self.num_moves} moves, {self.num_poses} poses{ended})"

    @property
    def length_s(self) -> float:
        """Length of the recording, s."""
        return self._at_s - self._began_s

    def note_view(self, view: dict[str, Any], now_s: float) -> None:
        """Record a change of the airway view; an unchanged view is not recorded."""
        if view != self._view:
            self._view = view
            self._write({"t": self._time(self._recorded_s(now_s)), "view": view})

    def note_breathing(self, motion: ChestMotion | None, now_s: float) -> None:
        """Record a change of the simulated breathing, on the clock of the moves; None ends it.

        The recording states the breathing on its own clock, which pauses exclude; the breathing must pause with it. A
        recording that began without breathing gets a line with the new version. Programs that do not know breathing
        refuse this line.
        """
        began_s = 0.0 if motion is None else round(motion.began_s - self._began_s, 6)
        breathing = None if motion is None else replace(motion, began_s=began_s).to_json()
        if breathing != self._breathing:
            self._breathing = breathing
            if self._version != BREATHING_VERSION:
                self._version = BREATHING_VERSION
                self._write({"version": BREATHING_VERSION})
            self._write({"t": self._time(self._recorded_s(now_s)), "breathing": breathing})

    def _recorded_s(self, now_s: float) -> float:
        """Return the time of a record: a change during a pause has the time at which the pause began."""
        return now_s if self._paused_s is None else self._at_s

    def note_task(self, task: dict[str, Any], now_s: float, learner: str | None = None) -> None:
        """Record the beginning of an attempt at a task of the training.

        Parameters
        ----------
        task
            The task as JSON values.
        now_s
            Time of the beginning.
        learner
            Key of the learner who flies, a random number without the pseudonym; None without a learner.
        """
        self.tick(now_s)
        self._in_task = True
        owner = {} if learner is None else {"learner": learner}
        self._write({"t": self._time(self._at_s), "task": task, **owner})

    def note_task_end(self, outcome: TaskOutcome, now_s: float) -> None:
        """Record the end of the attempt at the training task."""
        self._in_task = False
        self.tick(now_s)
        self._write({"t": self._time(self._at_s), "task_end": outcome})

    def pause(self, now_s: float) -> None:
        """Stop the time of the recording until `resume`; the recording states the pause."""
        if self._paused_s is None:
            self.tick(now_s)
            self._paused_s = self._at_s
            self._write({"t": self._time(self._at_s), "paused": True})

    def resume(self, now_s: float) -> None:
        """Continue after a pause, whose length is recorded; do nothing without a pause."""
        if self._paused_s is not None:
            length_s = max(now_s - self._paused_s, 0.0)
            self._began_s += length_s
            self._at_s += length_s
            self._paused_s = None
            self._write({"t": self._time(self._at_s), "paused": False, "pause_s": round(length_s, 6)})

    def tick(self, now_s: float) -> None:
        """Set the current time for the next records; moves of devices contain their own times."""
        if self._paused_s is None:
            self._at_s = max(self._at_s, now_s)

    def close(self) -> None:
        """Write the end and close the file; a write error is passed to ``on_end`` and not raised.

        An attempt at a task that has not ended was interrupted.
        """
        self._pilot.on_move = None
        if self._in_task:
            self.note_task_end("interrupted", self._at_s)
        self._write({"end": self._time(self._at_s), "num_moves": self.num_moves, "num_poses": self.num_poses})
        if self.trouble is None:
            try:
                self._file.close()
            except OSError as error:
                self._end(error)

    def _record_move(self, move: m.Move, dt_s: float) -> None:
        if isinstance(move, m.DeviceSaid | m.Frame):
            self.tick(move.now_s)
        try:
            line: dict[str, Any] = {"t": self._time(self._at_s), "move": m.move_to_json(move, dt_s)}
            json.dumps(line, allow_nan=False)
        except ValueError:
            return  # A sample with NaN was rejected by the gate, so it moves nothing.
        if isinstance(move, m.LayScope) and self._pilot.wall_made_from is not None:
            line["wall"] = self._pilot.wall_made_from
        pose = self._pilot.navigator.pose
        if pose is not self._pose:
            self._pose = pose
            line["pose"] = [float(v) for v in pose.lps_from_camera.ravel()]
            self.num_poses += 1
        self.num_moves += 1
        self._write(line)

    def _time(self, now_s: float) -> float:
        return round(max(0.0, now_s - self._began_s), 6)

    def _write(self, value: dict[str, Any]) -> None:
        if self.trouble is not None:
            return
        try:
            self._file.write(json.dumps(value, allow_nan=False, separators=(",", ":")) + "\n")
        except OSError as error:
            self._end(error)

    def _end(self, trouble: OSError) -> None:
        """End the recording after a write error, without an exception in the code that moves the tip."""
        self.trouble = trouble
        self._pilot.on_move = None
        with contextlib.suppress(OSError):
            self._file.close()
        if self._on_end is not None:
            self._on_end(trouble)


@dataclass(frozen=True, slots=True)
class ReplayedPose:
    """Pose of a replay at one time: seconds from the start, pose in the CT at rest, and settings of the view."""

    time_s: float
    pose: Pose
    view: dict[str, Any]
    picture_turned: bool = False
    """See :attr:`carina.navigate.Navigator.picture_turned`."""
    motion: ChestMotion | None = None
    """Simulated breathing on the clock of the recording; None without breathing."""


@one_line
@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """Recording that was read from a file: header and lines.

    Parameters
    ----------
    header
        First line of the file.
    lines
        Other lines, each with a checked time.
    complete
        False if the end is missing because the program was stopped during the recording.
    """

    header: dict[str, Any]
    lines: tuple[dict[str, Any], ...]
    complete: bool

    @property
    def length_s(self) -> float:
        """Time from the first to the last line of the recording, s."""
        return max((float(line.get("t", line.get("end", 0.0))) for line in self.lines), default=0.0)

    def check(self, volume: Volume, *, carina: str) -> None:
        """Raise an error if the recording belongs to another case or version of Carina.

        Raises
        ------
        VolumeImportError
            ``navigate.recording``.
        """
        made_by = self.header.get("carina")
        if made_by != carina:
            raise VolumeImportError(
                f"this recording was made by Carina {made_by}; this is Carina {carina}, whose poses may differ very "
                f"slightly; replay it with Carina {made_by}",
                code="navigate.recording",
            )
        self.check_scan(volume)

    def check_scan(self, volume: Volume) -> None:
        """Raise an error if the recording belongs to another scan; recorded poses are valid in any version of Carina.

        Raises
        ------
        VolumeImportError
            ``navigate.recording``.
        """
        if self.header.get("case") != case_key(volume):
            raise VolumeImportError(
                "this recording belongs to another scan, with a different grid or different voxel values; open that "
                "scan",
                code="navigate.recording",
            )

    @property
    def task(self) -> dict[str, Any] | None:
        """The task of the training as JSON values, if the recording is an attempt at one, else None."""
        return next((dict(line["task"]) for line in self.lines if "task" in line), None)

    @property
    def learner(self) -> str | None:
        """Key of the learner who flew the attempt; None without an attempt or a learner."""
        return next((line.get("learner") for line in self.lines if "task" in line), None)

    @property
    def task_outcome(self) -> str | None:
        """End of the attempt, one of :data:`TaskOutcome`; None without a task, or if the recording was cut off."""
        return next((line["task_end"] for line in self.lines if "task_end" in line), None)

    @property
    def pauses(self) -> tuple[tuple[float, float], ...]:
        """Pauses of the recording: place in its time, which excludes pauses, and length, both in s.

        A pause during which the recording was cut off has the length 0.
        """
        begun = [float(line["t"]) for line in self.lines if line.get("paused") is True]
        lengths = [float(line["pause_s"]) for line in self.lines if line.get("paused") is False]
        return tuple((at_s, lengths[n] if n < len(lengths) else 0.0) for n, at_s in enumerate(begun))

    @property
    def motions(self) -> tuple[tuple[float, ChestMotion | None], ...]:
        """Changes of the simulated breathing: time of the change in s, and breathing on the recording's clock.

        A recording without breathing has none.
        """
        return tuple((float(line["t"]), _motion(line)) for line in self.lines if "breathing" in line)

    @property
    def needs_wall(self) -> bool:
        """Whether the recording contains a scope in the lumen, whose replay needs the wall."""
        return any(line.get("move", {}).get("move") == "SetScope" for line in self.lines)

    def recorded_poses(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the recorded poses and their times, without a replay, so from any version of Carina.

        Returns
        -------
        tuple
            (n,) seconds from the start, ascending, the first 0; and (n, 4, 4) ``lps_from_camera``, mm.

        Raises
        ------
        VolumeImportError
            ``navigate.recording``: if a recorded pose is invalid.
        """
        try:
            moments = [(0.0, self.header["tip"]["lps_from_camera"])]
            moments += [(float(line["t"]), line["pose"]) for line in self.lines if "pose" in line]
            poses = np.stack([np.asarray(pose, dtype=np.float64).reshape(4, 4) for _, pose in moments])
            for pose in poses:
                Pose(pose)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise VolumeImportError(f"the recording cannot be replayed: {error}", code="navigate.recording") from error
        return np.array([time_s for time_s, _ in moments]), poses

    def replay(
        self, volume: Volume, *, wall: WallField | Callable[[dict[str, Any]], WallField] | None = None
    ) -> Iterator[tuple[ReplayedPose, bool]]:
        """Apply the recorded moves again; yield every pose, and whether it equals the recorded pose bit for bit.

        Parameters
        ----------
        volume
            Volume of the case.
        wall
            Wall that constrains a scope (:attr:`needs_wall`); or a function that computes the wall for each inserted
            scope from the recorded description of the airways (``digest``, ``root_lps``, ``lumen_threshold``,
            ``edits``).

        Raises
        ------
        VolumeImportError
            ``navigate.recording``: if a line contains no valid move.
        """
        try:
            pilot = Pilot(Navigator(Pose(np.asarray(self.header["tip"]["lps_from_camera"])), volume=volume))
            pilot.wall = wall if isinstance(wall, WallField) else None
            for value in self.header["begin"]:
                move, dt_s = m.move_from_json(value)
                pilot.apply(move, dt_s=dt_s)
            pilot.navigator.restore(self.header["tip"], pilot.navigator.path)
            view: dict[str, Any] = {}
            motion: ChestMotion | None = None
            tip = pilot.navigator
            yield ReplayedPose(0.0, tip.pose, view), True
            for line in self.lines:
                if "view" in line:
                    view = dict(line["view"])
                    yield ReplayedPose(float(line["t"]), tip.pose, view, tip.picture_turned, motion), True
                elif "breathing" in line:
                    motion = _motion(line)
                    yield ReplayedPose(float(line["t"]), tip.pose, view, tip.picture_turned, motion), True
                elif "move" in line:
                    if line["move"].get("move") == "SetScope" and wall is not None and not isinstance(wall, WallField):
                        pilot.wall = wall(dict(line.get("wall") or {}))
                    move, dt_s = m.move_from_json(line["move"])
                    pilot.apply(move, dt_s=dt_s)
                    if "pose" in line:
                        same = tip.pose.lps_from_camera.ravel().tolist() == line["pose"]
                        yield ReplayedPose(float(line["t"]), tip.pose, view, tip.picture_turned, motion), same
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise VolumeImportError(f"the recording cannot be replayed: {error}", code="navigate.recording") from error


def open_recording(path: str | Path) -> Recording:
    """Read a recording; one that a crash has cut off is read up to its last complete line.

    Raises
    ------
    VolumeImportError
        ``navigate.recording``: if the file is not a recording, has another version of the format, or is too large.
    """
    place = Path(path)
    try:
        if place.stat().st_size > MAX_BYTES:
            raise _unusable_recording_error(place, f"it is larger than {MAX_BYTES >> 20} MiB")
        with open_regular_text(place) as file:
            return read_recording(file, place)
    except VolumeImportError:
        raise  # VolumeImportError is an OSError too, and must not be replaced.
    except OSError as error:
        raise _unusable_recording_error(place, error.strerror or "it cannot be read") from error
    except UnicodeDecodeError as error:
        raise _unusable_recording_error(place, "it is not a text file") from error


def read_recording(file: io.TextIOBase | TextIO, place: Path) -> Recording:
    """Read a recording from an open text file; messages name it by ``place``.

    Raises
    ------
    VolumeImportError
        As :func:`open_recording`.
    """
    header = _json_object(file.readline(MAX_LINE))
    if header is None or header.get("format") != FORMAT:
        raise _unusable_recording_error(place, "it does not start with the header of a Carina recording")
    _check_version(header, place)
    lines: list[dict[str, Any]] = []
    complete = False
    last_s = 0.0
    number = 1
    while text := file.readline(MAX_LINE):
        number += 1
        line = _json_object(text)
        if line is None:
            if file.read(1) == "" and not text.endswith("\n"):
                break  # The last line is incomplete, because the recording was cut off.
            raise _unusable_recording_error(place, f"line {number} is not a JSON object")
        if set(line) == {"version"}:
            _check_version(line, place)
            continue
        at_s = line.get("end", line.get("t"))
        if not isinstance(at_s, int | float) or not last_s <= at_s <= MAX_LENGTH_S:
            raise _unusable_recording_error(
                place, f"line {number} has no time, or an earlier time than the line before"
            )
        if not all(isinstance(line.get(part, {}), dict) for part in ("move", "view", "wall", "task")):
            raise _unusable_recording_error(
                place, f"line {number} contains an invalid movement, view, wall or task record"
            )
        if not all(isinstance(line.get(part, ""), str) for part in ("task_end", "learner")):
            raise _unusable_recording_error(place, f"line {number} contains an invalid end or learner of a task")
        if "paused" in line and not _is_pause(line):
            raise _unusable_recording_error(place, f"line {number} contains an invalid pause")
        if "breathing" in line:
            try:
                _motion(line)
            except CarinaError as error:
                raise _unusable_recording_error(place, f"line {number}: {error}") from error
        last_s = float(at_s)
        lines.append(line)
        if "end" in line:
            complete = True
            break
    return Recording(header, tuple(lines), complete)


def _check_version(line: dict[str, Any], place: Path) -> None:
    """Raise an error if the header, or a line with a new version, states an unknown version of the format."""
    version = line.get("version")
    if version not in (VERSION, BREATHING_VERSION):
        raise _unusable_recording_error(
            place,
            f"it has format version {version!r}; this version of Carina reads {VERSION} and {BREATHING_VERSION}",
        )


def _motion(line: dict[str, Any]) -> ChestMotion | None:
    """Return the breathing of a line that states one; None if the line ends the breathing."""
    return None if line["breathing"] is None else ChestMotion.from_json(line["breathing"])


def _is_pause(line: dict[str, Any]) -> bool:
    """Return whether a line is the beginning of a pause, or its end with its length."""
    length_s = line.get("pause_s")
    is_length = isinstance(length_s, int | float) and 0.0 <= length_s <= MAX_LENGTH_S
    return line["paused"] is True or (line["paused"] is False and is_length)


def _json_object(text: str) -> dict[str, Any] | None:
    try:
        value = json.loads(text, parse_constant=lambda _: None)
    except (ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None


def _unusable_recording_error(place: Path, why: str) -> VolumeImportError:
    return VolumeImportError(f"{place}: could not be replayed: {why}", code="navigate.recording")


def sampled(moments: list[ReplayedPose], times_s: NDArray[np.float64]) -> list[ReplayedPose]:
    """Return the pose that a replay displayed at each time: the latest pose that is not later than the time.

    The results have the given times, because the breathing moves the chest also while the tip rests.
    """
    known = np.array([moment.time_s for moment in moments])
    places = np.maximum(np.searchsorted(known, times_s, side="right") - 1, 0)
    return [replace(moments[int(n)], time_s=float(time_s)) for n, time_s in zip(places, times_s, strict=True)]
