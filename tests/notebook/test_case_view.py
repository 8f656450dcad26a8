"""Widget of a notebook: answers to the page's requests, gestures, messages, and the end of the case."""

from __future__ import annotations

import io
import sys
import threading

import numpy as np
import pytest
from PIL import Image

import carina
import fake_anywidget
from cached_test_data import cached_phantom
from carina import commands as c
from carina.errors import UsageError
from carina.notebook import case_view
from carina.session.state.snapshot import Changed
from carina.volume import Note
from carina.volume.model import VolumeSource

VIEWS = ("airway", "axial", "coronal", "sagittal")
SIZES = {name: [120, 90] for name in VIEWS}


@pytest.fixture(autouse=True)
def anywidget(monkeypatch):
    fake_anywidget.install(monkeypatch)


class Page:
    """A view of a case and the messages that its page receives."""

    def __init__(self, view):
        self.view, self.received = view, []
        view.widget.send = lambda content, buffers=None: self.received.append((content, buffers))

    def request(self, *actions, move=(0, 0, 0, 0), **changes):
        """Send a request as the page does, and return the answer and the pictures by view."""
        number = len(self.received) + 1
        content = {"number": number, "sizes": SIZES, "still": True, "move": list(move), "actions": list(actions)}
        self.view._on_message(self.view.widget, content | changes, [])
        answer, buffers = self.received[-1]
        assert (answer["kind"], answer["number"]) == ("pictures", number)
        return answer, {row["view"]: data for row, data in zip(answer["views"], buffers, strict=True)}


def decoded(data):
    return np.asarray(Image.open(io.BytesIO(data)))


@pytest.fixture(scope="module")
def volume():
    return cached_phantom(spacing_mm=3.0, generations=3).volume


@pytest.fixture(scope="module")
def case(volume):
    """Return a case that the tests of this module share; `page` restores its tip and its crosshair."""
    with carina.Case.open(volume) as opened:
        yield opened


@pytest.fixture
def page(case):
    start = tuple(case.pose.lps_from_camera.ravel().tolist())
    view = carina.show(case)
    yield Page(view)
    view.close()
    case.do(c.PlacePose(start))
    case.do(c.SetCrosshair(None))


def test_first_request_is_answered_with_all_views(page):
    answer, pictures = page.request()
    assert list(pictures) == list(VIEWS)
    assert answer["problem"] is None
    assert answer["line"].startswith("Trachea, ")
    for data in pictures.values():
        assert decoded(data).shape == (90, 120, 3)
        assert decoded(data).std() > 5.0
    tip = page.view.case.pose.position_lps
    for row in answer["views"][1:]:
        np.testing.assert_allclose(row["crosshair"], page.view._pictures[row["view"]].pixel_of(tip), atol=0.01)
    assert answer["views"][0]["crosshair"] is None


def test_movement_moves_the_tip_and_all_pictures(page):
    _, before = page.request()
    start = page.view.case.pose
    _, after = page.request(move=(10.0, 0.3, 0.0, 0.0))
    moved = page.view.case.pose
    assert np.linalg.norm(moved.position_lps - start.position_lps) == pytest.approx(10.0, abs=0.01)
    # A positive yaw turns to the right of the picture.
    assert start.lps_from_camera[:3, 0] @ moved.lps_from_camera[:3, 2] > 0.2
    assert before["airway"] != after["airway"]
    assert before["axial"] != after["axial"]


def test_click_in_a_slice_shows_that_point_in_the_others(page):
    page.request()
    expected = page.view._pictures["coronal"].lps_from_pixel @ np.array([80.0, 50.0, 0.0, 1.0])
    answer, _ = page.request({"kind": "point", "view": "coronal", "pixel": [80.0, 50.0]})
    shown = np.array(page.view.case.state.sight.crosshair_lps)
    np.testing.assert_allclose(shown, expected[:3], atol=1e-9)
    for row in answer["views"][1:]:
        np.testing.assert_allclose(row["crosshair"], page.view._pictures[row["view"]].pixel_of(shown), atol=1e-6)
    page.request({"kind": "follow"})
    assert page.view.case.state.sight.crosshair_lps is None


def test_double_click_moves_the_tip_to_the_point(page):
    page.request()
    picture = page.view._pictures["axial"]
    page.request({"kind": "place", "view": "axial", "pixel": [60.0, 40.0]})
    expected = picture.lps_from_pixel @ np.array([60.0, 40.0, 0.0, 1.0])
    np.testing.assert_allclose(page.view.case.pose.position_lps, expected[:3], atol=1e-6)


def test_wheel_moves_a_slice_by_voxels_and_stops_at_the_border(page, volume):
    page.request({"kind": "point", "view": "axial", "pixel": [60.0, 45.0]})
    page.request()
    page.request({"kind": "point", "view": "coronal", "pixel": [60.0, 45.0]})
    before = np.array(page.view.case.state.sight.crosshair_lps)
    page.request({"kind": "slices", "view": "axial", "steps": [2]})
    after = np.array(page.view.case.state.sight.crosshair_lps)
    assert np.linalg.norm(after - before) == pytest.approx(2 * volume.spacing_mm[2], abs=1e-6)
    assert abs(after - before)[2] == pytest.approx(2 * volume.spacing_mm[2], abs=1e-6)
    page.request({"kind": "slices", "view": "axial", "steps": [199]})
    assert np.array_equal(page.view.case.state.sight.crosshair_lps, after)


