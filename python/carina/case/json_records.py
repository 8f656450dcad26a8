"""Classes for the JSON in a case file: the numbers and texts that accompany the arrays, with their bounds."""

from __future__ import annotations

import re
from functools import cache
from typing import Annotated, Any, Literal, Union

import msgspec
from msgspec import Meta

from carina.case.bounds import MAX_MESSAGE_CHARS, MAX_MM, MAX_NAME_CHARS, MAX_NUMBER
from carina.case.compression import from_json
from carina.case.routes import NeedleLine
from carina.case.sized_targets import LesionFacts
from carina.commands import Command, KeyFrameFlying, all_commands
from carina.commands.fields import BranchId, Count, Identifier, Matrix4, Part, PointLps
from carina.commands.look import Look
from carina.commands.plan import TargetNote, TargetRank
from carina.commands.tree import AskedPath
from carina.commands.value import LocalCommand
from carina.render import Sight
from carina.track import Uncertainty
from carina.typed_reading import json_decoder
from carina.value import TEXT

MAX_BRANCHES = 100_000
MAX_LIST = 1_000_000
CtValue = Annotated[int, Meta(ge=-(2**31), le=2**31)]
RowId = Annotated[int, Meta(ge=1, le=2**53)]
Number = Annotated[float, Meta(ge=-MAX_NUMBER, le=MAX_NUMBER)]
Mm = Annotated[float, Meta(ge=-MAX_MM, le=MAX_MM)]
Numbers = Annotated[tuple[Mm, ...], Meta(max_length=MAX_LIST)]
Message = Annotated[str, Meta(max_length=MAX_MESSAGE_CHARS, pattern=TEXT)]
Name = Annotated[str, Meta(max_length=MAX_NAME_CHARS, pattern=TEXT)]
ShortWords = Annotated[str, Meta(min_length=1, max_length=MAX_NAME_CHARS, pattern=TEXT)]
EARLIER_NAMES = {"edit_keys": "edit_key_frames", "set_key_flight": "set_key_frame_flight"}
"""Names of commands in files of earlier versions, with the current name of each command."""
_EARLIER = re.compile(rf'^\{{"type":"({"|".join(EARLIER_NAMES)})"')
Ids = Annotated[tuple[RowId, ...], Meta(max_length=MAX_LIST)]


class _Facts(msgspec.Struct, frozen=True):
    """Base class of the JSON objects in a case file; unknown fields, which a newer Carina may add, are ignored."""


class BadgeFacts(_Facts, frozen=True):
    """JSON record of a permanent note about an airway tree."""

    code: ShortWords
    words: Message
    badge: bool


class BranchFacts(_Facts, frozen=True, omit_defaults=True):
    """JSON record of an airway tree's branch in a case file, without its centreline points."""

    id: BranchId
    parent: BranchId | None
    children: Annotated[tuple[BranchId, ...], Meta(max_length=MAX_BRANCHES)]
    generation: Annotated[int, Meta(ge=0, le=MAX_BRANCHES)]
    kind: Literal["tracked", "bridge", "manual"] = "tracked"
    name: Name | None = None
    cost: Number | None = None
    confidence: Part | None = None
    name_confidence: Part | None = None
    name_from: Literal["anatomy", "person"] | None = None
    variant: Name | None = None
    doubtful_mm: Annotated[float, Meta(ge=0.0, le=1e6)] = 0.0


class TreeFacts(_Facts, frozen=True):
    """The branches of a tree, parents first, and notes about doubts that concern the whole tree."""

    branches: Annotated[tuple[BranchFacts, ...], Meta(min_length=1, max_length=MAX_BRANCHES)]
    notes: Annotated[tuple[BadgeFacts, ...], Meta(max_length=1000)] = ()


class AirwaysFacts(_Facts, frozen=True):
    """JSON record of airways in a case file, without lumen, tree and tracker, which other tables store."""

    root_lps: PointLps
    threshold: Number | None
    """Threshold of the lumen; null if the lumen comes from a mask."""
    notes: Annotated[tuple[Message, ...], Meta(max_length=1000)]
    wall_levels: tuple[Number, Number, Number] | None
    next_id: Count | None
    edits: Ids
    uncertain: RowId
    bridges: Ids
    found_by: ShortWords | None = None
    """Version of Carina that found the airways; null for edited airways, because their base stores it."""


class StenosisFacts(_Facts, frozen=True):
    """A stenosis, with the fields of :class:`carina.track.Stenosis`."""

    percent: Number
    percent_error: Number
    area_percent: Number
    at_mm: Mm
    min_mm: Mm
    reference_mm: Mm
    reference_from: Literal["branch", "neighbours"]


class SummaryFacts(_Facts, frozen=True, omit_defaults=True):
    """A summary of a branch's measures, with the fields of :class:`carina.track.BranchSummary`."""

    length_mm: Mm = 0.0
    angle_deg: Number | None = None
    num_sections: Count = 0
    mean_mm: Mm | None = None
    mean_error_mm: Mm | None = None
    min_mm: Mm | None = None
    min_error_mm: Mm | None = None
    min_at_mm: Mm | None = None
    taper: Number | None = None
    wall_mm: Mm | None = None
    wall_error_mm: Mm | None = None
    stenosis: StenosisFacts | None = None


class ForkFacts(_Facts, frozen=True):
    """Measures of the fork at the end of a branch, with the fields of :class:`carina.track.ForkMeasures`."""

    children: Annotated[tuple[BranchId, ...], Meta(max_length=MAX_BRANCHES)]
    fork_lps: PointLps
    carina_lps: PointLps | None
    fork_to_carina_mm: Mm | None
    angle_between_deg: Number | None


