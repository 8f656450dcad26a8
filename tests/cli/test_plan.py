"""Tests of the command ``carina plan``: its plan equals the plan in Python, in the terminal and in files."""

from __future__ import annotations

import json
from functools import cache, partial

import numpy as np
import pytest
from typer.testing import CliRunner

import carina
import carina.track
from cached_test_data import cached_phantom, found_airways
from carina.cli.app import app
from carina.config import load_settings
from carina.plan import judge_pairs
from carina.scopes import scope_presets
from carina.session import LocalStore
from carina.volume import write_grid
from second_scan import write_second_ct

CHEST = {"seed": 4, "spacing_mm": 1.2, "generations": 5, "nodule": True}
"""Options of the chest with a nodule, also of the browser tests of plans, which share its second CT."""


@pytest.fixture(scope="module")
def chest(tmp_path_factory):
    """Return the file of a chest with a nodule, and a point in the nodule as an argument."""
    made = cached_phantom(**CHEST)
    folder = tmp_path_factory.mktemp("chest")
    carina.write_phantom(made, folder)
    return folder / "ct.nii.gz", made.truth["nodule"]["centre_lps"]


@cache
def wall_of(airways: carina.Airways) -> carina.WallField:
    return carina.track.wall_field(airways.tracker.grid.ct, airways)


@pytest.fixture
def found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Search for the airways and their wall only once for each CT, to save time."""
    monkeypatch.setattr(carina, "find_airways", lambda volume, **_options: found_airways(volume))
    monkeypatch.setattr(carina, "wall_field", lambda _volume, airways: wall_of(airways))


@pytest.fixture
def undriven(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate no drive, because tests of other parts of the plan do not depend on it."""
    monkeypatch.setattr(carina, "plan_route", partial(carina.plan_route, drives=0))
    monkeypatch.setattr("carina.cli.plan.judge_scopes", lambda *_given, **_options: ())


def run(path, place, *more):
    point = ",".join(f"{v:.2f}" for v in place)
    return CliRunner().invoke(app, ["plan", str(path), "--target", point, *more])


def test_plan_command_prints_and_writes_the_plan_of_the_python_function(chest, tmp_path) -> None:
    path, place = chest
    output = tmp_path / "plan.json"
    result = run(path, place, "--json", "-o", str(output), "--carina-depth-mm", "265")
    assert result.exit_code == 0, result.output
    document = json.loads(output.read_text(encoding="utf-8"))
    printed = json.loads(result.stdout)
    assert printed.pop("badges") == []
    assert printed == document
    volume = carina.open_volume(path)
    at = [round(float(v), 2) for v in place]
    verdicts = document["verdicts"]
    alone = carina.plan_route(volume, carina.find_airways(volume), at).to_json()
    assert {name: document[name] for name in alone} == alone
    assert document["turns"]["turns"] and document["report"]["route"] == 1
    # The depth at nose or mouth is that of the main carina plus the distance past it.
    depth_mm = 265.0 + alone["routes"][0]["from_carina_mm"]
    assert document["turns"]["park_depth_estimate_mm"] == depth_mm
    (length,) = [check for check in verdicts[0]["checks"] if check["name"] == "length"]
    assert length["words"].startswith(f"needs a working length of {depth_mm:.0f} mm")
    assert [one["scope"] for one in verdicts] == ["thin"]
    assert f"on route 1: {verdicts[0]['words']}" in result.stderr
    assert "target: solid nodule" in result.stderr
    # The list of reasons is that of the file, in its order.
    reasons = document["report"]["reasons"]
    assert reasons, "the planned scope is too wide for this chest"
    lines = result.stderr.splitlines()
    first = lines.index("against this plan, and its limits:") + 1
    marks = {"stop": "!", "caution": "-"}
    assert lines[first : first + len(reasons)] == [f"{marks[one['severity']]} {one['words']}" for one in reasons]
    assert "route 1: " in result.stderr and "needle" in result.stderr
    assert "in the procedure the target may lie up to" in result.stderr


@pytest.fixture(scope="module")
def mirrored_chest(chest, tmp_path_factory):
    """Return the file of the chest with left and right exchanged, and the point in its nodule as an argument."""
    volume = carina.open_volume(chest[0])
    place = volume.lps_from_ijk.copy()
    place[0] *= -1.0
    path = tmp_path_factory.mktemp("mirrored") / "ct.nrrd"
    write_grid(path, volume.hu_zyx, place, what="a mirrored chest")
    return path, np.array(chest[1]) * (-1.0, 1.0, 1.0)


def test_plan_command_reports_a_mirrored_chest_in_the_terminal_and_as_a_badge(
    mirrored_chest, found_once, undriven, tmp_path
) -> None:
    path, place = mirrored_chest
    output = tmp_path / "plan.json"
    result = run(path, place, "--json", "-o", str(output))
    assert result.exit_code == 0, result.output
    assert [badge["code"] for badge in json.loads(result.stdout)["badges"]] == ["track.mirrored"]
    assert result.stderr.count("note: the airways are mirrored: the three-lobed lung is on the patient's left") == 1


