"""Training: tasks, the published scores of recorded flights, and nodules that are inserted into a CT."""

from carina.training.attempt_checks import AttemptDoubt
from carina.training.course import Course, CourseAttempt, Learner, learner_files
from carina.training.events import FlightEvent
from carina.training.expert import BranchStay, FlightComparison, HighErrorEvent, compare_flights
from carina.training.flight_frames import FlightFrames, flight_frames
from carina.training.insert_nodule import InsertedNodule, free_nodule_position, insert_nodule
from carina.training.log_files import events_csv, flight_log, poses_csv, scores_csv, write_flight_log, xapi_statements
from carina.training.mastery import REFERENCE_GROUPS, Mastery, ReferenceGroup, judge_mastery
from carina.training.quiz import QuizKind, QuizQuestion, quiz_questions
from carina.training.score import FlightScorer, Score, ScoredContact, score_flight, score_recording, task_of_flight
from carina.training.segments import LANDMARKS, SEGMENTS, CaseSegment, segments_of_case
from carina.training.task import Task
from carina.training.task_file import find_task, task_from_file, task_names, task_to_json
from carina.training.task_folder import FolderTasks, TaskFolder
from carina.training.task_steps import TaskResult

__all__ = [
    "LANDMARKS",
    "REFERENCE_GROUPS",
    "SEGMENTS",
    "AttemptDoubt",
    "BranchStay",
    "CaseSegment",
    "Course",
    "CourseAttempt",
    "FlightComparison",
    "FlightEvent",
    "FlightFrames",
    "FlightScorer",
    "FolderTasks",
    "HighErrorEvent",
    "InsertedNodule",
    "Learner",
    "Mastery",
    "QuizKind",
    "QuizQuestion",
    "ReferenceGroup",
    "Score",
    "ScoredContact",
    "Task",
    "TaskFolder",
    "TaskResult",
    "compare_flights",
    "events_csv",
    "find_task",
    "flight_frames",
    "flight_log",
    "free_nodule_position",
    "insert_nodule",
    "judge_mastery",
    "learner_files",
    "poses_csv",
    "quiz_questions",
    "score_flight",
    "score_recording",
    "scores_csv",
    "segments_of_case",
    "task_from_file",
    "task_names",
    "task_of_flight",
    "task_to_json",
    "write_flight_log",
    "xapi_statements",
]
