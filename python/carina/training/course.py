"""Course: pseudonymous learners and their scored attempts, in local files of one machine.

A learner's file contains the pseudonym and the scores: nothing about the patient, no poses and no time of day. The
name of the file is the learner's key, a random number, which recorded flights contain instead of the pseudonym.
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import os
import re
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard

from carina.argument_checks import check_arguments, file_path, instance, text_of
from carina.disk import disk_trouble, make_folder, read_regular_text, write_whole
from carina.disk.locks import try_lock
from carina.display import one_line
from carina.display.escaped_text import printable
from carina.errors import DiskError, UsageError
from carina.training.flight_frames import REPEATED_SHARE
from carina.training.log_files import score_values, xapi_statements
from carina.training.mastery import Mastery, is_mastery_procedure, judge_mastery
from carina.training.score import Score

FORMAT, VERSION = "carina-learner", 1
SUFFIX = ".learner.json"
KEY = re.compile(r"[0-9a-f]{16}")
LOCK = ".learners.lock"
"""File that a process locks while it changes the learners; other processes wait."""
LOCK_WAIT_S = 20.0
LOCK_POLL_S = 0.01
RENAMED = (
    "the file {name} of a learner was copied or renamed, and is not used: expected a name of 16 hexadecimal digits and "
    f"{SUFFIX}, which Carina gave to the file; restore this name, or delete the copy"
)
UNREADABLE = "the file of this learner cannot be read; it is left unchanged"
MAX_NAME = 40
MAX_BYTES = 256 << 20
MAX_LEARNERS = 1000
SAMPLED_OF = 4
"""Sampling ratio: of so many recorded poses, the digest of one is stored, by which a replayed flight is recognised."""
MAX_VALUE = 1e12
"""Maximum magnitude of a score or measure of an attempt; greater or infinite numbers come from a damaged file."""
OWN_ATTEMPTS = "over all attempts of this learner, in their order"
_VALUES = (
    "diagnostic_completeness", "num_case_segments", "structured_progress", "procedure_time_s",
    "mean_intersegmental_time_s", "segments_revisited", "path_length_mm", "smoothness", "num_contacts",
    "contact_time_s", "red_out_s", "lumen_in_middle",
)  # fmt: skip
"""Measures of an attempt, in the order of the export."""


@one_line
@dataclass(frozen=True, slots=True)
class CourseAttempt:
    """Scored attempt of a learner."""

    task: str
    title: str
    is_inspection: bool
    completed: bool
    num_steps_done: int
    num_steps: int
    values: dict[str, float | int | None] = field(repr=False)
    """Published scores, and measures for which no pass mark is published, by name (`docs/training.md`)."""
    passed: bool
    """Whether the attempt has 18 segments, 18 progressions and less than 120 s."""
    reasons: tuple[str, ...]
    """Reasons why the attempt does not count in a verdict, without the comparison with earlier attempts."""
    digest: str
    """Digest of all recorded poses of the attempt."""
    poses: frozenset[str] = field(repr=False)
    """Digests of a sample of the poses, by which a replay is recognised."""
    statements: tuple[dict[str, Any], ...] = field(repr=False)
    """xAPI statements of the attempt."""

    @classmethod
    def of(cls, score: Score, learner: str) -> CourseAttempt:
        """Return the attempt of a learner from its score."""
        values = score_values(score)
        hashes = {hashlib.blake2b(pose.tobytes(), digest_size=6).hexdigest() for pose in score.frames.recorded_poses}
        sample = frozenset(one for one in hashes if int(one[:2], 16) % SAMPLED_OF == 0)
        return cls(
            task=score.task.name,
            title=score.task.title,
            is_inspection=score.task.kind == "inspect",
            completed=score.result.completed and score.frames.complete,
            num_steps_done=len(score.result.steps_done),
            num_steps=score.result.num_steps,
            values={name: values[name] for name in _VALUES},
            passed=is_mastery_procedure(score),
            reasons=judge_mastery([score]).reasons[0],
            digest=score.frames.pose_digest(),
            poses=sample or frozenset(hashes),
            statements=tuple(xapi_statements(score, learner=learner)),
        )

    def repeats(self, earlier: CourseAttempt) -> bool:
        """Return whether most of the sampled poses occur in an earlier attempt, as in a replayed flight."""
        return len(self.poses) > 1 and len(self.poses & earlier.poses) > REPEATED_SHARE * len(self.poses)

    def to_json(self) -> dict[str, Any]:
        """Return the attempt as plain JSON types."""
        return {
            "task": self.task,
            "title": self.title,
            "is_inspection": self.is_inspection,
            "completed": self.completed,
            "num_steps_done": self.num_steps_done,
            "num_steps": self.num_steps,
            "values": self.values,
            "passed": self.passed,
            "reasons": list(self.reasons),
            "digest": self.digest,
            "poses": sorted(self.poses),
            "statements": list(self.statements),
        }

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> CourseAttempt:
        """Return the attempt of plain JSON types; ValueError, KeyError or TypeError if they are invalid."""
        texts = [value[name] for name in ("task", "title", "digest")]
        flags = [value[name] for name in ("is_inspection", "completed", "passed")]
        counts = [value[name] for name in ("num_steps_done", "num_steps")]
        known = {name: value["values"][name] for name in _VALUES}
        reasons, poses, statements = value["reasons"], value["poses"], value["statements"]
        is_valid = (
            _are(texts, str)
            and _are(flags, bool)
            and _are(counts, int)
            and _are([one for one in known.values() if one is not None], (int, float))
            and all(abs(one) <= MAX_VALUE for one in (*counts, *known.values()) if one is not None)  # also for NaN
            and isinstance(reasons, list) and _are(reasons, str)
            and isinstance(poses, list) and _are(poses, str)
            and isinstance(statements, list) and _are(statements, dict)
        )  # fmt: skip
        if not is_valid:
            raise ValueError("an attempt has an invalid field")
        return cls(
            task=texts[0], title=texts[1], is_inspection=flags[0], completed=flags[1], num_steps_done=counts[0],
            num_steps=counts[1], values=known, passed=flags[2], reasons=tuple(reasons), digest=texts[2],
            poses=frozenset(poses), statements=tuple(statements),
        )  # fmt: skip


def _are(values: Sequence[Any], kinds: type | tuple[type, ...]) -> bool:
    """Return whether all values have one of the given types; a Boolean does not count as a number."""
    wants_bool = kinds is bool
    return all(isinstance(one, kinds) and isinstance(one, bool) == wants_bool for one in values)


@one_line
@dataclass(frozen=True, slots=True)
class Learner:
    """Learner of the course, by a pseudonym."""

    name: str
    attempts: tuple[CourseAttempt, ...] = field(default=(), repr=False)
    """Scored attempts in the order in which they were stored."""
    key: str = field(default="", repr=False)
    """Random number that identifies the learner in recorded flights, 16 hexadecimal digits; empty without a file."""

    @property
    def inspections(self) -> tuple[CourseAttempt, ...]:
        """Attempts at inspections of all segments, for which mastery is defined."""
        return tuple(one for one in self.attempts if one.is_inspection)

    def mastery(self) -> Mastery:
        """Return the mastery over the inspections; an attempt that repeats an earlier one does not count."""
        reasons = []
        for number, one in enumerate(self.inspections):
            why = list(one.reasons)
            same = next((n for n in range(number) if one.repeats(self.inspections[n])), None)
            if same is not None:
                why.append(f"the poses repeat those of attempt {same + 1}: a replay of its recording")
            reasons.append(tuple(why))
        counted = tuple(not why for why in reasons)
        passed = tuple(one.passed and counts for one, counts in zip(self.inspections, counted, strict=True))
        return Mastery(passed, counted, tuple(reasons), OWN_ATTEMPTS)

    def to_json(self) -> dict[str, Any]:
        """Return the learner as plain JSON types, in the format of the files."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "attempts": [one.to_json() for one in self.attempts],
        }

    def attempts_csv(self) -> str:
        """Return the attempts as CSV, one row each; an unknown value is empty."""
        mastery = self.mastery()
        judged = iter(zip(mastery.counted, mastery.reasons, strict=True))
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        head = (
            "attempt",
            "learner",
            "task",
            "completed",
            "steps_done",
            "steps",
            "counts_in_verdict",
            "reasons",
            *_VALUES,
        )
        writer.writerow(head)
        for number, one in enumerate(self.attempts, start=1):
            counts, why = next(judged) if one.is_inspection else (False, one.reasons)
            values = ("" if one.values[name] is None else one.values[name] for name in _VALUES)
            texts = (
                _cell(self.name),
                _cell(one.task),
                one.completed,
                one.num_steps_done,
                one.num_steps,
                counts,
                "; ".join(why),
            )
            writer.writerow((number, *texts, *values))
        return text.getvalue()

    def statements(self) -> list[dict[str, Any]]:
        """Return the xAPI statements of all attempts, in their order."""
        return [statement for one in self.attempts for statement in one.statements]


