"""Tests of the cache of opened CTs: equal results with and without it, detection of changes and damage, limits."""

from __future__ import annotations

import dataclasses
import errno
import logging
import os
import shutil
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import dicom_writer
import grid_writers
import numpy as np
import pytest

from carina import _core
from carina.disk import disk_trouble
from carina.disk.locks import try_lock
from carina.errors import CancelledError, VolumeImportError
from carina.volume import (
    CtSource,
    Volume,
    VolumeCache,
    cache,
    code_digest,
    ct_digest,
    demo_patient,
    open_volume,
    quality,
    voxel_file,
    write_grid,
)
from carina.volume.voxel_file import SUFFIX

DAY_S = 86_400.0


class Clock:
    """Clock in seconds since 1970 that starts 100 s after the real time.

    So the cache accepts all files as old enough.
    """

    def __init__(self) -> None:
        self.now_s = time.time() + 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return the folder in which the cache stores its files."""
    return tmp_path / "cache" / "volumes"


@pytest.fixture
def volume_cache(folder: Path, clock: Clock) -> VolumeCache:
    return VolumeCache(folder, max_bytes=1 << 30, clock=clock)


def chest_file(folder: Path, seed: int = 0, name: str = "ct.nrrd") -> Path:
    """Write a CT as NRRD, with different voxels for each seed."""
    values = grid_writers.chest()
    values[0, 0, :8] -= np.arange(8, dtype=np.int16) * seed
    folder.mkdir(exist_ok=True)
    path = folder / name
    grid_writers.nrrd(folder, values).rename(path)
    return path


def open_and_cache(volume_cache: VolumeCache, path: Path, series: str | None = None) -> str:
    """Open the CT from its files, store it in the cache and return its digest."""
    opened = volume_cache.open(path, series=series)
    assert not opened.from_cache
    volume_cache.keep(opened)
    return ct_digest(opened.volume)


def files(folder: Path, suffix: str = "") -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.name.endswith(suffix) and path.name != "lock")


def assert_equal(found: Volume, expected: Volume) -> None:
    """Assert that two volumes are equal in every field, including fields that are computed at their first use."""
    for field in dataclasses.fields(Volume):
        a, b = getattr(found, field.name), getattr(expected, field.name)
        if isinstance(b, np.ndarray):
            assert a.dtype == b.dtype, field.name
            assert a.flags.c_contiguous, field.name
            assert a.flags.writeable is b.flags.writeable, field.name
            assert a.tobytes() == b.tobytes(), field.name
        elif field.name not in ("_range", "_quality", "_digest"):
            assert a == b, field.name
            assert type(a) is type(b), field.name
    assert ct_digest(found) == ct_digest(expected)
    assert found.value_range == expected.value_range
    assert quality.quality_gate(found) == quality.quality_gate(expected)
    assert type(found.source.series) is type(expected.source.series)


def two_series(folder: Path) -> Path:
    """Write a folder with two series and an unusable file, which cause notes on import."""
    dicom_writer.series(folder, number=3)
    dicom_writer.series(folder, hu=dicom_writer.chest(6), number=4, name=lambda index: f"other{index}")
    (folder / "IM900").write_bytes(b"")
    return folder


SOURCES: dict[str, Callable[[Path], Path]] = {
    "a folder of two series": lambda folder: two_series(folder / "scan"),
    "one file of a series": lambda folder: dicom_writer.series(folder / "scan") / "IM003",
    "a pair of header and values": lambda folder: grid_writers.FORMS["nifti pair"](folder, grid_writers.chest()),
    "values that are no HU": lambda folder: grid_writers.nrrd(folder, grid_writers.chest().astype("<f4") * 40.125),
    "values that are no numbers": lambda folder: grid_writers.nifti(
        folder, np.where(grid_writers.chest() > 1000, np.nan, grid_writers.chest()).astype("<f4")
    ),
}


@pytest.mark.parametrize("source", SOURCES)
def test_ct_read_from_the_cache_equals_the_ct_from_its_files_in_every_field(source, volume_cache, tmp_path):
    path = SOURCES[source](tmp_path)
    digest = open_and_cache(volume_cache, path)
    opened = volume_cache.open(path)
    assert opened.from_cache
    assert ct_digest(opened.volume) == digest
    volume = opened.volume
    assert ct_digest(Volume(volume.hu_zyx, volume.lps_from_ijk)) == digest
    assert_equal(opened.volume, open_volume(path))


def test_citation_of_a_ct_is_restored_from_the_cache(volume_cache, tmp_path):
    patient = demo_patient()
    source = CtSource.of(chest_file(tmp_path))
    assert volume_cache.put(patient, source)
    assert_equal(volume_cache.get(source.path), patient)


def test_quality_range_and_digest_of_a_cached_ct_are_restored_and_not_computed_again(
    volume_cache, tmp_path, monkeypatch
):
    path = chest_file(tmp_path)
    open_and_cache(volume_cache, path)
    expected = open_volume(path)
    judged = quality.quality_gate(expected), expected.value_range, ct_digest(expected)
    monkeypatch.setattr(quality, "_judge", None)
    monkeypatch.setattr("carina.volume.digest.canonical_axes", None)
    monkeypatch.setattr("carina._core.value_range", None)
    found = volume_cache.get(path)
    assert (quality.quality_gate(found), found.value_range, ct_digest(found)) == judged


def test_selected_series_is_cached_beside_the_default_series(volume_cache, tmp_path):
    path = two_series(tmp_path / "scan")
    open_and_cache(volume_cache, path)
    assert volume_cache.get(path, series="4") is None
    open_and_cache(volume_cache, path, series="4")
    assert_equal(volume_cache.get(path, series="4"), open_volume(path, series="4"))
    assert_equal(volume_cache.get(path), open_volume(path))


@pytest.mark.skipif(os.name != "posix", reason="modes of POSIX")
def test_cache_files_of_cts_are_private_and_their_names_contain_no_patient_data(volume_cache, folder, tmp_path):
    path = two_series(tmp_path / "DOE_JOHN")
    open_and_cache(volume_cache, path)
    found = files(folder)
    assert len(found) == 2
    for file in found:
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        assert "DOE" not in file.name
        assert "Thorax" not in file.name
        assert "SECRET" not in file.read_bytes().decode("latin-1")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700


def touch(path: Path) -> None:
    os.utime(path, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns + 1))


CHANGES: dict[str, Callable[[Path], object]] = {
    "a file of another time": lambda folder: touch(folder / "IM007"),
    "a file of another size": lambda folder: (folder / "IM900").write_bytes(b"1"),
    "a file more": lambda folder: (folder / "IM901").write_bytes(b""),
    "a file in a new folder below": lambda folder: dicom_writer.series(folder / "sub", hu=dicom_writer.chest(3)),
    "a file less": lambda folder: (folder / "IM019").unlink(),
    "a file of another name": lambda folder: (folder / "IM019").rename(folder / "IM020"),
    "a link to nothing": lambda folder: (folder / "IM902").symlink_to(folder / "nowhere"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_each_kind_of_change_in_the_folder_of_a_cached_ct_is_detected(change, volume_cache, tmp_path):
    path = two_series(tmp_path / "scan")
    digest = open_and_cache(volume_cache, path)
    assert volume_cache.find(path).state == "unchanged"
    CHANGES[change](path)
    found = volume_cache.find(path)
    assert (found.state, found.digest) == ("changed", digest)
    assert volume_cache.get(path) is None
    opened = volume_cache.open(path)
    assert not opened.from_cache
    # The cached volume may still be shown while the digests are compared.
    assert ct_digest(found.load()) == digest


def test_changed_data_file_of_a_detached_header_is_detected(volume_cache, tmp_path):
    path = grid_writers.FORMS["nrrd detached"](tmp_path, grid_writers.chest())
    open_and_cache(volume_cache, path)
    touch(tmp_path / "ct.raw")
    assert volume_cache.find(path).state == "changed"


def test_new_data_file_with_a_preferred_name_beside_a_cached_header_is_detected(volume_cache, tmp_path):
    path = grid_writers.FORMS["nifti pair"](tmp_path, grid_writers.chest())
    (tmp_path / "ct.img").rename(tmp_path / "ct.IMG")
    open_and_cache(volume_cache, path)
    shutil.copy(tmp_path / "ct.IMG", tmp_path / "ct.img")
    assert volume_cache.find(path).state == "changed"


def test_missing_source_of_a_cached_ct_is_reported_and_opening_it_fails(volume_cache, tmp_path):
    path = chest_file(tmp_path)
    digest = open_and_cache(volume_cache, path)
    path.unlink()
    assert volume_cache.find(path).state == "missing"
    assert volume_cache.find_digest(digest).load() is not None
    with pytest.raises(VolumeImportError, match="there is no such file"):
        volume_cache.open(path)


def test_file_written_less_than_two_seconds_ago_is_not_cached(volume_cache, clock, folder, tmp_path):
    path = chest_file(tmp_path)
    clock.now_s = path.stat().st_mtime + 1.5
    open_and_cache(volume_cache, path)
    assert volume_cache.find(path) is None
    clock.now_s += 1.0
    open_and_cache(volume_cache, path)
    assert volume_cache.find(path) is not None


def test_file_that_changes_while_it_is_read_is_not_cached(volume_cache, tmp_path):
    path = chest_file(tmp_path)
    opened = volume_cache.open(path)
    touch(path)
    assert not volume_cache.keep(opened)
    assert volume_cache.find(path) is None


def test_moved_ct_shares_its_cached_voxel_file_and_a_ct_with_other_axes_does_not(volume_cache, folder, clock, tmp_path):
    path = chest_file(tmp_path)
    digest = open_and_cache(volume_cache, path)
    moved = path.rename(tmp_path / "moved.nrrd")
    assert volume_cache.find(moved) is None
    clock.now_s += 10
    assert open_and_cache(volume_cache, moved) == digest
    assert len(files(folder, SUFFIX)) == 1
    assert len(files(folder, ".source")) == 2
    assert volume_cache.find_digest(digest).source.path == moved
    read = open_volume(moved)
    back = Volume(np.ascontiguousarray(read.hu_zyx[::-1]), read.lps_from_ijk @ np.diag([1.0, 1.0, -1.0, 1.0]))
    exported = write_grid(tmp_path / "back.nii", back.hu_zyx, back.lps_from_ijk, what="the CT")
    assert open_and_cache(volume_cache, exported) == digest
    assert len(files(folder, SUFFIX)) == 2
    assert_equal(volume_cache.get(exported), open_volume(exported))


def damage(file: Path, where: str) -> None:
    size = file.stat().st_size
    if where == "emptied":
        os.truncate(file, 0)
    elif where.startswith("cut"):
        os.truncate(file, {"cut in its first bytes": 10, "cut in its header": 40, "cut in its voxels": size - 1}[where])
    elif where == "longer":
        with file.open("ab") as out:
            out.write(b"\0")
    else:
        at = {"first byte": 0, "version": 8, "header's length": 12, "header": 60, "first voxel": 4096, "last": size - 1}
        with file.open("r+b") as out:
            out.seek(at[where])
            byte = out.read(1)[0]
            out.seek(at[where])
            out.write(bytes([byte ^ 0x10]))


@pytest.mark.parametrize(
    "where",
    [
        *("emptied", "cut in its first bytes", "cut in its header", "cut in its voxels", "longer"),
        *("first byte", "version", "header's length", "header", "first voxel", "last"),
    ],
)
def test_damaged_cached_voxel_file_is_removed_and_the_source_is_read(where, volume_cache, folder, tmp_path, caplog):
    path = chest_file(tmp_path)
    expected = open_and_cache(volume_cache, path)
    (voxels,) = files(folder, SUFFIX)
    damage(voxels, where)
    with caplog.at_level(logging.WARNING):
        opened = volume_cache.open(path)
    assert not opened.from_cache
    assert "could not be used" in caplog.text
    assert str(path) not in caplog.text
    assert not voxels.exists()
    assert volume_cache.keep(opened)
    assert ct_digest(opened.volume) == expected
    assert_equal(volume_cache.get(path), open_volume(path))


def test_cached_voxel_file_truncated_while_it_is_read_is_not_used(volume_cache, folder, tmp_path, monkeypatch):
    path = chest_file(tmp_path)
    open_and_cache(volume_cache, path)
    (voxels,) = files(folder, SUFFIX)
    fill = voxel_file._read_full

    def cut_first(file, place):
        fill(file, place)
        os.truncate(voxels, 4096)

    monkeypatch.setattr(voxel_file, "_read_full", cut_first)
    assert volume_cache.get(path) is None


@pytest.mark.parametrize("where", ["emptied", "first byte", "longer"])
def test_damaged_cache_record_of_a_source_is_not_used_and_is_removed(where, volume_cache, folder, tmp_path):
    path = chest_file(tmp_path)
    open_and_cache(volume_cache, path)
    (source,) = files(folder, ".source")
    damage(source, where)
    assert volume_cache.find(path) is None
    volume_cache.sweep()
    assert not source.exists()


def test_change_of_a_byte_of_a_cache_record_is_detected(volume_cache, folder, tmp_path):
    path = chest_file(tmp_path)
    open_and_cache(volume_cache, path)
    (source,) = files(folder, ".source")
    content = source.read_bytes()
    for at in range(0, len(content), 7):
        source.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
        assert volume_cache.find(path) is None, at
    source.write_bytes(content)
    assert volume_cache.find(path) is not None


def test_cached_voxel_file_with_the_name_of_another_ct_is_not_used(volume_cache, folder, tmp_path):
    one, other = chest_file(tmp_path, 1, "a.nrrd"), chest_file(tmp_path, 2, "b.nrrd")
    open_and_cache(volume_cache, one)
    (voxels,) = files(folder, SUFFIX)
    aside = voxels.rename(folder / "aside")
    open_and_cache(volume_cache, other)
    (others,) = files(folder, SUFFIX)
    others.replace(voxels)
    aside.unlink()
    assert volume_cache.get(one) is None


def test_cache_record_of_another_carina_version_is_replaced_and_its_voxels_are_reused(
    volume_cache, folder, tmp_path, monkeypatch
):
    path = chest_file(tmp_path)
    digest = open_and_cache(volume_cache, path)
    (voxels,) = files(folder, SUFFIX)
    before = voxels.stat().st_ino
    monkeypatch.setattr(cache, "reader_digest", lambda: "a newer one")
    assert volume_cache.find(path) is None
    assert volume_cache.find_digest(digest) is None
    open_and_cache(volume_cache, path)
    assert volume_cache.find(path) is not None
    # The voxels are the same, so their file is not written again.
    assert voxels.stat().st_ino == before


@pytest.fixture
def forget_digests():
    """Return a function that makes the digests of the code be computed again, as in another process."""

    def forget():
        code_digest.compiled_code_digest.cache_clear()
        code_digest.reader_digest.cache_clear()

    yield forget
    forget()


def test_ct_that_another_build_of_the_compiled_module_read_is_not_used(
    volume_cache, tmp_path, monkeypatch, forget_digests
):
    path = chest_file(tmp_path)
    open_and_cache(volume_cache, path)
    build = tmp_path / "_core.so"
    shutil.copyfile(_core.__file__, build)
    forget_digests()
    with monkeypatch.context() as patch:
        patch.setattr(_core, "__file__", str(build))
        assert volume_cache.find(path) is not None
        with build.open("ab") as file:
            file.write(b"a corrected decoder")
        forget_digests()
        assert volume_cache.find(path) is None


def test_compiled_module_is_not_read_when_carina_is_imported():
    script = (
        "import carina, carina.cli, carina.volume.cache\n"
        "from carina.volume.code_digest import compiled_code_digest\n"
        "assert compiled_code_digest.cache_info().currsize == 0\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_least_recently_used_ct_is_removed_when_the_cache_is_full(folder, clock, tmp_path):
    paths = [chest_file(tmp_path, seed, f"{seed}.nrrd") for seed in range(3)]
    one = 2 * grid_writers.chest().size + 4096
    volume_cache = VolumeCache(folder, max_bytes=2 * one, clock=clock)
    for path in paths[:2]:
        clock.now_s += 10
        open_and_cache(volume_cache, path)
    clock.now_s += 10
    assert volume_cache.get(paths[0]) is not None  # after this use the second CT is the least recently used one
    clock.now_s += 10
    open_and_cache(volume_cache, paths[2])
    assert [volume_cache.find(path) is not None for path in paths] == [True, False, True]
    assert len(files(folder, SUFFIX)) == len(files(folder, ".source")) == 2
    assert sum(size.num_bytes for size in volume_cache.sizes()) <= 2 * one
    assert [size.last_used_s for size in volume_cache.sizes()] == sorted(
        (s.last_used_s for s in volume_cache.sizes()), reverse=True
    )


def test_ct_larger_than_the_cache_limit_is_not_cached_and_removes_no_other(folder, clock, tmp_path):
    path = chest_file(tmp_path)
    open_and_cache(VolumeCache(folder, max_bytes=1 << 30, clock=clock), path)
    small = VolumeCache(folder, max_bytes=2 * grid_writers.chest().size - 1, clock=clock)
    keep_too = chest_file(tmp_path, 1, "b.nrrd")
    small.keep(small.open(keep_too))
    assert small.find(keep_too) is None
    assert small.find(path) is not None


def test_default_cache_limit_is_a_tenth_of_free_space_and_cache_size_together(folder, clock, monkeypatch):
    usage = shutil.disk_usage(".")
    monkeypatch.setattr(cache.shutil, "disk_usage", lambda _: usage._replace(free=900))
    assert VolumeCache(folder)._size_limit(100) == 100
    monkeypatch.setattr(cache.shutil, "disk_usage", lambda _: usage._replace(free=10**15))
    assert VolumeCache(folder)._size_limit(100) == cache.MAX_BYTES


def test_ct_unused_for_a_long_time_is_removed_from_the_cache(volume_cache, folder, clock, tmp_path):
    paths = [chest_file(tmp_path, seed, f"{seed}.nrrd") for seed in range(2)]
    for path in paths:
        open_and_cache(volume_cache, path)
    clock.now_s += 60 * DAY_S
    assert volume_cache.get(paths[1]) is not None
    clock.now_s += 60 * DAY_S
    assert volume_cache.sweep() > 0
    assert [volume_cache.find(path) is not None for path in paths] == [False, True]


def test_ct_cache_can_be_emptied_and_switched_off_and_on_while_in_use(volume_cache, folder, clock, tmp_path):
    path = chest_file(tmp_path)
    open_and_cache(volume_cache, path)
    assert volume_cache.empty() > 0
    assert volume_cache.sizes() == ()
    open_and_cache(volume_cache, path)
    volume_cache.switch(False)
    assert volume_cache.sizes() == ()
    assert not volume_cache.is_on
    assert volume_cache.can_be_on
    assert not volume_cache.keep(volume_cache.open(path))
    volume_cache.switch(True)
    assert volume_cache.keep(volume_cache.open(path))
    never = VolumeCache(folder, max_bytes=0, clock=clock)
    never.switch(True)
    assert not never.is_on
    assert not never.can_be_on


def test_disabled_ct_cache_stores_nothing_and_its_cleanup_empties_it(volume_cache, folder, clock, tmp_path):
    path = chest_file(tmp_path)
    open_and_cache(volume_cache, path)
    off = VolumeCache(folder, max_bytes=0, clock=clock)
    assert not off.is_on
    opened = off.open(path)
    assert (opened.from_cache, opened.source) == (False, None)
    off.keep(opened)
    off.sweep()
    assert files(folder) == []


def test_ct_deleted_from_the_cache_is_removed_with_the_records_of_all_its_sources(volume_cache, folder, tmp_path):
    path = chest_file(tmp_path)
    digest = open_and_cache(volume_cache, path)
    open_and_cache(volume_cache, Path(shutil.copy(path, tmp_path / "copy.nrrd")))
    stays = chest_file(tmp_path, 1, "stays.nrrd")
    open_and_cache(volume_cache, stays)
    assert volume_cache.forget(digest) > 2 * grid_writers.chest().size
    assert len(files(folder)) == 2
    assert volume_cache.get(stays) is not None
    assert volume_cache.forget(digest) == 0


def test_ct_deleted_from_the_cache_while_it_is_written_is_not_stored(volume_cache, folder, tmp_path):
    path = chest_file(tmp_path)
    opened = volume_cache.open(path)
    digest = ct_digest(opened.volume)

    def forget_now() -> bool:
        if next(folder.glob(".*.draft"), None) is not None:
            volume_cache.forget(digest)
        return False

    assert not volume_cache.put(opened.volume, opened.source, cancel=forget_now)
    assert files(folder) == []
    # A later request stores the CT again.
    assert volume_cache.put(opened.volume, opened.source)


def test_full_disk_of_the_cache_is_logged_and_the_ct_opens(volume_cache, folder, tmp_path, monkeypatch, caplog):
    def full(*_arguments, **_options):
        raise disk_trouble(OSError(errno.ENOSPC, "full"), "cannot write the cached CT to", folder)

    monkeypatch.setattr(cache, "draft_voxel_file", full)
    with caplog.at_level(logging.WARNING):
        digest = open_and_cache(volume_cache, chest_file(tmp_path))
    assert len(digest) == 64
    assert "could not be cached" in caplog.text
    assert files(folder) == []


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write everywhere")
def test_read_only_cache_folder_does_not_prevent_opening_a_ct(tmp_path, clock):
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    volume_cache = VolumeCache(closed / "volumes", clock=clock)
    open_and_cache(volume_cache, chest_file(tmp_path))
    assert volume_cache.sizes() == ()


def test_opening_from_the_cache_reports_progress_and_can_be_cancelled(volume_cache, tmp_path):
    path = chest_file(tmp_path)
    open_and_cache(volume_cache, path)
    reported: list[tuple[str, float | None]] = []
    assert volume_cache.open(path, progress=lambda *step: reported.append(step)).from_cache
    assert reported[0] == ("Reading the cached CT", 0)
    with pytest.raises(CancelledError):
        volume_cache.open(path, cancel=lambda: True)
    with pytest.raises(CancelledError):
        volume_cache.keep(volume_cache.open(chest_file(tmp_path, 1, "b.nrrd")), cancel=lambda: True)


def test_cleanup_and_deletion_in_the_cache_leave_files_of_other_programs(volume_cache, folder, tmp_path):
    path = chest_file(tmp_path)
    digest = open_and_cache(volume_cache, path)
    for name in ("mine.txt", f"mine{SUFFIX}", f"{digest}{SUFFIX}.txt"):
        (folder / name).write_text("mine")
    (folder / f"link{SUFFIX}").symlink_to(path)
    VolumeCache(folder, max_bytes=0).sweep()
    volume_cache.forget(digest)
    assert {file.name for file in files(folder)} >= {"mine.txt", f"mine{SUFFIX}", f"link{SUFFIX}"}
    assert path.exists()


def test_cache_cleanup_does_nothing_while_another_process_cleans_up(volume_cache, folder, tmp_path):
    open_and_cache(volume_cache, chest_file(tmp_path))
    descriptor = os.open(folder / "lock", os.O_RDWR)
    try:
        assert try_lock(descriptor)
        off = VolumeCache(folder, max_bytes=0)
        assert off.sweep() == 0
        assert len(files(folder)) == 2
    finally:
        os.close(descriptor)
    assert off.sweep() > 0


def test_cache_cleanup_removes_voxel_files_without_a_source_record_after_two_hours(
    volume_cache, folder, clock, tmp_path
):
    path = chest_file(tmp_path)
    open_and_cache(volume_cache, path)
    (source,) = files(folder, ".source")
    source.unlink()
    volume_cache.sweep()
    assert len(files(folder, SUFFIX)) == 1  # another process may be about to write the source record
    clock.now_s += 2 * 3600
    volume_cache.sweep()
    assert files(folder) == []


def test_opened_ct_is_cached_in_the_background(volume_cache, tmp_path):
    path = chest_file(tmp_path)
    opened = volume_cache.open_and_keep(path)
    volume_cache.wait_stored()
    assert volume_cache.find(path) is not None
    assert_equal(volume_cache.open_and_keep(path), opened)


def test_closing_the_cache_cancels_a_pending_write(volume_cache, folder, tmp_path, monkeypatch):
    begun, ended = threading.Event(), threading.Event()
    draft = cache.draft_voxel_file

    def slowly(*arguments, **options):
        begun.set()
        assert ended.wait(60)
        return draft(*arguments, **options)

    monkeypatch.setattr(cache, "draft_voxel_file", slowly)
    volume_cache.open_and_keep(chest_file(tmp_path))
    assert begun.wait(60)
    ending = threading.Thread(target=volume_cache.close)
    ending.start()
    assert volume_cache._ending.wait(60)
    ended.set()
    ending.join()
    assert files(folder) == []
    volume_cache.open_and_keep(chest_file(tmp_path, 1, "b.nrrd"))
    volume_cache.wait_stored()
    assert files(folder) == []


WORKER = """
import sys
from pathlib import Path
from carina.volume import Volume, VolumeCache, ct_digest
folder, paths = Path(sys.argv[1]), [Path(p) for p in sys.argv[2:]]
bound = 2 * (2 * 12 * 20 * 24 + 4096)
kept = VolumeCache(folder, max_bytes=bound, clock=lambda: 4e9)
known = {}
for turn in range(18):
    path = paths[turn % len(paths)]
    opened = kept.open(path)
    volume = opened.volume
    digest = ct_digest(Volume(volume.hu_zyx, volume.lps_from_ijk))
    assert known.setdefault(path, digest) == digest
    kept.keep(opened)
    if turn % 7 == 6:
        kept.forget(digest)
print("whole")
"""


def test_processes_that_share_a_cache_read_complete_volumes_or_none(folder, tmp_path):
    paths = [chest_file(tmp_path, seed, f"{seed}.nrrd") for seed in range(3)]
    orders = [paths, paths[::-1]]
    running = [
        subprocess.Popen(
            [sys.executable, "-c", WORKER, str(folder), *map(str, order)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for order in orders
    ]
    for process in running:
        out, err = process.communicate()
        assert (process.returncode, out) == (0, "whole\n"), err
        assert "cannot be used" not in err
