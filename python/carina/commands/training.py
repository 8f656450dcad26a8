"""Commands of the training: tasks, and the scores of recorded flights."""

from __future__ import annotations

from carina.commands.fields import FlightNumber, OwnName
from carina.commands.value import Command


class StartTask(Command, frozen=True):
    """Begin an attempt at a task: insert the scope into the trachea and record the flight until the task ends.

    The command is a job if the wall of the airways must be computed first.
    """

    task: OwnName
    """Name of a built-in task."""


class StopTask(Command, frozen=True):
    """End the attempt, and score its flight; nothing happens if no task is running."""


class ScoreFlight(Command, frozen=True):
    """Score a recorded flight, by a job."""

    number: FlightNumber
    task: OwnName | None = None
    """Name of a built-in task; null takes the task that the flight states, or else the inspection of all segments."""
