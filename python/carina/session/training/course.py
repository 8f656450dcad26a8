"""The course: learners of this machine, and the storage of their scored attempts."""

from __future__ import annotations

from itertools import takewhile
from typing import TYPE_CHECKING

from carina import commands as c
from carina.errors import CarinaError, UsageError
from carina.session.command_registry import CommandHandlers, answers, does
from carina.session.state.snapshot import ErrorEvent
from carina.session.state.training import CourseAttemptInfo, CourseInfo, LearnerInfo, PublishedScores
from carina.training import Course, Learner, Score, learner_files
from carina.training.course import CourseAttempt
from carina.training.mastery import NOT_AN_INSPECTION

if TYPE_CHECKING:
    from carina.session.core import SessionCore

NO_COURSE = "this session stores no learners: start Carina with a folder for its data"


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
        self._unstored: list[tuple[str, Score]] = []
        """Scores that could not be stored, each with its learner; they are stored with the next score."""
        self._info: CourseInfo | None = None
        self._summaries: dict[str, tuple[Learner, LearnerInfo]] = {}
        """Summary of each learner, for as long as the learner's file is unchanged."""

    @property
    def chosen(self) -> str | None:
        """Pseudonym of the chosen learner; None without one. The caller holds the session's lock."""
        return self._chosen

    @does(c.AddLearner)
    def add(self, command: c.AddLearner) -> None:
        """Add a learner, and choose this learner.

        Raises
        ------
        UsageError
            ``training.learner``: if the pseudonym is invalid or in use, or if the session stores no learners.
        """
        made = self._needed().add(command.name)
        self._change(made.name)

    @does(c.ChooseLearner)
    def choose(self, command: c.ChooseLearner) -> None:
        """Choose the learner whose attempts are stored from now on; None stores no attempts.

        Raises
        ------
        UsageError
            ``training.learner``: if there is no such learner.
        """
        self._change(None if command.name is None else self._needed().learner(command.name).name)

    @does(c.RemoveLearner)
    def remove(self, command: c.RemoveLearner) -> None:
        """Delete a learner with all attempts.

        Raises
        ------
        UsageError
            ``training.learner``: if there is no such learner.
        """
        course = self._needed()
        name = course.learner(command.name).name
        course.remove(name)
        with self.core.lock:
            self._unstored = [(learner, score) for learner, score in self._unstored if learner != name]
            chosen = None if self._chosen == name else self._chosen
        self._change(chosen)

    @answers(c.LearnerFiles)
    def files(self, question: c.LearnerFiles) -> dict[str, str]:
        """Return the texts of the files of a learner, by file name."""
        return learner_files(self._needed().learner(question.name))

    def record(self, learner: str, score: Score) -> None:
        """Store a score of a learner, and the scores that could not be stored before; called without the lock."""
        course = self._course
        if course is None:
            return
        with self.core.lock:
            waiting, self._unstored = [*self._unstored, (learner, score)], []
        failed: list[tuple[str, Score]] = []
        trouble: CarinaError | None = None
        for name, one in waiting:
            try:
                course.record(name, one)
            except UsageError as error:
                # The learner was deleted during the attempt.
                trouble = error
            except CarinaError as error:
                failed.append((name, one))
                trouble = error
        with self.core.lock:
            self._unstored = [*failed, *self._unstored]
            self._info = None
            if trouble is not None:
                later = "; it is tried again after the next attempt" if failed else ""
                self.core.emit(ErrorEvent(trouble.code, f"the score of {learner} was not stored: {trouble}{later}"))
            self.core.changed("training")

    def info(self) -> CourseInfo:
        """Return the learners, and the attempts of the chosen one; the caller holds the session's lock."""
        if self._info is None:
            course = self._course
            learners = () if course is None else course.learners()
            chosen = next((one for one in learners if one.name == self._chosen), None)
            waiting = len(self._unstored)
            self._info = CourseInfo(
                stores=course is not None,
                learners=tuple(map(self._summary, learners)),
                chosen=None if chosen is None else chosen.name,
                attempts=() if chosen is None else _attempts(chosen),
                problems=(
                    *(() if course is None else course.problems()),
                    *(
                        (f"{waiting} scores are not stored yet, because the disk could not be written",)
                        if waiting
                        else ()
                    ),
                ),
            )
        return self._info

    def _summary(self, learner: Learner) -> LearnerInfo:
        known = self._summaries.get(learner.name)
        if known is None or known[0] is not learner:
            known = self._summaries[learner.name] = (learner, _summary(learner))
        return known[1]

    def _change(self, chosen: str | None) -> None:
        with self.core.lock:
            self._chosen, self._info = chosen, None
            self.core.changed("training")

    def _needed(self) -> Course:
        if self._course is None:
            raise UsageError(NO_COURSE, code="training.learner")
        return self._course


def _summary(learner: Learner) -> LearnerInfo:
    mastery = learner.mastery()
    return LearnerInfo(
        name=learner.name,
        num_attempts=len(learner.attempts),
        num_counted=mastery.num_counted,
        mastery=mastery.verdict,
        verdict=mastery.words,
    )


def _attempts(learner: Learner) -> tuple[CourseAttemptInfo, ...]:
    mastery = learner.mastery()
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
