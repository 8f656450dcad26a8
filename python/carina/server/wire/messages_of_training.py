"""Messages about the training, from the server."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import Words
from carina.server.wire.codec import ServerMessage
from carina.session import ClassLearner, CourseInfo, FlightScore, QuizInfo, ReferenceScores, RunningTask, TaskInfo


class TrainingMessage(ServerMessage, frozen=True):
    """Tasks, the running attempt or quiz, and scores of flights.

    Sent after each change, and each second during an attempt.
    """

    tasks: Annotated[tuple[TaskInfo, ...], Meta(max_length=1000)]
    running: RunningTask | None
    quiz: QuizInfo | None
    scores: Annotated[tuple[FlightScore, ...], Meta(max_length=100_000)]
    """Scores of the flights that were scored since the case was opened, in the order of the flights."""
    verdict: Words | None
    """Judgement whether mastery was reached over the inspections among these flights; null without one."""
    references: Annotated[tuple[ReferenceScores, ...], Meta(max_length=100)]
    course: CourseInfo
    """Learners of this machine, and the attempts of the chosen one; without learners for observers."""
    task_folder: Words | None = None
    """Folder of the tasks of teachers; null if the session has none, and for observers."""
    task_problems: Annotated[tuple[Words, ...], Meta(max_length=1000)] = ()
    """Files of this folder without a usable task, each with the reason; empty for observers."""
    classroom: Annotated[tuple[ClassLearner, ...], Meta(max_length=1000)] = ()
    """All learners with their latest attempts: only for observers, and only while the user shares the learners."""
