"""Tests of the renderer of airway views: leaping, strips, IsoRegion maps and their cache, the wall, and threads."""

from __future__ import annotations

import itertools
import sys
import threading

import numpy as np
import pytest

from carina import _core
from carina.errors import CancelledError, GeometryError, RenderError, UsageError
from carina.render import AirwayView, CancelToken, Light, Renderer, SliceView, TransferFunction, transfer_preset
from carina.render.value_labels import bin_width, equal_by_name, value_labels
from carina.render.wall import grow_one_voxel, wall_levels, with_wall
from carina.scopes import Pose
from carina.volume import Volume

SIZE = {"width": 56, "height": 44}


def view(airway, **changes):
    return AirwayView(airway.pose, **{**SIZE, **changes})


def test_leaping_equals_brute_force_bit_for_bit_in_a_phantom(airway):
    renderer = Renderer(airway.volume)
    renderer.set_lumen(airway.lumen_zyx)
    renderer.prepare()
    for fov_deg in (60.0, 110.0, 170.0):
        for shading in (True, False):
            leap = renderer.render(view(airway, fov_deg=fov_deg, shading=shading))
            brute = renderer.render(view(airway, fov_deg=fov_deg, shading=shading, method="brute"))
            assert leap.stats.method == "leap"
            assert leap.stats.num_samples < 0.6 * brute.stats.num_samples
            assert leap.stats.num_skipped > 0
            np.testing.assert_array_equal(leap.rgb, brute.rgb)
            assert leap.rgb.max() > 60, "a black picture would equal any black picture"


def test_picture_before_the_isoregion_map_is_built_uses_brute_force_and_equals_the_leaping_picture(airway):
    renderer = Renderer(airway.volume)
    before = renderer.render(view(airway))
    assert before.stats.method == "brute"
    assert not renderer.prepared
    renderer.prepare()
    after = renderer.render(view(airway))
    assert after.stats.method == "leap"
    np.testing.assert_array_equal(before.rgb, after.rgb)


def test_leaping_over_all_classes_differs_from_brute_force_by_at_most_one_grey_level(airway):
    renderer = Renderer(airway.volume, transfer=transfer_preset("ct-grey"))
    renderer.prepare(all_classes=True)
    leap = renderer.render(view(airway, shading=False))
    assert leap.stats.method == "leap-all"
    brute = renderer.render(view(airway, shading=False, method="brute"))
    # A leaped segment is rounded once, single samples are rounded one by one.
    assert np.abs(leap.rgb.astype(int) - brute.rgb).max() <= 1


def test_paper_mode_samples_nearest_voxels_in_steps_of_one_and_leaps_over_all_bins(airway):
    renderer = Renderer(airway.volume, transfer=transfer_preset("paper"))
    renderer.prepare()
    leap = renderer.render(view(airway))
    brute = renderer.render(view(airway, method="brute", step_vox=0.3))
    assert leap.stats.method == "leap-all"
    assert np.abs(leap.rgb.astype(int) - brute.rgb).max() <= 1
    whole_steps = Renderer(airway.volume, transfer=transfer_preset("ct-grey")).render(view(airway, step_vox=1.0))
    # The paper mode always has steps of one voxel, so about as many samples as another transfer function with such
    # steps.
    assert brute.stats.num_samples < 1.5 * whole_steps.stats.num_samples


