"""Tests of pictures assembled from strips: equal bit for bit to those of a single machine, even if renderers fail."""

from __future__ import annotations

import pickle
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from carina.cluster import ClusterRenderer, ClusterSettings, render_frames
from carina.cluster import console as console_module
from carina.cluster.renderer_host import RendererHost
from carina.cluster.scene_data import Parcels, open_parcel
from carina.cluster.strips import cut_rows
from carina.errors import CancelledError, CarinaError, ClusterError, RenderError
from carina.render import (
    AirwayView,
    CancelToken,
    CutPlaneView,
    DrrView,
    PathView,
    SliceView,
    TreeView,
    TriPlaneView,
    XrayView,
    build_info,
    can_cut,
    transfer_preset,
)
from carina.scopes import DepthOfField, Lens, PathFrames, scope_preset

SIZE = {"width": 72, "height": 61}
SIMD = ("portable", "avx2", "avx512", "neon")


def _views(case) -> dict:
    centre = tuple(case.volume.centre_lps)
    along = np.stack([case.volume.to_lps((17 + 3 * np.sin(k / 9), 16.0, k)) for k in np.linspace(35, 4, 24)])
    steps = np.linalg.norm(np.diff(along, axis=0), axis=1)
    path = _frames(along, np.concatenate([[0.0], np.cumsum(steps)]))
    return {
        "airway": AirwayView(case.pose, **SIZE),
        "airway by brute force": AirwayView(case.pose, method="brute", **SIZE),
        "airway unshaded": AirwayView(case.pose, shading=False, **SIZE),
        "airway through a scope": AirwayView.of_scope(scope_preset("generic"), case.pose, **SIZE),
        "airway, equidistant": AirwayView(case.pose, fov_deg=140.0, lens=Lens.equidistant(), **SIZE),
        "cut-plane": CutPlaneView(case.pose, **SIZE),
        "tri-plane": TriPlaneView(centre, **SIZE),
        "xray": XrayView("coronal", **SIZE),
        "drr": DrrView(window_mm=(60.0, 40.0), **SIZE),
        "axial": SliceView("axial", centre, **SIZE),
        "tree": TreeView(**SIZE),
        "straightened": PathView("straightened", path, **SIZE),
        "curved": PathView("curved", path, **SIZE),
    }


def _frames(points: np.ndarray, path_mm: np.ndarray) -> PathFrames:
    forward = np.gradient(points, path_mm, axis=0)
    forward /= np.linalg.norm(forward, axis=1)[:, None]
    right = np.cross(np.cross(forward, [1.0, 0.0, 0.0]), forward)
    right /= np.linalg.norm(right, axis=1)[:, None]
    frames = np.tile(np.eye(4), (len(points), 1, 1))
    frames[:, :3, 0], frames[:, :3, 1], frames[:, :3, 2] = right, np.cross(forward, right), forward
    frames[:, :3, 3] = points
    return PathFrames(path_mm, frames)


VIEW_NAMES = (
    "airway",
    "airway by brute force",
    "airway unshaded",
    "airway through a scope",
    "airway, equidistant",
    "cut-plane",
    "tri-plane",
    "xray",
    "drr",
    "axial",
    "tree",
    "straightened",
    "curved",
)


@pytest.fixture(scope="module")
def machines(case):
    """Return a renderer for each instruction set of this machine, and one without IsoRegion maps."""
    found = {}
    for simd in SIMD:
        renderer = case.renderer(simd)
        try:
            renderer.render(AirwayView(case.pose, width=8, height=8))
        except RenderError:
            continue
        found[simd] = renderer
    assert {"portable", build_info()["simd"]} <= set(found), "an instruction set of this machine was not compared"
    found["no maps"] = case.renderer(prepared=False)
    return found


@pytest.fixture(scope="module")
def truth(case):
    """Return the picture of each view that one renderer outside the cluster makes."""
    renderer = case.renderer()
    return {name: renderer.render(view).rgb for name, view in _views(case).items()}


@pytest.mark.parametrize("name", VIEW_NAMES)
@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    shares=st.lists(st.floats(0.0, 9.0), min_size=1, max_size=9),
    min_rows=st.integers(1, 20),
    max_rows=st.one_of(st.none(), st.integers(1, 30)),
    seed=st.integers(0, 99),
)
def test_strips_of_any_layout_and_instruction_set_join_to_the_picture_of_one_machine(  # noqa: PLR0917 - Hypothesis's own
    case, machines, truth, name, shares, min_rows, max_rows, seed
):
    view = _views(case)[name]
    names = list(machines)
    strips = cut_rows(view.height, dict(enumerate(shares)), min_rows=min_rows, max_rows=max_rows)
    parts = [
        machines[names[(lane * 7 + first + seed) % len(names)]].render(view, rows=(first, end)).rgb
        for lane, first, end in strips
    ]
    assert np.array_equal(np.concatenate(parts), truth[name])


