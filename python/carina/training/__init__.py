"""Training: tasks, and the published scores of recorded flights."""

from carina.training.segments import LANDMARKS, SEGMENTS, Segment, segments_of_case
from carina.training.task import Task
from carina.training.task_file import find_task, task_from_file, task_names, task_to_json

__all__ = [
    "LANDMARKS",
    "SEGMENTS",
    "Segment",
    "Task",
    "find_task",
    "segments_of_case",
    "task_from_file",
    "task_names",
    "task_to_json",
]
