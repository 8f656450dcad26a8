"""Tests of the commands ``carina airways`` and ``carina export``."""

from __future__ import annotations

import json

import numpy as np
import pytest
import SimpleITK as sitk
from edit_case import edit_case, in_plain_lung, open_ended_volume

from cached_test_data import cached_phantom
from carina.export import write_mask
from carina.phantom import write_phantom
from carina.track import find_airways, measure_tree
from carina.volume import open_volume


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("phantom")
    write_phantom(cached_phantom(seed=4, spacing_mm=1.5, generations=3), folder)
    return folder


def test_airways_command_states_the_calibrated_detection_shares_for_thick_slices(carina, tmp_path):
    chest = cached_phantom(seed=4, spacing_mm=(0.8, 0.8, 3.0), generations=4)
    write_phantom(chest, tmp_path)
    found = carina("airways", tmp_path / "ct.nii.gz", "--json")
    report = found.json()
    assert report["calibrated_shares"]["slice_mm"] == 3.0
    assert [share["to_mm"] for share in report["calibrated_shares"]["shares"]] == [None, 6.0, 4.0, 3.0, 2.0]
    (badge,) = [badge for badge in report["badges"] if badge["code"] == "track.thick-slices"]
    share = report["calibrated_shares"]["shares"][3]
    low, mean, high = (f"{100 * share[key]:.0f}" for key in ("least", "typical", "most"))
    assert f"{mean} % ({low} to {high} %) of those of 2 to 3 mm" in badge["words"]
    assert badge["words"] in report["notes"]
    assert f"note: {badge['words']}" in found.err
    printed = carina("airways", tmp_path / "ct.nii.gz")
    assert badge["words"] in printed.out + printed.err


def test_airways_command_states_no_detection_shares_for_thin_slices(carina, case):
    report = carina("airways", case / "ct.nii.gz", "--json").json()
    assert report["calibrated_shares"] is None
    assert report["badges"] == []


def test_airways_command_prints_its_result_and_writes_tree_and_lumen(carina, case, tmp_path):
    tree, lumen = tmp_path / "t.json", tmp_path / "lumen.nii.gz"
    found = carina("airways", case / "ct.nii.gz", "-o", tree, "--mask", lumen, "--json")
    assert found.code == 0
    report = found.json()
    assert report["num_branches"] == len(report["branches"]) == len(json.loads(tree.read_text())["branches"])
    assert report["branches"][0]["name"] == "Trachea"
    inside = sitk.GetArrayFromImage(sitk.ReadImage(str(lumen)))
    truth = sitk.GetArrayFromImage(sitk.ReadImage(str(case / "lumen.nii.gz")))
    assert 2.0 * (inside * truth).sum() / (inside.sum() + truth.sum()) > 0.85
    printed = carina("airways", case / "ct.nii.gz")
    assert "Trachea" in printed.out
    assert "mm wide" in printed.out
    # A bronchus that is divided by its side branches is one row.
    heads = {row["row"] for row in report["branches"]}
    assert sum("mm long" in line for line in printed.out.splitlines()) == len(heads)
    assert all(report["branches"][0].keys() == row.keys() for row in report["branches"])


def test_airways_command_uses_the_given_mask_instead_of_a_search(carina, case, tmp_path):
    written = tmp_path / "lumen.nrrd"
    found = carina("airways", case / "ct.nii.gz", "--from-mask", case / "lumen.nii.gz", "--mask", written, "--json")
    assert found.code == 0
    inside = sitk.GetArrayFromImage(sitk.ReadImage(str(written)))
    truth = sitk.GetArrayFromImage(sitk.ReadImage(str(case / "lumen.nii.gz")))
    assert np.array_equal(inside, truth != 0)