def test_view_whose_pixels_depend_on_the_complete_picture_is_not_divided_into_strips(case):
    renderer = case.renderer()
    for view in (DrrView(**SIZE), AirwayView(case.pose, depth_of_field=DepthOfField(2.0, 20.0), **SIZE)):
        assert not can_cut(view)
        with pytest.raises(RenderError, match="whole image"):
            renderer.render(view, rows=(0, 9))


def test_strip_rows_outside_the_picture_are_refused(case):
    renderer = case.renderer()
    for rows in ((-1, 5), (5, 5), (0, 62)):
        with pytest.raises(CarinaError, match="rows"):
            renderer.render(CutPlaneView(case.pose, **SIZE), rows=rows)


@pytest.mark.parametrize("name", VIEW_NAMES)
def test_cluster_returns_the_picture_with_all_its_metadata(case, cluster, name):
    made = cluster()
    view = _views(case)[name]
    _wait_ready(made)
    found, expected = made.renderer.render(view), made.truth.render(view)
    assert np.array_equal(found.rgb, expected.rgb)
    assert found.view == expected.view and found.fov_deg == expected.fov_deg
    for what in ("lps_from_camera", "lps_from_pixel"):
        a, b = getattr(found, what), getattr(expected, what)
        assert (a is None) == (b is None) and (a is None or np.array_equal(a, b))
    assert (found.lines is None) == (expected.lines is None)
    assert (found.optics is None) == (expected.optics is None)
    assert found.stats.num_rays == expected.stats.num_rays
    assert found.stats.num_samples == expected.stats.num_samples
    assert sum(lane.trouble.num_orders > 0 for lane in made.lanes) >= 2 or not made.renderer.renders_remotely(view)


def _wait_ready(made, num: int | None = None) -> None:
    """Wait until the lanes are ready with the current content."""
    made.renderer.prepare()
    num = len(made.lanes) if num is None else num
    _wait(made, lambda: sum(m.state == "ready" for m in made.console.status().members) > num)


def _wait(made, what, meanwhile=lambda: time.sleep(0.005)) -> None:
    """Wait until a condition is true; call ``meanwhile`` repeatedly, which may make it true."""
    end_s = time.monotonic() + WAIT_S
    while not what():
        assert time.monotonic() < end_s, made.console.status()
        meanwhile()


def _wait_loaded(made) -> None:
    """Wait until all lanes have loaded the newest content (scene)."""

    def all_have_it() -> bool:
        newest = made.renderer._sent[1]
        return all(made.console._members[lane.name].loaded == newest for lane in made.lanes)

    _wait(made, all_have_it)


def _airway(case, **changes) -> AirwayView:
    return AirwayView(case.pose, **{**SIZE, **changes})


WAIT_S = 120.0
"""Time limit of every wait, seconds."""
FAST = ClusterSettings(late_floor_s=0.03, first_answer_s=0.5)


def test_renderer_that_stops_replying_delays_only_one_picture_and_is_used_again_when_it_replies(case, cluster):
    made = cluster(settings=FAST)
    _wait_ready(made)
    expected = made.truth.render(_airway(case)).rgb
    for _ in range(5):
        made.renderer.render(_airway(case))
    made.lanes[1].trouble.holds = True
    for _ in range(5):
        # The picture is complete although the strip of lane 1 is delayed until ``release`` below.
        future = made.renderer.request(_airway(case))[1]
        assert np.array_equal(future.result(timeout=WAIT_S).rgb, expected)
        assert "away" not in [m.state for m in made.console.status().members], "the picture is not cancelled for it"
    _wait(made, lambda: [m.state for m in made.console.status().members if m.name == "lane-1"] == ["late"])
    _wait(made, lambda: any("lane-1 is late" in n for n in made.console.status().notices))
    assert sum("lane-1 is late" in n for n in made.console.status().notices) == 1
    made.lanes[1].release()
    _wait(
        made,
        lambda: all(m.state == "ready" for m in made.console.status().members),
        lambda: made.renderer.render(_airway(case)),
    )