def test_forks_and_undo_and_their_errors_as_words(page):
    answer, _ = page.request({"kind": "next_fork"})
    assert answer["problem"] is None
    page.view.case.do(c.SetOperator("facing"))
    labels = page.view.case.history()
    page.request({"kind": "undo"})
    assert page.view.case.history() == labels[:-1]
    answer, pictures = page.request({"kind": "unknown"})
    assert "unknown action: 'unknown'" in answer["problem"]
    assert len(pictures) == 4


@pytest.mark.parametrize(
    "changes",
    [
        {"sizes": {"airway": ["wide", 90]}},
        {"sizes": None},
        {"sizes": {"airway": [float("nan"), 90]}},
        {"move": [1.0, 2.0]},
        {"move": "far"},
        {"actions": [{"kind": "point", "view": "axial"}, {"kind": "point", "view": 4, "pixel": [1, 2]}]},
        {"actions": [{"kind": "slices", "view": "airway", "steps": [1]}]},
    ],
)
def test_damaged_requests_change_nothing_and_are_answered(page, changes):
    page.request()
    pose = page.view.case.pose
    answer, _ = page.request(**changes)
    assert answer["problem"] is None
    np.testing.assert_array_equal(page.view.case.pose.lps_from_camera, pose.lps_from_camera)
    assert page.view.case.state.sight.crosshair_lps is None


def test_sizes_are_bounded(page):
    answer, _ = page.request(sizes={"axial": [1e9, 0]})
    (row,) = answer["views"]
    assert (row["width"], row["height"]) == (case_view.PIXELS[1], case_view.PIXELS[0])


def test_internal_error_is_answered_and_logged(page, monkeypatch, caplog):
    monkeypatch.setattr(case_view, "finish_case_picture", lambda *_args, **_named: 1 / 0)
    answer, _ = page.request()
    assert answer["problem"] == "internal error in Carina (ZeroDivisionError)"
    assert "could not show the views" in caplog.text
    monkeypatch.undo()
    assert page.request()[0]["problem"] is None


def test_change_by_another_cell_is_reported_once_answered_changes_are_not(page):
    page.request(move=(5.0, 0.0, 0.0, 0.0))
    assert [content["kind"] for content, _ in page.received] == ["pictures"]
    page.view.case.do(c.SetTexture(on=False))
    assert "changed" in [content["kind"] for content, _ in page.received]


def test_change_by_another_thread_during_an_answer_is_reported_after_it(page, monkeypatch):
    finish = case_view.finish_case_picture

    def change_meanwhile(*args, **named):
        other = threading.Thread(target=page.view._on_event, args=(Changed(frozenset({"views"})),))
        other.start()
        other.join()
        return finish(*args, **named)

    page.request()
    before = len(page.received)
    monkeypatch.setattr(case_view, "finish_case_picture", change_meanwhile)
    content = {"number": "a-1", "sizes": SIZES, "still": True, "move": [0, 0, 0, 0], "actions": []}
    page.view._on_message(page.view.widget, content, [])
    assert [content["kind"] for content, _ in page.received[before:]] == ["pictures", "changed"]


def test_number_of_actions_in_a_request_is_limited(page):
    page.request()
    steps = [{"kind": "slices", "view": "axial", "steps": [0]}] * case_view.MAX_ACTIONS
    answer, _ = page.request(*steps, {"kind": "unknown"})
    assert answer["problem"] is None


def test_badges_of_the_ct_are_shown(volume):
    noted = carina.Volume(
        volume.hu_zyx,
        volume.lps_from_ijk,
        source=VolumeSource(
            format="array", title="volume", notes=(Note("import.tilt-corrected", "tilted", badge=True),)
        ),
    )
    view = carina.show(noted, views=("axial",))
    answer, _ = Page(view).request()
    assert "tilted" in answer["badges"]
    assert all("slices of 3 mm" in words for words in answer["badges"] if words != "tilted")
    view.close()


def test_view_without_its_content_states_the_reason(case):
    view = carina.show(case, views=("airway", "straightened"))
    case.do(c.ChooseRoute())
    answer, pictures = Page(view).request(sizes={"airway": [64, 64], "straightened": [64, 64]})
    case.undo()
    assert "route" in answer["views"][1]["problem"]
    assert pictures["straightened"] == b""
    assert decoded(pictures["airway"]).shape == (64, 64, 3)
    view.close()


def test_close_ends_only_a_case_that_show_opened(case, monkeypatch):
    closed = []

    def close(own):
        closed.append(own)

    monkeypatch.setattr(case_view.Case, "close", close)
    view = carina.show(case, views="axial")
    assert repr(view).startswith("CaseView(axial; Case(")
    view.close()
    view.close()
    assert repr(view) == "CaseView(axial; closed)"
    assert view.widget.is_closed
    assert closed == []
    monkeypatch.setattr(case_view.Case, "open", lambda _source: case)
    view = carina.show("scan")
    view.close()
    view.close()
    assert closed == [case]
    # A late request of the page is ignored.
    view._on_message(view.widget, {"number": 9}, [])


@pytest.mark.parametrize("views", [(), ("airway",) * 2, ("airwy",), tuple("abcdefg")])
def test_invalid_views_are_refused_before_the_case_is_opened(views, monkeypatch):
    monkeypatch.setattr(case_view.Case, "open", lambda *_args: pytest.fail("the case was opened"))
    with pytest.raises(UsageError):
        carina.show("scan", views=views)


def test_missing_package_is_named_with_its_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "anywidget", None)
    with pytest.raises(UsageError, match=r"anywidget>=0\.9") as refused:
        carina.show("scan")
    assert refused.value.code == "notebook.no-anywidget"
