"""Tests of airway views rendered on a graphics device, compared with the CPU.

`make test-gpu` runs these tests on the installed wheel.
"""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
import threading

import numpy as np
import pytest
from render_trees import forked

from carina import _core
from carina.errors import RenderError
from carina.render import AirwayView, Backend, Renderer, find_adapters, transfer_preset
from carina.render.graphics_device import PICTURES_FIRST
from carina.render.processor_choice import MAX_PART_OFF, differing_share
from carina.scopes import PINHOLE, DepthOfField, ImageField, Lens, Pose, scope_preset
from carina.volume import Volume

pytestmark = pytest.mark.gpu
SIZE = {"width": 96, "height": 72}
ENDOSCOPIC = transfer_preset("endoscopic")
# This transfer function applies the light to every sample during the casting, not to the walls after it.
TIP_LIT = dataclasses.replace(ENDOSCOPIC, appearance=None)


@pytest.fixture(scope="module", autouse=True)
def adapters():
    """Return the adapters of this machine, or skip the test with the reason why there are none."""
    found = find_adapters()
    if not found:
        why = "GPU support is not in this build" if found is None else "there is no graphics adapter"
        assert "CARINA_GPU_REQUIRED" not in os.environ, why
        pytest.skip(f"{why}; `make test-gpu` has both")
    return found


def both(volume, lumen_zyx=None, transfer=ENDOSCOPIC, tree=None):
    renderers = [Renderer(volume, transfer=transfer, backend=Backend(mode)) for mode in ("cpu", "gpu")]
    for renderer in renderers:
        if lumen_zyx is not None:
            renderer.set_lumen(lumen_zyx, tree)
        renderer.prepare()
    return renderers


def assert_same(cpu, gpu, view, *, method=None):
    expected, found = cpu.render(view), gpu.render(view)
    assert found.stats.method == (f"gpu-{expected.stats.method}" if method is None else method)
    assert differing_share(expected.rgb, found.rgb) <= MAX_PART_OFF
    # A pixel with a larger difference shows another object, because a wall moved by one sample keeps its colour.
    assert np.abs(expected.rgb.astype(int) - found.rgb).max() <= 40
    assert found.stats.num_rays == expected.stats.num_rays
    for count in ("num_samples", "num_skipped", "num_shaded", "num_loads"):
        assert getattr(found.stats, count) == pytest.approx(getattr(expected.stats, count), rel=0.01, abs=50)
    return found


@pytest.mark.parametrize(
    "transfer",
    [ENDOSCOPIC, TIP_LIT, transfer_preset("ct-grey"), transfer_preset("see-through")],
    ids=["endoscopic", "tip-lit", "ct-grey", "see-through"],
)
def test_gpu_pictures_equal_cpu_pictures_for_every_preset_field_of_view_and_method(airway, transfer):
    cpu, gpu = both(airway.volume, airway.lumen_zyx, transfer)
    brightest = 0
    for fov_deg in (60.0, 110.0, 170.0):
        for method in ("leap", "brute"):
            for shading in (True, False):
                view = AirwayView(airway.pose, fov_deg=fov_deg, shading=shading, method=method, **SIZE)
                brightest = max(brightest, assert_same(cpu, gpu, view).rgb.max())
    assert brightest > 60, "black pictures would be equal for any input"


@pytest.mark.parametrize("lens", [scope_preset("generic").lens, Lens.equidistant()], ids=["generic", "equidistant"])
def test_gpu_picture_with_lens_outline_and_vignette_of_a_scope_equals_the_cpu_picture(airway, lens):
    cpu, gpu = both(airway.volume, airway.lumen_zyx)
    field = ImageField("octagon", vignette=0.7)
    for fov_deg in (90.0, 120.0):
        view = AirwayView(airway.pose, fov_deg=fov_deg, lens=lens, field=field, **SIZE)
        picture = assert_same(cpu, gpu, view)
        assert picture.rgb[0, 0].max() == 0, "outside the outline"
        assert picture.rgb.max() > 60


