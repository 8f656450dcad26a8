"""Tests of the choice between CPU and GPU: setting, measurement and fallback, with simulated devices."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from carina import _core
from carina.errors import RenderError
from carina.render import Adapter, AirwayView, Backend, Picture, Renderer, RenderStats, find_adapters
from carina.render.graphics_device import (
    COMPARED_PICTURES,
    NUM_PAIRS,
    PICTURES_FIRST,
    PICTURES_WITHOUT_MAP,
    SLOW_PICTURES,
    SLOWER_PICTURES,
    DeviceCaster,
)
from carina.render.processor_choice import differing_share
from carina.scopes import Pose

CARD = Adapter(0, "Card 9000", "vulkan", "driver 1.2", "discrete")
LAVAPIPE = Adapter(1, "llvmpipe", "vulkan", "Mesa 22", "software")
VIEW = AirwayView(Pose.looking((0.0, 0.0, 0.0), (0, 0, 1)), width=128, height=96)


class SimulatedDevice:
    """Simulated device that offers both casters, counts calls and fails on request."""

    def __init__(self, *, gpu_ms=2.0, cpu_ms=10.0, off=0):
        self.ms = {"gpu": gpu_ms, "cpu": cpu_ms}
        self.off = off
        self.now = 0.0
        self.light = 200
        self.error = None
        self.upload_error = None
        self.uploads = []
        self.casts = []

    def open(self, index):
        return self

    def upload(self, hu_zyx, radius_zyx=None):
        if self.upload_error is not None:
            raise self.upload_error
        self.uploads.append(hu_zyx)
        return SimpleNamespace(values=hu_zyx, with_map=lambda radius=None: SimpleNamespace(values=hu_zyx, map=radius))

    def cast(self, scene, view, gpu):
        who = "cpu" if gpu is None else "gpu"
        self.casts.append(who)
        self.now += self.ms[who] / 1e3
        if gpu is not None:
            if self.error is not None:
                raise self.error
            assert gpu.values is scene.values, "a picture of another volume"
        rgb = np.full((view.height, view.width, 3), self.light, dtype=np.uint8)
        if gpu is not None:
            rgb.reshape(-1)[: self.off * 3 : 3] += 2
        method = "leap" if scene.maps is not None else "brute"
        name = method if gpu is None else f"gpu-{method}"
        return Picture(rgb=rgb, view="airway", stats=RenderStats(name, view.width, view.height, *[0] * 7, seconds=0.0))


def a_scene(*, maps=True):
    radius = np.zeros((4, 5, 6), dtype=np.uint8)
    return SimpleNamespace(
        values=np.zeros((4, 5, 6), dtype=np.int16), maps=SimpleNamespace(radius=radius) if maps else None
    )


class BackendFixture:
    """Caster with a simulated device, whose background work waits until the test calls ``run_work``."""

    def __init__(self, stand_in, mode, *, adapters=(CARD, LAVAPIPE), record=None):
        self.device = stand_in
        self.work = []
        self.backend = Backend(mode, record=record, find=lambda: adapters, open_device=stand_in.open)
        self.caster = DeviceCaster(self.backend, stand_in.cast, start=self.work.append, clock=lambda: stand_in.now)

    def picture(self, scene, view=VIEW):
        """Render a picture as ``AirwayCaster`` does and return the device used: "cpu" or "gpu"."""
        leaps = scene.maps is not None
        picture = self.caster.try_cast(scene, view, leaps=leaps, cast=self.device.cast)
        if picture is None:
            started = self.device.now
            picture = self.device.cast(scene, view, None)
            self.caster.count_cpu_picture(scene, view, self.device.now - started)
        return "gpu" if picture.stats.method.startswith("gpu-") else "cpu"

    def run_work(self):
        while self.work:
            self.work.pop(0)()

    def fly(self, scene, count=10, view=VIEW):
        who = []
        for _ in range(count):
            who.append(self.picture(scene, view))
            self.run_work()
        return who


def test_cpu_backend_is_the_default_and_calls_no_graphics_driver():
    def fail():
        raise AssertionError("a driver was loaded")

    backend = Backend(find=fail)
    assert backend.mode == "cpu"
    assert backend.adapters() == ()
    with pytest.raises(RenderError, match="abacus"):
        Backend("abacus")


def test_faster_graphics_card_is_used_after_the_first_pictures_without_delaying_a_picture():
    fixture = BackendFixture(SimulatedDevice(), "auto")
    scene = a_scene()
    for _ in range(PICTURES_FIRST + 2):
        assert fixture.picture(scene) == "cpu"
        assert not fixture.device.uploads
    assert len(fixture.work) == 1, "measured once, in the background"
    fixture.run_work()
    assert fixture.device.casts.count("gpu") == NUM_PAIRS + 1
    assert fixture.fly(scene, 3) == ["gpu"] * 3
    (measurement,) = fixture.backend.measurements
    assert (measurement.chosen, measurement.adapter, measurement.shape_zyx) == (True, "Card 9000", (4, 5, 6))
    assert (round(measurement.gpu_ms, 6), round(measurement.cpu_ms, 6)) == (2.0, 10.0)


def test_graphics_card_slower_than_the_cpu_is_not_used():
    fixture = BackendFixture(SimulatedDevice(gpu_ms=9.5), "auto")
    assert set(fixture.fly(a_scene())) == {"cpu"}
    assert "no faster" in fixture.backend.measurements[0].why
    assert fixture.caster._resident is None, "the memory of the device is released"


def test_graphics_card_whose_picture_differs_from_that_of_the_cpu_is_not_used_at_any_speed():
    allowed = VIEW.width * VIEW.height // 1000
    assert "gpu" in BackendFixture(SimulatedDevice(gpu_ms=0.1, off=allowed), "auto").fly(a_scene())
    fixture = BackendFixture(SimulatedDevice(gpu_ms=0.1, off=allowed + 1), "auto")
    assert set(fixture.fly(a_scene())) == {"cpu"}
    assert "differs" in fixture.backend.measurements[0].why


def test_software_adapter_is_used_only_on_request():
    fixture = BackendFixture(SimulatedDevice(gpu_ms=0.1), "auto", adapters=(LAVAPIPE,))
    assert set(fixture.fly(a_scene())) == {"cpu"}
    assert fixture.device.casts.count("gpu") == 0
    assert set(BackendFixture(SimulatedDevice(), "gpu", adapters=(LAVAPIPE,)).fly(a_scene())) == {"gpu"}


def test_graphics_card_is_measured_with_brute_force_after_a_while_if_no_isoregion_map_is_built():
    fixture = BackendFixture(SimulatedDevice(), "auto")
    who = fixture.fly(a_scene(maps=False), PICTURES_WITHOUT_MAP + 2)
    assert who == ["cpu"] * PICTURES_WITHOUT_MAP + ["gpu"] * 2


def test_speed_of_the_graphics_card_is_not_measured_with_small_or_dark_pictures():
    fixture = BackendFixture(SimulatedDevice(), "auto")
    small = dataclasses.replace(VIEW, width=64, height=64)
    assert set(fixture.fly(a_scene(), view=small)) == {"cpu"}
    fixture.device.light = 10
    assert set(fixture.fly(a_scene())) == {"cpu"}
    assert not fixture.backend.measurements
    fixture.device.light = 200
    assert fixture.fly(a_scene())[-1] == "gpu"


def test_changed_voxels_are_uploaded_in_the_background_and_a_new_map_without_the_volume():
    fixture = BackendFixture(SimulatedDevice(), "auto")
    scene = a_scene()
    fixture.fly(scene)
    walled = a_scene()
    assert fixture.picture(walled) == "cpu"
    fixture.run_work()
    assert fixture.picture(walled) == "gpu"
    assert len(fixture.device.uploads) == 2
    other = SimpleNamespace(values=walled.values, maps=SimpleNamespace(radius=np.ones((4, 5, 6), dtype=np.uint8)))
    assert fixture.picture(other) == "cpu"
    fixture.run_work()
    assert fixture.picture(other) == "gpu"
    assert len(fixture.device.uploads) == 2


@pytest.mark.parametrize("mode", ["auto", "gpu"])
def test_lost_graphics_device_loses_no_picture_and_logs_one_message(mode, caplog):
    fixture = BackendFixture(SimulatedDevice(), mode, adapters=(CARD,))
    scene = a_scene()
    assert fixture.fly(scene)[-1] == "gpu"
    fixture.device.error = RenderError("the graphics device Card 9000 cannot be used: lost", code="render.gpu")
    assert set(fixture.fly(scene)) == {"cpu"}
    fixture.device.error = None
    assert set(fixture.fly(a_scene())) == {"cpu"}, "not trusted again in this process"
    assert [record.levelname for record in caplog.records if record.levelno >= 30] == ["WARNING"]
    assert "lost" in caplog.text


def test_graphics_device_that_has_become_slow_is_given_up_with_one_message(caplog):
    fixture, scene = BackendFixture(SimulatedDevice(gpu_ms=2.0, cpu_ms=10.0), "auto"), a_scene()
    for _ in range(PICTURES_FIRST):
        fixture.picture(scene)
    fixture.run_work()
    assert fixture.picture(scene) == "gpu"
    fixture.device.ms["gpu"] = 500.0
    for _ in range(SLOW_PICTURES - 1):
        assert fixture.picture(scene) == "gpu"
    fixture.device.ms["gpu"] = 2.0
    assert fixture.picture(scene) == "gpu", "a few slow pictures have other causes"
    fixture.device.ms["gpu"] = 500.0
    for _ in range(SLOW_PICTURES):
        assert fixture.picture(scene) == "gpu"
    assert fixture.picture(scene) == "cpu"
    assert "has become slow" in caplog.text


def test_slow_graphics_device_stays_in_use_if_the_user_chose_it():
    fixture, scene = BackendFixture(SimulatedDevice(gpu_ms=500.0, cpu_ms=10.0), "gpu"), a_scene()
    assert {fixture.picture(scene) for _ in range(2 * SLOW_PICTURES)} == {"gpu"}


def test_graphics_device_is_used_for_other_volumes_after_a_volume_that_is_too_large(caplog):
    fixture = BackendFixture(SimulatedDevice(), "gpu", adapters=(CARD,))
    fixture.device.upload_error = RenderError(
        "the volume does not fit in the memory of the graphics device", code="render.gpu-limit"
    )
    large = a_scene()
    assert set(fixture.fly(large)) == {"cpu"}
    assert len([record for record in caplog.records if record.levelno >= 30]) == 1
    fixture.device.upload_error = None
    assert set(fixture.fly(large)) == {"cpu"}
    assert set(fixture.fly(a_scene())) == {"gpu"}


def test_invalid_render_setting_raises_an_error_and_the_graphics_device_stays_in_use():
    fixture = BackendFixture(SimulatedDevice(), "gpu")
    fixture.device.error = RenderError("rows: expected a range", code="render.setting")
    with pytest.raises(RenderError, match="rows"):
        fixture.picture(a_scene())


def test_stored_speed_measurement_is_reused_and_one_picture_is_compared_again(tmp_path):
    record = tmp_path / "cache" / "backend.json"
    BackendFixture(SimulatedDevice(), "auto", record=record).fly(a_scene())
    again = BackendFixture(SimulatedDevice(), "auto", record=record)
    assert again.fly(a_scene())[-1] == "gpu"
    assert again.device.casts[: PICTURES_FIRST + 2] == ["cpu"] * (PICTURES_FIRST + 1) + ["gpu"], "one picture each"
    changed = BackendFixture(SimulatedDevice(off=5000), "auto", record=record)
    assert set(changed.fly(a_scene())) == {"cpu"}
    slow = BackendFixture(SimulatedDevice(), "auto", record=record)
    assert set(slow.fly(a_scene())) == {"cpu"}
    assert slow.device.casts.count("gpu") == 0, "the device is known to differ and is not used"


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "carina-backend", "version": 1}', '{"format": 3}'])
def test_graphics_device_with_a_damaged_stored_measurement_is_measured_again(tmp_path, text):
    record = tmp_path / "backend.json"
    record.write_text(text)
    fixture = BackendFixture(SimulatedDevice(), "auto", record=record)
    assert fixture.fly(a_scene())[-1] == "gpu"
    saved = json.loads(record.read_text())
    assert saved["measured"][0]["chosen"] is True
    saved["carina"] = "0.0.0"
    record.write_text(json.dumps(saved))
    assert not Backend("auto", record=record).measurements, "renderers of another version"


def test_share_of_different_pixels_of_two_pictures_counts_pixels_and_not_channels():
    a = np.full((10, 10, 3), 100, dtype=np.uint8)
    b = a.copy()
    b[0, 0] = 102
    b[0, 1] = 101
    assert differing_share(a, b) == 0.01
    assert differing_share(a, b[1:]) == 1.0


def test_build_without_gpu_support_reports_it_and_renders_on_the_cpu(airway):
    if find_adapters() is not None:
        pytest.skip("this build has GPU support")
    with pytest.raises(RenderError, match="not in this build") as caught:
        _core.Gpu(0)
    assert caught.value.code == "render.gpu"
    renderer = Renderer(airway.volume, backend=Backend("gpu"))
    picture = renderer.render(AirwayView(airway.pose, width=40, height=30))
    assert picture.stats.method == "brute"


def test_graphics_device_that_has_become_slower_than_the_cpu_is_compared_again_and_given_up(tmp_path):
    record = tmp_path / "backend.json"
    fixture, scene = BackendFixture(SimulatedDevice(gpu_ms=2.0, cpu_ms=10.0), "auto", record=record), a_scene()
    reported = []
    fixture.backend.subscribe(reported.append)
    assert fixture.fly(scene)[-1] == "gpu"
    fixture.device.ms["gpu"] = 15.0
    assert fixture.fly(scene, SLOWER_PICTURES) == ["gpu"] * SLOWER_PICTURES
    assert set(fixture.fly(scene, 2 * COMPARED_PICTURES)) == {"cpu"}
    assert reported == [fixture.backend.trouble]
    assert "slower than the CPU" in reported[0]
    assert Backend("auto", record=record).measurements[0].chosen, "another program may have used the device"
    fixture.backend.set_mode("auto")
    assert fixture.fly(scene)[-1] == "gpu", "the user's choice permits the device again"


def test_graphics_device_stays_in_use_if_the_pictures_that_took_longer_cost_the_cpu_more_too():
    fixture, scene = BackendFixture(SimulatedDevice(gpu_ms=2.0, cpu_ms=10.0), "auto"), a_scene()
    assert fixture.fly(scene)[-1] == "gpu"
    fixture.device.ms.update(gpu=15.0, cpu=40.0)
    drawn = fixture.fly(scene, SLOWER_PICTURES + COMPARED_PICTURES)
    assert drawn == ["gpu"] * SLOWER_PICTURES + ["cpu"] * COMPARED_PICTURES
    assert set(fixture.fly(scene, SLOWER_PICTURES + 20)) == {"gpu"}, "compared with the CPU's new time"
    assert fixture.backend.trouble is None


def test_a_few_pictures_that_take_longer_start_no_comparison():
    fixture, scene = BackendFixture(SimulatedDevice(gpu_ms=2.0, cpu_ms=10.0), "auto"), a_scene()
    assert fixture.fly(scene)[-1] == "gpu"
    for _ in range(3):
        fixture.device.ms["gpu"] = 15.0
        assert set(fixture.fly(scene, SLOWER_PICTURES - 1)) == {"gpu"}
        fixture.device.ms["gpu"] = 2.0
        assert fixture.picture(scene) == "gpu"


def test_user_may_change_the_processor_while_the_program_runs():
    fixture, scene = BackendFixture(SimulatedDevice(), "cpu"), a_scene()
    assert fixture.picture(scene) == "cpu"
    fixture.backend.set_mode("gpu")
    assert fixture.picture(scene) == "gpu"
    fixture.device.error = RenderError("the graphics device Card 9000 cannot be used: lost", code="render.gpu")
    assert set(fixture.fly(scene)) == {"cpu"}
    assert "lost" in fixture.backend.trouble
    fixture.device.error = None
    fixture.backend.set_mode("gpu")
    assert fixture.backend.trouble is None
    assert fixture.picture(scene) == "gpu", "the user asked for the device again"
    fixture.backend.set_mode("cpu")
    assert fixture.picture(scene) == "cpu"
    assert fixture.caster._resident is None, "the memory of the device is released"
    fixture.backend.set_mode("auto")
    assert fixture.fly(scene)[-1] == "gpu"
    with pytest.raises(RenderError, match="abacus"):
        fixture.backend.set_mode("abacus")


def test_device_picture_of_another_thread_does_not_disturb_the_comparison():
    fixture, scene = BackendFixture(SimulatedDevice(gpu_ms=2.0, cpu_ms=10.0), "auto"), a_scene()
    assert fixture.fly(scene)[-1] == "gpu"
    fixture.device.ms["gpu"] = 15.0
    fixture.fly(scene, SLOWER_PICTURES)
    picture = fixture.device.cast(scene, VIEW, fixture.caster._resident.leaping)
    fixture.caster._count_device_picture(scene, picture, 1e-3)
    assert set(fixture.fly(scene, 2 * COMPARED_PICTURES)) == {"cpu"}
    assert "slower than the CPU" in fixture.backend.trouble


def test_loss_of_a_device_is_reported_after_a_volume_that_does_not_fit():
    fixture = BackendFixture(SimulatedDevice(), "gpu", adapters=(CARD,))
    reported = []
    fixture.backend.subscribe(reported.append)
    fixture.device.upload_error = RenderError("the volume does not fit", code="render.gpu-limit")
    for _ in range(3):  # Each edit of the airways makes new values of the same shape.
        fixture.fly(a_scene())
    assert len(reported) == 1
    fixture.device.upload_error = None
    assert fixture.picture(a_scene()) == "gpu"
    assert fixture.backend.trouble is None
    fixture.device.error = RenderError("the graphics device Card 9000 cannot be used: lost", code="render.gpu")
    fixture.fly(a_scene())
    assert len(reported) == 2
    assert "lost" in fixture.backend.trouble
