"""What can be asked about an open case: answered at once, and nothing changes."""

from __future__ import annotations

from typing import Any, Generic, TypeVar

from carina.commands.fields import BranchId, FlightNumber, Identifier, PointLps
from carina.commands.tree import AddBranch, Bridge, MoveFork
from carina.commands.value import FrozenValue

A = TypeVar("A")


class Question(FrozenValue, Generic[A], frozen=True):
    """A question whose answer has the type in its brackets."""


class VoxelAt(Question[int | None], frozen=True):
    """The number of the voxel that a point lies in (HU where the volume is in HU); None outside the volume."""

    lps: PointLps


class WallAt(Question[Any], frozen=True):
    """What the scan and the tree say about a point of the wall: a :class:`carina.session.WallPoint`."""

    lps: PointLps


class LivePathTo(Question[Any], frozen=True):
    """The way from the root to a point under the cursor (paper 6.3), from what the tracker has solved already.

    The answer is a :class:`carina.track.LivePath`, with the reason in words in ``problem`` where no way leads there.
    Without airways NoResultError.
    """

    lps: PointLps


class PreviewOf(Question[Any], frozen=True):
    """The very lines that an edit would make, at once and without making it: a :class:`carina.track.EditPreview`.

    With the reason in words in ``problem`` where it cannot be made. Without airways NoResultError.
    """

    edit: AddBranch | Bridge | MoveFork


class PlanningOf(Question[Any], frozen=True):
    """The plans of all targets with a size, as far as they are made: a :class:`carina.session.PlanningInfo`."""


class LungsOf(Question[Any], frozen=True):
    """What was mapped of the lungs, as far as it is made: a :class:`carina.session.LungsInfo`."""


class CtFolder(Question[Any], frozen=True):
    """Where the DICOM files of the CT lie, a path; UsageError (``plan.not-dicom``) says why it is not known."""


class PlanToTakeAway(Question[Any], frozen=True):
    """What the report of a target's plan is made from: a :class:`carina.plan.report.PlanMaterials`."""

    target_id: Identifier


class LumenBeforeWall(Question[tuple[float, float, float]], frozen=True):
    """The point that a click on a wall means: the lumen in front of it (paper 6.3, Figure 14).

    Without airways NoResultError.
    """

    wall_lps: PointLps
    lens_lps: PointLps


class MeasuresOf(Question[Any], frozen=True):
    """What was measured along a branch (:class:`carina.track.BranchMeasures`); None until it is ready.

    Without airways NoResultError; UsageError if the tree has no such branch.
    """

    branch_id: BranchId


class AirwaysToTakeAway(Question[tuple[Any, Any]], frozen=True):
    """The volume and its :class:`carina.track.Airways` as they are now (both immutable), for a file.

    Without airways NoResultError.
    """


class KeyFramesToTakeAway(Question[Any], frozen=True):
    """The key frames with their ways, the view and the case, as a :class:`carina.navigate.KeyFrameFile`.

    Without any NoResultError (``session.keys``).
    """


class FlightToTakeAway(Question[str], frozen=True):
    """A recorded flight as the text of a ``carina-recording`` file, read from the disk.

    UsageError (``session.flights``) if the case has none of this number.
    """

    number: FlightNumber


class FlightsToKeep(Question[Any], frozen=True):
    """The flights that no file has yet, for whoever saves the case: :class:`carina.case.recordings.WholeRecording`."""


class MomentToKeep(Question[Any], frozen=True):
    """All of the case that a file keeps, as it is now: a :class:`carina.case.Moment`."""


class MaskFileNeeded(Question[bool], frozen=True):
    """Whether a mask's file is being read, or will be once its question is answered."""
