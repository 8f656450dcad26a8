"""Tests of case files on the command line: their content, and commands that use the edited tree."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import carina as package
from cached_test_data import cached_phantom
from carina import commands as c
from carina.case import CaseFile, SourceFacts
from carina.commands import Steer
from carina.config import load_settings
from carina.export import read_tree
from carina.navigate import Navigator, Pilot, Recorder, case_key, open_recording
from carina.phantom import write_phantom
from carina.scopes import Pose
from carina.session.open_case.open_case import moment_of
from carina.session.store.case_names import neutral_alias
from carina.session.store.registry import CaseRecords
from carina.version import VERSION
from carina.volume import CtSource, VolumeCache, ct_digest, open_volume
from user_folders import user_folders


@pytest.fixture(scope="session")
def made_case(tmp_path_factory):
    """Return a folder with a CT and its case, and the tree of the case.

    The case has a renamed and a removed branch, a target, two key frames and view settings.
    """
    folder = tmp_path_factory.mktemp("case")
    write_phantom(cached_phantom(spacing_mm=3.0, generations=3), folder / "scans")
    with package.Case.open(folder / "scans" / "ct.nii.gz") as case:
        first, other = case.airways.tree.tips()[:2]
        case.do(c.EditTree(c.RenameBranch(first.id, "near the tumour")))
        case.do(c.EditTree(c.CutBranch(other.id)))
        case.do(c.AddTarget(tuple(float(v) for v in first.points[-1])))
        case.do(c.SetTransfer(preset="ct-grey"))
        case.do(c.GoTo(10.0))
        case.do(c.EditKeyFrames(c.KeyFrameAdd()))
        case.do(c.GoTo(30.0))
        case.do(c.EditKeyFrames(c.KeyFrameAdd()))
        case.do(c.SetShading(False))
        case.do(c.SetFov(100.0))
        case.undo()
        found = case.volume, moment_of(case._session._core.case), case.airways.tree
    volume, moment, tree = found
    with CaseFile.create(folder / "live.carina", SourceFacts.of(volume, ct_digest(volume))) as file:
        file.save(moment)
        file.write_copy(folder / "lunch.carina", ct_place="scans/ct.nii.gz")
    (folder / "live.carina").unlink()
    return folder, tree


@pytest.fixture
def case(made_case, tmp_path):
    """Return the path of a copy of the case that the test may change."""
    folder = tmp_path / "work"
    shutil.copytree(made_case[0], folder)
    return folder / "lunch.carina"


@pytest.fixture(autouse=True)
def nothing_is_searched_for(monkeypatch):
    def searched(*_arguments, **_options):
        pytest.fail("the airways of a case were searched for again")

    monkeypatch.setattr(package, "find_airways", searched, raising=False)


def test_info_command_lists_the_content_of_a_case_without_its_scan(carina, case, made_case):
    shutil.rmtree(case.parent / "scans")
    held = carina("case", "info", case, "--json").json()
    assert held["source"]["path"] == "scans/ct.nii.gz"
    assert len(held["source"]["digest"]) == 64
    assert held["num_branches"] == len(made_case[1])
    assert held["num_edits"] == 2
    assert held["targets"] == ["Target 1"]
    assert held["key_frames"] == ["key-1", "key-2"]
    assert (held["num_steps"], held["num_done"]) == (7, 6)
    assert held["source"]["packed"] is False
    result = carina("case", "info", case).out
    assert "targets: Target 1" in result
    assert "6 changes, 1 undone" in result


def test_history_command_lists_the_label_and_time_of_each_undo_step(carina, case):
    steps = carina("case", "history", case, "--json").json()["steps"]
    assert [step["holds"] for step in steps] == [True] * 6 + [False]
    assert steps[0]["label"].startswith("rename")
    assert steps[0]["command"] == "edit_tree"
    assert [step["at_s"] for step in steps] == sorted(step["at_s"] for step in steps)
    assert "(undone)" in carina("case", "history", case).out


def test_report_export_and_track_commands_use_the_edited_tree_of_a_case(carina, case, made_case, tmp_path):
    tree = made_case[1]
    found = carina("airways", case, "-o", tmp_path / "tree.json", "--json").json()
    assert found["num_branches"] == len(tree)
    assert "near the tumour" in {branch["name"] for branch in found["branches"]}
    written = read_tree(tmp_path / "tree.json")
    assert [b.id for b in written.branches] == [b.id for b in tree.branches]
    assert carina("export", case, "-o", tmp_path / "tree.vtp").code == 0
    target = ",".join(str(v) for v in tree.named("near the tumour").points[-1])
    row = carina("track", case, "--target", target, "--json").json()["targets"][0]
    assert row["length_mm"] == pytest.approx(tree.route_to(tree.named("near the tumour").id).length_mm, abs=6.0)


def test_fly_command_follows_the_key_frames_and_targets_of_a_case(carina, case, tmp_path):
    keys = ("--size", "48x48", "--rate", "2", "--step-vox", "2", "--json")
    quick = (*keys, "--speed", "60", "--pause", "0")
    along = carina("fly", case, "--keys", "all", "-o", tmp_path / "a.mp4", *keys).json()
    assert along["path_mm"] == pytest.approx(20.0, abs=3.0)
    back = carina("fly", case, "--keys", "key-2,key-1", "-o", tmp_path / "b.mp4", *keys).json()
    assert back["path_mm"] == pytest.approx(along["path_mm"], abs=1.0)
    to = carina("fly", case, "--to", "Target 1", "-o", tmp_path / "c.mp4", *quick).json()
    named = carina("fly", case, "--to", "near the tumour", "-o", tmp_path / "d.mp4", *quick).json()
    assert to["path_mm"] == pytest.approx(named["path_mm"], abs=6.0)
    none = carina("fly", case, "--keys", "lunch", "-o", tmp_path / "e.mp4", *keys)
    assert none.code == 2
    assert "key-1, key-2" in none.err


def test_render_command_uses_the_tip_position_and_view_settings_of_a_case(carina, case, tmp_path):
    small = ("--size", "40x40", "--step-vox", "2", "--json")
    shown = carina("render", case, "-o", tmp_path / "a.png", *small).json()
    with CaseFile.open(case, read_only=True) as file:
        moment = file.load(package.open_volume(case.parent / "scans" / "ct.nii.gz"))
    tip = np.array(moment.tip["lps_from_camera"]).reshape(4, 4)
    assert np.allclose(np.array(shown["lps_from_camera"])[:3, 3], tip[:3, 3])
    assert shown["fov_deg"] == pytest.approx(moment.history().current.look.fov_deg)
    carina("render", case, "-o", tmp_path / "b.png", "--transfer", "endoscopic", *small).json()
    assert (tmp_path / "a.png").read_bytes() != (tmp_path / "b.png").read_bytes()


def test_info_command_about_a_case_includes_its_scan(carina, case):
    result = carina("info", case, "--json").json()
    assert result["shape_zyx"] == result["case"]["source"]["shape_zyx"]


# Scan of a case file


def test_case_with_a_moved_scan_is_refused_until_the_new_path_is_given(carina, case, tmp_path):
    (case.parent / "scans").rename(tmp_path / "elsewhere")
    gone = carina("airways", case, "--json")
    assert gone.code == 3
    assert gone.json()["error"]["code"] == "case.no-scan"
    assert "--ct PATH" in gone.err
    assert carina("airways", case, "--ct", tmp_path / "elsewhere" / "ct.nii.gz").code == 0


def test_case_with_another_scan_is_refused_at_any_path(carina, case, tmp_path):
    write_phantom(cached_phantom(seed=3, spacing_mm=3.0, generations=3), tmp_path / "other")
    given = carina("airways", case, "--ct", tmp_path / "other" / "ct.nii.gz")
    assert given.code == 3
    assert "a different CT" in given.err
    shutil.copy(tmp_path / "other" / "ct.nii.gz", case.parent / "scans" / "ct.nii.gz")
    assert "a different CT" in carina("airways", case).err


def test_missing_scan_of_a_case_is_read_from_the_cache_or_from_the_case(carina, case, tmp_path):
    from carina.config import load_settings

    scan = case.parent / "scans" / "ct.nii.gz"
    assert carina("case", "pack", case, "-o", tmp_path / "packed.carina").code == 0
    cache = VolumeCache(load_settings().cache_dir / "volumes", clock=lambda: 4e9)
    assert cache.put(package.open_volume(scan), CtSource.of(scan))
    scan.unlink()
    assert carina("airways", case).code == 0
    shutil.rmtree(load_settings().cache_dir)
    assert carina("airways", case).code == 3
    assert carina("airways", tmp_path / "packed.carina").code == 0
    assert carina("case", "info", tmp_path / "packed.carina", "--json").json()["source"]["packed"] is True


@pytest.mark.parametrize(
    "arguments",
    [
        ["airways", "CT", "--ct", "CT"],
        ["airways", "CASE", "--seed", "0,0,0"],
        ["export", "CASE", "--from-mask", "CT", "-o", "OUT.stl"],
        ["track", "CASE", "--target", "0,0,0", "--root", "0,0,0"],
        ["case", "pack", "CASE", "-o", "CASE"],
        ["case", "migrate", "CASE", "-o", "OUT.txt"],
        ["case", "forget", "nothing"],
        ["case", "forget", ""],
    ],
)
def test_inconsistent_arguments_of_case_commands_are_refused_before_the_case_is_read(
    carina, case, ct, tmp_path, arguments
):
    names = {"CT": ct, "CASE": case}
    given = [names.get(one, tmp_path / one if one.startswith("OUT") else one) for one in arguments]
    ended = carina(*given)
    assert ended.code == 2
    assert ended.err


def test_file_that_is_not_a_case_is_refused_by_case_commands(carina, tmp_path):
    file = tmp_path / "words.carina"
    file.write_text("these are words")
    for verb in (["case", "info"], ["case", "history"], ["info"], ["airways"]):
        ended = carina(*verb, file)
        assert ended.code == 3
        assert "words.carina" in ended.err


def test_migrate_and_rescue_commands_write_new_files_for_an_undamaged_case(carina, case, tmp_path):
    before = case.read_bytes()
    assert carina("case", "migrate", case, "-o", tmp_path / "new.carina").code == 0
    assert carina("case", "rescue", case, "-o", tmp_path / "whole.carina", "--json").json()["lost"] == []
    for name in ("new.carina", "whole.carina"):
        assert carina("case", "info", tmp_path / name, "--json").json()["num_steps"] == 7
    assert case.read_bytes() == before


# Cases that are stored on this computer


def test_stored_cases_are_listed_and_deleted_by_command(carina, tmp_path):
    from carina.config import load_settings

    assert carina("case", "list", "--json").json() == {"cases": []}
    records = CaseRecords(load_settings().cases_dir, lambda: 1_800_000_000.0)
    held = records.begin("ab" * 32, "/scans/one")
    copy = tmp_path / "one.carina"
    copy.write_bytes(b"a copy")
    held.note(num_changes=3, copy_path=str(copy))
    held.path.write_bytes(b"x" * 5000)
    row = carina("case", "list", "--json").json()["cases"][0]
    assert (row["title"], row["num_changes"], row["copy"]) == (neutral_alias(row["id"]), 3, str(copy))
    assert row["bytes"] >= 5000
    listed = carina("case", "list").out
    assert listed.startswith(row["id"][:6])
    assert "3 changes" in listed

    assert carina("case", "forget", row["id"][:6]).code == 2
    assert carina("case", "forget", row["id"][:6], "--yes").code == 2, "it is open"
    held.release()
    result = carina("case", "forget", copy, "--yes", "--json").json()
    assert result["id"] == row["id"]
    assert copy.exists()
    assert carina("case", "list", "--json").json() == {"cases": []}
    assert not list(Path(load_settings().cases_dir).rglob("*.carina"))


def test_cached_scan_is_deleted_together_with_the_last_case_that_uses_it(carina, ct):
    from carina.config import load_settings

    settings = load_settings()
    cache = VolumeCache(settings.cache_dir / "volumes", clock=lambda: 4e9)
    volume = package.open_volume(ct)
    assert cache.put(volume, CtSource.of(ct))
    records = CaseRecords(settings.cases_dir, lambda: 0.0)
    ids = []
    for _ in range(2):
        held = records.begin(ct_digest(volume), str(ct))
        held.path.touch()
        ids.append(held.record.case_id)
        held.release()
    assert carina("case", "forget", ids[0], "--yes", "--json").json()["cache_bytes"] == 0
    assert cache.sizes()
    assert carina("case", "forget", ids[1], "--yes", "--json").json()["cache_bytes"] > 0
    assert not cache.sizes()


def test_help_of_every_case_command_has_an_example(carina):
    for verb in ("info", "history", "list", "forget", "pack", "migrate", "rescue"):
        assert f"Example: carina case {verb}" in " ".join(carina("case", verb, "--help").out.split())
    assert json.dumps(carina("case", "--help").code) == "0"


@pytest.fixture
def recorded(case):
    """Return a case with a recorded flight of two seconds."""
    volume = open_volume(case.parent / "scans" / "ct.nii.gz")
    pilot = Pilot(Navigator(Pose.looking(tuple(volume.centre_lps), (0.0, 0.0, -1.0)), volume=volume))
    with CaseFile.open(case) as file, file.record("Flight 1", begun_s=3.0) as sink:
        recorder = Recorder(pilot, sink, case=case_key(volume), carina=VERSION, now_s=0.0, view={})
        for n in range(1, 21):
            recorder.tick(0.1 * n)
            pilot.apply(Steer(0.5, 0.01, 0.0, 0.0), dt_s=0.1)
        recorder.close()
    return case


def test_recording_of_a_case_is_replayed_and_exported_as_a_file(carina, recorded, tmp_path):
    assert carina("case", "info", recorded, "--json").json()["recordings"][0]["name"] == "Flight 1"
    quick = ("--size", "48x48", "--rate", "2", "--step-vox", "2", "--json")
    ends = [
        carina("fly", recorded, "--recording", name, "-o", tmp_path / f"{n}.mp4", *quick).json()
        for n, name in enumerate(("Flight 1", "1"))
    ]
    assert [(end["num_different"], end["complete"]) for end in ends] == [(0, True)] * 2
    assert carina("case", "recording", recorded, "Flight 1", "-o", tmp_path / "flight.jsonl").code == 0
    assert open_recording(tmp_path / "flight.jsonl").length_s == pytest.approx(2.0)
    again = carina("case", "recording", recorded, "Flight 1", "-o", tmp_path / "flight.jsonl")
    assert again.code == 2
    assert "already exists" in again.err
    for verb in (("case", "recording", recorded, "Flight 7"), ("fly", recorded, "--recording", "Flight 7")):
        missing = carina(*verb, "-o", tmp_path / ("x.mp4" if verb[0] == "fly" else "x.jsonl"))
        assert missing.code == 2
        assert "no recording 'Flight 7'; its recordings: Flight 1 (1)" in missing.err


def test_commands_read_a_case_that_is_open_in_a_window_as_last_saved(carina, case, live_case):
    assert [step["label"] for step in carina("case", "history", case, "--json").json()["steps"]][-1] == "renamed since"
    result = carina("case", "info", case)
    assert "is open in Carina; its last saved state is used" in result.err
    assert carina("airways", case, "--json").json()["num_branches"] > 1
    live_case.release()
    assert "renamed since" not in carina("case", "history", case).out


@pytest.fixture
def live_case(case, monkeypatch, tmp_path):
    """Return the live case of a window, which has one more step than its copy."""
    for name, folder in user_folders(tmp_path / "home").items():
        monkeypatch.setenv(name, folder)
    records = CaseRecords(load_settings().cases_dir, lambda: 1_800_000_000.0)
    with CaseFile.open(case, read_only=True) as copy:
        held = records.begin(copy.digest, str(case.parent / "scans" / "ct.nii.gz"))
        copy.write_copy(held.path)
        volume = package.open_volume(case.parent / "scans" / "ct.nii.gz")
        moment = copy.load(volume)
    held.note(copy_path=str(case))
    with CaseFile.open(held.path) as live:
        steps = moment.steps[: moment.position]
        live.save(replace(moment, steps=(*steps, replace(steps[-1], label="renamed since")), position=len(steps) + 1))
        yield held
    held.release()
