"""State of the training that windows show: tasks, the running attempt, and the scores of flights."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from carina.commands.fields import BranchId, Count, FlightNumber, OwnName, Wide, Words
from carina.value import FrozenValue, Part


class TaskInfo(FrozenValue, frozen=True):
    """A task of the training."""

    name: OwnName
    title: Words
    level: Literal["beginner", "intermediate", "advanced"]
    time_limit_s: float | None
    """Time in s after which an attempt ends; null for no limit."""
    names_shown: bool
    """Whether the window shows the names of branches during an attempt."""
    tree_shown: bool
    """Whether the window shows the airway tree during an attempt."""
    ghost_shown: bool
    """Whether the window shows the expert's tip during an attempt, if the case has an expert's flight."""
    problem: Words | None
    """Reason why the open case is unsuitable for the task; null if it is suitable."""
    is_own: bool = False
    """Whether the task is a teacher's own, from the folder of tasks."""


class RunningTask(FrozenValue, frozen=True):
    """The attempt at a task that is being flown."""

    task: OwnName
    """Name of the task."""
    flight: FlightNumber
    """Number of the flight that is being recorded."""
    elapsed_s: float
    """Time in s since the attempt began, without pauses."""
    num_steps: Count
    steps_done: tuple[Words, ...] = ()
    next_step: Words | None = None
    """The next step in the order of the task; null without an order, or if names are hidden."""
    arrow_branches: tuple[BranchId, ...] = ()
    """Branches to which the arrow leads: the next step of a task with the hint ``arrow``; empty without an arrow."""
    message: Words | None = None
    """The latest event of the flight, for a few seconds."""
    is_warning: bool = False
    """Whether the message reports a fault, such as a wrong branch or a contact with the wall."""
    paused: bool = False
    """Whether the attempt is paused: the clock is stopped, and the tip does not move."""
    learner: OwnName | None = None
    """Pseudonym of the learner to whom the score is stored, who was chosen at the start; null stores no score."""


class ScoreMoment(FrozenValue, frozen=True):
    """A moment of a scored flight, to be replayed."""

    time_s: float
    """Time of the event in s, from the start of the flight."""
    words: Words


class PublishedScores(FrozenValue, frozen=True):
    """The published scores of an attempt; docs/training.md defines each of them and names its source."""

    num_seen: Count
    """Diagnostic completeness: number of segments seen, of 18."""
    num_progressions: Count
    """Structured progress: number of moves to the next segment in ascending order, of 18."""
    time_s: float
    """Procedure time (PT) in s: from the start of the clock to the end of the attempt."""
    time_per_segment_s: float | None
    """Mean intersegmental time (MIT) in s: procedure time by number of seen segments; null if none was seen."""
    num_revisited: Count
    """Segments revisited (SR): how many times the tip entered a segment that it had entered and left before."""


class UnmarkedMeasures(FrozenValue, frozen=True):
    """Measures of an attempt for which no threshold is published."""

    path_mm: float
    smoothness: float | None
    num_contacts: Count
    contact_s: float
    red_out_s: float
    middle_share: Part
    """Share of the time with the lumen in the middle of the picture."""


class SegmentVisit(FrozenValue, frozen=True):
    """When and how a segment of the case was seen in a flight."""

    name: Words
    branch_ids: tuple[Annotated[int, Meta(ge=0, le=2**31)], ...]
    """Branches that begin at the openings of the segment."""
    seen_s: float | None
    """Time from the start of the flight; null if the segment was not seen."""
    entered: bool
    """Whether the tip entered the segment; otherwise it was seen from outside."""


class TimelineMark(FrozenValue, frozen=True):
    """Event on the timeline of a flight."""

    at_s: float
    """Time in s at which the segment was seen, from the start of the flight."""
    kind: Literal["seen", "contact", "wrong", "revisit"]
    name: Words


