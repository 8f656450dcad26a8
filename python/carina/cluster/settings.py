"""Settings of the division of pictures among machines, with the source of each value."""

from __future__ import annotations

from dataclasses import dataclass

from carina.display import one_line
from carina.errors import UsageError


@one_line
@dataclass(frozen=True, slots=True)
class ClusterSettings:
    """Settings for dividing, issuing and monitoring frames (paper 5; docs/decisions/0109)."""

    in_flight: int = 2
    """Maximum number of unanswered strips of a lane: subtask pre-assignment (paper 5.1). 1 disables the pre-
    assignment."""
    open_frames: int = 2
    """Number of frames that are rendered at the same time (image buffers, paper 5.1). 1 completes each frame before
    the next."""
    balances: bool = True
    """Whether the lanes' shares follow their measured times (paper 5.2).

    If False, all lanes get the same number of rows.
    """
    inertia: float = 0.9
    """Inertia I of the forgetting function: weight of a lane's former share (paper 5.2)."""
    settling_inertia: float = 0.5
    """Inertia (0 to 1) of a lane's share for the first complete frames after the lane has joined.

    A smaller inertia lets the share follow the measured speed faster: with 0.5 it has its true value after 5 frames,
    with 0.9 after 23 frames.
    """
    settling_epochs: int = 10
    """Number of complete frames (epochs) for which ``settling_inertia`` applies."""
    chooses_lanes: bool = True
    """Whether only lanes are used that make pictures faster, by measured times; if False, all lanes are used."""
    min_rows: int = 4
    """Minimum height of a strip in rows, so that the speed of slow lanes is measured too."""
    max_strip_bytes: int = 1_000_000
    """Maximum size of an answer in bytes; larger strips are divided. Answers above 1 MiB take 9 ms instead of 1 ms."""
    late_factor: float = 3.0
    """Multiple of the expected time after which a strip counts as late."""
    late_floor_s: float = 0.05
    """Minimum time in seconds after which a strip can count as late."""
    first_answer_s: float = 2.0
    """Deadline in seconds for the first answer of a lane of unknown speed."""

    def __post_init__(self) -> None:
        """Raise an error if a setting is outside its range."""
        for what, value in (("in_flight", self.in_flight), ("open_frames", self.open_frames)):
            if not 1 <= value <= 64:
                raise UsageError(f"cluster: {what} must be between 1 and 64; found {value}", code="usage.cluster")
        for what, inertia in (("inertia", self.inertia), ("settling_inertia", self.settling_inertia)):
            if not 0.0 <= inertia <= 1.0:
                raise UsageError(f"cluster: {what} must be between 0 and 1; found {inertia}", code="usage.cluster")
        if self.min_rows < 1:
            raise UsageError(
                f"cluster: a strip must have at least one row; found {self.min_rows}", code="usage.cluster"
            )
        if self.late_factor < 1.0 or self.late_floor_s <= 0.0 or self.first_answer_s <= 0.0:
            msg = "cluster: the late factor must be at least 1, and the deadlines must be longer than 0 s"
            raise UsageError(msg, code="usage.cluster")