def _cell(text: str) -> str:
    """Return a cell's text, changed so that no spreadsheet program executes it as a formula."""
    return f"'{text}" if text[:1] in {"=", "+", "-", "@"} else text


class Course:
    """Learners of one machine, one file each in a folder; nothing is sent.

    Several processes may use one folder: a change locks the folder, reads the file again, and replaces it.

    Parameters
    ----------
    folder
        Folder of the files, which is created with the first learner.
    """

    def __init__(self, folder: str | Path) -> None:
        self._folder = Path(folder)
        self._lock = threading.RLock()
        self._known: dict[Path, tuple[tuple[int, int], Learner | None]] = {}
        """Time of the last change, size and learner of each file that was read; no learner if the file is damaged."""

    def __repr__(self) -> str:
        """Return the number of learners."""
        return f"Course({len(self.learners())} learners)"

    @property
    def folder(self) -> Path:
        """Folder of the files."""
        return self._folder

    def learners(self) -> tuple[Learner, ...]:
        """Return the learners in the order of their names, without those of damaged and renamed files."""
        return tuple(sorted((one for _, one in self._read()[0]), key=lambda one: one.name.casefold()))

    def problems(self) -> tuple[str, ...]:
        """Return a message for each file that cannot be used as a learner; such a file is never changed."""
        return self._read()[1]

    def learner(self, name: str) -> Learner:
        """Return a learner by the name or the key.

        Raises
        ------
        UsageError
            ``training.learner``: if there is none.
        """
        return self._file_of(name)[1]

    @check_arguments(name=text_of(200))
    def add(self, name: str) -> Learner:
        """Add a learner.

        Parameters
        ----------
        name
            Pseudonym: 1 to 40 printable characters, different from those of the other learners.

        Raises
        ------
        UsageError
            ``training.learner``: if the pseudonym is invalid or in use.
        DiskError
            If the file cannot be written.
        """
        shown = " ".join(name.split())
        if not 1 <= len(shown) <= MAX_NAME or not shown.isprintable() or KEY.fullmatch(shown.casefold()):
            raise UsageError(
                f"pseudonym: expected 1 to {MAX_NAME} printable characters; found {len(shown)} characters; choose "
                "another pseudonym",
                code="training.learner",
            )
        make_folder(self._folder, what="the course")
        with self._changing():
            known = self.learners()
            if any(one.name.casefold() == shown.casefold() for one in known):
                raise UsageError(f"the pseudonym {shown} is in use; choose another one", code="training.learner")
            if len(known) >= MAX_LEARNERS:
                raise UsageError(f"a course has at most {MAX_LEARNERS} learners", code="training.learner")
            made = Learner(shown, key=secrets.token_hex(8))
            self._write(self._folder / f"{made.key}{SUFFIX}", made)
            return made

    @check_arguments(name=text_of(200), score=instance(Score, "get one from carina.score_recording"))
    def record(self, name: str, score: Score) -> Learner:
        """Store a scored attempt of a learner; an attempt at the same task with the same poses is replaced.

        Parameters
        ----------
        name
            Pseudonym or key of the learner.
        score
            The score.

        Raises
        ------
        UsageError
            ``training.learner``: if there is no such learner.
        DiskError
            If the file cannot be read or written; the stored attempts are unchanged.
        """
        return self._store(name, lambda learner: CourseAttempt.of(score, learner))

    def _store(self, name: str, attempt: Callable[[str], CourseAttempt]) -> Learner:
        """Store the attempt that ``attempt`` returns for the pseudonym of a learner."""
        with self._changing():
            path, _ = self._file_of(name)
            # Two changes within one tick of the disk's clock may leave time and size equal, so the file is read again.
            self._known.pop(path, None)
            learner = self._learner_in(path)
            if learner is None:
                raise DiskError(UNREADABLE, code="disk.failed")
            made = attempt(learner.name)
            same = [n for n, one in enumerate(learner.attempts) if (one.digest, one.task) == (made.digest, made.task)]
            attempts = list(learner.attempts)
            if same:
                attempts[same[0]] = made
            else:
                attempts.append(made)
            changed = Learner(learner.name, tuple(attempts), learner.key)
            self._write(path, changed)
            return changed

    @check_arguments(name=text_of(200))
    def remove(self, name: str) -> None:
        """Delete a learner with all attempts; the recorded flights in cases are not deleted.

        Raises
        ------
        UsageError
            ``training.learner``: if there is no such learner.
        DiskError
            If the file cannot be deleted.
        """
        with self._changing():
            path, _ = self._file_of(name)
            try:
                path.unlink()
            except OSError as error:
                raise disk_trouble(error, "cannot delete the learner in", path) from error

    @check_arguments(name=text_of(200), folder=file_path())
    def export(self, name: str, folder: str | Path) -> tuple[Path, ...]:
        """Write ``attempts.csv`` and ``xapi.json`` of a learner into a folder, and return the paths.

        Raises
        ------
        UsageError
            ``training.learner``: if there is no such learner.
        DiskError
            If a file cannot be written.
        """
        place = Path(folder)
        make_folder(place, what="the export")
        files = learner_files(self.learner(name))
        return tuple(
            write_whole(place / file, text.encode(), what=f"the export {file}") for file, text in files.items()
        )

    @contextlib.contextmanager
    def _changing(self) -> Iterator[None]:
        """Lock the folder against changes by other threads and processes.

        Raises
        ------
        DiskError
            If the folder cannot be locked: another process holds the lock for too long, or the disk cannot be written.
        """
        with self._lock:
            if not self._folder.is_dir():
                # Without a folder there is no learner to change.
                yield
                return
            path = self._folder / LOCK
            try:
                descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
            except OSError as error:
                raise disk_trouble(error, "cannot lock the learners in", path) from error
            try:
                end_s = time.monotonic() + LOCK_WAIT_S
                # None (a file system without locks) needs no wait: each file is replaced atomically there, too.
                while try_lock(descriptor) is False:
                    if time.monotonic() > end_s:
                        raise DiskError(
                            "another program of Carina changes the learners; wait until it has finished, and try again",
                            code="disk.locked",
                        )
                    time.sleep(LOCK_POLL_S)
                yield
            finally:
                os.close(descriptor)

    def _file_of(self, name: str) -> tuple[Path, Learner]:
        found, _ = self._read()
        wanted = " ".join(name.split()).casefold()
        for path, learner in found:
            if wanted in {learner.name.casefold(), learner.key}:
                return path, learner
        if KEY.fullmatch(wanted) and (self._folder / f"{wanted}{SUFFIX}").exists():
            raise DiskError(UNREADABLE, code="disk.failed")
        names = ", ".join(sorted(one.name for _, one in found)) or "none"
        raise UsageError(f"learner: expected one of {names}; found {name!r}", code="training.learner")

    def _read(self) -> tuple[list[tuple[Path, Learner]], tuple[str, ...]]:
        """Return the learners with their files, and a message for each damaged or renamed file.

        A learner in a file with another name has no key, so that no attempt could be stored for this learner.
        """
        found: list[tuple[Path, Learner]] = []
        problems: list[str] = []
        with self._lock:
            try:
                paths = sorted(self._folder.glob(f"*{SUFFIX}"))
            except OSError:
                paths = []
            self._known = {path: value for path, value in self._known.items() if path in paths}
            for path in paths:
                learner = self._learner_in(path)
                name = printable(path.name)
                if learner is None:
                    problems.append(f"the file {name} of a learner cannot be read; it is left unchanged")
                elif not learner.key:
                    problems.append(RENAMED.format(name=name))
                else:
                    found.append((path, learner))
        return found, tuple(problems)

    def _learner_in(self, path: Path) -> Learner | None:
        """Return the learner of a file, which is only read again after a change; None if the file is damaged."""
        try:
            stat = path.stat()
        except OSError:
            return None
        state = (stat.st_mtime_ns, stat.st_size)
        if path not in self._known or self._known[path][0] != state:
            self._known[path] = (state, _learner_in(path))
        return self._known[path][1]

    @staticmethod
    def _write(path: Path, learner: Learner) -> None:
        text = json.dumps(learner.to_json(), allow_nan=False, separators=(",", ":"))
        write_whole(path, text.encode(), what="the attempts of the learner", private=True, lasting=True)


