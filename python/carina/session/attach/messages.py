"""Messages between a program that joins a case and the process that owns the case, besides commands.

The messages are part of the wire protocol (``protocol/README.md``). They are in this module because a notebook uses
them without a server.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import Identifier, Numbers, PointsLps
from carina.commands.value import snake_case
from carina.session.state.snapshot import SavingInfo
from carina.value import Count, FrozenValue, Words


class JoinMessage(FrozenValue, tag_field="type", tag=snake_case, frozen=True):
    """A message from a program to the owner; the other messages from a program are commands."""


class ToJoinMessage(FrozenValue, tag_field="type", tag=snake_case, frozen=True):
    """A message from the owner to a program."""


class Join(JoinMessage, frozen=True):
    """First message of a program, which then works on this case and on no case that is opened later."""

    wire_version: Annotated[int, Meta(ge=0, le=2**31)]
    case_id: Identifier


class Settle(JoinMessage, frozen=True):
    """Request for ``settled`` once all earlier commands and jobs of this program are complete and on the disk."""

    settle_id: Count
    all_jobs: bool = False
    """Whether to wait also for jobs that other programs and windows of the session have started."""


class Joined(ToJoinMessage, frozen=True):
    """Answer to ``join``: the program has joined the case."""

    carina_version: Words


class Problem(FrozenValue, frozen=True):
    """Error of a command that was not executed."""

    kind: Identifier
    """Name of the error's class in :mod:`carina.errors`."""
    code: Identifier
    message: Words
    doubtful_mm: float | None = None
    """Length without evidence, in mm, of a branch to be added; ``way_lps`` and ``doubtful`` describe its path."""
    way_lps: PointsLps | None = None
    doubtful: Numbers | None = None
    """For each segment of the path: 1 if it has no evidence, else 0."""


class Settled(ToJoinMessage, frozen=True):
    """Answer to ``settle``: the changes since the previous ``settle`` are in the live file of the case."""

    settle_id: Count
    problems: tuple[Problem, ...]
    """Errors of the commands since the last ``settle``, in their order."""
    unsaved: Words | None
    """Reason why the live file lacks the latest changes; null if it has them."""
    saving: SavingInfo
