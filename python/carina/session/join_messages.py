"""What a program that joins a case and the process that owns it say to each other, beside commands.

They are part of the wire (``protocol/README.md``), and stand here since a notebook speaks it without a server.
"""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from carina.commands.fields import Identifier, Numbers, PointsLps
from carina.commands.value import snake_case
from carina.session.snapshot import SavingInfo
from carina.value import Count, FrozenValue, Words

__all__ = ["Join", "JoinMessage", "Joined", "Problem", "Settle", "Settled", "ToJoinMessage"]


class JoinMessage(FrozenValue, tag_field="type", tag=snake_case, frozen=True):
    """What a program says; commands are the others."""


class ToJoinMessage(FrozenValue, tag_field="type", tag=snake_case, frozen=True):
    """What it is told."""


class Join(JoinMessage, frozen=True):
    """The first message of a program: it works on this case, and on no other that is opened later."""

    wire_version: Annotated[int, Meta(ge=0, le=2**31)]
    case_id: Identifier


class Settle(JoinMessage, frozen=True):
    """Answered by ``settled`` once all that this program sent before is done, its jobs too, and on the disk."""

    settle_id: Count
    all_jobs: bool = False
    """Wait for what others have started, too."""


class Joined(ToJoinMessage, frozen=True):
    """Answer to ``join``."""

    carina_version: Words


class Problem(FrozenValue, frozen=True):
    """Something that was asked for and not done."""

    kind: Identifier
    """Its class in :mod:`carina.errors`."""
    code: Identifier
    message: Words
    doubtful_mm: float | None = None
    """Of a branch that was to be added without evidence, with its way and which of its segments are doubtful."""
    way_lps: PointsLps | None = None
    doubtful: Numbers | None = None
    """1 where it is, else 0."""


class Settled(ToJoinMessage, frozen=True):
    """Answer to ``settle``: what is done since the one before is in the live file of the case."""

    settle_id: Count
    problems: tuple[Problem, ...]
    """What could not be done of it, in its order."""
    unsaved: Words | None
    """Why the live file is behind; null where it is not."""
    saving: SavingInfo
