"""Tests of saved connections: private files, no password beside the address, refusals."""

from __future__ import annotations

import json
import stat
import sys
from types import ModuleType

import pytest

from carina.errors import PacsError, UsageError
from carina.pacs import PacsConnection, PacsConnections


@pytest.fixture(autouse=True)
def no_keyring(monkeypatch):
    monkeypatch.setitem(sys.modules, "keyring", None)


def test_connection_is_saved_and_read_with_its_password(tmp_path):
    saved = PacsConnections(tmp_path / "settings")
    one = PacsConnection("hospital", url="https://pacs.example.org/dicom-web", user="erika", password="geheim-1")
    saved.save(one)
    assert PacsConnections(tmp_path / "settings").get("hospital") == one
    assert [found.password for found in saved.all()] == [""]


def test_files_are_readable_by_this_user_alone_and_the_password_is_in_its_own(tmp_path):
    PacsConnections(tmp_path).save(PacsConnection("a", url="https://a.example", user="u", password="geheim-1"))
    files = {path.name: path for path in tmp_path.iterdir()}
    assert sorted(files) == ["pacs-passwords.json", "pacs.json"]
    assert "geheim" not in files["pacs.json"].read_text()
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in files.values())


def test_password_goes_to_the_keyring_if_there_is_one(tmp_path, monkeypatch):
    stored = {}
    keyring, backends, fail = ModuleType("keyring"), ModuleType("keyring.backends"), ModuleType("keyring.backends.fail")
    fail.Keyring = type("Keyring", (), {})
    backends.fail = fail
    keyring.get_keyring = object
    keyring.get_password = lambda service, name: stored.get((service, name))
    keyring.set_password = lambda service, name, password: stored.update({(service, name): password})
    keyring.delete_password = lambda service, name: stored.pop((service, name))
    for module in (keyring, backends, fail):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    saved = PacsConnections(tmp_path)
    saved.save(PacsConnection("a", url="https://a.example", user="u", password="geheim-1"))
    assert list(stored.values()) == ["geheim-1"]
    assert not (tmp_path / "pacs-passwords.json").exists()
    assert saved.get("a").password == "geheim-1"
    saved.remove("a")
    assert not stored


def test_removed_connection_leaves_no_password(tmp_path):
    saved = PacsConnections(tmp_path)
    saved.save(PacsConnection("a", url="https://a.example", user="u", password="geheim-1"))
    saved.remove("a")
    assert saved.all() == ()
    assert not any("geheim" in path.read_text() for path in tmp_path.iterdir())


def test_unknown_name_is_refused_with_the_known_ones(tmp_path):
    saved = PacsConnections(tmp_path)
    saved.save(PacsConnection("a", host="a.example"))
    with pytest.raises(UsageError, match="saved: a"):
        saved.get("b")


def test_damaged_settings_are_refused(tmp_path):
    (tmp_path / "pacs.json").write_text("{")
    with pytest.raises(PacsError, match=r"delete .*pacs\.json"):
        PacsConnections(tmp_path).all()


def test_invalid_saved_connection_is_left_out(tmp_path):
    PacsConnections(tmp_path).save(PacsConnection("a", host="a.example"))
    values = json.loads((tmp_path / "pacs.json").read_text())
    (tmp_path / "pacs.json").write_text(json.dumps({**values, "b": {"url": 5}, "c": 7}))
    assert [one.name for one in PacsConnections(tmp_path).all()] == ["a"]


def test_repr_of_a_connection_has_no_password():
    assert "geheim" not in repr(PacsConnection("a", url="https://a.example", user="u", password="geheim-1"))


@pytest.mark.parametrize(
    "values",
    [
        {"name": ""},
        {"name": "a/b", "host": "x"},
        {"name": "a"},
        {"name": "a", "host": "x y"},
        {"name": "a", "host": "x", "port": 0},
        {"name": "a", "host": "x", "listen_port": 70000},
        {"name": "a", "host": "x", "called_ae": "SEVENTEEN-LETTERS"},
        {"name": "a", "host": "x", "calling_ae": " "},
        {"name": "a", "url": "ftp://x"},
        {"name": "a", "url": "http://["},
        {"name": "a", "url": 5},
        {"name": "a", "host": "x", "tls": True, "listen_port": 11112},
        {"name": "a", "host": "x", "listen_port": 11112},
        {"name": "a", "url": "https://u:p@x.example"},
    ],
)
def test_invalid_connections_are_refused(values):
    with pytest.raises(UsageError) as found:
        PacsConnection(**values)
    assert found.value.code == "usage.pacs"