def test_airways_command_reports_a_mirrored_chest_in_the_terminal_and_as_a_badge(
    mirrored_chest, found_once, tmp_path
) -> None:
    tree = tmp_path / "tree.json"
    result = CliRunner().invoke(app, ["airways", str(mirrored_chest[0]), "--json", "-o", str(tree)])
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert [badge["code"] for badge in document["badges"]] == ["track.mirrored"]
    assert any(note.startswith("the airways are mirrored") for note in document["notes"])
    assert result.stderr.count("note: the airways are mirrored") == 1
    assert [badge["code"] for badge in json.loads(tree.read_text(encoding="utf-8"))["badges"]] == ["track.mirrored"]


@pytest.fixture(scope="module")
def thick_chest(tmp_path_factory):
    """Return the file of a chest with a nodule in slices of 3 mm, and a point in the nodule as an argument."""
    made = cached_phantom(seed=4, spacing_mm=(0.8, 0.8, 3.0), generations=5, nodule=True)
    folder = tmp_path_factory.mktemp("thick")
    carina.write_phantom(made, folder)
    return folder / "ct.nii.gz", made.truth["nodule"]["centre_lps"]


def test_plan_in_thick_slices_states_the_calibrated_detection_shares_in_every_output(
    thick_chest, found_once, tmp_path
) -> None:
    path, place = thick_chest
    output = tmp_path / "plan.html"
    result = run(path, place, "--json", "-o", str(output))
    assert result.exit_code in (0, 4), result.output
    document = json.loads(result.stdout)
    (badge,) = [one for one in document["badges"] if one["code"] == "track.thick-slices"]
    assert result.stderr.count(f"note: {badge['words']}") == 1
    assert badge["words"] in document["notes"]
    sentence = badge["words"][0].upper() + badge["words"][1:]
    assert sentence + "." in [one["words"] for one in document["report"]["reasons"]]
    assert not [one for one in document["report"]["uncertain"] if badge["words"][1:] in one]
    assert sentence in " ".join(output.read_text(encoding="utf-8").split())
    shares = document["calibrated_shares"]
    assert (shares["slice_mm"], shares["distance_mm"]) == (3.0, 3.0)
    assert all(f"{100 * one['most']:.0f} %" in sentence for one in shares["shares"])