def learner_files(learner: Learner) -> dict[str, str]:
    """Return the texts of the files that `Course.export` writes, by file name."""
    statements = json.dumps(learner.statements(), allow_nan=False, indent=2) + "\n"
    return {"attempts.csv": learner.attempts_csv(), "xapi.json": statements}


def _learner_in(path: Path) -> Learner | None:
    """Return the learner of a file; None if the file is damaged."""
    try:
        document = json.loads(read_regular_text(path, max_bytes=MAX_BYTES))
        if not _is_learner(document):
            return None
        # An infinite number or half of a character, which JSON files can contain, cannot be exported or sent.
        json.dumps(document, allow_nan=False, ensure_ascii=False).encode()
        key = path.name.removesuffix(SUFFIX)
        attempts = tuple(map(CourseAttempt.from_json, document["attempts"]))
        return Learner(document["name"], attempts, key if KEY.fullmatch(key) else "")
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _is_learner(document: Any) -> TypeGuard[dict[str, Any]]:
    return (
        isinstance(document, dict)
        and (document.get("format"), document.get("version")) == (FORMAT, VERSION)
        and isinstance(document.get("name"), str)
        and 1 <= len(document["name"]) <= MAX_NAME
        and document["name"].isprintable()
        and isinstance(document.get("attempts"), list)
    )
