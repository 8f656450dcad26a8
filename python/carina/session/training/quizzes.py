"""Commands of quizzes: questions about the names of segments, each at a pose of the tip."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec
import numpy as np

from carina import commands as c
from carina.errors import NoResultError, UsageError
from carina.render import FlatPlace, Sight
from carina.scopes import Pose, WallField
from carina.session.command_registry import CommandHandlers, does
from carina.session.flights.tip_commands import place_pose
from carina.session.open_case.open_case import OpenCase
from carina.session.state.training import QuizInfo
from carina.track import Airways
from carina.training import QuizKind, QuizQuestion, quiz_questions
from carina.training.quiz import turned_choice
from carina.volume.anatomical_planes import PLANES

SLICE_MM_PER_PX = 0.4
"""Scale in mm per pixel of the slices at a question with three slices."""
TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Rotation of the picture by 180 degrees."""


@dataclass(slots=True)
class _Quiz:
    """Questions and answers of a quiz on a case."""

    case: OpenCase
    airways: Airways
    kind: QuizKind
    questions: tuple[QuizQuestion, ...]
    answers: list[str] = field(default_factory=list)
    at: int = 0
    """Index in ``questions`` of the question that the window shows."""
    sight: Sight = field(default_factory=Sight)
    """Display settings (sight) before the quiz, whose crosshair and zoom are restored at its end."""

    @property
    def _is_turned(self) -> bool:
        """Whether the picture is turned by 180 degrees, for an operator who faces the patient."""
        return self.case.document.look.operator == "facing"

    @property
    def pose(self) -> Pose:
        """Pose of the tip of the present question, upright for the operator."""
        upright = self.questions[self.at].pose
        return Pose(upright.lps_from_camera @ TURN) if self._is_turned else upright

    def shown(self, choice: str) -> str:
        """Return a choice as windows show it: clock hours are those of the picture that the operator sees."""
        return turned_choice(choice) if self.kind == "slices" and self._is_turned else choice

    @property
    def choices(self) -> tuple[str, ...]:
        """Choices of the present question as windows show them; clock hours are in ascending order."""
        found = [self.shown(one) for one in self.questions[self.at].choices]
        return tuple(sorted(found, key=lambda text: int(text.split()[0])) if self.kind == "slices" else found)

    @property
    def info(self) -> QuizInfo:
        """Quiz as windows show it, with the right answer only after the trainee has answered."""
        question = self.questions[self.at]
        is_answered = len(self.answers) > self.at
        return QuizInfo(
            kind=self.kind,
            number=self.at + 1,
            num_questions=len(self.questions),
            choices=self.choices,
            lps_from_tip=tuple(float(v) for v in self.pose.lps_from_camera.ravel()),
            num_right=sum(given == one.answer for given, one in zip(self.answers, self.questions, strict=False)),
            given=self.shown(self.answers[self.at]) if is_answered else None,
            answer=self.shown(question.answer) if is_answered else None,
            is_over=len(self.answers) == len(self.questions),
        )


