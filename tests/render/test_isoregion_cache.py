"""Tests of the cache of IsoRegion maps on disk: reuse, checks, size limit, and storage only of slow maps."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from carina import _core
from carina.render import AirwayView, Renderer, TransferFunction, isoregion_cache, transfer_preset
from carina.render.isoregion_cache import CachedMap, MapCache, MapName
from carina.volume import Volume


@pytest.fixture
def slow(monkeypatch):
    """Make every build of an IsoRegion map count as slow, so that the map is stored."""
    monkeypatch.setattr(isoregion_cache, "SLOW_NS_PER_VOXEL", 0.0)


def view(airway):
    return AirwayView(airway.pose, width=56, height=44)


def test_isoregion_map_that_is_quick_to_build_is_not_stored(airway, tmp_path, monkeypatch):
    monkeypatch.setattr(isoregion_cache, "SLOW_NS_PER_VOXEL", 1e9)
    renderer = Renderer(airway.volume, cache_dir=tmp_path)
    renderer.prepare()
    renderer.wait_stored()
    assert not list(tmp_path.iterdir())
    # The volume is not read for the name of a map that cannot be in the cache.
    monkeypatch.setattr(_core, "content_digest", None)
    Renderer(airway.volume, cache_dir=tmp_path).prepare()


@pytest.mark.usefixtures("slow")
@pytest.mark.parametrize("preset", ["endoscopic", "paper"])
def test_isoregion_maps_are_read_from_disk_and_rebuilt_if_damaged(airway, tmp_path, monkeypatch, preset):
    folder = tmp_path / "maps"
    transfer = transfer_preset(preset)

    def picture():
        renderer = Renderer(airway.volume, transfer=transfer, cache_dir=folder)
        renderer.prepare()
        renderer.wait_stored()
        result = renderer.render(view(airway))
        assert result.stats.method == ("leap-all" if preset == "paper" else "leap")
        return result.rgb

    expected = picture()
    assert expected.max() > 60
    (path,) = folder.iterdir()
    assert path.name.split(".")[0].isalnum(), "a name from the content"

    with monkeypatch.context() as patched:
        for builder in ("build_cell_map", "build_radius_map", "label_values"):
            patched.setattr(_core, builder, None)
        np.testing.assert_array_equal(picture(), expected)

    good = path.read_bytes()
    flipped = [good[:at] + bytes([good[at] ^ 1]) + good[at + 1 :] for at in (0, 9, 13, 40, len(good) - 1)]
    for damaged in (*flipped, good[:-9], good[:30], b"", b"x" * len(good), good + b"x"):
        path.write_bytes(damaged)
        np.testing.assert_array_equal(picture(), expected)
        assert path.read_bytes() == good


@pytest.mark.usefixtures("slow")
def test_isoregion_map_of_another_volume_or_of_other_classes_is_not_read_from_the_cache(airway, tmp_path):
    hu = airway.volume.hu_zyx
    turned = np.ascontiguousarray(hu.transpose(0, 2, 1))
    for volume, transfer in (
        (airway.volume, transfer_preset("endoscopic")),
        (airway.volume, TransferFunction(points=np.array([[-400.0, 1, 1, 1, 0.0], [0.0, 1, 1, 1, 1.0]]))),
        (Volume(hu + np.int16(1), airway.volume.lps_from_ijk), transfer_preset("endoscopic")),
        (Volume(hu.reshape(turned.shape), airway.volume.lps_from_ijk), transfer_preset("endoscopic")),
    ):
        renderer = Renderer(volume, transfer=transfer, cache_dir=tmp_path)
        renderer.prepare()
        renderer.wait_stored()
    assert len(list(tmp_path.iterdir())) == 4


def small_map(n):
    name = MapName(np.full((10, 12, 14), n, dtype=np.int16), "test")
    return name, lambda: CachedMap((np.full((10, 12, 14), n, dtype=np.uint8),))


def test_isoregion_map_of_another_build_of_the_compiled_module_has_another_name(monkeypatch):
    name, _ = small_map(1)
    before = name.full()
    monkeypatch.setattr(isoregion_cache, "compiled_code_digest", lambda: "a corrected builder")
    assert name.full() != before


@pytest.mark.usefixtures("slow")
def test_isoregion_cache_stays_below_its_limit_and_deletes_files_of_a_killed_process(tmp_path, monkeypatch):
    (tmp_path / "left.part").write_bytes(b"half a map")
    monkeypatch.setattr(isoregion_cache, "_ABANDONED_S", -1.0)
    cache = MapCache(tmp_path, max_bytes=5000)
    for n in range(6):
        cache.get_or_build(*small_map(n))
        cache.wait_stored()
    files = list(tmp_path.iterdir())
    assert files
    assert all(path.suffix == ".isoregion" for path in files)
    assert sum(path.stat().st_size for path in files) <= 5000


@pytest.mark.usefixtures("slow")
def test_isoregion_map_is_used_for_pictures_before_it_is_stored(tmp_path, monkeypatch):
    go_on = threading.Event()
    digest = _core.content_digest

    def slowly(voxels):
        assert go_on.wait(30)
        return digest(voxels)

    monkeypatch.setattr(_core, "content_digest", slowly)
    cache = MapCache(tmp_path / "new")
    assert cache.get_or_build(*small_map(3)).arrays[0].min() == 3
    assert not (tmp_path / "new").exists()
    go_on.set()
    cache.wait_stored()
    assert len(list((tmp_path / "new").iterdir())) == 1


@pytest.mark.usefixtures("slow")
def test_pictures_are_rendered_with_a_read_only_or_deleted_isoregion_cache(airway, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    renderer = Renderer(airway.volume, cache_dir=blocked)
    renderer.prepare()
    renderer.wait_stored()
    assert renderer.render(view(airway)).stats.method == "leap"

    folder = tmp_path / "maps"
    renderer = Renderer(airway.volume, cache_dir=folder)
    renderer.prepare()
    renderer.wait_stored()
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    renderer.set_transfer(transfer_preset("paper"))
    renderer.prepare()
    renderer.wait_stored()
    assert renderer.render(view(airway)).stats.method == "leap-all"
