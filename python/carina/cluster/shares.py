"""Shares of a picture's rows that each lane (connection to a renderer) renders: the forgetting function (5.2)."""

from __future__ import annotations

from collections.abc import Hashable, Iterable

from carina.cluster.settings import ClusterSettings


class Shares:
    """Shares p_i of a picture's rows that the lanes render; they sum to one.

    Paper 5.2: ``r_i = m_i^-1 / sum(m^-1)``, ``p_i(t) = p_i(t-1) I + r_i(t) (1 - I)``, ``p_i(0) = 1/n``.
    Departure: m_i is the time *per row*, not of the strip. The heights of strips are proportional to p, so with times
    per strip p would settle at 1/sqrt(cost): of four renderers, one that is three times slower would keep 0.16 instead
    of 0.10.
    Departure: a lane that joins gets the mean share; the share of a lane that leaves is divided among the others in
    proportion.
    """

    def __init__(self, settings: ClusterSettings) -> None:
        self._settings = settings
        self._p: dict[Hashable, float] = {}
        self._settling = settings.settling_epochs

    def join(self, lane: Hashable) -> None:
        """Add a lane of unknown speed with the mean share."""
        if lane in self._p:
            return
        num = len(self._p)
        self._p = {other: p * num / (num + 1) for other, p in self._p.items()}
        self._p[lane] = 1.0 / (num + 1)
        self.use_small_inertia()

    def leave(self, lane: Hashable) -> None:
        """Remove a lane and divide its share among the others."""
        if self._p.pop(lane, None) is None:
            return
        total = sum(self._p.values())
        num = len(self._p)
        self._p = {other: p / total if total > 0.0 else 1.0 / num for other, p in self._p.items()}
        self.use_small_inertia()

    def use_small_inertia(self) -> None:
        """Use the small inertia for the next complete frames, so that shares follow a lasting change of speeds."""
        self._settling = self._settings.settling_epochs

    def update(self, row_seconds: dict[Hashable, float]) -> None:
        """Update the shares after a complete frame.

        Parameters
        ----------
        row_seconds
            Measured time per row in seconds, by lane. Lanes without a measurement keep their share.
        """
        if not self._settings.balances:
            return
        known = {lane: m for lane, m in row_seconds.items() if lane in self._p and m > 0.0}
        if len(known) < 2:
            return
        inertia = self._settings.inertia
        if self._settling > 0:
            self._settling -= 1
            inertia = min(inertia, self._settings.settling_inertia)
        mass = sum(self._p[lane] for lane in known)
        speed = {lane: 1.0 / m for lane, m in known.items()}
        total = sum(speed.values())
        for lane in known:
            self._p[lane] = self._p[lane] * inertia + mass * speed[lane] / total * (1.0 - inertia)

    def of(self, lanes: Iterable[Hashable]) -> dict[Hashable, float]:
        """Return the shares of the given lanes, scaled to a sum of one; an unknown lane gets the mean share."""
        chosen = list(lanes)
        mean = 1.0 / max(1, len(self._p))
        found = {lane: self._p.get(lane, mean) for lane in chosen}
        total = sum(found.values())
        if total <= 0.0:
            return dict.fromkeys(chosen, 1.0 / len(chosen)) if chosen else {}
        return {lane: p / total for lane, p in found.items()}

    @property
    def all(self) -> dict[Hashable, float]:
        """Share of every lane in a picture, by lane; the shares sum to one."""
        return dict(self._p)