def test_paper_mode_compares_and_shows_the_values_of_8_bit_data(airway):
    values = np.clip((airway.volume.hu_zyx.astype(np.int32) + 1000) // 5, 0, 255).astype(np.int16)
    # Noise in the lumen would leave no equal neighbours to leap over.
    values[values < 60] = 5
    volume = Volume(values, airway.volume.lps_from_ijk)
    ramp = TransferFunction(
        points=np.array([[0.0, 0, 0, 0, 0.0], [20.0, 0, 0, 0, 0.0], [255.0, 1, 1, 1, 0.9]]),
        sampling="nearest",
        unit="raw",
    )
    renderer = Renderer(volume, transfer=ramp)
    renderer.prepare()
    leap = renderer.render(view(airway, method="leap-always", shading=False))
    brute = renderer.render(view(airway, method="brute", shading=False))
    assert leap.stats.method == "leap-all"
    assert leap.stats.num_leaps > 0
    assert np.abs(leap.rgb.astype(int) - brute.rgb).max() <= 1
    assert len(np.unique(brute.rgb)) > 16


def test_value_labels_are_values_up_to_256_and_bins_of_16_beyond(rng):
    few = rng.choice(rng.choice(60_000, 256, replace=False) - 30_000, (30, 20, 25)).astype(np.int16)
    for values in (few, few // 300):
        labels, lowest = value_labels(values)
        assert equal_by_name(values) == "values"
        known = labels > 0
        assert np.array_equal(lowest[labels[known].astype(int) - 1], values[known])
        # Labels have 8 bits: with 256 values the rarest one has none.
        assert len(np.unique(values[~known])) == max(len(np.unique(values)) - 255, 0)
    many = np.arange(257, dtype=np.int16).repeat(27).reshape(257, 3, 9)
    labels, lowest = value_labels(many)
    assert (equal_by_name(many), bin_width(many)) == ("bins of 16", 16)
    assert np.array_equal(lowest[labels.astype(int) - 1], many // 16 * 16)
    with pytest.raises(UsageError, match="at most 256 different values"):
        value_labels(many, "values")


def test_joined_strips_equal_the_undivided_picture(airway):
    renderer = Renderer(airway.volume)
    renderer.prepare()
    whole = renderer.render(view(airway)).rgb
    cuts = [0, 5, 6, 30, 44]
    strips = [renderer.render(view(airway), rows=(a, b)).rgb for a, b in itertools.pairwise(cuts)]
    np.testing.assert_array_equal(np.vstack(strips), whole)
    with pytest.raises(RenderError, match="rows"):
        renderer.render(view(airway), rows=(10, 45))


def test_every_instruction_set_gives_an_equal_picture(airway):
    pictures = [Renderer(airway.volume, simd=name).render(view(airway)).rgb for name in ("portable", None)]
    np.testing.assert_array_equal(*pictures)
    with pytest.raises(UsageError, match=r"simd: expected one of portable"):
        Renderer(airway.volume, simd="abacus").render(view(airway))


def test_camera_outside_the_volume_shows_the_volume_only_if_directed_at_it(airway):
    renderer = Renderer(airway.volume)
    renderer.prepare()
    outside = airway.volume.centre_lps + np.array([0.0, -200.0, 0.0])
    towards = renderer.render(AirwayView(Pose.looking(outside, (0, 1, 0)), fov_deg=40.0, **SIZE))
    away = renderer.render(AirwayView(Pose.looking(outside, (0, -1, 0)), fov_deg=40.0, **SIZE))
    assert towards.rgb[22, 28].max() > 0
    assert away.rgb.max() == 0


def test_wall_in_the_airway_picture_is_brighter_than_the_deep_lumen(airway):
    renderer = Renderer(airway.volume)
    picture = renderer.render(view(airway, fov_deg=100.0)).rgb.astype(int)
    edge = picture[:, [0, -1]].sum(axis=2).mean()
    right, left = (renderer.render(view(airway)).pixel_of(p) for p in ((-14.0, 3.0, -22.0), (16.0, 4.0, -14.0)))
    assert right[0] > 28 > left[0], "head-end position: patient right on image right"
    column, row = (int(v) for v in right)
    assert renderer.render(view(airway)).rgb[row, column].sum() < 0.5 * edge


def test_transfer_function_with_the_same_classes_needs_no_new_isoregion_map(airway, monkeypatch):
    renderer = Renderer(airway.volume)
    renderer.prepare()
    monkeypatch.setattr(_core, "build_cell_map", None)
    renderer.set_transfer(transfer_preset("see-through"))
    # The transfer function is transparent up to -700 HU like the endoscopic preset, so the classes and the map are the
    # same.
    assert renderer.prepared
    renderer.prepare()
    black = TransferFunction(points=np.array([[0.0, 0, 0, 0, 0.0], [1.0, 1, 1, 1, 1.0]]))
    renderer.set_transfer(black)
    assert not renderer.prepared


def test_pictures_use_brute_force_while_a_slow_isoregion_map_is_built(airway, monkeypatch):
    renderer = Renderer(airway.volume)
    expected = renderer.render(view(airway, method="brute")).rgb
    building, go_on = threading.Event(), threading.Event()
    build = _core.build_cell_map

    def slowly(*arguments, **options):
        building.set()
        assert go_on.wait(30)
        return build(*arguments, **options)

    monkeypatch.setattr(_core, "build_cell_map", slowly)
    worker = threading.Thread(target=renderer.prepare)
    worker.start()
    assert building.wait(30)
    meanwhile = renderer.render(view(airway))
    go_on.set()
    worker.join()
    assert meanwhile.stats.method == "brute"
    np.testing.assert_array_equal(meanwhile.rgb, expected)
    after = renderer.render(view(airway))
    assert after.stats.method == "leap"
    np.testing.assert_array_equal(after.rgb, expected)


def test_isoregion_map_of_a_transfer_function_replaced_during_the_build_is_not_used(airway, monkeypatch):
    renderer = Renderer(airway.volume)
    everything = TransferFunction(points=np.array([[-2000.0, 1, 1, 1, 0.2], [-400.0, 1, 1, 1, 0.9]]))
    build = _core.build_cell_map
    built = []

    def meanwhile(*arguments, **options):
        if not built:
            renderer.set_transfer(everything)
        built.append(arguments[1])
        return build(*arguments, **options)

    monkeypatch.setattr(_core, "build_cell_map", meanwhile)
    renderer.prepare()
    assert len(built) == 2
    assert built[-1] == (), "nothing is clear"
    leap, brute = (renderer.render(view(airway, method=method)) for method in ("leap", "brute"))
    np.testing.assert_array_equal(leap.rgb, brute.rgb)


def test_cancelled_preparation_of_the_renderer_stops_and_leaves_it_usable(airway):
    renderer = Renderer(airway.volume)
    with pytest.raises(CancelledError):
        renderer.prepare(cancel=lambda: True)
    assert renderer.render(view(airway)).stats.method == "brute"
    reported = []
    renderer.prepare(lambda what, fraction: reported.append((what, fraction)))
    assert reported[0][1] == 0.0
    assert reported[-1][1] == 1.0


def test_cancelled_picture_does_not_affect_the_next_one(airway):
    renderer = Renderer(airway.volume)
    wanted = view(airway, width=96, height=80, method="brute")
    whole = renderer.render(wanted).rgb
    # Without the cancellation this picture would take minutes.
    long = view(airway, width=2000, height=2000, method="brute", step_vox=0.1)
    stop = CancelToken()
    timer = threading.Timer(0.05, stop.cancel)
    timer.start()
    with pytest.raises(CancelledError):
        renderer.render(long, stop=stop)
    timer.join()
    assert stop.cancelled
    np.testing.assert_array_equal(renderer.render(wanted, stop=CancelToken()).rgb, whole)


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells of a thread how long it was on a core")
def test_airway_picture_has_ray_statistics_and_a_slice_has_none(airway):
    renderer = Renderer(airway.volume)
    renderer.prepare()
    wanted = view(airway, width=96, height=80)
    while (stats := renderer.render(wanted).stats).rays_s is None:
        pass  # A thread that still builds a map may not have reported its time.
    assert 0.0 < stats.rays_s <= 1.1 * stats.seconds
    # The machine is busy, so the CPU times without waits are compared for four times as many rays.
    more = renderer.render(view(airway, width=384, height=320)).stats
    assert more.rays_s > 4.0 * stats.rays_s
    plane = SliceView("axial", (0.0, 0.0, 0.0), width=32, height=32)
    assert renderer.render(plane).stats.rays_s is None


def test_picture_rendered_during_a_lumen_change_shows_the_state_before_or_after_it(airway):
    states = [None, airway.lumen_zyx]
    expected = []
    for lumen in states:
        renderer = Renderer(airway.volume)
        renderer.set_lumen(lumen)
        expected.append(renderer.render(view(airway)).rgb)
    assert (expected[0] != expected[1]).any()

    renderer = Renderer(airway.volume)
    done = threading.Event()

    def change() -> None:
        for n in range(12):
            renderer.set_lumen(states[n % 2])
            renderer.prepare()
        done.set()

    thread = threading.Thread(target=change)
    thread.start()
    count = 0
    while not done.is_set() or count == 0:
        found = renderer.render(view(airway)).rgb
        assert any((found == e).all() for e in expected)
        count += 1
    thread.join()


def thin_tube():
    """Return an airway in lung whose wall is invisible in the scan: -950 HU in -850 HU."""
    shape = (30, 34, 38)
    z, y, x = np.ogrid[:30, :34, :38]
    lumen = np.broadcast_to((y - 16.3) ** 2 + (x - 18.6) ** 2 < 5.2**2, shape) & (z > 2) & (z < 27)
    matrix = np.diag([0.7, 0.7, 1.5, 1.0])
    return Volume(np.where(lumen, -950, -850).astype(np.int16), matrix), lumen.astype(np.uint8)


def test_endoscopic_preset_shows_a_closed_wall_where_the_ct_shows_none():
    volume, lumen = thin_tube()
    # The light is white and without loss, so a black pixel shows a ray that met no wall.
    endoscopic = transfer_preset("endoscopic")
    bright = TransferFunction(points=endoscopic.points, wall=True, light=Light(ambient=1.0, diffuse=0.0))
    at = volume.to_lps(np.array([18.0, 16.0, 14.0]))
    raw, walled = Renderer(volume, transfer=bright), Renderer(volume, transfer=bright)
    walled.set_lumen(lumen)
    walled.prepare()
    for look in ((0, 0, 1), (0, 0, -1), (1, 0.2, 0), (-0.3, 1, 0.4), (-1, -1, 0)):
        spec = AirwayView(Pose.looking(at, look), fov_deg=120.0, width=64, height=64)
        assert raw.render(spec).rgb.max() == 0
        # The first stop has a red of 0.88, and less than a tenth passes through the wall.
        assert walled.render(spec).rgb[..., 0].min() > 0.8 * 255


def test_wall_added_round_the_lumen_only_increases_values_and_leaves_the_lumen_free(airway):
    levels = wall_levels(transfer_preset("endoscopic"))
    assert levels == (-700, -400)
    for volume, lumen in (thin_tube(), (airway.volume, airway.lumen_zyx)):
        out = with_wall(volume.hu_zyx, lumen, levels)
        assert (out >= volume.hu_zyx).all()
        inside = lumen != 0
        assert (out[inside] <= np.maximum(volume.hu_zyx[inside], -700)).all()
        far = ~grow_one_voxel(grow_one_voxel(grow_one_voxel(inside)))
        np.testing.assert_array_equal(out[far], volume.hu_zyx[far])
    np.testing.assert_array_equal(with_wall(volume.hu_zyx, np.zeros_like(lumen), levels), volume.hu_zyx)


def test_transfer_functions_without_a_closed_wall_render_the_unchanged_volume():
    volume, lumen = thin_tube()
    spec = AirwayView(Pose.looking(volume.centre_lps, (1, 0, 0)), width=32, height=32)
    for name in ("ct-grey", "paper", "see-through"):
        renderer = Renderer(volume, transfer=transfer_preset(name))
        before = renderer.render(spec).rgb
        renderer.set_lumen(lumen)
        np.testing.assert_array_equal(renderer.render(spec).rgb, before)


def test_renderer_refuses_a_lumen_of_another_shape(airway):
    with pytest.raises(GeometryError, match="shape"):
        Renderer(airway.volume).set_lumen(airway.lumen_zyx[1:])


def test_renderer_refuses_settings_out_of_range(airway):
    for changes in ({"fov_deg": 171.0}, {"width": 0}, {"step_vox": 0.0}, {"method": "magic"}):
        with pytest.raises(RenderError):
            view(airway, **changes)