def test_mask_on_another_grid_is_refused_before_the_search(carina, case, tmp_path):
    other = sitk.ReadImage(str(case / "lumen.nii.gz"))
    other.SetSpacing((1.0, 1.0, 1.0))
    sitk.WriteImage(other, str(tmp_path / "other.nii.gz"))
    ended = carina("airways", case / "ct.nii.gz", "--from-mask", tmp_path / "other.nii.gz", "--json")
    assert ended.code == 3
    assert ended.json()["error"]["code"] == "import.mask-grid"
    assert carina("airways", case / "ct.nii.gz", "--label", "2").code == 2


def test_ct_without_airways_exits_with_code_4_and_states_reason_and_remedy(carina, tmp_path):
    image = sitk.GetImageFromArray(np.random.default_rng(0).integers(-100, 100, (20, 40, 40), dtype=np.int16))
    sitk.WriteImage(image, str(tmp_path / "block.nrrd"))
    ended = carina("airways", tmp_path / "block.nrrd", "-o", tmp_path / "t.json", "--json")
    assert ended.code == 4
    assert "trachea" in ended.json()["error"]["message"]
    assert not (tmp_path / "t.json").exists()


@pytest.mark.parametrize("name", ["a.json", "a.vtp", "a.swc", "a.mrk.json", "a.nii.gz", "a.stl", "a.glb"])
def test_export_command_writes_a_file_in_each_tree_format(carina, case, tmp_path, name):
    ended = carina("export", case / "ct.nii.gz", "-o", tmp_path / name, "--json")
    assert ended.code == 0
    assert ended.json()["output"] == str(tmp_path / name)
    assert (tmp_path / name).stat().st_size > 500


def test_export_command_with_a_given_tree_runs_no_search(carina, case, tmp_path):
    truth = case / "truth.json"
    ended = carina("export", case / "ct.nii.gz", "--tree", truth, "-o", tmp_path / "t.swc", "--json")
    assert ended.code == 0
    assert ended.json()["num_branches"] == len(json.loads(truth.read_text())["branches"])
    far = json.loads(truth.read_text())
    for branch in far["branches"]:
        branch["points"] = [[x + 5000.0, y, z] for x, y, z in branch["points"]]
    (tmp_path / "far.json").write_text(json.dumps(far))
    ended = carina("export", case / "ct.nii.gz", "--tree", tmp_path / "far.json", "-o", tmp_path / "far.vtp", "--json")
    assert ended.code == 2
    assert "another patient" in ended.json()["error"]["message"]


def test_export_with_an_unknown_suffix_is_refused_with_the_known_suffixes(carina, case, tmp_path):
    ended = carina("export", case / "ct.nii.gz", "-o", tmp_path / "a.txt", "--json")
    assert ended.code == 2
    assert ".glb" in ended.json()["error"]["message"]


@pytest.fixture(scope="module")
def lung_case(tmp_path_factory):
    """Return a small CT with two paths from an airway into plain lung, and its lumen as a mask file."""
    folder = tmp_path_factory.mktemp("lung")
    volume, airways = open_ended_volume(), edit_case().airways
    image = sitk.GetImageFromArray(volume.hu_zyx)
    spacing = np.array(volume.spacing_mm)
    image.SetSpacing(spacing.tolist())
    image.SetDirection((volume.lps_from_ijk[:3, :3] / spacing).ravel().tolist())
    image.SetOrigin(volume.lps_from_ijk[:3, 3].tolist())
    sitk.WriteImage(image, str(folder / "ct.nii.gz"))
    write_mask(folder / "lumen.nii.gz", airways.lumen_zyx, volume)
    root = ",".join(f"{v:.3f}" for v in airways.root_lps)
    return ["airways", folder / "ct.nii.gz", "--from-mask", folder / "lumen.nii.gz", "--seed", root]


def point(lps):
    return ",".join(f"{v:.3f}" for v in lps)


