"""Commands of the training: tasks, and the scores of recorded flights."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.fields import FlightNumber, OwnName
from carina.commands.value import Command


class StartTask(Command, frozen=True):
    """Begin an attempt at a task: insert the scope into the trachea and record the flight until the task ends.

    The command is a job if the wall of the airways must be computed first.
    """

    task: OwnName
    """Name of a built-in task, or of a task in the folder of tasks."""


class PauseTask(Command, frozen=True):
    """Pause the attempt, or continue it: the clock stops and the tip does not move; nothing without an attempt.

    A paused attempt is scored, but does not count in a verdict.
    """

    paused: bool


class StopTask(Command, frozen=True):
    """End the attempt, and score its flight; nothing happens if no task is running."""


class ScoreFlight(Command, frozen=True):
    """Score a recorded flight, by a job."""

    number: FlightNumber
    task: OwnName | None = None
    """Name of a task; null takes the task that the flight states, or else the inspection of all segments."""


class ReadTrainingFiles(Command, frozen=True):
    """Read the tasks of teachers and the learners again, which other programs may have changed."""


class MarkExpert(Command, frozen=True):
    """Mark a recorded flight as the expert's, with which other flights are compared; null removes the mark."""

    number: FlightNumber | None


class CompareFlight(Command, frozen=True):
    """Compare a scored flight with the expert's, by a job.

    Without a mark, the simulated drive of the instrument's verdict is stored as a flight and marked.
    """

    number: FlightNumber


class AddLearner(Command, frozen=True):
    """Add a learner to the course of this machine by a pseudonym, and choose this learner."""

    name: OwnName


class ChooseLearner(Command, frozen=True):
    """Choose the learner whose scored attempts are stored from now on; null stores no attempts."""

    name: OwnName | None


class RemoveLearner(Command, frozen=True):
    """Delete a learner with all stored attempts; the flights in cases remain."""

    name: OwnName


class StartQuiz(Command, frozen=True):
    """Begin a quiz on the open case: place the tip for the first question.

    The command is a job if the wall of the airways must be computed first.
    """

    kind: Literal["name-opening", "where-are-you", "slices"]
    """Kind of the questions.

    ``name-opening``: name the segment behind the opening in the middle. ``where-are-you``: name the segment of the tip.
    ``slices``: choose the opening that leads to the place where the three slices meet.
    """
    seed: Annotated[int, Meta(ge=0, le=2**31)] = 0
    """Seed of the random choice and order of the questions."""
    num: Annotated[int, Meta(ge=1, le=100)] = 10
    """Largest number of questions of the quiz."""


class AnswerQuiz(Command, frozen=True):
    """Answer the question of the running quiz; a second answer to one question is refused."""

    name: OwnName


class NextQuestion(Command, frozen=True):
    """Place the tip for the next question of the quiz; after the last question the quiz remains with its result."""


class RepeatQuestion(Command, frozen=True):
    """Place the tip again at the pose of the present question of the quiz."""


class StopQuiz(Command, frozen=True):
    """End the quiz; nothing happens if none is running."""