class QuizHandlers(CommandHandlers):
    """The quiz on the open case."""

    _quiz: _Quiz | None = None

    def info_of(self, case: OpenCase) -> QuizInfo | None:
        """Return the running quiz of a case; None without one. The caller holds the session's lock."""
        quiz = self._quiz
        return quiz.info if quiz is not None and quiz.case is case else None

    @does(c.StartQuiz)
    def start(self, command: c.StartQuiz) -> None:
        """Begin a quiz, once the wall of the airways is computed.

        Raises
        ------
        NoResultError
            ``training.no-airways``: without airways.
        """
        case = self.core.needed_case()
        with self.core.lock:
            airways = case.document.airways
            if airways is None:
                raise NoResultError("a quiz needs the airways: wait for the search", code="training.no-airways")
            case.wall.again()
            case.wall.want(airways, then=lambda wall: self._begin(case, airways, wall.field, command))

    def _begin(self, case: OpenCase, airways: Airways, wall: WallField, command: c.StartQuiz) -> None:
        """Make the questions and ask the first one; the caller holds the session's lock."""
        if self.core.case is not case or case.document.airways is not airways:
            return
        questions = quiz_questions(airways.tree, wall, command.kind, num=command.num, seed=command.seed)
        self._end()
        self._quiz = _Quiz(case, airways, command.kind, questions, sight=case.sight)
        self._ask()

    def _ask(self) -> None:
        assert self._quiz is not None
        question = self._quiz.questions[self._quiz.at]
        self.core.fly(place_pose(self._quiz.pose))
        place = question.place_lps
        if place is not None:
            near = {view: FlatPlace(mm_per_px=SLICE_MM_PER_PX) for view in PLANES}
            self.core.see(
                self._quiz.case,
                lambda sight: msgspec.structs.replace(sight, crosshair_lps=place, zoom={**sight.zoom, **near}),
            )
        self.core.changed("training")

    @does(c.AnswerQuiz)
    def answer(self, command: c.AnswerQuiz) -> None:
        """Store the user's answer to the current question of the quiz.

        Raises
        ------
        UsageError
            ``training.quiz``: if no quiz is open, if the question was answered before, or if the name is not one of
            the choices.
        """
        with self.core.lock:
            quiz = self._needed()
            if len(quiz.answers) > quiz.at:
                raise UsageError("this question is answered already; go to the next one", code="training.quiz")
            choices = {quiz.shown(one): one for one in quiz.questions[quiz.at].choices}
            if command.name not in choices:
                raise UsageError(
                    f"quiz: expected one of {', '.join(quiz.choices)}; found {command.name!r}", code="training.quiz"
                )
            quiz.answers.append(choices[command.name])
            self.core.changed("training")

    @does(c.NextQuestion)
    def next_question(self, _command: c.NextQuestion) -> None:
        """Ask the next question.

        Raises
        ------
        UsageError
            ``training.quiz``: without a quiz, before the answer, or after the last question.
        """
        with self.core.lock:
            quiz = self._needed()
            if len(quiz.answers) <= quiz.at:
                raise UsageError("answer this question first", code="training.quiz")
            if quiz.at + 1 == len(quiz.questions):
                raise UsageError("this was the last question", code="training.quiz")
            quiz.at += 1
            self._ask()

    @does(c.RepeatQuestion)
    def repeat(self, _command: c.RepeatQuestion) -> None:
        """Ask the present question again.

        Raises
        ------
        UsageError
            ``training.quiz``: without a quiz.
        """
        with self.core.lock:
            self._needed()
            self._ask()

    @does(c.StopQuiz)
    def stop(self, _command: c.StopQuiz) -> None:
        """End the quiz; do nothing without one."""
        with self.core.lock:
            self._end()
            self.core.changed("training")

    def _end(self) -> None:
        """End the quiz, and restore crosshair and zoom; the caller holds the session's lock."""
        quiz, self._quiz = self._quiz, None
        if quiz is not None and quiz.kind == "slices" and quiz.case is self.core.case:
            before = quiz.sight
            self.core.see(
                quiz.case,
                lambda sight: msgspec.structs.replace(sight, crosshair_lps=before.crosshair_lps, zoom=before.zoom),
            )

    def follow(self, case: OpenCase) -> None:
        """End the quiz after a change of the airways or update its hours; the caller holds the session's lock."""
        quiz = self._quiz
        if quiz is None:
            return
        if quiz.case is not case or case.document.airways is not quiz.airways:
            self._end()
            self.core.changed("training")
        else:
            # Pose and clock hours depend on the operator's position, which may have changed.
            self.core.changed("training")

    def discard(self) -> None:
        """Release the quiz, because its case is being closed; the caller holds the session's lock."""
        self._quiz = None

    def _needed(self) -> _Quiz:
        quiz = self._quiz
        if quiz is None or quiz.case is not self.core.case:
            raise UsageError("no quiz is running; start one", code="training.quiz")
        return quiz