@pytest.mark.parametrize("what", ["wrong_shape", "old_frame", "other_rows"])
def test_strip_with_a_wrong_shape_frame_or_row_range_is_not_shown(case, cluster, what):
    made = cluster(settings=FAST)
    _wait_ready(made)
    expected = made.truth.render(_airway(case)).rgb
    setattr(made.lanes[0].trouble, what, True)
    expected_texts = {"wrong_shape": "of shape", "old_frame": "of frame", "other_rows": "from row"}[what]

    def shows_the_truth() -> None:
        assert np.array_equal(made.renderer.render(_airway(case)).rgb, expected)
        time.sleep(0.02)

    for _ in range(10):
        shows_the_truth()
    _wait(
        made,
        lambda: any(
            "lane-0 returned an invalid reply" in n and expected_texts in n for n in made.console.status().notices
        ),
        shows_the_truth,
    )


@pytest.mark.parametrize("what", ["wrong_shape", "garbles", "twice", "refuses"])
def test_frame_is_rendered_by_another_renderer_after_any_unusable_reply(case, cluster, monkeypatch, what):
    """Disable the check of replies; another renderer must render a strip that cannot be used."""
    from carina.cluster import console

    monkeypatch.setattr(console, "find_mismatch", lambda answer, order: None)
    made = cluster(settings=FAST)
    _wait_ready(made)
    expected = made.truth.render(_airway(case)).rgb
    setattr(made.lanes[0].trouble, what, True)
    expected_texts = {"twice": [], "refuses": ["is not responding"]}.get(what, ["an unusable strip"])

    def shows_the_truth() -> None:
        _, future = made.renderer.request(_airway(case))
        assert np.array_equal(future.result(timeout=WAIT_S).rgb, expected)
        time.sleep(0.05)

    def is_reported() -> bool:
        reported = [n for n in made.console.status().notices if "lane-0" in n]
        is_complete = len(reported) >= len(expected_texts) and all(
            any(text in notice for notice in reported) for text in expected_texts
        )
        return is_complete and made.lanes[0].trouble.num_orders > 0

    for _ in range(6):
        shows_the_truth()
    _wait(made, is_reported, shows_the_truth)