def test_gpu_pictures_from_cameras_outside_the_volume_on_a_voxel_and_along_an_axis_equal_cpu_pictures(airway):
    cpu, gpu = both(airway.volume)
    centre = airway.volume.centre_lps
    corner = airway.volume.lps_from_ijk[:3, 3]
    axis = airway.volume.lps_from_ijk[:3, 0] / np.linalg.norm(airway.volume.lps_from_ijk[:3, 0])
    for position, direction in (
        (centre + np.array([0.0, -200.0, 0.0]), (0, 1, 0)),
        (centre + np.array([0.0, -200.0, 0.0]), (0, -1, 0)),
        (corner, tuple(centre - corner)),
        (corner - 20 * axis, tuple(axis)),
    ):
        for step_vox in (0.5, 1.0):
            assert_same(cpu, gpu, AirwayView(Pose.looking(position, direction), step_vox=step_vox, **SIZE))


def test_nearest_voxel_sampling_uses_the_gpu_and_leaping_over_all_classes_uses_the_cpu(airway):
    cpu, gpu = both(airway.volume, transfer=transfer_preset("paper"))
    view = AirwayView(airway.pose, **SIZE)
    assert gpu.render(view).stats.method == "leap-all"
    assert_same(cpu, gpu, AirwayView(airway.pose, method="brute", **SIZE), method="gpu-brute")


def test_joined_strips_rendered_on_the_gpu_equal_the_undivided_picture(airway):
    _, gpu = both(airway.volume)
    view = AirwayView(airway.pose, **SIZE)
    strips = [gpu.render(view, rows=rows).rgb for rows in ((0, 7), (7, 8), (8, 72))]
    np.testing.assert_array_equal(np.vstack(strips), gpu.render(view).rgb)


def test_changed_wall_or_transfer_function_is_used_in_the_next_gpu_picture(airway):
    cpu, gpu = both(airway.volume)
    view = AirwayView(airway.pose, **SIZE)
    before = assert_same(cpu, gpu, view).rgb
    for renderer in (cpu, gpu):
        renderer.set_lumen(airway.lumen_zyx)
    walled = assert_same(cpu, gpu, view, method="gpu-brute").rgb
    assert (before != walled).any()
    for renderer in (cpu, gpu):
        renderer.set_transfer(dataclasses.replace(transfer_preset("ct-grey"), appearance=None))
        renderer.prepare()
    assert (assert_same(cpu, gpu, view).rgb != walled).any()


def test_walls_rendered_on_the_gpu_are_lit_as_on_the_cpu(airway):
    cpu, gpu = both(airway.volume, airway.lumen_zyx)
    view = AirwayView(airway.pose, **SIZE)
    lit = assert_same(cpu, gpu, view, method="gpu-leap")
    for other in (
        AirwayView(airway.pose, texture=False, **SIZE),
        AirwayView(airway.pose, guides_mm=((0.0, 3.0, 0.0),), **SIZE),
        AirwayView(airway.pose, shading=False, **SIZE),
        AirwayView(airway.pose, stop_transparency=0.2, **SIZE),
    ):
        assert (assert_same(cpu, gpu, other, method="gpu-leap").rgb != lit.rgb).any()
    strips = [gpu.render(view, rows=rows).rgb for rows in ((0, 7), (7, 8), (8, 72))]
    np.testing.assert_array_equal(np.vstack(strips), lit.rgb)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"rings": 2.0, "membrane": 0.0, "hue": 0.0},
        {"rings": 0.0, "membrane": 2.0, "spurs": 0.0},
        {"secretions": 0.8, "specks": 2.0},
        {"fog": 0.6},
        {"silhouettes": False, "vessels": 2.0},
        {"exposure": 300.0, "shininess_log2": 2},
    ],
    ids=lambda changes: " ".join(changes) or "shipped",
)
def test_decorated_gpu_pictures_equal_cpu_pictures_for_every_look_lens_and_angle(airway, changes):
    appearance = dataclasses.replace(ENDOSCOPIC.appearance, **changes)
    transfer = dataclasses.replace(ENDOSCOPIC, appearance=appearance)
    cpu, gpu = both(airway.volume, airway.lumen_zyx, transfer, forked())
    size = {"width": 160, "height": 120}
    for fov_deg in (60.0, 120.0):
        for lens, field in (
            (PINHOLE, ImageField()),
            (scope_preset("generic").lens, ImageField("octagon", vignette=0.7)),
            (Lens.equidistant(), ImageField("round", edge_px=3.0)),
        ):
            view = AirwayView(airway.pose, fov_deg=fov_deg, lens=lens, field=field, **size)
            picture = assert_same(cpu, gpu, view, method="gpu-leap")
            assert picture.decorated == cpu.render(view).decorated
            assert picture.rgb.max() > 60


