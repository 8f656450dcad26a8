"""The course: learners of this machine, and the storage of their scored attempts."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING

from carina import commands as c
from carina.errors import CarinaError, UsageError
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.state.snapshot import ErrorEvent
from carina.session.state.training import (
    ClassLearner,
    CourseAttemptInfo,
    CourseInfo,
    LearnerInfo,
    PublishedScores,
    RunningTask,
)
from carina.training import Course, Learner, Score, learner_files
from carina.training.course import CourseAttempt
from carina.training.mastery import NOT_AN_INSPECTION, Mastery
from carina.training.running_tasks import RunningTasks

if TYPE_CHECKING:
    from carina.session.core import SessionCore

CLASS_ATTEMPTS = 5
"""Maximum number of attempts of each learner in the teacher's view, the latest ones."""
NO_LEARNER = "the score was not stored: the learner who flew this attempt is not on this machine"
NO_COURSE = "this session stores no learners: start Carina with a folder for its data"


@dataclass(frozen=True, slots=True)
class _Summary:
    """Learner as read from the file, with the values that windows show."""

    learner: Learner
    info: LearnerInfo
    attempts: tuple[CourseAttemptInfo, ...]


class CourseHandlers(CommandHandlers):
    """The learners of this machine.

    Parameters
    ----------
    core
        Core of the session.
    course
        Files of the learners; None for a session without a folder for data.
    """

    def __init__(self, core: SessionCore, course: Course | None) -> None:
        super().__init__(core)
        self._course = course
        self._chosen: str | None = None
        """Key of the chosen learner."""
        self._unstored: list[tuple[str, Score]] = []
        """Scores that could not be stored, each with its learner's key; they are stored with the next score."""
        self._info: CourseInfo | None = None
        self._running = None if course is None else RunningTasks(course.folder)
        self._flown: dict[str, str] = {}
        """Task and progress of each learner who flies now, on any machine that uses the folder, by the key."""
        self._reading = threading.Lock()
        self._read: tuple[tuple[Learner, ...], tuple[str, ...]] | None = None
        """Learners and problems at the latest reading; None before the first."""
        self._summaries: dict[str, _Summary] = {}
        """Summary of each learner by the key, for as long as the learner's file is unchanged; replaced as a whole."""
        self._class_learners: dict[str, ClassLearner] = {}
        """Each learner in the teacher's view by the key, for as long as summary and running task are unchanged."""

    def chosen_key(self) -> str | None:
        """Return the key of the chosen learner; None without one. The caller holds the session's lock."""
        return next((one.key for one in self._learners() if one.key == self._chosen), None)

    def name_of(self, key: str | None) -> str | None:
        """Return the pseudonym of a learner by the key; None if this machine has no such learner."""
        return None if not key else next((one.name for one in self._learners() if one.key == key), None)

    def read_files(self) -> None:
        """Read the learners again; the caller does not hold the session's lock, since a disk may be slow."""
        course = self._course
        if course is None:
            return
        # The lock prevents that an older reading replaces a newer one, in which a learner was added.
        with self._reading:
            found = course.learners(), course.problems()
            flown = {} if self._running is None else self._running.read()
            summaries = _summarised(found[0], self._summaries)
            with self.core.lock:
                self._read, self._summaries, self._flown, self._info = found, summaries, flown, None

    def note_running(self, key: str | None, running: RunningTask | None, title: str = "") -> None:
        """Send the task that a learner flies, or its end, to teachers; a thread writes the file."""
        if key is None or self._running is None:
            return
        if running is None:
            self._running.end(key)
        else:
            text = f"{title}: {len(running.steps_done)} of {running.num_steps} steps, {running.elapsed_s:.0f} s"
            self._running.note(key, f"{text}, paused" if running.paused else text)

    def close(self) -> None:
        """Delete the files of running tasks, because the session ends."""
        if self._running is not None:
            self._running.close()

    def _known(self) -> tuple[tuple[Learner, ...], tuple[str, ...]]:
        """Return learners and problems without reading the disk again."""
        if self._read is None:
            self._read = ((), ()) if self._course is None else (self._course.learners(), self._course.problems())
            self._summaries = _summarised(self._read[0], self._summaries)
        return self._read

    def _learners(self) -> tuple[Learner, ...]:
        return self._known()[0]

    @does(c.AddLearner)
    def add(self, command: c.AddLearner) -> None:
        """Add a learner, and choose this learner.

        Raises
        ------
        UsageError
            ``training.learner``: if the pseudonym is invalid or in use, or if the session stores no learners.
        """
        made = self._needed().add(command.name)
        self._change(made.key)

    @does(c.ChooseLearner)
    def choose(self, command: c.ChooseLearner) -> None:
        """Choose the learner whose attempts are stored from now on; None stores no attempts.

        Raises
        ------
        UsageError
            ``training.learner``: if there is no such learner.
        """
        self._change(None if command.name is None else self._needed().learner(command.name).key)

    @does(c.RemoveLearner)
    def remove(self, command: c.RemoveLearner) -> None:
        """Delete a learner with all attempts.

        Raises
        ------
        UsageError
            ``training.learner``: if there is no such learner.
        """
        course = self._needed()
        learner = course.learner(command.name)
        course.remove(learner.name)
        with self.core.lock:
            self._unstored = [(key, score) for key, score in self._unstored if key != learner.key]
            chosen = None if self._chosen == learner.key else self._chosen
        self._change(chosen)

    @answers(c.LearnerFiles)
    def files(self, question: c.LearnerFiles) -> dict[str, str]:
        """Return the texts of the files of a learner, by file name."""
        return learner_files(self._needed().learner(question.name))

    def record(self, key: str, score: Score) -> None:
        """Store a score of the learner who flew, and the scores that could not be stored before.

        The caller does not hold the session's lock.

        Parameters
        ----------
        key
            Key of the learner.
        score
            The score.
        """
        course = self._course
        if course is None:
            return
        with self.core.lock:
            waiting, self._unstored = [*self._unstored, (key, score)], []
        failed: list[tuple[str, Score]] = []
        troubles: list[tuple[str, CarinaError]] = []
        for one, its_score in waiting:
            try:
                course.record(one, its_score)
            except UsageError:
                # The learner was deleted, or the flight comes from another machine.
                troubles.append((NO_LEARNER, UsageError(NO_LEARNER, code="training.learner")))
            except CarinaError as error:
                failed.append((one, its_score))
                later = "Carina tries again after the next attempt, and the flight stays in the case"
                name = self.name_of(one) or "a learner"
                troubles.append((f"the score of {name} was not stored: {error}; {later}", error))
        self.read_files()
        with self.core.lock:
            self._unstored = [*failed, *self._unstored]
            self._info = None
            for text, trouble in dict(troubles).items():
                self.core.emit(ErrorEvent(trouble.code, text))
            self.core.changed("training")

    @answers(c.ClassroomOf)
    def classroom(self, _question: c.ClassroomOf) -> tuple[ClassLearner, ...]:
        """Return all learners with their latest attempts, for a teacher."""
        with self.core.lock:
            learners = self._learners()
            self._class_learners = {one.key: self._class_learner(one.key) for one in learners}
            return tuple(self._class_learners.values())

    def _class_learner(self, key: str) -> ClassLearner:
        """Return a learner for a teacher, the same object for as long as the learner has not changed."""
        summary, running, known = self._summaries[key], self._flown.get(key), self._class_learners.get(key)
        if known is None or known.learner is not summary.info or known.running != running:
            return ClassLearner(summary.info, summary.attempts[-CLASS_ATTEMPTS:], running)
        return known

    def info(self) -> CourseInfo:
        """Return the learners, and the attempts of the chosen one; the caller holds the session's lock."""
        if self._info is None:
            course, (learners, problems) = self._course, self._known()
            chosen = next((one for one in learners if one.key == self._chosen), None)
            waiting = len(self._unstored)
            self._info = CourseInfo(
                stores=course is not None,
                learners=tuple(self._summaries[one.key].info for one in learners),
                chosen=None if chosen is None else chosen.name,
                attempts=() if chosen is None else self._summaries[chosen.key].attempts,
                problems=(
                    *problems,
                    *(
                        (f"{waiting} scores are not stored yet, because the disk could not be written",)
                        if waiting
                        else ()
                    ),
                ),
            )
        return self._info

    def _change(self, chosen: str | None) -> None:
        self.read_files()
        with self.core.lock:
            self._chosen, self._info = chosen, None
            self.core.changed("training")

    def _needed(self) -> Course:
        if self._course is None:
            raise UsageError(NO_COURSE, code="training.learner")
        return self._course


