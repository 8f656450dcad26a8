"""Tests of the view settings (sight) of windows: each window has separate ones.

Other callers set those of all windows.
"""

from __future__ import annotations

import pytest

from carina.case import Document
from carina.commands import (
    OpenPath,
    SetCrosshair,
    SetFov,
    SetOrbit,
    SetTexture,
    SetWindow,
    SetZoom,
    ShowPlace,
    Steer,
    Undo,
)
from carina.errors import VolumeImportError
from carina.session import Changed, ErrorEvent, JobEnded, UserMessage
from small_case import LEFT_TIP, RIGHT_TIP, session_fixture


class Windows:
    """Case with two windows, and the events that each window received."""

    def __init__(self, **replaced) -> None:
        self.fixture = session_fixture(**replaced)
        self.session = self.fixture.session
        self.events = {1: [], 2: []}
        self.ends = {n: self.session.subscribe(self.events[n].append, window=n) for n in self.events}

    def sight(self, window=None):
        return self.session.snapshot(window).sight

    def of_type(self, window, kind):
        return [event for event in self.events[window] if isinstance(event, kind)]


@pytest.fixture
def windows():
    made = Windows()
    made.fixture.open()
    for messages in made.events.values():
        messages.clear()
    return made


def test_view_settings_of_one_window_leave_others_unchanged_and_the_latest_are_stored(windows):
    begun = windows.sight()
    windows.session.do(SetCrosshair(LEFT_TIP), window=1)
    windows.session.do(SetOrbit(view="tree", azimuth_deg=20.0, elevation_deg=5.0), window=2)
    assert windows.sight(1).crosshair_lps == LEFT_TIP
    assert windows.sight(1).orbits == begun.orbits
    assert windows.sight(2).crosshair_lps is None
    assert windows.sight() == windows.sight(2)
    assert windows.session.scene(1).shown_lps == LEFT_TIP
    assert windows.session.scene(1).key("tree") != windows.session.scene(2).key("tree")
    assert windows.session.scene(1).key("airway") == windows.session.scene(2).key("airway")


def test_only_the_window_whose_view_settings_change_is_notified(windows):
    windows.session.do(SetTexture(on=False), window=1)
    assert [event.topics for event in windows.of_type(1, Changed)] == [{"state", "views"}]
    assert windows.events[2] == []
    windows.session.do(SetFov(90.0), window=1)
    assert windows.of_type(2, Changed)


def test_caller_without_a_window_changes_the_view_settings_of_all_windows(windows):
    windows.session.do(SetZoom(view="axial", mm_per_px=0.5), window=1)
    windows.session.do(SetZoom(view="coronal", mm_per_px=0.7))
    windows.session.do(SetWindow(400.0, 40.0))
    assert set(windows.sight(1).zoom) == {"axial", "coronal"}
    assert set(windows.sight(2).zoom) == {"coronal"}
    assert windows.sight(1).window == windows.sight(2).window == windows.sight().window
    assert windows.of_type(1, Changed)
    assert windows.of_type(2, Changed)


def test_movement_of_the_tip_recentres_every_window_that_follows_the_tip(windows):
    for window in (1, 2):
        windows.session.do(SetZoom(view="axial", mm_per_px=0.5, centre_lps=LEFT_TIP), window=window)
    windows.session.do(SetCrosshair(RIGHT_TIP), window=2)
    windows.session.do(Steer(1.0, 0.0, 0.0, 0.0), window=1)
    assert windows.sight(1).place("axial").centre_lps is None
    assert windows.sight(2).place("axial").centre_lps == LEFT_TIP


def test_show_place_command_moves_the_common_tip_and_the_crosshair_of_one_window(windows):
    before = windows.session.pose_info().pose_id
    windows.session.do(ShowPlace(LEFT_TIP, None), window=2)
    assert windows.session.pose_info().pose_id > before
    assert (windows.sight(1).crosshair_lps, windows.sight(2).crosshair_lps) == (None, LEFT_TIP)


def test_new_window_starts_with_the_latest_view_settings_and_those_of_a_closed_window_are_deleted(windows):
    windows.session.do(SetTexture(on=False), window=1)
    end = windows.session.subscribe(lambda _event: None, window=3)
    windows.session.do(SetTexture(on=True), window=1)
    assert not windows.sight(3).texture
    end()
    assert windows.sight(3) == windows.sight()
    windows.ends[1]()
    windows.session.do(SetTexture(on=False), window=2)
    assert not windows.sight(1).texture


def test_opening_another_case_resets_the_view_settings_of_all_windows(windows):
    begun = windows.sight()
    windows.session.do(SetTexture(on=False), window=1)
    windows.session.do(OpenPath("another"), window=2)
    windows.fixture.background.run_all()
    # The later sight of one window is not used for the new case.
    windows.session.do(SetWindow(400.0, 40.0), window=1)
    assert windows.sight(2) == begun
    assert windows.sight(1).texture


def test_all_windows_share_one_undo_history(windows):
    windows.session.do(SetFov(90.0), window=1)
    windows.session.do(Undo(), window=2)
    assert isinstance(windows.session.snapshot(1).document, Document)
    assert windows.session.snapshot(1).document is windows.session.snapshot(2).document
    assert windows.session.snapshot().redo_label == "field of view"
    assert windows.of_type(1, UserMessage) == windows.of_type(2, UserMessage) != []
    windows.session.do(Undo(), window=2)
    assert [len(windows.of_type(n, UserMessage)) for n in (1, 2)] == [1, 2], "only the requesting window is notified"


def test_failed_job_is_reported_to_the_window_that_started_it_or_to_all_windows_if_it_is_closed():
    def open_volume(path, progress, cancel):
        raise VolumeImportError("no CT here", code="import.nothing")

    windows = Windows(open_volume=open_volume)
    windows.session.do(OpenPath("case"), window=1)
    windows.fixture.background.run_all()
    assert windows.of_type(2, JobEnded)
    assert [len(windows.of_type(n, ErrorEvent)) for n in (1, 2)] == [1, 0]
    windows.session.do(OpenPath("case"), window=1)
    windows.ends[1]()
    windows.fixture.background.run_all()
    assert len(windows.of_type(2, ErrorEvent)) == 1
