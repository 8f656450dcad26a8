"""State of the machines of a cluster that render one picture together; the cluster creates it, the server sends it."""

from __future__ import annotations

from typing import Literal

from carina.value import Count, FrozenValue, Part, Words


class Processor(FrozenValue, frozen=True):
    """Processor that renders pictures: number of threads, and vector instructions."""

    threads: Count
    simd: Words


class Machine(Processor, frozen=True):
    """Machine that renders pictures, with the host name that the user sees."""

    host: Words


class MemberStatus(Machine, frozen=True):
    """State of one machine that renders pictures together with others."""

    name: Words
    state: Literal["ready", "late", "away", "loading"]
    """Readiness of the machine to render: ``late`` has not answered in time, ``away`` must load the scene again.

    ``late``: the machine has not answered in time, and others render its strips until it answers. ``loading``: the
    machine is receiving the volume.
    """
    share: Part
    """Share of a picture that the machine renders, 0..1."""
    latency_ms: float | None
    """Median time from the request of a strip of rows to its answer, ms, of the latest strips.

    Null before the first strip.
    """
    num_late: Count
    num_strips: Count


class ClusterState(FrozenValue, frozen=True):
    """State of all machines that render together, with the rate and latency of their pictures."""

    address: Words
    members: tuple[MemberStatus, ...]
    alone: bool
    """Whether this machine renders whole pictures alone, because no other machine can render now."""
    mixed: bool
    """Whether pictures may come from graphics devices, which equal the CPU's within one grey level only."""
    fps: float
    """Number of pictures that the machines completed in the last second."""
    frame_ms: float | None
    """Median time from the request of a picture to its completion, ms, of the latest pictures.

    Null before the first picture.
    """


class ClusterStatus(ClusterState, frozen=True):
    """State of the cluster of rendering machines, with messages for the user."""

    notices: tuple[Words, ...]
    """Messages for the user, oldest first; each is sent once."""