def test_error_while_strips_are_joined_is_raised_at_once(case, cluster, monkeypatch):
    from carina.cluster import frames

    made = cluster(settings=FAST)
    _wait_ready(made)
    monkeypatch.setattr(frames, "with_pixels", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        made.renderer.request(_airway(case))[1].result(timeout=WAIT_S)
    monkeypatch.undo()
    made.renderer.render(_airway(case))


def test_renderer_that_repeatedly_sends_wrong_replies_is_excluded(case, cluster):
    made = cluster(simds=(None, None), settings=FAST)
    _wait_ready(made)
    made.lanes[0].trouble.wrong_shape = True
    end_s = time.monotonic() + WAIT_S
    while any(m.name == "lane-0" for m in made.console.status().members):
        made.renderer.render(_airway(case))
        assert time.monotonic() < end_s
    assert any("no longer used" in n for n in made.console.status().notices)


def test_renderer_that_fails_during_a_frame_loses_no_picture(case, cluster):
    made = cluster(settings=FAST)
    _wait_ready(made)
    expected = made.truth.render(_airway(case)).rgb
    made.lanes[2].trouble.raises = ConnectionError("gone")

    def num_reported() -> int:
        assert np.array_equal(made.renderer.render(_airway(case)).rgb, expected)
        return sum("lane-2 is not responding" in n for n in made.console.status().notices)

    _wait(made, num_reported)
    assert num_reported() == num_reported() == 1
    made.lanes[2].trouble.raises = None
    _wait_ready(made)


def test_other_renderers_load_the_scene_if_one_renderer_cannot_receive_the_request(case, cluster, monkeypatch):
    made = cluster(settings=FAST)
    _wait_ready(made)
    expected = made.truth.render(_airway(case)).rgb
    calls = []

    def load(parcel, done):
        calls.append(parcel)
        raise ConnectionError("the head is gone")

    monkeypatch.setattr(made.lanes[0], "load", load)
    made.lanes[0].trouble.raises = ConnectionError("gone")
    end_s = time.monotonic() + WAIT_S
    while len(calls) < 2:
        assert np.array_equal(made.renderer.request(_airway(case))[1].result(timeout=WAIT_S).rgb, expected)
        assert time.monotonic() < end_s
        time.sleep(0.02)
    # The other lanes receive the next transfer function.
    made.renderer.set_transfer(transfer_preset("paper"))
    made.truth.set_transfer(transfer_preset("paper"))
    expected = made.truth.render(_airway(case)).rgb
    assert np.array_equal(made.renderer.request(_airway(case))[1].result(timeout=WAIT_S).rgb, expected)
    monkeypatch.undo()
    made.lanes[0].trouble.raises = None
    _wait_ready(made)


def test_renderer_that_cannot_load_the_scene_is_reported_once_and_tried_again(case, cluster, monkeypatch):
    monkeypatch.setattr(console_module, "RETRY_S", (0.001,))
    made = cluster(settings=FAST)
    _wait_ready(made)
    calls, load = [], made.lanes[0].load

    def refuses(parcel, done):
        calls.append(parcel)
        done(ConnectionError("the arrays do not come"))
        return False

    monkeypatch.setattr(made.lanes[0], "load", refuses)
    made.renderer.set_transfer(transfer_preset("paper"))
    made.renderer.prepare()
    _wait(made, lambda: len(calls) > console_module.NOTIFY_AFTER_LOADS + 2)
    reported = [notice for notice in made.console.status().notices if "cannot load the case" in notice]
    assert reported == ["the renderer lane-0 cannot load the case (ConnectionError); Carina keeps trying"]
    monkeypatch.setattr(made.lanes[0], "load", load)
    _wait_ready(made)


def test_console_renders_pictures_if_no_renderer_is_left(case, cluster):
    made = cluster(simds=(None,), settings=FAST)
    _wait_ready(made)
    expected = made.truth.render(_airway(case)).rgb
    made.lanes[0].trouble.raises = ConnectionError("gone")
    assert np.array_equal(made.renderer.render(_airway(case)).rgb, expected)
    assert np.array_equal(made.renderer.render(_airway(case)).rgb, expected)
    made.console.remove_lane("lane-0")
    assert np.array_equal(made.renderer.render(_airway(case)).rgb, expected)
    assert made.console.status().alone


def test_renderer_that_joins_during_a_flight_receives_strips(case, cluster, consoles):
    made = cluster(simds=(None,), settings=ClusterSettings(open_frames=2))
    _wait_ready(made)
    views = [_airway(case, fov_deg=60.0 + n) for n in range(4)]
    expected = [made.truth.render(view).rgb for view in views]
    late = cluster(simds=("portable",)).lanes[0]
    late.name = "newcomer"
    under_way, joined_at, num = [], None, 0
    end_s = time.monotonic() + WAIT_S
    # Two frames are always in progress, so the new renderer joins while strips are rendered.
    while joined_at is None or late.trouble.num_orders < 5:
        assert time.monotonic() < end_s, "it gets nothing"
        under_way.append((num % 4, made.renderer.request(views[num % 4])[1]))
        num += 1
        if num == 6:
            made.console.add_lane(late)
            joined_at = num
        if len(under_way) > 2:
            which, future = under_way.pop(0)
            assert np.array_equal(future.result(timeout=WAIT_S).rgb, expected[which])
    for which, future in under_way:
        assert np.array_equal(future.result(timeout=WAIT_S).rgb, expected[which])
    [share] = [m.share for m in made.console.status().members if m.name == "newcomer"]
    assert 0.0 < share < 1.0


def test_new_transfer_function_is_used_in_all_strips_of_a_frame_or_in_none(case, cluster):
    made = cluster(simds=("portable", None))
    _wait_ready(made)
    shown = made.truth.render(_airway(case)).rgb
    for name in ("see-through", "endoscopic", "ct-grey", "paper"):
        made.truth.set_transfer(transfer_preset(name))
        made.truth.prepare()
        expected = made.truth.render(_airway(case)).rgb
        assert not np.array_equal(expected, shown), "the change would not be seen"
        shown = expected
        made.renderer.set_transfer(transfer_preset(name))
        assert np.array_equal(made.renderer.render(_airway(case)).rgb, expected)
        _wait_ready(made)
        _wait_loaded(made)
        before = [lane.trouble.num_orders for lane in made.lanes]
        assert np.array_equal(made.renderer.render(_airway(case)).rgb, expected)
        grown = [lane.trouble.num_orders > n for lane, n in zip(made.lanes, before, strict=True)]
        assert grown == [True, True], "both lanes render what is shown now"


def test_several_threads_may_request_pictures_concurrently(case, cluster):
    made = cluster(settings=ClusterSettings(open_frames=3))
    _wait_ready(made)
    views = [_airway(case, fov_deg=60.0 + n) for n in range(24)]
    expected = [made.truth.render(view).rgb for view in views]
    with ThreadPoolExecutor(6) as threads:
        for found, picture in zip(threads.map(made.renderer.render, views), expected, strict=True):
            assert np.array_equal(found.rgb, picture)


def test_picture_rendered_on_the_cluster_can_be_cancelled(case, cluster):
    made = cluster(simds=(None,), settings=ClusterSettings(first_answer_s=60.0))
    _wait_ready(made)
    made.lanes[0].trouble.holds = True
    stop = CancelToken()
    threading.Timer(0.05, stop.cancel).start()
    with pytest.raises(CancelledError):
        made.renderer.render(_airway(case), stop=stop)
    made.lanes[0].release()
    made.renderer.render(_airway(case))


def test_view_that_cannot_be_rendered_is_refused_as_on_one_machine(case, consoles):
    from carina.cluster import LocalLane
    from carina.render import Renderer

    console = consoles()
    console.add_lane(LocalLane(Renderer(case.volume), name="a"))
    renderer = ClusterRenderer(Renderer(case.volume), console, spread_all=True)
    renderer.prepare()
    with pytest.raises(RenderError, match="no tree to show"):
        renderer.render(TreeView(**SIZE))
    assert renderer.render(_airway(case)).rgb.shape == (61, 72, 3)


def test_series_of_pictures_is_in_order_and_can_be_resumed(case, cluster):
    made = cluster(settings=FAST)
    _wait_ready(made)
    views = [_airway(case, fov_deg=50.0 + n) for n in range(12)]
    expected = [made.truth.render(view).rgb for view in views]
    got = []
    for number, picture in render_frames(made.renderer, views):
        assert np.array_equal(picture.rgb, expected[number])
        got.append(number)
        if number == 4:
            break
    made.lanes[0].trouble.raises = ConnectionError("gone")
    for number, picture in render_frames(made.renderer, iter(views), first=5):
        assert np.array_equal(picture.rgb, expected[number])
        got.append(number)
    assert got == list(range(12))
    assert [n for n, _ in render_frames(made.truth, views, first=10)] == [10, 11]
    assert sum(lane.trouble.num_orders > 0 for lane in made.lanes) >= 2


def test_pickled_case_contains_each_large_array_once_and_repeated_arrays_are_not_sent_again(case):
    renderer = case.renderer()
    parcels = Parcels()
    first = parcels.pack(renderer.volume, renderer.scene)
    renderer.set_transfer(transfer_preset("see-through"))
    second = parcels.pack(renderer.volume, renderer.scene)
    assert second.content > first.content
    assert set(second.arrays) & set(first.arrays), "the volume is not sent again"
    volume, scene = open_parcel(first.skeleton, first.arrays)
    assert np.shares_memory(volume.hu_zyx, renderer.volume.hu_zyx)
    assert scene.maps is not None and scene.maps.values is scene.values


def test_case_pickled_for_the_cluster_contains_no_name_and_no_path(case):
    from carina.volume import Note, Volume, VolumeSource

    named = VolumeSource(format="dicom", title="SECRET^NAME", notes=(Note("import.lossy", "SECRET"),))
    volume = Volume(case.volume.hu_zyx, case.volume.lps_from_ijk, source=named)
    from carina.render import Renderer

    assert b"SECRET" not in Parcels().pack(volume, Renderer(volume).scene).skeleton


def test_renderer_refuses_to_render_a_scene_that_it_has_not_loaded(case):
    renderer = case.renderer()
    parcel = Parcels().pack(renderer.volume, renderer.scene)
    host = RendererHost(simd="portable")
    view = pickle.dumps(_airway(case))
    with pytest.raises(ClusterError, match="expected 1"):
        host.strip(1, 1, view, (0, 9))
    with pytest.raises(ClusterError, match="restarted"):
        host.load(parcel.content, parcel.skeleton, list(parcel.arrays), [])
    arrays = list(parcel.arrays.values())
    host.load(parcel.content, parcel.skeleton, [], list(parcel.arrays), *arrays)
    answer = host.strip(7, parcel.content, view, (5, 20))
    frame_id, content, first_row, num_rows, seconds, method, counts, picture, rgb = answer
    assert picture is None and method == "leap" and counts[0] > 0
    assert (frame_id, content, first_row, num_rows) == (7, parcel.content, 5, 15) and seconds > 0.0
    assert np.array_equal(rgb, renderer.render(_airway(case)).rgb[5:20])
    assert host.strip(8, parcel.content, view, (0, 20))[7].view == "airway"
    assert host.strip(8, parcel.content, view, None)[2:4] == (0, 61)
    with pytest.raises(ClusterError):
        host.strip(8, parcel.content + 1, view, (5, 20))
    assert host.ping()["content"] == parcel.content


@pytest.mark.parametrize("name", VIEW_NAMES)
def test_view_restored_from_a_pickle_gives_an_equal_picture(case, name):
    view = _views(case)[name]
    there = pickle.loads(pickle.dumps(view, protocol=5))
    renderer = case.renderer()
    assert np.array_equal(renderer.render(there).rgb, renderer.render(view).rgb)