def _summarised(learners: tuple[Learner, ...], before: dict[str, _Summary]) -> dict[str, _Summary]:
    """Return the summary of each learner by the key; the summary of an unchanged learner is taken from ``before``."""
    found = {}
    for one in learners:
        known = before.get(one.key)
        found[one.key] = known if known is not None and known.learner is one else _summary(one)
    return found


def _summary(learner: Learner) -> _Summary:
    mastery = learner.mastery()
    info = LearnerInfo(
        name=learner.name,
        num_attempts=len(learner.attempts),
        num_counted=mastery.num_counted,
        mastery=mastery.verdict,
        verdict=mastery.words,
    )
    return _Summary(learner, info, _attempts(learner, mastery))


def _attempts(learner: Learner, mastery: Mastery) -> tuple[CourseAttemptInfo, ...]:
    judged = iter(zip(mastery.counted, mastery.reasons, strict=True))
    found = []
    for number, one in enumerate(learner.attempts, start=1):
        counts, reasons = next(judged) if one.is_inspection else (False, _doubts(one))
        values = one.values
        found.append(
            CourseAttemptInfo(
                number=number,
                task=one.task,
                title=one.title,
                is_inspection=one.is_inspection,
                completed=one.completed,
                num_steps_done=one.num_steps_done,
                num_steps=one.num_steps,
                counts=counts,
                reasons=reasons,
                published=PublishedScores(
                    num_seen=int(values["diagnostic_completeness"] or 0),
                    num_progressions=int(values["structured_progress"] or 0),
                    time_s=float(values["procedure_time_s"] or 0.0),
                    time_per_segment_s=values["mean_intersegmental_time_s"],
                    num_revisited=int(values["segments_revisited"] or 0),
                ),
                num_contacts=int(values["num_contacts"] or 0),
                middle_share=min(max(float(values["lumen_in_middle"] or 0.0), 0.0), 1.0),
            )
        )
    return tuple(found)


def _doubts(attempt: CourseAttempt) -> tuple[str, ...]:
    """Return the doubts of an attempt at another task than an inspection, without the rules of mastery."""
    return tuple(takewhile(lambda words: words != NOT_AN_INSPECTION, attempt.reasons))
