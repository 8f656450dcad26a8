"""Messages about the training, from the server."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import Words
from carina.server.wire.codec import ServerMessage
from carina.session import CourseInfo, FlightScore, QuizInfo, ReferenceScores, RunningTask, TaskInfo


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
    """Verdict on mastery over the inspections among these flights; null without one."""
    references: Annotated[tuple[ReferenceScores, ...], Meta(max_length=100)]
    course: CourseInfo
    """Learners of this machine, and the attempts of the chosen one."""
