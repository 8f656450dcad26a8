"""Tests of output files that cannot be written: the command refuses them before it searches for airways."""

from __future__ import annotations

import numpy as np
import pytest

import carina as package
from carina.volume import write_grid


@pytest.fixture
def long_ct(tmp_path):
    """Return a CT with more slices than NIfTI stores."""
    values = np.full((32768, 3, 3), -1000, np.int16)
    values[:, 1] = 40
    return write_grid(tmp_path / "long.nrrd", values, np.diag([0.7, 0.7, 0.05, 1.0]), what="the scan", level=1)


@pytest.fixture(autouse=True)
def _no_search(monkeypatch):
    def search(*_arguments, **_options):
        pytest.fail("the search has begun")

    for name in ("find_airways", "grow_nodule", "isoregion_map", "wall_field"):
        monkeypatch.setattr(package, name, search, raising=False)


@pytest.mark.parametrize(
    "command", [("airways", "--mask"), ("export", "-o"), ("isoregion", "-o")], ids=lambda command: command[0]
)
def test_grid_that_the_format_cannot_store_is_refused_before_the_airway_search(carina, long_ct, tmp_path, command):
    verb, option = command
    ended = carina(verb, long_ct, option, tmp_path / "out.nii.gz", "--json")
    assert ended.code == 3
    assert ended.json()["error"]["code"] == "geometry.shape"
    assert "NIfTI stores at most 32767; write it as .nrrd" in ended.json()["error"]["message"]
    assert not (tmp_path / "out.nii.gz").exists()


def test_mask_with_an_unknown_suffix_is_refused_before_the_airway_search(carina, ct, tmp_path):
    ended = carina("airways", ct, "--mask", tmp_path / "out.stl", "--json")
    assert ended.code == 2
    assert "--mask: expected a file name that ends in .nii.gz" in ended.json()["error"]["message"]


@pytest.mark.parametrize(("suffix", "options"), [(".seg.dcm", ()), (".sr.dcm", ()), (".pdf.dcm", ("--with-identity",))])
def test_dicom_plan_of_a_ct_that_is_not_dicom_is_refused_before_the_airway_search(
    carina, ct, tmp_path, suffix, options
):
    ended = carina("plan", ct, "--target", "0,0,0", "-o", tmp_path / f"plan{suffix}", *options, "--json")
    assert ended.code == 2
    assert ended.json()["error"]["code"] == "plan.not-dicom"