class FlightScore(FrozenValue, frozen=True):
    """Scores of a recorded flight."""

    flight: FlightNumber
    task: OwnName
    task_title: Words
    is_inspection: bool
    """Whether the task is the inspection of all segments, for which mastery is defined."""
    completed: bool
    num_steps_done: Count
    num_steps: Count
    num_wrong: Count
    published: PublishedScores
    unmarked: UnmarkedMeasures
    seen: tuple[Words, ...]
    """Segments seen, in the order in which they were seen."""
    not_seen: tuple[Words, ...]
    """Names of the case's segments that were not seen."""
    absent: tuple[Words, ...]
    """Segments of the published list that the case does not have."""
    doubts: tuple[Words, ...]
    """Reasons why the attempt does not count towards mastery; empty if it counts."""
    notes: tuple[Words, ...]
    moments: tuple[ScoreMoment, ...]
    """At most three moments to replay: the longest contacts, wrong branches, and revisits."""
    segments: tuple[SegmentVisit, ...]
    """Segments of the case, for the map of the tree."""
    timeline: tuple[TimelineMark, ...]
    clock_start_s: float
    """Time in s from the start of the flight to the start of the clock for the procedure time."""
    clock_end_s: float
    comparison: tuple[Words, ...]
    """Differences from the expert's flight; empty before the comparison."""
    comparison_moments: tuple[ScoreMoment, ...] = ()
    """At most three high-error events of the comparison, to be replayed: those with the largest deviations."""


class ReferenceScores(FrozenValue, frozen=True):
    """Published scores of one group on a phantom, with another system; not a pass mark."""

    group: Words
    num_seen: float
    num_progressions: float
    time_s: float
    time_per_segment_s: float
    source: Words


class QuizInfo(FrozenValue, frozen=True):
    """A running quiz: its present question, and the answers so far."""

    kind: Literal["name-opening", "where-are-you", "slices"]
    number: Count
    """Number of the present question, from 1."""
    num_questions: Count
    choices: tuple[Words, ...]
    lps_from_tip: Annotated[tuple[Wide, ...], Meta(min_length=16, max_length=16)]
    """Pose of the tip for the question, row by row, mm."""
    num_right: Count
    """Number of right answers so far."""
    given: Words | None = None
    """Answer of the trainee to the present question; null before it."""
    answer: Words | None = None
    """The right answer; null until the trainee has answered."""
    is_over: bool = False
    """Whether all questions are answered."""


class LearnerInfo(FrozenValue, frozen=True):
    """A learner of the course."""

    name: OwnName
    """Pseudonym of the learner."""
    num_attempts: Count
    num_counted: Count
    """Number of the learner's inspections that count towards mastery."""
    mastery: bool | None
    """Whether mastery was reached; null with fewer than six attempts that count."""
    verdict: Words


class CourseAttemptInfo(FrozenValue, frozen=True):
    """A stored attempt of the chosen learner; the measures are those of `PublishedScores` and `UnmarkedMeasures`."""

    number: Count
    """Number of the attempt, from 1, in the order in which they were stored."""
    task: OwnName
    title: Words
    is_inspection: bool
    completed: bool
    num_steps_done: Count
    num_steps: Count
    counts: bool
    """Whether the attempt counts towards mastery."""
    reasons: tuple[Words, ...]
    """Reasons why an inspection does not count."""
    published: PublishedScores
    num_contacts: Count
    middle_share: Part


class CourseInfo(FrozenValue, frozen=True):
    """The learners of this machine, and the attempts of the chosen one."""

    stores: bool = False
    """Whether this session can store learners."""
    learners: tuple[LearnerInfo, ...] = ()
    chosen: OwnName | None = None
    """Pseudonym of the learner whose attempts are stored; null: attempts are not stored."""
    attempts: tuple[CourseAttemptInfo, ...] = ()
    """Attempts of the chosen learner."""
    problems: tuple[Words, ...] = ()
    """Files that cannot be read, and scores that could not be stored yet."""


class ClassLearner(FrozenValue, frozen=True):
    """A learner in the teacher's view."""

    learner: LearnerInfo
    attempts: tuple[CourseAttemptInfo, ...]
    """The latest attempts, the oldest first."""
    running: Words | None = None
    """Task and progress while the learner flies, on any machine that uses the same folder of learners."""


class TrainingInfo(FrozenValue, frozen=True):
    """Tasks, the running attempt or quiz, and scores of flights of the open case."""

    tasks: tuple[TaskInfo, ...] = ()
    task_folder: Words | None = None
    """Folder of the tasks of teachers; null if the session has none."""
    task_problems: tuple[Words, ...] = ()
    """Files of this folder without a usable task, each with the reason."""
    running: RunningTask | None = None
    quiz: QuizInfo | None = None
    scores: tuple[FlightScore, ...] = ()
    """Scores of the flights that were scored since the case was opened, in the order of the flights."""
    verdict: Words | None = None
    """Judgement whether mastery was reached over the inspections among these flights; null without one."""
    references: tuple[ReferenceScores, ...] = ()
    course: CourseInfo = CourseInfo()