def test_change_of_look_tree_or_lens_is_shown_in_the_next_gpu_picture(airway):
    cpu, gpu = both(airway.volume, airway.lumen_zyx, ENDOSCOPIC, forked())
    view = AirwayView(airway.pose, **SIZE)
    before = assert_same(cpu, gpu, view).rgb
    for renderer in (cpu, gpu):
        renderer.set_lumen(airway.lumen_zyx, None)
        renderer.prepare()
    bare = assert_same(cpu, gpu, view).rgb
    assert (before != bare).any()
    for renderer in (cpu, gpu):
        renderer.set_lumen(airway.lumen_zyx, forked())
        renderer.prepare()
    np.testing.assert_array_equal(assert_same(cpu, gpu, view).rgb, before)


def test_gpu_picture_with_depth_of_field_equals_the_cpu_picture(airway):
    cpu, gpu = both(airway.volume, airway.lumen_zyx)
    field = ImageField("round", vignette=0.5)
    lens = scope_preset("generic").lens
    view = AirwayView(airway.pose, lens=lens, field=field, depth_of_field=DepthOfField(5.0, 30.0), **SIZE)
    assert_same(cpu, gpu, view)


def test_auto_backend_compares_cpu_and_gpu_pictures_with_the_transfer_function_of_the_case(airway, adapters):
    # In this test the software adapter is declared as a graphics card.
    card = dataclasses.replace(adapters[0], kind="discrete")
    renderer = Renderer(airway.volume, backend=Backend("auto", find=lambda: [card]))
    renderer.set_lumen(airway.lumen_zyx)
    renderer.set_transfer(ENDOSCOPIC)
    renderer.prepare()
    device = renderer._airway._device
    plain, compared = device._cast, []

    def cast(scene, view, gpu):
        picture = plain(scene, view, gpu)
        compared.append((scene.transfer, picture))
        return picture

    device._cast, device._start = cast, lambda work: work()
    view = AirwayView(airway.pose, width=120, height=90)
    expected = [renderer.render(view) for _ in range(PICTURES_FIRST)][-1]
    (measurement,) = renderer._airway._device._backend.measurements
    assert "measured" in measurement.why, "their pictures agree"
    assert {picture.stats.method for _, picture in compared} == {"leap", "gpu-leap"}
    for transfer, picture in compared:
        assert transfer is ENDOSCOPIC
        assert differing_share(picture.rgb, expected.rgb) <= MAX_PART_OFF


