"""Tests of the session: opening in stages, commands with undo, jobs, and unchanged state after a refused command."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from carina.commands import (
    AddTarget,
    Cancel,
    CloseCase,
    GoTo,
    MarkSphere,
    OpenPath,
    OpenRecent,
    Place,
    SetCarm,
    SetCrosshair,
    SetFov,
    SetLumenThreshold,
    SetMethod,
    SetOperator,
    SetOrbit,
    SetOutline,
    SetPlanOptions,
    SetReformation,
    SetRoot,
    SetScope,
    SetShading,
    SetSlab,
    SetTexture,
    SetTransfer,
    SetWindow,
    SetZoom,
    Steer,
    VoxelAt,
    WallAt,
)
from carina.commands.plan import ChosenPlace
from carina.errors import CancelledError, NoResultError, UsageError
from carina.render import GreyWindow
from carina.scopes import PINHOLE, scope_preset
from carina.session import Changed, ErrorEvent, JobEnded, JobProgress, LocalStore, Session, UserMessage
from carina.session.jobs.background_jobs import JobRunner
from carina.session.jobs.job_groups import JobGroup
from small_case import (
    BRANCHES_IJK,
    LEFT_TIP,
    OUTSIDE_LUMEN,
    SmallRenderer,
    session_fixture,
    small_airways,
    small_lps,
    small_parts,
    small_volume,
)


def test_slices_are_available_before_the_airways_are_found():
    fixture = session_fixture()
    fixture.session.do(OpenPath("case"))
    assert fixture.session.scene() is None
    fixture.background.run_next()
    snapshot = fixture.session.snapshot()
    assert snapshot.stage == "opening"
    assert snapshot.airways == "finding"
    scene = fixture.session.scene()
    assert scene is not None
    assert snapshot.case.volume.contains_lps(scene.pose.position_lps)
    # The camera looks towards the feet.
    assert scene.pose.forward_lps @ np.array([0.0, 0.0, -1.0]) > 0.999
    assert scene.key("tree") is None


def test_opened_case_shows_the_start_of_a_route_to_the_deepest_airway_on_the_right():
    fixture = session_fixture()
    fixture.open()
    snapshot = fixture.session.snapshot()
    assert (snapshot.stage, snapshot.airways, snapshot.mode) == ("ready", "found", "path")
    assert snapshot.document.route.branch_id == 3
    assert [s.name for s in snapshot.document.route.spans] == ["Trachea", "RMB", None]
    pose = fixture.session.pose_info()
    assert pose.path_mm == 0.0
    assert pose.inside
    # The tree was not measured, so no diameter is shown; the radius of the found lumen is not a measured diameter.
    assert (pose.branch.name, pose.branch.generation, pose.lumen_mm) == ("Trachea", 0, None)
    np.testing.assert_allclose(
        pose.pose.position_lps, small_lps(BRANCHES_IJK[0][1][0]), atol=0.6
    )  # The tolerance is half of a smoothed voxel.
    assert fixture.renderers[-1].lumen is snapshot.document.airways.lumen_zyx
    # The renderer was prepared for the raw volume and for the wall of the lumen.
    assert fixture.renderers[-1].prepared == 2
    assert snapshot.undo_label is None


def test_airways_found_later_do_not_move_a_tip_that_the_user_moved():
    fixture = session_fixture()
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    fixture.session.do(Place(OUTSIDE_LUMEN))
    fixture.background.run_all()
    np.testing.assert_allclose(fixture.session.pose_info().pose.position_lps, OUTSIDE_LUMEN, atol=1e-9)


def test_unreadable_file_leaves_the_session_unchanged_with_the_message_of_the_import():
    fixture = session_fixture()
    fixture.open("case")
    fixture.session.do(AddTarget(LEFT_TIP))
    fixture.background.run_all()
    before = (fixture.session.snapshot(), fixture.session.pose_info().pose_id)
    fixture.events.clear()
    fixture.open("/scans/bad")
    assert (fixture.session.snapshot(), fixture.session.pose_info().pose_id) == before
    assert fixture.of_type(ErrorEvent) == [
        ErrorEvent("import.no-images", "/scans/bad holds no images: choose a DICOM folder", None)
    ]
    assert [e.outcome for e in fixture.of_type(JobEnded)] == ["failed"]


def test_cancelled_opening_leaves_the_session_unchanged():
    fixture = session_fixture()
    fixture.open("case")
    before = fixture.session.snapshot()
    fixture.events.clear()
    job_id = fixture.session.do(OpenPath("other"))
    fixture.session.do(Cancel(job_id))
    fixture.background.run_all()
    assert fixture.session.snapshot() == before
    assert [(e.job_id, e.outcome) for e in fixture.of_type(JobEnded)] == [(job_id, "cancelled")]
    assert not fixture.of_type(ErrorEvent)


def test_opening_a_second_case_cancels_the_first_opening():
    fixture = session_fixture()
    fixture.session.do(OpenPath("case"))
    fixture.session.do(OpenPath("other"))
    fixture.background.run_all()
    assert fixture.session.snapshot().case.volume.source.title == "Other"
    assert [e.outcome for e in fixture.of_type(JobEnded)][:2] == ["cancelled", "done"]


def test_opening_another_case_stops_the_airway_search_in_the_first():
    fixture = session_fixture()
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    _prepare, search = fixture.background.waiting
    fixture.background.waiting.clear()
    fixture.open("other")
    before = fixture.session.snapshot()
    search()
    assert fixture.session.snapshot() == before


def test_undo_of_a_change_before_the_airways_were_found_does_not_remove_the_airways():
    fixture = session_fixture()
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    fixture.session.do(SetFov(100.0))
    fixture.background.run_all()
    fixture.session.undo()
    document = fixture.session.snapshot().document
    assert document.look.fov_deg == 120.0
    assert document.airways is not None


def test_dragging_the_field_of_view_is_one_undo_step_and_a_later_drag_another():
    fixture = session_fixture()
    fixture.open()
    for fov_deg in (118.0, 116.0, 114.0):
        fixture.session.do(SetFov(fov_deg))
        fixture.clock.advance(0.05)
    fixture.clock.advance(5.0)
    fixture.session.do(SetFov(90.0))
    fixture.session.undo()
    assert fixture.session.snapshot().document.look.fov_deg == 114.0
    fixture.session.undo()
    assert fixture.session.snapshot().document.look.fov_deg == 120.0
    assert fixture.session.snapshot().undo_label is None


def test_view_settings_are_not_undo_steps():
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(SetOutline("octagon"))
    steps = fixture.session.history()
    before = fixture.session.snapshot().sight
    for command in (
        SetWindow(400.0, 40.0),
        SetShading(False),
        SetTexture(False),
        SetMethod("brute"),
        SetSlab(10.0, "min"),
        SetCarm(10.0, 5.0, None, "fluoroscopy"),
        SetReformation(40.0, 0.5),
        SetCrosshair(LEFT_TIP),
        SetZoom(view="axial", mm_per_px=0.5),
        SetOrbit(view="tree", azimuth_deg=10.0, elevation_deg=5.0),
    ):
        fixture.session.do(command)
        after = fixture.session.snapshot().sight
        assert after != before, command
        before = after
    assert fixture.session.history() == steps
    fixture.session.undo()
    assert fixture.session.snapshot().document.look.outline == "round"
    assert fixture.session.snapshot().sight == before
    fixture.session.redo()
    assert fixture.session.snapshot().document.look.outline == "octagon"


def test_setting_the_root_is_undone_without_a_new_airway_search():
    fixture = session_fixture()
    fixture.open()
    first = fixture.session.snapshot().document.airways
    fixture.session.do(SetRoot(small_lps((16.0, 14.0, 35.0))))
    fixture.background.run_all()
    second = fixture.session.snapshot().document.airways
    assert second is not first
    assert fixture.session.snapshot().undo_label == "mark the trachea"
    fixture.session.undo()
    fixture.background.run_all()
    assert fixture.session.snapshot().document.airways is first
    assert fixture.renderers[-1].lumen is first.lumen_zyx


def test_root_at_a_point_without_airways_leaves_the_tree_unchanged_and_states_the_reason():
    fixture = session_fixture()
    fixture.open()
    before = fixture.session.snapshot()
    fixture.session.do(SetRoot(small_lps((16.0, 14.0, 1.0))))
    assert fixture.session.snapshot().airways == "finding"
    fixture.background.run_all()
    assert fixture.session.snapshot() == before
    assert [t.message for t in fixture.of_type(ErrorEvent)] == ["no airway at this point"]


def test_case_without_airways_is_usable_and_has_a_message():
    def find_nothing(volume, **_options):
        raise NoResultError("no trachea was found")

    fixture = session_fixture(find_airways=find_nothing)
    fixture.open()
    snapshot = fixture.session.snapshot()
    assert (snapshot.stage, snapshot.airways) == ("ready", "failed")
    assert snapshot.airways_words == ("no trachea was found. Mark the trachea: click inside it on a slice.")
    assert fixture.renderers[-1].prepared == 1
    fixture.session.do(Steer(1.0, 0.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="no path to fly along"):
        fixture.session.do(GoTo(3.0))


def test_search_from_a_new_root_uses_the_threshold_of_the_failed_search_and_shows_no_error_message():
    calls = []

    def find_nothing(volume, *, root_lps=None, lumen_threshold=None, **_options):
        calls.append((root_lps is not None, lumen_threshold))
        raise NoResultError("no trachea was found")

    fixture = session_fixture(find_airways=find_nothing)
    fixture.open()
    fixture.session.do(SetLumenThreshold(-850.0))
    fixture.background.run_all()
    fixture.session.do(SetRoot(small_lps((16.0, 14.0, 35.0))))
    fixture.background.run_all()
    assert calls == [(False, None), (False, -850.0), (True, -850.0)]
    assert fixture.session.snapshot().airways_words is not None
    assert fixture.of_type(ErrorEvent) == []


def test_stopped_airway_search_is_reported_and_setting_a_root_starts_another():
    fixture = session_fixture()
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    (search,) = [job for job in fixture.session.jobs.running if job.kind == "airways"]
    fixture.session.do(Cancel(search.job_id))
    fixture.background.run_all()
    assert fixture.session.snapshot().airways == "failed"
    fixture.session.do(SetRoot(small_lps((16.0, 14.0, 35.0))))
    fixture.background.run_all()
    assert fixture.session.snapshot().airways == "found"


def test_volume_without_hu_gets_transfer_function_and_threshold_from_its_histogram():
    thresholds = []

    def find_airways(volume, *, lumen_threshold, **_options):
        thresholds.append(lumen_threshold)
        return small_airways(volume)

    fixture = session_fixture(find_airways=find_airways)
    fixture.open("raw")
    snapshot = fixture.session.snapshot()
    assert snapshot.document.transfer.name == "from histogram"
    assert snapshot.transfer_presets == ("from histogram",)
    assert snapshot.sight.window == GreyWindow(190.0, 105.0)
    assert thresholds == [105.0]
    assert all("8-bit" in off.why for off in snapshot.case.off)
    with pytest.raises(UsageError, match="no transfer function 'endoscopic'"):
        fixture.session.do(SetTransfer(preset="endoscopic"))
    with pytest.raises(UsageError, match="in HU"):
        fixture.session.do(SetTransfer(document={"unit": "HU"}))
    fixture.session.do(SetLumenThreshold(90.0))
    fixture.session.do(SetLumenThreshold(None))
    fixture.background.run_all()
    assert thresholds == [105.0, 105.0]  # The next search stopped the search for 90 before it began.


def test_operator_position_is_undone_and_tip_poses_are_not():
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(Steer(4.0, 0.0, 0.0, 0.0))
    up = fixture.session.pose_info().pose.down_lps
    fixture.session.do(SetOperator("facing"))
    np.testing.assert_allclose(fixture.session.pose_info().pose.down_lps, -up, atol=1e-9)
    fixture.session.undo()
    np.testing.assert_allclose(fixture.session.pose_info().pose.down_lps, up, atol=1e-9)
    assert fixture.session.pose_info().path_mm == pytest.approx(4.0)
    fixture.session.undo()
    assert fixture.session.pose_info().path_mm == pytest.approx(4.0)
    assert UserMessage("there is nothing to undo") in fixture.events


def test_every_movement_has_a_new_pose_number():
    fixture = session_fixture()
    fixture.open()
    numbers = [fixture.session.pose_info().pose_id]
    for _ in range(3):
        fixture.session.do(Steer(1.0, 0.0, 0.1, 0.0))
        numbers.append(fixture.session.pose_info().pose_id)
    assert numbers == sorted(set(numbers))


def test_selecting_a_scope_sets_field_of_view_and_picture_outline_and_undo_restores_both():
    fixture = session_fixture()
    fixture.open()

    def seen():
        look = fixture.session.snapshot().document.look
        return look.scope, look.fov_deg, look.outline

    assert seen() == ("generic", 120.0, "round")
    fixture.session.do(SetScope("single-use-slim"))
    assert seen() == ("single-use-slim", 85.0, "octagon")
    fixture.session.do(SetFov(100.0))
    assert seen() == ("single-use-slim", 100.0, "octagon")
    fixture.session.do(SetOutline("none"))
    fixture.session.do(SetScope("ebus"))
    # The user chose a full frame, which a new scope does not change.
    assert seen() == ("ebus", 80.0, "none")
    fixture.session.do(SetScope(None))
    assert seen() == (None, 90.0, "none")
    assert fixture.session.snapshot().undo_label == "no scope"
    for _ in range(5):
        fixture.session.undo()
    assert seen() == ("generic", 120.0, "round")
    with pytest.raises(UsageError, match=r"expected one of the scopes"):
        fixture.session.do(SetScope("BF-1000"))
    with pytest.raises(UsageError, match="round"):
        fixture.session.do(SetOutline("square"))


def test_airway_view_and_plans_of_all_targets_have_the_same_scope():
    fixture = session_fixture()
    fixture.open()

    def scopes():
        document = fixture.session.snapshot().document
        return document.look.scope, *(target.lesion.options.scope for target in document.targets)

    # The generic scope represents no instrument, so the first plan replaces it by the scope that plans use by default.
    fixture.session.do(MarkSphere(small_lps((4.0, 4.0, 4.0)), 6.0))
    assert scopes() == ("thin", "thin")
    assert fixture.session.snapshot().document.look.fov_deg == scope_preset("thin").usual_fov_deg
    fixture.session.undo()
    assert scopes() == ("generic",)
    fixture.session.redo()
    fixture.session.do(SetScope("ultrathin"))
    fixture.session.do(MarkSphere(small_lps((5.0, 5.0, 5.0)), 6.0))
    assert scopes() == ("ultrathin", "ultrathin", "ultrathin")
    target = fixture.session.snapshot().document.targets[1]
    fixture.session.do(SetPlanOptions(target_id=target.target_id, scope="therapeutic", vessel_margin_mm=5.0))
    assert scopes() == ("therapeutic", "therapeutic", "therapeutic")
    margins = [one.lesion.options.vessel_margin_mm for one in fixture.session.snapshot().document.targets]
    assert margins == [3.0, 5.0]
    fixture.session.undo()
    assert scopes() == ("ultrathin", "ultrathin", "ultrathin")
    # A pinhole camera is not an instrument: the plans keep theirs, also that of a further target.
    fixture.session.do(SetScope(None))
    fixture.session.do(MarkSphere(small_lps((6.0, 6.0, 6.0)), 6.0))
    assert scopes() == (None, "ultrathin", "ultrathin", "ultrathin")
    # The field of view that the user chose stays when a target is added.
    fixture.session.do(SetScope("thin"))
    fixture.session.do(SetFov(100.0))
    fixture.session.do(MarkSphere(small_lps((7.0, 7.0, 7.0)), 6.0))
    assert fixture.session.snapshot().document.look.fov_deg == 100.0


def test_parking_position_selected_with_one_scope_is_not_used_with_another_scope():
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(MarkSphere(small_lps((4.0, 4.0, 4.0)), 6.0))
    (target,) = fixture.session.snapshot().document.targets
    place = ChosenPlace(1, 4.0)
    fixture.session.do(SetPlanOptions(target_id=target.target_id, place=place))
    assert fixture.session.snapshot().document.targets[0].lesion.options.place == place
    fixture.session.do(SetScope("ebus"))
    assert fixture.session.snapshot().document.targets[0].lesion.options.place is None


def test_airway_picture_has_the_optics_of_the_scope():
    fixture = session_fixture()
    fixture.open()
    view = fixture.session.scene().spec("airway", 64, 48, 0.5)
    generic = scope_preset("generic")
    assert (view.lens, view.field, view.fov_deg) == (generic.lens, generic.field, 120.0)
    assert view.depth_of_field is None
    fixture.session.do(SetScope("ebus"))
    oblique = fixture.session.scene().spec("airway", 64, 48, 0.5)
    assert float(oblique.pose.forward_lps @ view.pose.forward_lps) == pytest.approx(0.8192, abs=1e-4)
    fixture.session.do(SetScope(None))
    fixture.session.do(SetOutline("none"))
    plain = fixture.session.scene().spec("airway", 64, 48, 0.5)
    assert (plain.lens, plain.field.outline, plain.field.vignette, plain.fov_deg) == (PINHOLE, "none", 0.0, 90.0)


def test_fine_texture_can_be_switched_off_and_on():
    fixture = session_fixture()
    fixture.open()

    def texture():
        return fixture.session.scene().spec("airway", 64, 48, 0.5).texture

    assert texture()
    fixture.session.do(SetTexture(False))
    assert not texture()
    fixture.session.do(SetScope(None))
    assert not texture(), "also without a scope"
    fixture.session.do(SetTexture(True))
    assert texture()


def test_pictures_are_requested_again_only_if_the_content_of_their_view_changes():
    fixture = session_fixture()
    fixture.open()

    def keys():
        scene = fixture.session.scene()
        return {view: scene.key(view) for view in ("airway", "axial", "xray-coronal", "tree", "tri-plane", "cut-plane")}

    def changed(act):
        before = keys()
        act()
        return {view for view, key in keys().items() if key != before[view]}

    assert changed(lambda: fixture.session.do(Steer(3.0, 0, 0, 0))) == {"airway", "axial", "tri-plane", "cut-plane"}
    assert changed(lambda: fixture.session.do(Steer(0.0, 0.2, 0, 0))) == {"airway", "cut-plane"}
    assert changed(lambda: fixture.session.do(SetCrosshair(LEFT_TIP))) == {"axial", "tri-plane"}
    assert changed(lambda: fixture.session.do(Steer(3.0, 0, 0, 0))) == {"airway", "cut-plane"}
    assert changed(lambda: fixture.session.do(SetOrbit(view="tree", azimuth_deg=10.0, elevation_deg=5.0))) == {"tree"}
    assert changed(lambda: fixture.session.do(SetFov(110.0))) == {"airway"}
    assert changed(lambda: fixture.session.do(SetScope("ultrathin"))) == {"airway"}
    assert changed(lambda: fixture.session.do(SetOutline("octagon"))) == {"airway"}
    assert changed(lambda: fixture.session.do(SetTexture(False))) == {"airway"}
    assert changed(lambda: fixture.session.do(SetZoom(view="cut-plane", extent_mm=30.0))) == {"cut-plane"}
    window = changed(lambda: fixture.session.do(SetWindow(400.0, 40.0)))
    assert window == {"axial", "tri-plane", "cut-plane"}


def test_new_transfer_function_is_used_by_pictures_once_the_renderer_is_prepared():
    fixture = session_fixture()
    fixture.open()
    before = fixture.session.scene().key("airway")
    fixture.session.do(SetTransfer(preset="ct-grey"))
    assert fixture.session.scene().key("airway") == before  # The renderer still has the old transfer function.
    fixture.background.run_all()
    assert fixture.renderers[-1].transfer.name == "ct-grey"
    assert fixture.session.scene().key("airway") != before
    fixture.session.undo()
    fixture.background.run_all()
    assert fixture.renderers[-1].transfer.name == "endoscopic"


def test_closing_the_case_returns_to_the_start_page():
    fixture = session_fixture()
    fixture.open()
    fixture.session.do(CloseCase())
    assert fixture.session.snapshot().stage == "empty"
    assert fixture.session.scene() is None
    with pytest.raises(UsageError, match="no case is open"):
        fixture.session.do(Steer(1.0, 0.0, 0.0, 0.0))


def test_recent_ct_list_stores_paths_locally_and_opens_them_by_id(tmp_path):
    store = LocalStore(tmp_path / "config")
    fixture = session_fixture(store=store)
    fixture.open(str(tmp_path / "case"))
    fixture.open(str(tmp_path / "other"))
    fixture.open(str(tmp_path / "bad"))
    fixture.open(str(tmp_path / "case"))
    places = [(Path(c.path).name, c.date) for c in store.recent()]
    assert places == [("case", "2026-01-31"), ("other", "2026-01-31")]
    fixture.session.do(OpenRecent(store.recent()[1].recent_id))
    fixture.background.run_all()
    assert fixture.session.snapshot().case.volume.source.title == "Other"
    with pytest.raises(UsageError, match="no longer in the list"):
        fixture.session.do(OpenRecent("nothing"))


def test_unreadable_recent_ct_list_is_empty(tmp_path):
    store = LocalStore(tmp_path)
    (tmp_path / "recent.json").write_text('{"cases": [1, {"title": "half"}]', encoding="utf-8")
    assert store.recent() == ()
    store.remember("/scans/a", "2026-01-31")
    assert [Path(c.path).name for c in store.recent()] == ["a"]
    assert list(tmp_path.glob(".*")) == []  # No temporary file remains.
    assert not store.notice_accepted()
    store.accept_notice()
    assert LocalStore(tmp_path).notice_accepted()


def test_progress_of_a_job_reports_the_estimated_time_left():
    fixture = session_fixture()
    seen = []

    def find_airways(volume, *, progress, **_options):
        progress("growing", 0.0)
        fixture.clock.advance(1.0)
        progress("growing", 0.04)
        fixture.clock.advance(1.0)
        progress("growing", 0.05)
        fixture.clock.advance(1.0)
        progress("growing", 0.25)
        seen.extend(e for e in fixture.events if isinstance(e, JobProgress) and e.what == "growing")
        return small_airways(volume)

    core = fixture.session._core
    core.parts = replace(core.parts, find_airways=find_airways)
    fixture.open()
    reported = [(e.fraction, e.seconds_left) for e in seen]
    assert reported == [(0.0, None), (0.04, None), (0.05, pytest.approx(38.0)), (0.25, pytest.approx(9.0))]


def test_estimated_time_left_uses_total_progress_and_restarts_where_the_fraction_decreases():
    fixture = session_fixture()
    stages = (("lungs", 0.0), ("vessels", 0.1), ("lobes", 0.5), ("edges", 0.1), ("edges", 0.55))

    def find_airways(volume, *, progress, **_options):
        for what, share in stages:
            progress(what, share)
            fixture.clock.advance(4.0)
        return small_airways(volume)

    core = fixture.session._core
    core.parts = replace(core.parts, find_airways=find_airways)
    fixture.open()
    reported = [e.seconds_left for e in fixture.events if isinstance(e, JobProgress) and e.what in dict(stages)]
    assert reported == [None, pytest.approx(36.0), pytest.approx(8.0), None, pytest.approx(4.0)]


def test_undo_history_stores_a_limited_number_of_airways():
    fixture = session_fixture()
    fixture.open()
    for value in range(-900, -890):
        fixture.session.do(SetLumenThreshold(value))
        fixture.background.run_all()
    seen = {id(fixture.session.snapshot().document.airways)}
    while fixture.session.snapshot().undo_label is not None:
        fixture.session.undo()
        seen.add(id(fixture.session.snapshot().document.airways))
    assert len(seen) == 4


def test_internal_error_in_a_job_is_reported_and_logged_without_its_message(caplog):
    caplog.set_level("INFO")

    def broken(volume, **_options):
        raise KeyError("/scans/doe_john")

    fixture = session_fixture(find_airways=broken)
    fixture.open()
    assert [t.code for t in fixture.of_type(ErrorEvent)] == ["carina.fault"]
    assert "a job failed: segmenting the airways: KeyError at test_session.py:" in caplog.text
    assert "doe" not in caplog.text
    assert fixture.session.snapshot().airways == "failed"


def test_panic_of_the_compiled_module_ends_its_job_with_a_message():
    class Panic(BaseException):
        pass

    def broken(volume, **_options):
        raise Panic("index out of bounds")

    fixture = session_fixture(find_airways=broken)
    fixture.open()
    assert [t.code for t in fixture.of_type(ErrorEvent)] == ["carina.fault"]
    assert fixture.session.jobs.running == ()


def test_settings_that_cannot_be_written_apply_until_the_end_of_the_session(tmp_path):
    # A file at the path of the folder makes writing impossible for every user, also for root.
    (tmp_path / "config").write_text("", encoding="utf-8")
    store = LocalStore(tmp_path / "config")
    store.accept_notice()
    store.remember("/scans/a", "2026-01-31")
    store.remember("/scans/b", "2026-01-31")
    assert store.notice_accepted()
    assert [Path(c.path).name for c in store.recent()] == ["b", "a"]
    assert not LocalStore(tmp_path / "config").notice_accepted()


def test_listeners_receive_changes_until_they_unsubscribe():
    fixture = session_fixture()
    fixture.open()
    heard = []
    stop = fixture.session.subscribe(heard.append)
    fixture.session.do(Steer(1.0, 0.0, 0.0, 0.0))
    assert heard == [Changed(frozenset({"pose", "views"}))]
    stop()
    fixture.session.do(Steer(1.0, 0.0, 0.0, 0.0))
    assert len(heard) == 1


def test_voxel_value_is_returned_only_for_points_inside_the_volume():
    fixture = session_fixture()
    fixture.open()
    assert fixture.session.ask(VoxelAt(LEFT_TIP)) == -980
    assert fixture.session.ask(VoxelAt(OUTSIDE_LUMEN)) == 40
    # The point is on the outer face of the first voxel, where plain rounding selects the voxel before it.
    assert fixture.session.ask(VoxelAt(small_lps((-0.4999, 0.0, 0.0)))) == 40
    assert fixture.session.ask(VoxelAt(small_lps((-0.6, 0.0, 0.0)))) is None


def test_wall_point_has_its_voxel_value_and_the_nearest_branch():
    fixture = session_fixture()
    fixture.session.do(OpenPath("case"))
    fixture.background.run_next()
    lumen = tuple(float(v) for v in small_volume().to_lps((16.0, 14.0, 30.0)))
    before = fixture.session.ask(WallAt(lumen))
    assert (before.lps, before.voxel_value, before.branch) == (lumen, -980, None)
    fixture.background.run_all()
    left = tuple(float(v) for v in small_volume().to_lps((25.0, 16.5, 13.0)))
    found = fixture.session.ask(WallAt(left))
    assert found.voxel_value == 40
    assert (found.branch.id, found.branch.name, found.branch.generation) == (2, "LMB", 1)
    outside = tuple(float(v) for v in small_volume().to_lps((-5.0, 0.0, 0.0)))
    assert fixture.session.ask(WallAt(outside)).voxel_value is None


def test_unused_memory_is_returned_to_the_system_before_the_end_of_a_job_is_announced(monkeypatch):
    order = []
    monkeypatch.setattr("carina.session.jobs.background_jobs.return_freed_memory", lambda: order.append("given back"))

    def fail(_job):
        raise NoResultError("no trachea was found")

    jobs = JobRunner(lambda work: work(), lambda event: order.append(event.outcome), time.monotonic)
    jobs.start("first", "the first", lambda _job: order.append("worked"))
    jobs.start("second", "the second", fail)
    assert order == ["worked", "given back", "done", "given back", "failed"]


def test_job_that_starts_another_job_while_carina_closes_ends_without_an_error():
    reported, begun, closing = [], threading.Event(), threading.Event()
    pool = ThreadPoolExecutor(1)
    jobs = JobRunner(pool.submit, reported.append, time.monotonic)

    def work(job):
        begun.set()
        assert closing.wait(60.0)
        jobs.start("rest", "the rest", lambda _job: None)

    jobs.start("first", "the first", work)
    assert begun.wait(60.0)
    jobs.close()
    closing.set()
    pool.shutdown(wait=True)
    assert [(one.title, one.outcome, one.error) for one in reported] == [("the first", "cancelled", None)]
    with pytest.raises(CancelledError, match="closing"):
        jobs.start("late", "late", lambda _job: None)


def test_jobs_that_wait_for_a_thread_end_when_carina_closes():
    """Check that a thread that waits for a job, such as that of a joined program, does not keep the process alive."""
    session = Session(SmallRenderer, parts=small_parts())
    jobs, job_group = session.jobs, JobGroup()

    def work(job):
        job._cancelled.wait(60.0)
        job.check()

    with job_group.doing():
        for number in range(12):
            jobs.start(f"job {number}", "a long job", work)
    waiter = threading.Thread(target=job_group.wait, daemon=True)
    waiter.start()
    session.close()
    assert jobs.running == ()
    assert jobs.wait_idle(0.0)
    waiter.join(60.0)
    assert not waiter.is_alive()