def test_plan_command_without_a_route_exits_with_code_4_and_the_reason(
    chest, found_once, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, place = chest
    from carina.plan.routes import plan_route

    monkeypatch.setattr(plan_route, "MAX_ANGLE_DEG", -1.0)
    result = run(path, place)
    assert result.exit_code == 4
    assert "! No route: " in result.stderr and "another access" in result.stderr


@pytest.mark.parametrize(
    ("more", "code", "text"),
    [
        (["--tool", "saw"], 2, "no tool is called 'saw'"),
        (["--scope", "long"], 2, "long"),
        (
            ["--moved-mm", "3", "--second-ct", "other.nii.gz"],
            2,
            "--second-ct measures the movement that --moved-mm states",
        ),
        (["--moved-mm", "-3"], 2, "--moved-mm: expected a number from 0 to 60 mm; found -3"),
        (["-o", "plan.txt"], 2, ".html, .pdf, .json"),
        (["--paper", "A3", "-o", "plan.pdf"], 2, "expected A4 or Letter"),
    ],
)
def test_plan_command_with_invalid_options_is_refused_with_a_message(
    chest, found_once, more: list[str], code: int, text: str
) -> None:
    path, place = chest
    result = run(path, place, *more)
    assert result.exit_code == code and text in result.stderr


def test_plan_command_for_a_position_without_a_nodule_is_refused(chest) -> None:
    path, place = chest
    result = run(path, [place[0], place[1], place[2] + 45.0])
    assert result.exit_code in {2, 4} and "nodule" in result.stderr


def test_plan_with_all_scopes_lists_a_verdict_for_each_pair_and_ranks_available_instruments_first(
    chest, found_once, monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    path, place = chest
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    # The results of the drive searches are tested elsewhere, so their effort is small here.
    monkeypatch.setattr("carina.cli.plan.judge_pairs", partial(judge_pairs, effort=200.0))
    # The windows' setting is stored in the test's own folder.
    LocalStore(load_settings().config_dir).set_available_scopes(("thin", "an unknown one"))
    result = run(path, place, "--all-scopes", "--json")
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    verdicts, pairs = document["verdicts"], document["pairs"]
    keys = [route["key"] for route in document["routes"][:3]]
    assert {(one["scope"], one["route"]) for one in pairs} == {(s.name, key) for s in scope_presets() for key in keys}
    assert [one["available"] for one in pairs] == [True] * len(keys) + [False] * (len(pairs) - len(keys))
    assert {one["scope"] for one in pairs[: len(keys)]} == {"thin"}
    some = run(path, place, "--available", "ultrathin,therapeutic", "--json")
    first = json.loads(some.stdout)["pairs"][: 2 * len(keys)]
    assert {one["scope"] for one in first} == {"ultrathin", "therapeutic"} and all(one["available"] for one in first)
    assert "of 2 available instruments" in some.stderr or "best pair: " in some.stderr
    assert run(path, place, "--available", "no-scope").exit_code == 2
    assert [one["scope"] for one in verdicts] == [one.name for one in scope_presets()]
    assert all(one["outcome"] in {"reaches", "may reach", "does not reach", "cannot say"} for one in verdicts)


def test_plan_for_a_mask_is_written_for_slicer_and_as_a_report(chest, found_once, undriven, tmp_path) -> None:
    path, place = chest
    volume = carina.open_volume(path)
    nodule = carina.grow_nodule(volume, place)
    nz, ny, nx = volume.shape_zyx
    ijk = np.stack(np.meshgrid(np.arange(nx), np.arange(ny), np.arange(nz), indexing="ij"), axis=-1)
    near = np.abs(ijk - volume.to_ijk(np.array(place))).max(axis=-1) < 14
    inside = np.zeros((nx, ny, nz), dtype=np.uint8)
    points = ijk[near] @ np.array(volume.lps_from_ijk)[:3, :3].T + np.array(volume.lps_from_ijk)[:3, 3]
    inside[near] = nodule.contains(points)
    mask = tmp_path / "nodule.nrrd"
    write_grid(mask, np.ascontiguousarray(inside.transpose(2, 1, 0)), volume.lps_from_ijk, what="a nodule")
    markups, page = tmp_path / "plan.mrk.json", tmp_path / "plan.html"
    for output in (markups, page):
        result = CliRunner().invoke(app, ["plan", str(path), "--target", str(mask), "-o", str(output)])
        assert result.exit_code == 0, result.output
        assert f"wrote {output}" in result.stderr
        assert "target: for comparison: the file's boundary has " in result.stderr
        assert "a click at its middle gives " in result.stderr
    drawn = json.loads(markups.read_text(encoding="utf-8"))["markups"]
    assert {one["coordinateSystem"] for one in drawn} == {"LPS"}
    assert "not a medical device" in page.read_text(encoding="utf-8").lower()


@pytest.mark.parametrize(
    ("more", "text"),
    [(["--send", "nowhere"], "expected HOST:PORT"), (["--send", "127.0.0.1:1"], "nothing listens there")],
)
def test_plan_command_with_an_invalid_receiver_address_is_refused(
    chest, found_once, undriven, more: list[str], text: str
) -> None:
    path, place = chest
    result = run(path, place, *more)
    assert result.exit_code != 0 and text in result.stderr


def test_plan_with_a_second_ct_states_the_measured_movement_in_terminal_and_json(
    chest, found_once, undriven, tmp_path
) -> None:
    path, place = chest
    second = write_second_ct(cached_phantom(**CHEST).volume, tmp_path / "second.nii.gz")
    result = run(path, place, "--json", "--second-ct", str(second))
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert document["movement"]["origin"] == "measured" and document["movement"]["error_mm"] > 0.0
    assert 0.5 < document["moved_mm"] == document["movement"]["most_mm"] < 20.0
    assert len(document["second_ct"]["forks"]) >= 8
    assert "second CT: " in result.stderr and "Movement of the target measured from the second CT: " in result.stderr


def test_second_ct_that_shows_half_of_the_chest_is_refused_with_its_error_code(chest, found_once, tmp_path) -> None:
    path, place = chest
    volume = carina.open_volume(path)
    half = tmp_path / "half.nii.gz"
    write_grid(half, volume.hu_zyx[: len(volume.hu_zyx) // 4], volume.lps_from_ijk, what="the CT")
    result = run(path, place, "--json", "--second-ct", str(half))
    assert result.exit_code == 4
    assert json.loads(result.stdout)["error"]["code"] == "movement.half-chest"
    result = run(path, place, "--second-ct", str(path))
    assert result.exit_code == 4 and "the second CT is the CT of this plan" in result.stderr


def test_compare_command_prints_one_ranking_with_its_rule_c_arm_angles_stations_and_predictors(
    chest, found_once, undriven
) -> None:
    path, place = chest
    beside = ",".join(f"{v + 1.0:.2f}" for v in place)
    result = run(path, place, "--json", f"--compare={beside}")
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert len(document["comparison"]["targets"]) == 2
    assert document["comparison"]["order"] in result.stderr
    first = document["routes"][0]
    own = [one for one in document["comparison"]["targets"] if one["narrowest_mm"] == first["narrowest_mm"]]
    assert own
    assert document["c_arm"]["route"] == first["key"]
    assert "C-arm on route 1:" in result.stderr
    assert "bifurcation angle" in result.stderr
    assert document["ebus"]["stations"]
    assert "EBUS: station" in result.stderr