class MeasuredFacts(_Facts, frozen=True):
    """JSON record of a branch's measures, without its cross-sections."""

    branch_id: BranchId
    summary: SummaryFacts
    fork: ForkFacts | None
    found_by: ShortWords
    """Version of Carina that measured the cross-sections."""
    method: Count = 1
    """Number of the measuring method, :attr:`carina.track.BranchMeasures.method`; earlier versions did not write it."""


class MeasuresFacts(_Facts, frozen=True):
    """JSON record of the settings and notes that apply to all measures of a tree."""

    blur_mm: tuple[Mm, Mm] | None
    noise: Number
    notes: Annotated[tuple[Message, ...], Meta(max_length=1000)]


class SpanFacts(_Facts, frozen=True):
    """JSON record of the part of a route that is in one branch."""

    branch_id: Annotated[int, Meta(ge=-1, le=2**31)]
    name: Name | None
    generation: Annotated[int, Meta(ge=-1, le=MAX_BRANCHES)]
    from_mm: Mm
    to_mm: Mm
    kind: ShortWords


class RouteFacts(_Facts, frozen=True):
    """JSON record of a route in a case file, without its points, which other tables store."""

    route_id: ShortWords
    title: Name
    forks_mm: Numbers
    lookouts_mm: Numbers
    spans: Annotated[tuple[SpanFacts, ...], Meta(max_length=MAX_BRANCHES)]
    target_id: ShortWords | None
    branch_id: BranchId | None
    drawn: tuple[Mm, Mm, Mm]
    """Lengths in mm: the whole route, the part drawn by hand, the bridged part."""
    up_lps: PointLps | None
    path_forks_mm: Numbers
    path_lookouts_mm: Numbers
    max_deviation_mm: Mm
    lumen_known: bool = True
    needle: NeedleLine | None = None


class TargetFacts(_Facts, AskedPath, frozen=True, forbid_unknown_fields=False):
    """A target; ``route`` is a row number of the table of routes."""

    target_id: ShortWords
    name: Name
    lps: PointLps
    used_lps: PointLps | None
    snapped_mm: Mm | None
    length_mm: Mm | None
    problem: Message | None
    route: RowId | None
    outside_mm: Mm | None = None
    crossings_mm: Numbers | None = None
    value_range: tuple[CtValue, CtValue] | None = None
    lesion: LesionFacts | None = None
    note: TargetNote = ""
    priority: TargetRank = 1


class KeyFrameFacts(_Facts, frozen=True):
    """JSON record of a key frame with its camera pose."""

    key_id: ShortWords
    lps_from_camera: Matrix4
    name: Name | None
    speed_mm_s: Mm | None


class KeyFramesFacts(_Facts, frozen=True):
    """JSON record of the key frames in their order, and the settings of the flight through them."""

    frames: Annotated[tuple[KeyFrameFacts, ...], Meta(max_length=MAX_LIST)]
    flying: KeyFrameFlying


class ScopeFacts(_Facts, frozen=True):
    """JSON record of the position of a bronchoscope: insertion, roll and lever."""

    insertion_mm: Mm
    roll_rad: Number
    flexion_rad: Number


class MomentFacts(_Facts, frozen=True):
    """The case state outside the history: the view, the pose of the tip, and the state of the airway search."""

    sight: Sight
    tip: dict[Identifier, Any]
    scope: ScopeFacts | None
    search_status: ShortWords
    search_words: Message | None
    person_moved: bool
    numbers: Annotated[dict[Identifier, Count], Meta(max_length=1000)]
    saved_by: ShortWords = "unknown"
    """Version of Carina that saved the state."""


class _Decoders:
    """Decoders for all kinds of JSON in a case file, created when the first case is opened."""

    def __init__(self) -> None:
        commands = tuple(cls for cls in all_commands() if not issubclass(cls, LocalCommand) and cls is not Command)
        self.tree = json_decoder(TreeFacts)
        self.airways = json_decoder(AirwaysFacts)
        self.measured = json_decoder(MeasuredFacts)
        self.measures = json_decoder(MeasuresFacts)
        self.route = json_decoder(RouteFacts)
        self.targets = json_decoder(Annotated[tuple[TargetFacts, ...], Meta(max_length=MAX_LIST)])
        self.keys = json_decoder(KeyFramesFacts)
        self.look = json_decoder(Look)
        self.transfer = json_decoder(Annotated[dict[str, Any], Meta(max_length=100)])
        self.edit = json_decoder(Annotated[dict[Identifier, Any], Meta(max_length=20)])
        self.uncertain = json_decoder(Annotated[tuple[Uncertainty, ...], Meta(max_length=MAX_LIST)])
        self.moment = json_decoder(MomentFacts)
        self.command = json_decoder(Union[commands])  # noqa: UP007  # of a tuple
        self.choices = json_decoder(Annotated[dict[Identifier, Any], Meta(max_length=100)])
        self.extra = json_decoder(Any)
        self.levels = json_decoder(tuple[Number, Number, Number] | None)


@cache
def decoders() -> _Decoders:
    """Return the shared decoders of all JSON objects in a case file; they are created at the first call."""
    return _Decoders()


def command_from_json(text: str | None, where: str) -> Any:
    """Return the command of a step, also under its name in an earlier version; None if the step has none.

    Parameters
    ----------
    text
        JSON of the command from the file; None for a step without a command.
    where
        Name of the step for messages.

    Raises
    ------
    CaseFileError
        ``case.damaged``: if the JSON is not a command.
    """
    if text is None:
        return None
    now = _EARLIER.sub(lambda found: f'{{"type":"{EARLIER_NAMES[found[1]]}"', text) if isinstance(text, str) else text
    return from_json(now, decoders().command, where)
