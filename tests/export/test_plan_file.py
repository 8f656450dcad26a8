"""Tests of the export of a plan to the format of a file suffix, and of the requirements of each format."""

from __future__ import annotations

import subprocess
import sys

import pydicom
import pytest
from dicom_writer import series
from sample_plan import a_plan, a_tree

import carina.export
from carina.errors import UsageError
from carina.export import PLAN_FORMATS, export_plan
from carina.volume import Note, open_volume

AIM = (-1.7125, -3.0625, 22.8125)


def test_plan_is_written_in_the_format_of_each_suffix(tmp_path):
    ct = series(tmp_path / "ct")
    plan = a_plan(aim_lps=AIM)
    for suffix in PLAN_FORMATS:
        path = export_plan(tmp_path / f"Plan{suffix.upper()}", plan, a_tree(), volume=open_volume(ct), ct=ct)
        assert path.stat().st_size > 500
    assert pydicom.dcmread(tmp_path / "Plan.SEG.DCM").Modality == "SEG"
    assert pydicom.dcmread(tmp_path / "Plan.SR.DCM").Modality == "SR"


def test_plan_files_for_slicer_contain_the_lasting_notes_of_the_case(tmp_path):
    badge = Note("import.tilt-corrected", "the gantry was tilted by 12.0 degrees", badge=True)
    for suffix in (".mrk.json", ".seg.nrrd"):
        path = export_plan(tmp_path / f"p{suffix}", a_plan(), a_tree(), badges=[badge])
        assert b"the gantry was tilted by 12.0 degrees" in path.read_bytes()


def test_plan_export_without_a_tree_or_ct_that_its_format_requires_is_refused(tmp_path):
    plans = {"A": a_plan(), "B": a_plan()}
    with pytest.raises(UsageError, match=r"\.mrk\.json, \.seg\.nrrd, \.seg\.dcm, \.sr\.dcm; found 'p\.json'"):
        export_plan(tmp_path / "p.json", a_plan(), a_tree())
    with pytest.raises(UsageError, match="airway tree"):
        export_plan(tmp_path / "p.mrk.json", a_plan())
    with pytest.raises(UsageError, match="holds one target and the plan has 2"):
        export_plan(tmp_path / "p.seg.nrrd", plans)
    for name in ("p.seg.dcm", "p.sr.dcm"):
        with pytest.raises(UsageError, match="DICOM folder"):
            export_plan(tmp_path / name, a_plan(), a_tree())
    with pytest.raises(UsageError, match="no target"):
        export_plan(tmp_path / "p.mrk.json", {}, a_tree())
    assert not list(tmp_path.iterdir())


def test_export_package_provides_all_listed_names_and_loads_the_dicom_library_on_first_use():
    assert all(getattr(carina.export, name) is not None for name in carina.export.__all__)
    code = "import sys, carina.export; carina.export.export_plan; print('pydicom' in sys.modules)"
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert ran.stdout.strip() == "False"
