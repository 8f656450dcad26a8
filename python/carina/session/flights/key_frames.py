"""Commands for key frames: their list, the flight through them, and their file."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from carina import commands as c
from carina.case.document import ChosenKeyFrame, Document, KeyFrames
from carina.errors import NoResultError, UsageError
from carina.navigate import (
    MAX_SPEED_MM_S,
    MIN_SPEED_MM_S,
    KeyFrameFile,
    case_key,
    open_key_frames,
)
from carina.render import Sight
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.flights.tip_commands import place_pose, view_words
from carina.session.jobs.background_jobs import Job
from carina.session.open_case.key_frame_flight import KeyFlight, key_frames
from carina.session.open_case.open_case import OpenCase
from carina.session.open_case.point_in_airways import in_airways
from carina.session.state.snapshot import KeyFramesInfo, ShownKeyFrame, UserMessage
from carina.volume import Volume

MAX_KEYS = 200


class KeyFrameHandlers(CommandHandlers):
    """Commands for key frames, which are part of the document; every change is an undo step."""

    # ------------------------------------------------------------ the list of key frames

    @does(c.EditKeyFrames)
    def edit_key_frames(self, command: c.EditKeyFrames) -> str | None:
        """Edit the list of key frames as one undo step; return the ID of a new key frame."""
        edit = command.edit
        match edit:
            case c.KeyFrameAdd():
                return self._add()
            case c.KeyFrameUpdate():
                self._change_key(edit.key_id, "update", pose=self.core.needed_case().navigator.pose)
            case c.KeyFrameMove():
                self._move(edit.key_id, edit.by)
            case c.KeyFrameRename():
                own = None if edit.name is None else edit.name.strip() or None
                self._change_key(edit.key_id, "rename", name=own)
            case c.KeyFrameSpeed():
                self._change_key(edit.key_id, "set the speed up to", speed_mm_s=edit.speed_mm_s)
            case c.KeyFrameRemove():
                self._remove(edit.key_id)
        return None

    def _add(self) -> str:
        case = self.core.needed_case()
        with self.core.lock:
            keys = case.document.key_frames
            if len(keys.frames) >= MAX_KEYS:
                raise UsageError(
                    f"a flight can have at most {MAX_KEYS} key frames; remove some first", code="session.keys"
                )
            key = ChosenKeyFrame(_new_key_id(case), case.navigator.pose)
            self._set_key_frames(case, f"add key frame {len(keys.frames) + 1}", (*keys.frames, key))
            return key.key_id

    def _move(self, key_id: str, by: int) -> None:
        """Move a key frame earlier (``by`` below 0) or later in the order, at most to either end."""
        case = self.core.needed_case()
        with self.core.lock:
            frames = list(case.document.key_frames.frames)
            at = _index_of(frames, key_id)
            to = min(max(at + by, 0), len(frames) - 1)
            if to != at:
                frames.insert(to, frames.pop(at))
                self._set_key_frames(case, f"move key frame {at + 1} to {to + 1}", tuple(frames))

    def _remove(self, key_id: str) -> None:
        case = self.core.needed_case()
        with self.core.lock:
            frames = list(case.document.key_frames.frames)
            at = _index_of(frames, key_id)
            del frames[at]
            self._set_key_frames(case, f"remove key frame {at + 1}", tuple(frames))

    @does(c.SetKeyFrameFlight)
    def set_key_frame_flight(self, command: c.SetKeyFrameFlight) -> None:
        """Set the common speed of the legs without a speed of their own, and whether the flight follows the airways.

        A field that is None leaves its value unchanged.
        """
        speed_mm_s, through = command.speed_mm_s, command.through
        case = self.core.needed_case()
        with self.core.lock:
            if speed_mm_s is not None:
                self._set_flying(
                    case, "set the speed of the key-frame flight", "key-frame speed", speed_mm_s=speed_mm_s
                )
            if through is not None:
                self._set_flying(case, "set the path of the key-frame flight", None, through=through)

    def _set_flying(self, case: OpenCase, label: str, gesture: str | None, **values: Any) -> None:
        keys = case.document.key_frames
        self.core.edit(label, gesture, key_frames=replace(keys, flying=msgspec.structs.replace(keys.flying, **values)))

    def _change_key(self, key_id: str, verb: str, **values: Any) -> None:
        case = self.core.needed_case()
        with self.core.lock:
            frames = list(case.document.key_frames.frames)
            at = _index_of(frames, key_id)
            changed = replace(frames[at], **values)
            if any(getattr(frames[at], name) != value for name, value in values.items()):
                frames[at] = changed
                self._set_key_frames(case, f"{verb} key frame {at + 1}", tuple(frames))

    def _set_key_frames(self, case: OpenCase, label: str, frames: tuple[ChosenKeyFrame, ...]) -> None:
        self.core.change(
            case, label, replace(case.document, key_frames=replace(case.document.key_frames, frames=frames))
        )

    # ------------------------------------------------------------ the flight through the key frames

    def follow(self, case: OpenCase) -> None:
        """Delete the cached flight after a change of key frames or airways; the caller holds the session's lock."""
        if case.key_flight.has_other_inputs((case.document.key_frames, case.document.airways)):
            # The pose of the tip was computed from the previous flight, so this pose has no time in the new flight.
            case.key_flight.forget()
            case.last_move = replace(case.last_move, key_frames_s=None)

    @does(c.ShowKeyFrame)
    def show_key_frame(self, command: c.ShowKeyFrame) -> None:
        """Place the tip at a key frame, and set the time of the flight to this key frame."""
        case = self.core.needed_case()
        with self.core.lock:
            at = _index_of(case.document.key_frames.frames, command.key_id)
            flight = self._key_flight(case).flight
            self.core.fly(place_pose(case.document.key_frames.frames[at].pose))
            self._record_key_frame_move(case, 0.0 if flight is None else flight.key_times_s[at])

    @does(c.FlyKeyFrames)
    def fly_key_frames(self, command: c.FlyKeyFrames) -> None:
        """Place the tip at a time of the flight, limited to its duration.

        Raises
        ------
        NoResultError
            ``session.keys``: if there are fewer than two key frames.
        """
        time_s, goes_on = command.time_s, command.goes_on
        case = self.core.needed_case()
        with self.core.lock:
            if goes_on and case.last_move.key_frames_s is None:
                return
            found = self._key_flight(case)
            flight = found.flight
            if flight is None:
                raise NoResultError(found.problem or "a flight needs at least two key frames", code="session.keys")
            place_s = min(max(time_s, 0.0), flight.duration_s)
            self.core.fly(place_pose(flight.pose_at(place_s)))
            self._record_key_frame_move(case, place_s)

    def _record_key_frame_move(self, case: OpenCase, key_frames_s: float) -> None:
        case.last_move = replace(case.last_move, by="key_frames", key_frames_s=key_frames_s)

    def info(self) -> KeyFramesInfo:
        """Return the key frames in the form that the windows show."""
        with self.core.lock:
            case = self.core.case
            if case is None:
                return _key_frames_info(KeyFrames())
            keys = case.document.key_frames
            found = self._key_flight(case)
            flight = found.flight
            shown = []
            for n, key in enumerate(keys.frames):
                leg = None if flight is None or n == 0 else n - 1
                words, branch_id = _branch_name_and_id(case, key)
                shown.append(
                    ShownKeyFrame(
                        key.key_id,
                        key.name or words,
                        key.name is not None,
                        branch_id,
                        key.speed_mm_s,
                        0.0 if flight is None else flight.key_times_s[n],
                        None if flight is None or leg is None else round(flight.leg_mm[leg], 3),
                        flight is not None and leg is not None and flight.through_airways[leg],
                    )
                )
            return _key_frames_info(keys, tuple(shown), 0.0 if flight is None else flight.duration_s, found.problem)

    def _key_flight(self, case: OpenCase) -> KeyFlight:
        """Return the flight through the key frames, or the reason why there is none.

        The caller holds the session's lock.
        """
        return case.key_flight.of((case.document.key_frames, case.document.airways))

    # ------------------------------------------------------------ the file of key frames

    @answers(c.KeyFrameFileQuery)
    def key_frames_to_take_away(self, _question: c.KeyFrameFileQuery) -> KeyFrameFile:
        """Return the content of a file with the key frames, from which ``carina fly`` renders a video."""
        case = self.core.needed_case()
        with self.core.lock:
            document, sight = case.document, case.sight
        return key_file(case.info.volume, document, sight)

    @does(c.TakeKeyFrameFile)
    def take_key_frame_file(self, command: c.TakeKeyFrameFile) -> str:
        """Open a file of key frames as a job; the paths between them are computed in the current airways."""
        case = self.core.needed_case()

        def work(job: Job) -> None:
            file = open_key_frames(command.path)
            job.check()
            file.check(case.info.volume)
            if len(file.frames) > MAX_KEYS:
                raise UsageError(f"the file has {len(file.frames)} key frames; at most {MAX_KEYS} can be opened")
            speeds = _speeds(file)
            with self.core.lock:
                job.check()
                frames = tuple(
                    ChosenKeyFrame(_new_key_id(case), frame.pose, frame.name or None, speed)
                    for frame, speed in zip(file.frames, speeds, strict=True)
                )
                keys = KeyFrames(frames, c.KeyFrameFlying(file.speed_mm_s, file.through))
                self.core.change(case, "open key frames", replace(case.document, key_frames=keys))
                if any(frame.time_s is not None for frame in file.frames):
                    self.core.emit(UserMessage("the file stores times, which were converted to speeds"))

        return self.core.jobs.start("key-frames", "opening key frames", work)


