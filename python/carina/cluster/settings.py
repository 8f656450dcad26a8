"""What decides how pictures are shared out; every number can be changed, and each says where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

from carina.display import one_line
from carina.errors import UsageError

__all__ = ["ClusterSettings"]


@one_line
@dataclass(frozen=True, slots=True)
class ClusterSettings:
    """How frames are cut, issued and watched (paper 5; docs/decisions/0109)."""

    in_flight: int = 2
    """Strips issued to a lane before its first answer is back: subtask pre-assignment (paper 5.1). 1 is without."""
    open_frames: int = 2
    """Frames that are rendered at the same time: image buffers (paper 5.1). 1 waits for each frame."""
    balances: bool = True
    """Whether shares follow the measured times (paper 5.2); without, all lanes get the same number of rows."""
    inertia: float = 0.9
    """I of the forgetting function (paper 5.2)."""
    settling_inertia: float = 0.5
    """I for the first epochs after a lane has joined or come back: 23 frames to a true share by 0.9, 5 by 0.5."""
    settling_epochs: int = 10
    """How many epochs those are."""
    min_rows: int = 4
    """Least height of a strip, so that a slow lane goes on being measured."""
    max_strip_bytes: int = 1_000_000
    """Larger strips are cut again. Answers above 1 MiB leave the quick path of the transport: 9 ms instead of 1."""
    late_factor: float = 3.0
    """A strip that takes this many times what was expected is late."""
    late_floor_s: float = 0.05
    """But none is late sooner than this."""
    first_answer_s: float = 2.0
    """How long a lane may take whose pace is not known yet."""

    def __post_init__(self) -> None:
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
