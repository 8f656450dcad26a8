"""How the machines do that render one picture together: the cluster says it, the server hands it on."""

from __future__ import annotations

from typing import Literal

from carina.value import Count, FrozenValue, Part, Words

__all__ = ["ClusterState", "ClusterStatus", "Machine", "MemberStatus", "Processor"]


class Processor(FrozenValue, frozen=True):
    """What pictures are computed with: how many threads, and their vector instructions."""

    threads: Count
    simd: Words


class Machine(Processor, frozen=True):
    """What a person wants to know about a machine that renders."""

    host: Words


class MemberStatus(Machine, frozen=True):
    """One machine that renders with others."""

    name: Words
    state: Literal["ready", "late", "away", "loading"]
    """``late``: its strips went to others, until it answers. ``loading``: it is being sent the volume."""
    share: Part
    """Of a picture."""
    latency_ms: float | None
    """From the order of a strip to its answer, the median of the last; null before the first."""
    num_late: Count
    num_strips: Count


class ClusterState(FrozenValue, frozen=True):
    """All of them, and what comes of it."""

    address: Words
    members: tuple[MemberStatus, ...]
    alone: bool
    """No other machine can render now: this one does."""
    mixed: bool
    """Pictures may come from graphics devices: equal to the CPU's within one grey level only."""
    fps: float
    """Pictures put together in the last second."""
    frame_ms: float | None
    """From wanted to complete, the median of the last pictures; null before the first."""


class ClusterStatus(ClusterState, frozen=True):
    """The same with what is to be said about it."""

    notices: tuple[Words, ...]
    """What a person should know, oldest first; each is told once."""
