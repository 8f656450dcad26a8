"""Display settings (sights) of the windows that show an open case, one for each window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from carina.render import VIEWS, Sight


@dataclass(slots=True)
class Sights:
    """The display settings (`Sight`) of each window; guarded by the session's lock."""

    latest: Sight
    """Sight of the window that was used last; it is stored with the case, and new windows start with it."""
    _of_windows: dict[int, Sight] = field(default_factory=dict)

    def begin(self, window: int) -> None:
        """Add a window; its display settings start as those of the window that was used last."""
        self._of_windows[window] = self.latest

    def end(self, window: int) -> None:
        """Remove a window; do nothing if it is unknown."""
        self._of_windows.pop(window, None)

    def of(self, window: int | None) -> Sight:
        """Return the sight of a window; the latest sight for None or for an unknown window."""
        return self.latest if window is None else self._of_windows.get(window, self.latest)

    def change(self, window: int | None, change: Callable[[Sight], Sight], *, is_latest: bool = True) -> bool:
        """Change the display settings (sight) of one window, or of all windows if ``window`` is None.

        Parameters
        ----------
        window
            Number of the window.
        change
            Returns the new sight; it returns the same object if nothing changes.
        is_latest
            Whether the new sight of a window also becomes the latest sight.

        Returns
        -------
        bool
            Whether a sight has changed.
        """
        if window is not None:
            before = self.of(window)
            self._of_windows[window] = change(before)
            if is_latest:
                self.latest = self._of_windows[window]
            return self._of_windows[window] is not before
        before_all = self.latest, self._of_windows
        self.latest = change(self.latest)
        self._of_windows = {number: change(sight) for number, sight in self._of_windows.items()}
        return self.latest is not before_all[0] or any(
            sight is not before_all[1][number] for number, sight in self._of_windows.items()
        )


def following_tip(sight: Sight) -> Sight:
    """Return the sight after a move of the tip: panned slices follow the tip again, and the cut-plane always does."""
    return sight.centred([view for view in sight.zoom if sight.crosshair_lps is None or VIEWS[view].at_tip])
