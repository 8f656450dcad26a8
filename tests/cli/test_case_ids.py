"""Tests of the case IDs that ``carina case list`` prints, which every command that reads a case accepts."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest
from typer.main import get_command

import carina as package
from cached_test_data import cached_phantom
from carina import commands as c
from carina.case import CaseFile, SourceFacts
from carina.cli.app import app
from carina.cli.case_ids import MIN_ID_CHARS, path_or_case, stored_case
from carina.config import load_settings
from carina.errors import UsageError
from carina.phantom import write_phantom
from carina.server import serve as serving
from carina.session.open_case.open_case import moment_of
from carina.session.store.case_names import neutral_alias
from carina.session.store.registry import CaseRecords
from carina.volume import ct_digest

ID = "abcd1234ef567890"


@pytest.fixture(scope="session")
def worked(tmp_path_factory):
    """Return a folder with a scan, its volume, and the content of a case with a target and a key frame."""
    folder = tmp_path_factory.mktemp("worked")
    write_phantom(cached_phantom(spacing_mm=3.0, generations=3), folder)
    with package.Case.open(folder / "ct.nii.gz") as case:
        first = case.airways.tree.tips()[0]
        case.do(c.EditTree(c.RenameBranch(first.id, "near the tumour")))
        case.do(c.AddTarget(tuple(float(v) for v in first.points[-1])))
        case.do(c.EditKeyFrames(c.KeyFrameAdd()))
        found = case.volume, moment_of(case._session._core.case)
    return folder, *found


@pytest.fixture
def stored(carina, worked):
    """Return the case records of this computer, which contain one case."""
    folder, volume, moment = worked
    records = CaseRecords(load_settings().cases_dir, lambda: 1.7e9)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("secrets.token_hex", lambda _: ID)
        held = records.begin(ct_digest(volume), str(folder / "ct.nii.gz"))
    with CaseFile.create(held.path, SourceFacts.of(volume, ct_digest(volume))) as file:
        file.save(moment)
        with file.record("first", begun_s=1.0) as recording:
            recording.write('{"format":"carina-recording","version":1}\n{"end":0.5}\n')
    held.note(num_changes=3)
    held.release()
    return records


def test_commands_read_a_stored_case_by_its_id(carina, stored, tmp_path):
    (listed,) = carina("case", "list", "--json").json()["cases"]
    assert listed["id"] == ID
    short = carina("case", "list").out.split()[0]
    assert ID.startswith(short)
    for name in (ID, short, ID[:MIN_ID_CHARS], ID.upper()):
        info = carina("case", "info", name, "--json")
        assert info.json()["targets"] == ["Target 1"]
        assert f"stored case {ID}, {neutral_alias(ID)}" in info.err
    assert "rename" in carina("case", "history", short).out
    out = tmp_path / "out"
    out.mkdir()
    small = ("--size", "32x32", "--step-vox", "2")
    runs = {
        "info": ("info", short, "--json"),
        "airways": ("airways", short, "-o", out / "tree.json"),
        "export": ("export", short, "-o", out / "tree.vtp"),
        "track": ("track", short, "--target", "0,0,0"),
        "render": ("render", short, "-o", out / "a.png", *small),
        "fly": ("fly", short, "--keys", "all", "-o", out / "a.mp4", *small, "--rate", "2"),
        "isoregion": ("isoregion", short, "-o", out / "map.nrrd"),
        "plan": ("plan", short, "--target", "Target 1"),
        "pack": ("case", "pack", short, "-o", out / "packed.carina"),
        "migrate": ("case", "migrate", short, "-o", out / "migrated.carina"),
        "rescue": ("case", "rescue", short, "-o", out / "rescued.carina"),
        "recording": ("case", "recording", short, "first", "-o", out / "first.jsonl"),
    }
    for name, arguments in runs.items():
        ended = carina(*arguments)
        assert f"stored case {ID}" in ended.err, name
        assert ended.code in ({0} if name not in {"track", "plan", "fly"} else {0, 2, 3, 4}), (name, ended.err)
        assert "case.unknown" not in ended.err
        assert "internal error" not in ended.err
    for name in ("packed", "migrated", "rescued"):
        with CaseFile.open(out / f"{name}.carina", read_only=True) as file:
            assert file.summary().targets == ("Target 1",)


def test_every_command_with_a_case_argument_accepts_an_id():
    """Read the list of commands from the parser, so that it includes new commands."""
    root = get_command(app)
    paths = {}
    for group in (root, root.commands["case"]):
        for name, command in group.commands.items():
            for parameter in command.params:
                if parameter.param_type_name == "argument" and parameter.name == "path":
                    paths[name if group is root else f"case {name}"] = parameter
    assert set(paths) >= {
        "info", "airways", "export", "track", "plan", "render", "fly", "isoregion", "open",
        "case info", "case history", "case pack", "case migrate", "case recording", "case rescue",
    }  # fmt: skip
    for name, parameter in paths.items():
        assert name == "open" or parameter.callback is not None, name
        assert "id of a stored case" in parameter.help, name


def test_command_reads_a_case_that_is_open_in_a_window_and_does_not_change_it(carina, stored):
    held = stored.hold(stored.find(ID))
    with CaseFile.open(held.path) as live:
        before = held.path.read_bytes()
        ended = carina("case", "info", ID, "--json")
        assert ended.json()["num_done"] == 3
        assert "it is open in Carina, so its last saved state is used" in ended.err
        assert held.path.read_bytes() == before
        live.history()
    held.release()


def test_file_or_folder_named_like_a_case_id_has_precedence_over_the_case(carina, stored, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / ID).mkdir()
    assert path_or_case(Path(ID)) == Path(ID)
    assert carina("info", ID).code == 3
    (tmp_path / ID).rmdir()
    (tmp_path / ID).write_text("a letter")
    assert path_or_case(Path(ID)) == Path(ID)
    assert path_or_case(Path("./" + ID[:6])) != Path(ID[:6])
    (tmp_path / ID).unlink()
    (tmp_path / ID).symlink_to("nowhere")
    assert path_or_case(Path(ID)) == Path(ID)


def test_unknown_case_id_is_refused_with_a_reason(carina, stored):
    ended = carina("case", "info", "deadbeef", "--json")
    assert (ended.code, ended.json()["error"]["code"]) == (2, "case.unknown")
    assert "neither a file or folder nor the id of a case on this machine" in ended.err
    assert "carina case list" in ended.err
    # A text that cannot be an ID is treated as a path.
    assert carina("info", "missing/deadbeef").code == 3
    assert carina("info", "deadbeef.carina").code != 2
    assert carina("info", ID[: MIN_ID_CHARS - 1]).code == 3


def test_ambiguous_prefix_of_a_case_id_is_refused_and_the_complete_id_accepted(stored, monkeypatch):
    volume = cached_phantom(spacing_mm=3.0, generations=3).volume
    for other in ("abcd1234ffffffff", ID[:12]):
        held = stored.begin("cd" * 32, None, case_id=other)
        CaseFile.create(held.path, SourceFacts.of(volume, "cd" * 32)).close()
        held.release()
    with pytest.raises(UsageError, match="3 cases on this machine have an id that begins with abcd1234") as refusal:
        stored_case(Path("abcd1234"))
    assert refusal.value.code == "case.unknown"
    assert stored_case(Path("abcd1234f")).case_id == "abcd1234ffffffff"
    # The whole ID of one case is the beginning of another ID.
    assert stored_case(Path(ID[:12])).case_id == ID[:12]


def test_open_command_with_a_case_id_continues_the_stored_case(carina, stored, monkeypatch):
    requested = {}
    monkeypatch.setattr("carina.server.serve", lambda path, **options: requested.update(path=path, **options) or 0)
    assert carina("open", ID[:6], "--no-browser").code == 0
    assert (requested["path"], requested["case_id"]) == (None, ID)
    assert carina("open", "deadbeef").code == 2
    assert "case_id" in inspect.signature(serving).parameters
