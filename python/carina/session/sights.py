"""How the windows look at an open case: each has a sight of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from carina.render import VIEWS, Sight

__all__ = ["Sights", "following_tip"]


@dataclass(slots=True)
class Sights:
    """The sight of each window; guarded by the session's lock."""

    latest: Sight
    """Of the window that was looked through last: kept with the case, and what a window begins with."""
    _of_windows: dict[int, Sight] = field(default_factory=dict)

    def begin(self, window: int) -> None:
        """A window looks at the case from now on."""
        self._of_windows[window] = self.latest

    def end(self, window: int) -> None:
        """Forget a window; nothing if it never began."""
        self._of_windows.pop(window, None)

    def of(self, window: int | None) -> Sight:
        """A window's; the latest for whoever is none."""
        return self.latest if window is None else self._of_windows.get(window, self.latest)

    def change(self, window: int | None, change: Callable[[Sight], Sight], *, is_kept: bool = True) -> bool:
        """Look otherwise through a window, which is the latest then if that is kept, or through all.

        False if it is as before.
        """
        if window is not None:
            before = self.of(window)
            self._of_windows[window] = change(before)
            if is_kept:
                self.latest = self._of_windows[window]
            return self._of_windows[window] is not before
        before_all = self.latest, self._of_windows
        self.latest = change(self.latest)
        self._of_windows = {number: change(sight) for number, sight in self._of_windows.items()}
        return self.latest is not before_all[0] or any(
            sight is not before_all[1][number] for number, sight in self._of_windows.items()
        )


def following_tip(sight: Sight) -> Sight:
    """The same after the tip has moved: slices that were panned follow it again, and the cut-plane in any case."""
    return sight.centred([view for view in sight.zoom if sight.crosshair_lps is None or VIEWS[view].at_tip])