def test_added_branch_without_evidence_exits_with_code_4_and_the_other_branches_are_written(
    carina, lung_case, tmp_path
):
    tree = tmp_path / "t.json"
    ended = carina(*lung_case, "--add-branch", point(in_plain_lung()), "-o", tree, "--json")
    assert ended.code == 4
    report = ended.json()
    error = report["error"]
    assert error["code"] == "track.no-evidence"
    assert error["doubtful_mm"] > 2.0
    assert len(error["doubtful"]) == len(error["way"]) - 1
    assert np.linalg.norm(np.array(error["way"][-1]) - in_plain_lung()) < 2.0
    assert report["added"] == [{"lps": pytest.approx(in_plain_lung(), abs=1e-3), "branches": [], "error": error}]
    assert "--even-without-evidence" in ended.err
    assert len(json.loads(tree.read_text())["branches"]) == report["num_branches"]
    assert report["drawn_mm"] == 0.0


def test_airways_command_lists_measured_diameters_with_their_errors(carina, lung_case):
    volume = open_volume(lung_case[1])
    root = np.array([float(part) for part in lung_case[-1].split(",")])
    airways = find_airways(volume, root_lps=root, lumen_zyx=edit_case().airways.lumen_zyx)
    measures = measure_tree(volume, airways)
    ended = carina(*lung_case, "--json")
    rows = ended.json()["branches"]
    assert [row["id"] for row in rows] == [branch.branch_id for branch in measures.branches]
    for row, own in zip(rows, measures.branches, strict=True):
        assert row["lumen_mm"] == own.summary.mean_mm
        assert row["lumen_error_mm"] == own.summary.mean_error_mm
    assert f"{rows[0]['lumen_mm']:.1f} mm wide" in carina(*lung_case).out


def test_branch_added_without_evidence_is_labelled_as_such_in_every_output(carina, lung_case, tmp_path):
    tree, lumen, lines = tmp_path / "t.json", tmp_path / "l.nrrd", tmp_path / "t.swc"
    arguments = [*lung_case, "--add-branch", point(in_plain_lung()), "--even-without-evidence", "-o", tree]
    ended = carina(*arguments, "--mask", lumen, "--json")
    assert ended.code == 0
    report = ended.json()
    assert "error" not in report
    (made,) = [row for row in report["added"][0]["branches"] if row["kind"] == "manual"]
    assert made["doubtful_mm"] > 2.0
    assert report["drawn_mm"] > 2.0
    row = next(row for row in report["branches"] if row["id"] == made["id"])
    assert (row["name"], row["confidence"], row["lumen_mm"]) == (None, None, None)
    assert row["doubtful_mm"] == made["doubtful_mm"]
    branch = next(b for b in json.loads(tree.read_text())["branches"] if b["id"] == made["id"])
    assert (branch["kind"], branch["confidence"]) == ("manual", None)
    assert branch["doubtful_mm"] == pytest.approx(made["doubtful_mm"], abs=0.01)
    header = sitk.ReadImage(str(lumen))
    assert any("drawn by hand" in header.GetMetaData(key) for key in header.GetMetaDataKeys())
    assert "drawn by hand: the CT shows no airway here" in carina(*arguments).out
    # Other commands that read the tree also report the branch that was drawn by hand.
    exported = carina("export", lung_case[1], "--tree", tree, "-o", lines)
    assert exported.code == 0
    assert "drawn by hand" in lines.read_text()
    seen = carina(
        "render",
        lung_case[1],
        "--view",
        "straightened",
        "--tree",
        tree,
        "--to",
        made["id"],
        "-o",
        tmp_path / "s.png",
        "--json",
    )
    assert "drawn by hand" in seen.err
    assert seen.json()["drawn_mm"] > 2.0


def test_added_branch_outside_the_scan_and_evidence_option_without_a_branch_are_refused(carina, lung_case):
    outside = carina(*lung_case, "--add-branch", "0,0,9000", "--json")
    assert outside.code == 2
    assert outside.json()["error"]["code"] == "track.outside-volume"
    assert carina(*lung_case, "--even-without-evidence").code == 2
    assert carina(*lung_case, "--add-branch", "1,2").code == 2