def test_each_of_several_threads_receives_the_gpu_pictures_that_it_requested(airway):
    _, gpu = both(airway.volume)
    views = [AirwayView(airway.pose, fov_deg=fov, **SIZE) for fov in (60.0, 90.0, 120.0, 150.0)]
    expected = [gpu.render(view).rgb for view in views]
    wrong = []

    def fly(view, picture):
        wrong.extend(view for _ in range(5) if (gpu.render(view).rgb != picture).any())

    threads = [threading.Thread(target=fly, args=pair) for pair in zip(views, expected, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_lost_graphics_device_causes_a_fallback_to_the_cpu_and_one_message(airway, caplog):
    devices = []

    def open_device(index):
        devices.append(_core.Gpu(index))
        return devices[-1]

    backend = Backend("gpu", open_device=open_device)
    renderer = Renderer(airway.volume, transfer=TIP_LIT, backend=backend)
    view = AirwayView(airway.pose, **SIZE)
    assert renderer.render(view).stats.method == "gpu-brute"
    expected = Renderer(airway.volume, transfer=TIP_LIT).render(view).rgb
    while backend.adapters():
        devices[-1].lose()
        picture = renderer.render(view)
        if backend.adapters():
            # Another adapter of this machine is used for the next picture.
            renderer.render(view)
    np.testing.assert_array_equal(picture.rgb, expected)
    assert renderer.render(view).stats.method == "brute"
    assert len([record for record in caplog.records if record.levelno >= 30]) == 1


OTHER_PROCESS = """
import sys
import numpy as np
from carina.phantom import generate_phantom
from carina.render import AirwayView, Backend, Renderer
from carina.scopes import Pose

made = generate_phantom(seed=3, generations=3, spacing_mm=2.0)
points = np.array(made.truth["branches"][0]["points"])
pose = Pose.looking(points[0], points[-1] - points[0])
renderer = Renderer(made.volume, backend=Backend(sys.argv[1]))
pictures = [renderer.render(AirwayView(pose, fov_deg=80.0 + 5 * n, width=96, height=72)) for n in range(8)]
assert all(p.stats.method.startswith("gpu-") == (sys.argv[1] == "gpu") for p in pictures), pictures[0].stats.method
np.save(sys.argv[2], np.stack([p.rgb for p in pictures]))
"""


def test_two_processes_on_one_graphics_device_both_render_the_cpu_picture(tmp_path):
    places = {mode: tmp_path / f"{mode}.npy" for mode in ("cpu", "gpu", "gpu-too")}
    running = [
        subprocess.Popen([sys.executable, "-c", OTHER_PROCESS, name.removesuffix("-too"), str(place)])
        for name, place in places.items()
    ]
    assert [one.wait(120) for one in running] == [0, 0, 0]
    expected = np.load(places["cpu"])
    assert expected.max() > 60
    for name in ("gpu", "gpu-too"):
        assert differing_share(expected.reshape(-1, 96, 3), np.load(places[name]).reshape(-1, 96, 3)) <= MAX_PART_OFF


def test_gpu_scene_uploaded_for_another_array_is_refused(airway):
    gpu = _core.Gpu(0)
    scene = gpu.upload(airway.volume.hu_zyx)
    copied = Volume(airway.volume.hu_zyx.copy(), airway.volume.lps_from_ijk)
    other = Renderer(copied, transfer=TIP_LIT)
    with pytest.raises(ValueError, match="another volume"):
        other._airway._cast(other._scenes.scene, AirwayView(airway.pose, **SIZE), gpu=scene)
    with pytest.raises(RenderError) as caught:
        gpu.upload(np.zeros((1, 1, 70_000), dtype=np.int16))
    assert caught.value.code == "render.gpu-limit"
    with pytest.raises(RenderError, match="9999"):
        _core.Gpu(9999)


def run_carina(*arguments, **environment):
    done = subprocess.run(
        [sys.executable, "-m", "carina.cli", *arguments],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_doctor_command_lists_adapters_and_does_not_choose_a_software_adapter(adapters, tmp_path):
    cache = {"XDG_CACHE_HOME": str(tmp_path)}
    facts = json.loads(run_carina("doctor", "--json", CARINA_BACKEND="auto", **cache))["gpu"]
    assert facts["in_build"]
    assert [a["name"] for a in facts["adapters"]] == [a.name for a in adapters]
    for adapter in facts["adapters"]:
        if adapter["kind"] == "software":
            assert not adapter["chosen"]
            assert "no faster" in adapter["why"]
    result = json.loads(run_carina("doctor", "--json", CARINA_BACKEND="gpu", **cache))
    assert result["renderer"] == "gpu"
    assert adapters[0].name in run_carina("doctor", CARINA_BACKEND="gpu", **cache)
    assert json.loads(run_carina("doctor", "--json", CARINA_BACKEND="cpu", **cache))["renderer"] == "cpu"
