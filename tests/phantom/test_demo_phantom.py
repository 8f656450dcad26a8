"""Tests of the demo case: its cache on disk, and the checksum of the generated phantom."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from carina.phantom import GENERATOR_VERSION, chest, demo_phantom, generate_phantom


@pytest.fixture
def small_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the options of the demo by small ones, because the real options take seconds."""
    monkeypatch.setattr(chest, "DEMO_OPTIONS", {"seed": 1, "spacing_mm": 5.0, "generations": 4, "nodule": True})


@pytest.mark.usefixtures("small_demo")
def test_demo_phantom_is_generated_once_and_then_read_from_the_cache(tmp_path: Path) -> None:
    reported: list[str] = []
    made = demo_phantom(cache_dir=tmp_path, progress=lambda what, _: reported.append(what))
    assert reported
    reported.clear()
    read = demo_phantom(cache_dir=tmp_path, progress=lambda what, _: reported.append(what))
    assert reported == []
    np.testing.assert_array_equal(read.volume.hu_zyx, made.volume.hu_zyx)
    np.testing.assert_array_equal(read.volume.lps_from_ijk, made.volume.lps_from_ijk)
    np.testing.assert_array_equal(read.lumen_zyx, made.lumen_zyx)
    assert read.lumen_zyx.dtype == np.uint8
    assert read.truth == made.truth | {"nodule": read.truth["nodule"]}
    assert read.volume.source == made.volume.source


@pytest.mark.usefixtures("small_demo")
@pytest.mark.parametrize("name", ["ct.npy", "lumen.npy", "truth.json", "sums.json"])
@pytest.mark.parametrize("damage", ["cut", "changed", "gone"])
def test_demo_phantom_with_a_damaged_cache_file_is_generated_again(tmp_path: Path, name: str, damage: str) -> None:
    made = demo_phantom(cache_dir=tmp_path)
    (file,) = tmp_path.glob(f"phantom-*/{name}")
    data = file.read_bytes()
    if damage == "cut":
        file.write_bytes(data[: len(data) // 2])
    elif damage == "changed":
        file.write_bytes(data[:-9] + bytes([data[-9] ^ 1]) + data[-8:])
    else:
        file.unlink()
    reported: list[str] = []
    again = demo_phantom(cache_dir=tmp_path, progress=lambda what, _: reported.append(what))
    assert reported
    np.testing.assert_array_equal(again.volume.hu_zyx, made.volume.hu_zyx)
    assert [p.name for p in tmp_path.iterdir()] == [file.parent.name], "no other file remains"
    reported.clear()
    demo_phantom(cache_dir=tmp_path, progress=lambda what, _: reported.append(what))
    assert reported == []


@pytest.mark.usefixtures("small_demo")
def test_cached_demo_with_american_field_names_is_read_with_british_names(tmp_path: Path) -> None:
    made = demo_phantom(cache_dir=tmp_path)
    (file,) = tmp_path.glob("phantom-*/truth.json")
    file.write_text(file.read_text(encoding="utf-8").replace('"centre_lps"', '"center_lps"'), encoding="utf-8")
    sums = json.loads((file.parent / "sums.json").read_text(encoding="utf-8"))
    sums["truth.json"] = hashlib.sha256(file.read_bytes()).hexdigest()
    (file.parent / "sums.json").write_text(json.dumps(sums), encoding="utf-8")
    reported: list[str] = []
    read = demo_phantom(cache_dir=tmp_path, progress=lambda what, _: reported.append(what))
    assert reported == [], "the demo is read from the cache and not generated"
    assert read.truth["nodule"]["centre_lps"] == made.truth["nodule"]["centre_lps"]
    assert "center_lps" not in read.truth["nodule"]


@pytest.mark.usefixtures("small_demo")
def test_demo_phantom_is_generated_if_the_cache_cannot_be_written(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder", encoding="utf-8")
    assert demo_phantom(cache_dir=blocked).volume.shape_zyx[0] > 10


def test_phantom_generator_output_matches_the_checksum_of_its_version() -> None:
    made = generate_phantom(seed=7, spacing_mm=6.0, generations=5, stenosis=True, nodule=True)
    found = hashlib.sha256(made.volume.hu_zyx.tobytes() + made.lumen_zyx.tobytes()).hexdigest()[:16]
    # If this assertion fails, the generator makes a different chest from the same options: raise GENERATOR_VERSION, so
    # that cached demos are generated again, and replace the checksum.
    assert (GENERATOR_VERSION, found) == (2, "893589dcaaf69299")