def key_file(volume: Volume, document: Document, sight: Sight) -> KeyFrameFile:
    """Return the key frames of a document, with all inputs of a flight through them.

    Raises
    ------
    NoResultError
        ``session.keys``: if there are none.
    """
    if not document.key_frames.frames:
        raise NoResultError("there are no key frames yet", code="session.keys")
    frames, flying = key_frames(document.key_frames, volume, document.airways), document.key_frames.flying
    return KeyFrameFile(frames, flying.speed_mm_s, flying.through, case_key(volume), view_words(document, sight))


def _key_frames_info(
    keys: KeyFrames, shown: tuple[ShownKeyFrame, ...] = (), duration_s: float = 0.0, problem: str | None = None
) -> KeyFramesInfo:
    return KeyFramesInfo(**msgspec.structs.asdict(keys.flying), frames=shown, duration_s=duration_s, problem=problem)


def _branch_name_and_id(case: OpenCase, key: ChosenKeyFrame) -> tuple[str, int | None]:
    """Return a key frame's default name, and the ID of the branch that contains its pose; the ID is None outside."""
    airways, index = case.document.airways, case.index
    if airways is None or index is None:
        return "in the volume", None
    if not in_airways(case.info.volume, airways, key.pose.position_lps):
        return "outside the airways", None
    branch, _, _ = index.nearest(np.asarray(key.pose.position_lps))
    return branch.name or f"generation {branch.generation}", branch.id


def _new_key_id(case: OpenCase) -> str:
    return f"key-{case.next_number('key')}"


def _speeds(file: KeyFrameFile) -> list[float | None]:
    """Return the speed in mm/s of the leg to each key frame of a file; times in the file are converted to speeds."""
    times = [frame.time_s for frame in file.frames]
    if times[0] is None:
        return [frame.speed_mm_s for frame in file.frames]
    legs = zip(file.flight().leg_mm, itertools.pairwise(t for t in times if t is not None), strict=True)
    found = [min(max(mm / (after - before), MIN_SPEED_MM_S), MAX_SPEED_MM_S) for mm, (before, after) in legs]
    return [None, *found]


def _index_of(frames: Sequence[ChosenKeyFrame], key_id: str) -> int:
    for n, key in enumerate(frames):
        if key.key_id == key_id:
            return n
    raise UsageError("this key frame has been removed", code="session.keys")
