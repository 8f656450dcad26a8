"""The case: the user's work on a CT as immutable values, its history of steps, and the file that stores it."""

from carina.case.document import ChosenKeyFrame, Document, KeyFrames, Target
from carina.case.error_texts import CaseFileError
from carina.case.file import CaseFile, StepFacts
from carina.case.follow_live_file import CaseFollower
from carina.case.history import History, Step
from carina.case.migration import migrate
from carina.case.reading import StoredAirways, StoredMeasures
from carina.case.recordings import RecordingFacts, RecordingWriter
from carina.case.rescue import rescued
from carina.case.routes import ChosenRoute
from carina.case.source import SourceFacts
from carina.case.stored_state import Moment

__all__ = [
    "CaseFile",
    "CaseFileError",
    "CaseFollower",
    "ChosenKeyFrame",
    "ChosenRoute",
    "Document",
    "History",
    "KeyFrames",
    "Moment",
    "RecordingFacts",
    "RecordingWriter",
    "SourceFacts",
    "Step",
    "StepFacts",
    "StoredAirways",
    "StoredMeasures",
    "Target",
    "migrate",
    "rescued",
]
