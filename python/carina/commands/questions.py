"""Questions about an open case: they are answered at once and change nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Generic, Literal, TypeVar

from msgspec import Meta

from carina.commands.fields import BranchId, FlightNumber, Identifier, PointLps
from carina.commands.tree import AddBranch, Bridge, MoveFork
from carina.commands.value import FrozenValue

A = TypeVar("A")


class Query(FrozenValue, Generic[A], frozen=True):
    """Question whose answer has the type in its brackets."""


class VoxelAt(Query[int | None], frozen=True):
    """Value of the voxel that contains a point (HU if the volume is in HU); None outside the volume."""

    lps: PointLps


class WallAt(Query[Any], frozen=True):
    """Properties of a point of the wall from scan and tree: a :class:`carina.session.WallPoint`."""

    lps: PointLps


class LivePathTo(Query[Any], frozen=True):
    """Path from the root to a point under the cursor (paper 6.3), from the tracker's present solution.

    The answer is a :class:`carina.track.LivePath`; its ``problem`` states the reason if no path leads to the point.
    Without airways the question raises NoResultError.
    """

    lps: PointLps


class MarkAt(Query[Any], frozen=True):
    """Result of ``AddTarget`` with the cost ``lumen`` at a point under the cursor, without adding a target.

    The answer is a :class:`carina.session.targets.routing.Mark`. A newer question of this kind ends the search for an
    earlier one, which then raises CancelledError.
    """

    lps: PointLps


class PreviewOf(Query[Any], frozen=True):
    """Preview of the exact lines that an edit would create: a :class:`carina.track.EditPreview`.

    Its ``problem`` states the reason if the edit is impossible. Without airways the question raises NoResultError.
    With ``with_names``, ``renamed`` lists the other branches that the edit would rename; this takes longer.
    """

    edit: AddBranch | Bridge | MoveFork
    with_names: bool = False


class PlanningOf(Query[Any], frozen=True):
    """Plans of all targets with a size that are complete so far: a :class:`carina.session.PlanningInfo`."""


class LungsOf(Query[Any], frozen=True):
    """Parts of the lungs that are mapped so far: a :class:`carina.session.LungsInfo`."""


class TrainingOf(Query[Any], frozen=True):
    """Tasks, the running attempt, and scores of flights: a :class:`carina.session.TrainingInfo`."""


class ClassroomOf(Query[Any], frozen=True):
    """All learners with their latest attempts: a tuple of :class:`carina.session.ClassLearner`."""


class LearnerFiles(Query[Any], frozen=True):
    """Attempts of a learner as texts of files (CSV, xAPI) by file name.

    UsageError (``training.learner``) without such a learner.
    """

    name: str


class ScoreOf(Query[Any], frozen=True):
    """Score of a flight that was scored since the case was opened: a :class:`carina.training.Score`.

    UsageError (``session.flights``) if the flight has no score.
    """

    number: FlightNumber


class CtFolder(Query[Any], frozen=True):
    """Path of the folder of the CT's DICOM files.

    UsageError (``plan.not-dicom``) states the reason if the folder is unknown.
    """


class SeriesFiles(Query[Path | None], frozen=True):
    """Folder, file or archive with all series that were found beside the open CT; None if it is not known.

    Dropped files are in a temporary folder, which must exist as long as the answer is its path.
    """


class OpeningPreviewOf(Query[Any], frozen=True):
    """Preview of the CT that a job is opening: a :class:`carina.session.OpeningInfo`; None without one."""


class PlanToTakeAway(Query[Any], frozen=True):
    """Data of the report of a target's plan: a :class:`carina.plan.report.PlanMaterials`."""

    target_id: Identifier


class LumenBeforeWall(Query[tuple[float, float, float]], frozen=True):
    """Point of the lumen in front of a wall, for a click on the wall (paper 6.3, Figure 14).

    Without airways the question raises NoResultError.
    """

    wall_lps: PointLps
    lens_lps: PointLps


class MeasuresOf(Query[Any], frozen=True):
    """Measurements along a branch (:class:`carina.track.BranchMeasures`); None until they are ready.

    Without airways the question raises NoResultError; if the tree has no such branch, UsageError.
    """

    branch_id: BranchId


class AirwaysQuery(Query[tuple[Any, Any]], frozen=True):
    """Present volume and :class:`carina.track.Airways` (both immutable), for export to a file.

    Without airways the question raises NoResultError.
    """


class PictureFacts(Query[Any], frozen=True):
    """Present state of the case for a saved picture: a :class:`carina.session.scene.picture_state.PictureState`."""

    window: Annotated[int, Meta(ge=0, le=2**31)] | None = None
    """Window whose views are saved; None for the window that was used last."""


class KeyFrameFileQuery(Query[Any], frozen=True):
    """Key frames with their airway paths, the view and the case, as a :class:`carina.navigate.KeyFrameFile`.

    Without key frames the question raises NoResultError (``session.keys``).
    """


class FlightFileQuery(Query[str], frozen=True):
    """Recorded flight as the text of a ``carina-recording`` file, read from the disk.

    UsageError (``session.flights``) is raised if the case has no flight of this number.
    """

    number: FlightNumber


class FlightToFilm(Query[Any], frozen=True):
    """A flight of the open case for a video: a :class:`carina.session.flights.film_flights.FilmFlight`.

    NoResultError is raised if the case has no such flight.
    """

    flight: Literal["route", "key_frames", "recording"]
    number: FlightNumber | None = None
    """Number of a recording; None for a route and for key frames."""
    speed_mm_s: Annotated[float, Meta(ge=0.1, le=500.0)] = 20.0
    """Speed along a route; key frames and recordings have their own speeds."""
    pause_s: Annotated[float, Meta(ge=0.0, le=60.0)] = 1.0
    """Pause at each fork of a route and at its end."""
    rate_hz: Annotated[float, Meta(ge=1.0, le=240.0)] = 30.0
    """Frames per second of the file."""
    window: Annotated[int, Meta(ge=0, le=2**31)] | None = None
    """Window whose light and decoration the video shows; None for the window that was used last."""


class UnstoredFlights(Query[Any], frozen=True):
    """Flights that are in no file yet, for saving the case: :class:`carina.case.recordings.WholeRecording`."""


class CurrentMoment(Query[Any], frozen=True):
    """Present state of the case that a file stores: a :class:`carina.case.Moment`."""


class MaskFileNeeded(Query[bool], frozen=True):
    """Whether a mask's file is being read, or will be read after the user's answer."""
